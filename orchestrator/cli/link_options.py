"""The options of the link to the workers, and of the live page."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from ..run.page.address import Address
from ..run.page.page_access import PagePlace
from .web_option import web_options

if TYPE_CHECKING:
    from ...schemas.link.configuration import Tls
    from ..run.link import Link

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
TLS_OPTIONS: tuple[Decorator, ...] = (
    click.option("--tls-key", default=None, help="PEM file of the private key of this side."),
    click.option("--tls-certificate", default=None, help="PEM file of the certificate of this side."),
    click.option("--tls-ca", default=None, help="PEM file of the authority that signed both sides' certificates."),
)


def connect_option(*, text: str) -> Decorator:
    """Return the option `--connect`."""
    return click.option(
        "--connect",
        "routers",
        multiple=True,
        metavar="ENDPOINT",
        help=f"{text}; may be repeated.",
    )


def names_option(option: str, kind: str) -> Decorator:
    """Return an option for the common names of certificates of one kind."""
    text = f"With TLS: let in the {kind} whose certificate has the common name NAME; may be repeated."
    return click.option(option, multiple=True, metavar="NAME", help=text)


def link_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of the endpoint for workers and of the live page."""
    page = web_options(
        "Serve a live page.  [default of HOST:PORT: loopback and a free port]",
        is_flag=False,
        flag_value=Address(),
        default=None,
    )
    return worker_options(page(command))


def worker_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of the endpoint for workers."""
    options: tuple[Decorator, ...] = (
        click.option(
            "--allow",
            multiple=True,
            metavar="NAME",
            help="With TLS: accept the worker NAME, whose certificate has this common name, and no unnamed one; may be "
            "repeated.",
        ),
        *TLS_OPTIONS,
        click.option(
            "--insecure", is_flag=True, help="Allow listening or serving a page beyond this machine without TLS."
        ),
        click.option(
            "--grace",
            type=click.FloatRange(0, 86_400),
            default=30.0,
            show_default=True,
            metavar="SECONDS",
            help="With --connect: time for workers to return after a router has come or gone.",
        ),
        connect_option(text="Endpoint of a router, to which the workers connect as well"),
        click.option(
            "--listen", "endpoint", default=None, help="Endpoint for workers.  [default: loopback and a free port]"
        ),
    )
    for option in options:
        command = option(command)
    return command


def link_of(
    endpoint: str | None,
    *,
    routers: tuple[str, ...],
    insecure: bool,
    allow: tuple[str, ...],
    grace: float,
    web: PagePlace | None = None,
    **tls: str | None,
) -> "Link":
    """Return the link of the options.

    Raises:
        UsageError: options do not belong together.

    """
    from ...schemas.link.configuration import LOCAL  # noqa: PLC0415
    from ..run.link import Link  # noqa: PLC0415

    if endpoint is not None and routers:
        raise click.UsageError("--listen and --connect exclude each other: workers connect here, or to the router")
    return Link(endpoint or LOCAL, tls_of(**tls), insecure, web, allow, routers, grace)


def tls_of(tls_ca: str | None, tls_certificate: str | None, tls_key: str | None) -> "Tls | None":
    """Return the files of the options.

    Raises:
        UsageError: one of them is missing.

    """
    from ...schemas.link.configuration import Tls  # noqa: PLC0415

    if not (tls_ca or tls_certificate or tls_key):
        return None
    if tls_ca is None or tls_certificate is None or tls_key is None:
        raise click.UsageError("--tls-ca, --tls-certificate and --tls-key belong together")
    return Tls(ca=tls_ca, certificate=tls_certificate, key=tls_key)
