"""Lines about messages of peers: some are shown, the others are counted."""

from perfbound.orchestrator.run.throttle import ALL, EACH, PERIOD, Throttle


def test_ten_lines_of_a_kind_from_a_worker_are_shown_in_a_minute() -> None:
    throttle = Throttle()
    shown = [throttle.admits(second, "ignored messages", "w") for second in range(50)]
    assert shown == [True] * EACH + [False] * 40
    assert throttle.admits(50, "ignored messages", "v"), "another worker"
    assert throttle.admits(50, "failed attempts", "w"), "another kind"
    assert throttle.summaries(PERIOD - 1) == []
    assert throttle.summaries(PERIOD) == ["40 more ignored messages in 60 s, not shown"]
    assert throttle.admits(PERIOD, "ignored messages", "w"), "the next minute"
    assert throttle.summaries(PERIOD) == [], "said once"


def test_names_without_end_fill_neither_the_terminal_nor_the_memory() -> None:
    throttle = Throttle()
    shown = sum(throttle.admits(0.0, "refused workers", f"w{number}") for number in range(100_000))
    assert shown == ALL
    assert throttle.summaries(PERIOD) == [f"{100_000 - ALL} more refused workers in 60 s, not shown"]
    assert sum(len(period.shown) for period in throttle._periods.values()) == 0
    for number in range(100_000):
        throttle.admits(0.0, "refused workers", f"w{number}")
    assert sum(len(period.shown) for period in throttle._periods.values()) == ALL
