"""The campaigns that a worker serves, one after the other."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from perfbound.schemas.link.messages import RunFinished
from perfbound.workers import serving
from perfbound.workers.ends import EndOptions
from perfbound.workers.serving import Life, LinkOptions, serve_campaigns
from perfbound.workers.stopping import Stopping
from perfbound.workers.transport import Receiver
from tests.unit.workers.test_ends import Wire


class Uplink(Wire):
    """An uplink to one orchestrator, whose run is finished when a worker joins it."""

    linked, strangers = True, False
    joined: tuple[str, ...] = ()

    def orchestrators(self) -> list[tuple[str, str]]:
        return [("o", "r")]

    @property
    def routed(self) -> bool:
        assert self.joined, "the worker serves a run that it has not joined"
        return False

    def by_certificate(self, _orchestrator: str) -> bool:
        return False

    def join(self, run: str, worker: str, receive: Receiver) -> None:
        self.joined = (*self.joined, run, worker)
        receive(RunFinished())

    def leave(self) -> None:
        self.joined = (*self.joined, "left")


def test_a_worker_joins_the_run_that_it_serves_and_leaves_it_at_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    uplink = Uplink()

    @contextmanager
    def connect(*_: object) -> Iterator[Uplink]:
        yield uplink

    monkeypatch.setattr(serving, "connect", connect)
    life = Life(EndOptions(until_done=True), Stopping(0.0, lambda: None))
    code = serve_campaigns(LinkOptions((), None, None, ""), life, "w", run=None, identity="w-1")
    assert (code, uplink.joined) == (0, ("r", "w-1", "left"))
