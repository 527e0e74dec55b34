"""A router between orchestrators and workers, which all connect to it: a Zenoh session and a token of its own."""

import threading
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import zenoh

from ....schemas.link import key_expressions, seal
from ....schemas.link.configuration import Tls
from ....schemas.link.ends import fresh_name
from . import sessions
from .sender import within_patience

CHANNEL = 4096
"""Tokens that may wait for the thread that counts them."""
MOST = 20_000
"""Tokens that are counted: anyone whom the link lets in may declare some."""
NAMES = {"router": "other router", "orchestrator": "orchestrator", "worker": "worker"}
"""What connects, by its word in a key."""


class Router:
    """A router that is open; any thread may ask it."""

    def __init__(self, session: zenoh.Session, endpoints: Sequence[str], name: str) -> None:
        self.endpoints = tuple(endpoints)
        self._session, self._own = session, key_expressions.live_router(name)
        self._alive: dict[str, str] = {}
        """What each token is of."""
        liveliness = session.liveliness()
        everything = liveliness.declare_subscriber(
            f"{key_expressions.ROOT}/**", zenoh.handlers.FifoChannel(CHANNEL), history=True
        )
        self._thread = threading.Thread(target=self._watch, args=(everything,), daemon=True)
        self._thread.start()
        self._token = liveliness.declare_token(self._own)

    @property
    def connected(self) -> str:
        """How many of each kind there are, behind this router and those that it is linked with."""
        counts = Counter(self._alive.copy().values())
        return ", ".join(f"{counts[kind]} {name}{'' if counts[kind] == 1 else 's'}" for kind, name in NAMES.items())

    def close(self) -> None:
        """Withdraw the token, and close the links."""
        within_patience(self._close)

    def _close(self) -> None:
        self._token.undeclare()  # type: ignore[no-untyped-call]
        self._session.close()  # type: ignore[no-untyped-call]
        self._thread.join()

    def _watch(self, tokens: Any) -> None:
        try:
            for sample in tokens:
                key = str(sample.key_expr)
                if sample.kind != zenoh.SampleKind.PUT:
                    self._alive.pop(key, None)
                elif key != self._own and len(self._alive) < MOST and (kind := key_expressions.kind_of(key)) in NAMES:
                    self._alive[key] = kind
        except zenoh.ZError:
            return  # the session is closed


@contextmanager
def route(
    endpoints: Sequence[str],
    routers: Sequence[str],
    tls: Tls | None,
    *,
    insecure: bool,
    secret: bytes | None,
    access: Mapping[str, Any] | None,
) -> Iterator[Router]:
    """Open a router that listens at `endpoints`, and links itself with other `routers`.

    With `secret`, those that know it are let in; with `access`, the rules of `schemas.link.access.router_rules` apply.

    Raises:
        PerfboundError: an endpoint is in use, malformed, or open to others without TLS.

    """
    session, chosen = sessions.routing(endpoints, routers, tls, insecure=insecure, secret=secret, access=access)
    router = Router(session, chosen, seal.router_name(secret or b"", fresh_name(by_certificate=access is not None)))
    try:
        yield router
    finally:
        router.close()
