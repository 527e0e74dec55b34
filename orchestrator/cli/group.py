"""The command group, to which the modules beside this one add their commands, and what those share."""

import sys
from pathlib import Path
from typing import Any

import click

RUN_DIRECTORY = click.Path(path_type=Path, file_okay=False)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="perfbound", prog_name="perfbound")
def cli() -> None:
    """Test campaigns for safety-critical systems that end with a certificate."""


def output_console() -> Any:
    """Return a console for the output of a command, on stdout."""
    from rich.console import Console  # noqa: PLC0415

    return Console(soft_wrap=True, width=None if sys.stdout.isatty() else 100)
