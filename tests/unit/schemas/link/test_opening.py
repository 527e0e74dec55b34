"""The tries until a link opens, and the lines while there is none."""

import itertools

import pytest

from perfbound.schemas.link import unanswered
from perfbound.schemas.link.reminder import MOST, Reminder, StateLines
from perfbound.schemas.link.unanswered import first_opened


def test_lines_about_a_state_that_lasts_become_rare() -> None:
    reminder = Reminder(5.0, now=100.0)
    assert not reminder.printed
    hour = [now - 100 for now in range(100, 3700) if reminder.is_due(now)]
    assert hour[:3] == [5, 15, 35]
    assert {later - earlier for earlier, later in itertools.pairwise(hour[6:])} == {MOST}
    assert len(hour) < 20, "a fleet of a thousand workers writes them all into one log"
    assert reminder.printed


def test_the_end_of_a_state_is_one_line_if_the_state_was_one(monkeypatch: pytest.MonkeyPatch) -> None:
    now, printed = 0.0, list[str]()
    monkeypatch.setattr("perfbound.schemas.link.reminder.time.monotonic", lambda: now)
    lines = StateLines(lambda: "none", "there", printed.append, first=5.0)
    lines.see(lasts=False)
    for now in (1000.0, 1004.0):  # noqa: B007  (the clock)
        lines.see(lasts=True)
    lines.see(lasts=False)
    assert printed == [], "a short break"
    for now in (2000.0, 2005.0, 2005.1, 2014.9, 2015.0):  # noqa: B007
        lines.see(lasts=True)
    for _ in range(2):
        lines.see(lasts=False)
    assert printed == ["none", "none", "there"]
    for now in (3000.0, 3005.0):  # noqa: B007
        lines.see(lasts=True)
    assert printed[3:] == ["none"], "the next break begins anew"


@pytest.mark.integration
def test_each_endpoint_is_tried_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unanswered, "PAUSE", 0.0)
    tried: list[str] = []

    def open_session(config: str) -> str:
        tried.append(config)
        if len(tried) < 4:
            raise KeyError(config)
        return config.upper()

    waits: list[int] = []
    assert first_opened(itertools.cycle("ab"), open_session, KeyError, lambda: waits.append(len(tried))) == "B"
    assert (tried, waits) == (["a", "b", "a", "b"], [1, 2, 3])


def test_a_side_may_end_between_two_tries() -> None:
    def end() -> None:
        raise SystemExit(3)

    with pytest.raises(SystemExit):
        first_opened(itertools.repeat("a"), lambda _: 1 // 0, ZeroDivisionError, end)
