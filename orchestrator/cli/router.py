"""`perfbound router`: carries the messages between orchestrators and workers that all connect to it."""

import signal
import sys
import threading
from collections.abc import Callable
from typing import Any

import click

from .campaigns import log_option
from .group import cli
from .link_options import TLS_OPTIONS, Decorator, connect_option, names_option, tls_of
from .stderr import STDERR

NEWS = 10.0
"""Seconds between two lines of what is connected, while that changes."""


def _options(command: Callable[..., Any]) -> Callable[..., Any]:
    options: tuple[Decorator, ...] = (
        *TLS_OPTIONS,
        names_option("--allow-router", "router"),
        names_option("--allow-orchestrator", "orchestrator"),
        names_option("--allow", "worker"),
        click.option("--insecure", is_flag=True, help="Allow listening beyond this machine without TLS."),
        connect_option(text="Endpoint of another router, with which this one shares all workers"),
        click.option(
            "--listen",
            "endpoints",
            multiple=True,
            required=True,
            metavar="ENDPOINT",
            help="Endpoint for orchestrators, workers and routers, e.g. tls/0.0.0.0:7447; may be repeated.",
        ),
    )
    for option in options:
        command = option(command)
    return command


@cli.command()
@log_option
@_options
def router(
    *,
    endpoints: tuple[str, ...],
    routers: tuple[str, ...],
    insecure: bool,
    allow: tuple[str, ...],
    allow_orchestrator: tuple[str, ...],
    allow_router: tuple[str, ...],
    **tls: str | None,
) -> None:
    """Carry the messages between orchestrators and workers, which all connect to this router.

    It stores nothing: it may be stopped and started again while campaigns run. With any --allow... it lets in what is
    named, and nothing else; a worker then speaks and reads in its own name alone.
    """
    from ...schemas.errors import LinkError  # noqa: PLC0415
    from ...schemas.link.access import router_rules  # noqa: PLC0415
    from ...schemas.link.configuration import asks_for_secret, check_own  # noqa: PLC0415
    from ...schemas.link.secret import shared_secret  # noqa: PLC0415
    from ...schemas.stop_signals import stop_signals  # noqa: PLC0415
    from ..fleet.link.router import route  # noqa: PLC0415
    from ..run.display.systemd import Systemd  # noqa: PLC0415
    from ..run.tls_end import end_announced  # noqa: PLC0415

    files, rules = tls_of(**tls), router_rules(allow, allow_orchestrator, allow_router)
    if rules is not None and files is None:
        raise LinkError("--allow: needs tls/ endpoints, --tls-ca, --tls-certificate and --tls-key")
    if files is not None:
        check_own("--listen", endpoints, files, "router")
    secret = shared_secret(loopback=all(map(asks_for_secret, endpoints)))
    ended, expired = threading.Event(), threading.Event()

    def expire() -> None:
        expired.set()
        ended.set()

    for number in stop_signals():
        signal.signal(number, lambda *_: ended.set())
    systemd, printed = Systemd(), ""
    with (
        route(endpoints, routers, files, insecure=insecure, secret=secret, access=rules) as opened,
        end_announced(None if files is None else files.certificate, _print, expire),
    ):
        _print(f"router: listening at {', '.join(opened.endpoints)}")
        systemd.ready(f"listening at {', '.join(opened.endpoints)}")
        while not ended.wait(NEWS):
            if (now := opened.connected) != printed:
                printed = now
                _print(f"router: {now}")
            systemd.alive(now)
        systemd.stopping()
    if expired.is_set():
        # No link may stay open, and whatever starts this process again gives it the certificate that is there then.
        sys.exit(1)


def _print(line: str) -> None:
    from rich.text import Text  # noqa: PLC0415

    STDERR.console.print(Text(line), soft_wrap=True)
