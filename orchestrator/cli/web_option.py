"""The option `--web`: where a live page is served."""

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
            self.fail(f"{error}; where --web is alone, it stands last", param, ctx)


def web_option(text: str, **settings: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option `--web` with its help."""
    return click.option("--web", type=_Place(), metavar="[HOST:PORT]", help=text, **settings)
