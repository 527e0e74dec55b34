"""Routers in the log of a run, and what the dispatch machine hears of them."""

import time
from dataclasses import replace

from perfbound.orchestrator.fleet.dispatch.events import LinkChanged, RouterChanged
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.state import DispatchState, Worker
from perfbound.orchestrator.fleet.link.transport import Linked, RouterToken
from perfbound.orchestrator.run.display.progress import worker_line
from perfbound.orchestrator.run.routers import RouterLink, Routers
from perfbound.orchestrator.run.service import RunStatus, _phases
from tests.campaigns import config
from tests.facts import says


def log() -> tuple[Routers, list[str]]:
    lines: list[str] = []
    return Routers(lines.append), lines


def test_a_router_that_ends_is_told_where_another_one_is_left() -> None:
    routers, lines = log()
    for name in ("a", "b"):
        assert routers.take(RouterToken(1.0, 30.0, name, alive=True)) == RouterChanged(1.0, 30.0)
    assert routers.take(RouterToken(2.0, 30.0, "a", alive=False)) == RouterChanged(2.0, 30.0)
    assert lines == ["a router has ended: workers behind it have 30 s to return"]


def test_the_own_link_has_lines_of_its_own() -> None:
    routers, lines = log()
    routers.take(RouterToken(1.0, 30.0, "a", alive=True))
    routers.take(RouterToken(2.0, 30.0, "a", alive=False))
    assert routers.take(Linked(2.1, 30.0, up=False)) == LinkChanged(2.1, 30.0, up=False)
    assert routers.take(Linked(22.1, 30.0, up=True)) == LinkChanged(22.1, 30.0, up=True)
    routers.take(RouterToken(22.2, 30.0, "b", alive=True))
    assert lines == [
        "the link to the router is down: no worker is given up until it is there again",
        "the link to the router is there again after 20 s",
    ]


def test_a_link_that_is_down_is_in_the_line_of_the_workers_and_in_no_estimate() -> None:
    routers, _ = log()
    assert routers.link(0.0) is None, "an orchestrator that listens has no router"
    routers.take(Linked(1.0, 30.0, up=True))
    routers.take(RouterToken(1.0, 30.0, "a", alive=True))
    up = routers.link(2.0)
    assert up == RouterLink(None, 1)
    routers.take(Linked(10.0, 30.0, up=False))
    routers.take(RouterToken(10.0, 30.0, "a", alive=False))
    down = routers.link(22.0)
    assert down == RouterLink(12.0, 0)
    workers = {"a": "out of reach", "b": "out of reach", "c": "set aside"}
    status = RunStatus(config("test-function"), {}, {}, workers, {}, 0, 0, 30.0, link=down)
    assert says(
        worker_line(status, 0.0), "workers 3 (0 busy) 0.0 rollouts/s 30 s link down 12 s 2 out of reach trouble c"
    )
    assert "link" not in worker_line(replace(status, link=up), 0.0)


def test_while_the_link_is_down_gone_workers_are_out_of_reach() -> None:
    now = time.monotonic()
    gone = Worker("gone", resumes_as="busy", gone_at=now - 2)
    state = DispatchState(Limits(), workers={"a": gone, "b": Worker("idle")})
    assert _phases(state) == {"a": "gone", "b": "idle"}
    assert _phases(replace(state, linked=False)) == {"a": "out of reach", "b": "idle"}
    just_now = replace(state, workers={"a": replace(gone, gone_at=now + 60)})
    assert _phases(just_now) == {"a": "busy"}, "the end of the link may be the next message"


def test_a_worker_that_has_left_is_no_trouble() -> None:
    left = Worker("gone", leaving=True, resumes_as="shunned")
    state = DispatchState(Limits(), workers={"a": left, "b": replace(left, phase="shunned"), "c": Worker("shunned")})
    assert _phases(state) == {"c": "shunned"}


def test_a_router_that_shows_nothing_does_not_let_this_orchestrator_in() -> None:
    routers, lines = log()
    assert routers.take(Linked(1.0, 30.0, up=True)) == LinkChanged(1.0, 30.0, up=True)
    said = {now: line for now in (5.0, 11.0, 11.1, 30.0, 31.0) for line in routers.reminder(now)}
    assert lines == []
    assert list(said) == [11.0, 31.0], "status lines hide one line soon"
    assert says(said[11.0], "connected no router --allow")


def test_a_router_that_shows_itself_is_no_news() -> None:
    routers, lines = log()
    routers.take(Linked(1.0, 30.0, up=True))
    routers.take(RouterToken(1.2, 30.0, "a", alive=True))
    assert (routers.reminder(30.0), lines) == ((), [])


def test_a_token_that_ends_without_having_been_there_is_no_news() -> None:
    routers, lines = log()
    routers.take(RouterToken(1.0, 30.0, "a", alive=True))
    routers.take(RouterToken(2.0, 30.0, "unknown", alive=False))
    assert lines == []
