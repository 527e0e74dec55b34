"""Commands that help with the others: the completion of a shell, the meaning of a word."""

import click

from .group import cli

PLACES = {
    "bash": "~/.local/share/bash-completion/completions/perfbound",
    "zsh": '"${fpath[1]}/_perfbound"',
    "fish": "~/.config/fish/completions/perfbound.fish",
}
"""Where each shell finds completion scripts of its user."""


@cli.command()
@click.argument("shell", type=click.Choice(tuple(PLACES)))
def completion(*, shell: str) -> None:
    """Print the script that completes commands, options and files in SHELL.

    \b
    perfbound completion bash > ~/.local/share/bash-completion/completions/perfbound
    perfbound completion zsh > "${fpath[1]}/_perfbound"
    perfbound completion fish > ~/.config/fish/completions/perfbound.fish
    """
    from click.shell_completion import get_completion_class  # noqa: PLC0415

    found = get_completion_class(shell)
    assert found is not None, "click has these shells"
    script = found(cli, {}, "perfbound", "_PERFBOUND_COMPLETE").source().strip()
    # At the end: zsh needs its own comment in the first line.
    click.echo(f"{script}\n# To install: perfbound completion {shell} > {PLACES[shell]}")


@cli.command()
@click.argument("word", nargs=-1)
def explain(*, word: tuple[str, ...]) -> None:
    """Explain a WORD of the field, such as margin, B or alpha, in one sentence; without one, list all words."""
    from ..report.glossary import entries_of, glossary  # noqa: PLC0415

    for entry in entries_of(" ".join(word)) if word else glossary():
        click.echo(f"{entry}: {glossary()[entry]}")
