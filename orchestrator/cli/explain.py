"""The command that explains a word."""

import click

from .group import cli


@cli.command()
@click.argument("word", nargs=-1)
def explain(*, word: tuple[str, ...]) -> None:
    """Explain a WORD of the field, such as margin, B or alpha, in one sentence; without one, list all words."""
    from ..report.glossary import entries_of, glossary  # noqa: PLC0415

    for entry in entries_of(" ".join(word)) if word else glossary():
        click.echo(f"{entry}: {glossary()[entry]}")
