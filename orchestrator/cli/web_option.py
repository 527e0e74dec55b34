"""The option `--web`: the address of a live page."""

from collections.abc import Callable
from typing import Any

import click

from ..run.address import Address


class _Place(click.ParamType[Address]):
    name = "HOST:PORT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Address:
        """Read an address."""
        if isinstance(value, Address):
            return value
        try:
            return Address.parse(value)
        except ValueError as error:
            self.fail(f"{error}; put --web last if you give it no value", param, ctx)


def web_option(text: str, **settings: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option `--web` with its help."""
    return click.option("--web", type=_Place(), metavar="[HOST:PORT]", help=text, **settings)
