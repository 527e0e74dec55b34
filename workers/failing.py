"""The end of a command of the worker side with an error."""

import sys
from typing import NoReturn

import click

from ..schemas.errors import one_line


def fail(*reasons: str) -> NoReturn:
    """Print each reason in one line on stderr, and exit with 1."""
    for reason in reasons:
        click.echo(f"perfbound-worker: {one_line(reason)}", err=True)
    sys.exit(1)
