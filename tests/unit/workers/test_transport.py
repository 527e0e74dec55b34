"""The orchestrators and routers that a worker sees by their tokens."""

from collections.abc import Iterable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.ends import fresh_name
from perfbound.schemas.link.seal import orchestrator_name, router_name
from perfbound.workers.transport import ZenohUplink

ORCHESTRATOR = orchestrator_name(b"secret", "r", fresh_name(by_certificate=False))
STRICT_ROUTER = router_name(b"secret", fresh_name(by_certificate=True))
PUT, DELETE = zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE


class Session:
    """A Zenoh session in which tokens appear and go; it is closed after the last one."""

    def __init__(self, key: str, kinds: Iterable[zenoh.SampleKind]) -> None:
        self._key, self._kinds = key, kinds

    def liveliness(self) -> "Session":
        return self

    def declare_subscriber(self, key: str, *_: object, **__: object) -> Iterator[SimpleNamespace]:
        mine = zenoh.KeyExpr(key).includes(zenoh.KeyExpr(self._key))
        return iter([SimpleNamespace(kind=kind, key_expr=self._key) for kind in self._kinds] if mine else [])


@pytest.mark.parametrize("kinds", [[PUT], [PUT, DELETE], [PUT, DELETE, PUT]], ids=["comes", "goes", "returns"])
def test_an_orchestrator_and_a_router_are_there_while_their_tokens_are(kinds: list[zenoh.SampleKind]) -> None:
    def seen(key: str) -> ZenohUplink:
        uplink = ZenohUplink(cast("Any", Session(key, kinds)), b"secret")
        uplink.wait_closed()
        return uplink

    there = kinds[-1] == PUT
    assert seen(key_expressions.live_orchestrator("r", ORCHESTRATOR)).orchestrators() == (
        [(ORCHESTRATOR, "r")] if there else []
    )
    assert seen(key_expressions.live_router(STRICT_ROUTER)).by_certificate(ORCHESTRATOR) == there
