"""The command group, to which the modules beside this one add their commands, and what those share."""

import os
import sys
from pathlib import Path
from typing import Any

import click

from ...schemas.link.secret import WEB_VARIABLE


class RunDirectory(click.Path):
    """The directory of a run; of a file the message says which one may be meant."""

    def __init__(self) -> None:
        super().__init__(path_type=Path, file_okay=False)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; raise BadParameter for a file."""
        path = Path(value)
        if path.is_file():
            meant = path.parent if (path.parent / "campaign.db").exists() else Path("runs", path.stem)
            self.fail(f"{value} is a file; give the directory of a run, such as {meant}", param, ctx)
        return super().convert(value, param, ctx)


RUN_DIRECTORY = RunDirectory()


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="perfbound", prog_name="perfbound")
@click.pass_context
def cli(context: click.Context) -> None:
    """Test campaigns for safety-critical systems that end with a certificate."""
    # Before anything is started: no child process gets it.
    context.obj = os.environ.pop(WEB_VARIABLE, None)


def output_console() -> Any:
    """Return a console for the output of a command, on stdout."""
    from rich.console import Console  # noqa: PLC0415

    return Console(soft_wrap=True, width=None if sys.stdout and sys.stdout.isatty() else 100)
