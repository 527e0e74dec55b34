"""The options of a live page: its address, its certificate, its token; a command gets all of them as one place."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import click

from ..run.page.address import Address
from ..run.page.page_access import PagePlace, PageTls


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


def web_options(text: str, **settings: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the options of a live page, with the help of `--web`; the command takes `web`, a place or None."""

    def with_options(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_place(
            *arguments: Any,
            web: Address | None,
            web_token: bool,
            web_tls_certificate: str | None,
            web_tls_key: str | None,
            **others: Any,
        ) -> Any:
            place = _page_place(web, web_tls_certificate, web_tls_key, with_token=web_token)
            return command(*arguments, web=place, **others)

        found: Callable[..., Any] = with_place
        for option in (
            click.option(
                "--web-tls-key", default=None, metavar="FILE", help="PEM file of the key of that certificate."
            ),
            click.option(
                "--web-tls-certificate",
                default=None,
                metavar="FILE",
                help="Serve the live page by https, with this PEM file of a certificate and those above it.",
            ),
            click.option(
                "--web-token",
                is_flag=True,
                help="Ask for a token on loopback as well; beyond this machine the live page always does.",
            ),
            click.option("--web", type=_Place(), metavar="[HOST:PORT]", help=text, **settings),
        ):
            found = option(found)
        return found

    return with_options


def _page_place(web: Address | None, certificate: str | None, key: str | None, *, with_token: bool) -> PagePlace | None:
    if (certificate is None) != (key is None):
        raise click.UsageError("--web-tls-certificate and --web-tls-key belong together")
    if web is None:
        if certificate is not None or with_token:
            raise click.UsageError(f"{'--web-token' if with_token else '--web-tls-certificate'}: needs --web")
        return None
    tls = None if certificate is None or key is None else PageTls(certificate, key)
    # The command group has taken it out of the environment.
    token = click.get_current_context().find_root().obj
    return PagePlace(web, tls, with_token, token)
