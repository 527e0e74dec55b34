"""Routers in the log of a run, and what the dispatch machine hears of them."""

from perfbound.orchestrator.fleet.events import LinkChanged, RouterChanged
from perfbound.orchestrator.fleet.transport import Linked, RouterToken
from perfbound.orchestrator.run.routers import Routers


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


def test_a_router_that_shows_nothing_does_not_let_this_orchestrator_in() -> None:
    routers, lines = log()
    assert routers.take(Linked(1.0, 30.0, up=True)) == LinkChanged(1.0, 30.0, up=True)
    (line,) = [line for now in (5.0, 11.0, 11.1, 30.0) for line in routers.reminder(now)]
    assert lines == []
    assert line.startswith("connected, but no router of perfbound shows itself: one that was started with --allow")


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
