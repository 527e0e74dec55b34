"""The lines of a worker or orchestrator that does not come through to the other side, with the remedies."""

import contextlib
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Literal, TypeVar

from ..errors import SecretError
from .configuration import Tls, split
from .handshake import refusal, speaks_tls
from .secret import VARIABLE, secret_file

EXPECTED = {"worker": "the orchestrator or router", "orchestrator": "the router"}
"""What a side waits for."""
PROBE = 1.0
"""Seconds for a TCP connection, which something that listens accepts at once."""


def no_link(endpoints: Sequence[str], side: Literal["worker", "orchestrator"], tls: Tls | None) -> str:
    """Return the line for a link that opens at none of `endpoints`: nothing listens, or what listens refuses this side.

    `side` is this one.
    """
    return "; ".join(_no_link(endpoint, side, tls) for endpoint in endpoints)


def _no_link(endpoint: str, side: str, tls: Tls | None) -> str:
    protocol, _ = split(endpoint)
    if protocol == "quic" or not _listens(endpoint):
        certificates = ", and that both certificates are signed by --tls-ca" if protocol == "quic" else ""
        return f"no answer from {endpoint} yet; check the address, and that {EXPECTED[side]} runs{certificates}"
    host, port = _host_and_port(endpoint)
    if tls is not None:
        if reason := refusal(host, port, tls):
            return reason
        remedy = (
            f"no certificate is at fault; check that {VARIABLE} is the same on both sides, or unset, and that it is a "
            "tls/ endpoint"
        )
    elif speaks_tls(host, port):
        return f"{endpoint} is encrypted; write tls/HOST:PORT, with --tls-ca, --tls-certificate and --tls-key"
    else:
        remedy = both_ways()
    return f"something listens at {endpoint}, but refuses this {side}: {remedy}"


def no_orchestrator(endpoints: Sequence[str], run: str | None, *, strangers: bool, common_name: str) -> str:
    """Return the line for a link without an orchestrator of the run, or with one that does not know the secret."""
    place = " or ".join(endpoints)
    if strangers:
        return f"the orchestrator at {place} does not know the secret of this worker: {both_ways()}"
    which = f"run {run}" if run else "any run"
    allowed = (
        f"; if one runs, it or the router was started with --allow and must list {common_name!r}" if common_name else ""
    )
    return f"connected to {place}, waiting for an orchestrator of {which}{allowed}"


def both_ways() -> str:
    """Return how two processes get the same secret."""
    with contextlib.suppress(SecretError):
        place = f" (their secret is in {secret_file()})"
        return f"start both as the same user{place}, or set {VARIABLE} to the same text for both"
    return f"set {VARIABLE} to the same text for both"


def _host_and_port(endpoint: str) -> tuple[str, int]:
    return split(endpoint)[1], int(endpoint.rsplit(":", 1)[1])


def _listens(endpoint: str) -> bool:
    try:
        socket.create_connection(_host_and_port(endpoint), timeout=PROBE).close()
    except OSError:
        return False
    return True


# The way to a link

PAUSE = 0.3
"""Seconds between two tries, each of which takes a second where nothing answers."""
UNLINKED = 5.0
"""Seconds without a link until the first line."""

Session = TypeVar("Session")


def first_opened(
    configs: Iterator[str],
    open_session: Callable[[str], Session],
    refused: type[Exception],
    waiting: Callable[[], None],
) -> Session:
    """Return the first session that opens, with each of `configs` in turn; `waiting` is called after each other try.

    `open_session` raises `refused` if it does not open, within a second: Zenoh's own endless try ignores Ctrl-C.
    `waiting` may raise anything.
    """
    while True:
        try:
            return open_session(next(configs))
        except refused:
            waiting()
            time.sleep(PAUSE)
