"""A search by ask and tell: the starts of the search of a campaign, and one line for every misuse."""

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import perfbound as pb
from perfbound.library import search as module
from perfbound.orchestrator.mathematics.search import Falsifier
from perfbound.orchestrator.mathematics.search.goal import Every, Part
from tests.facts import facts
from tests.patience import PATIENCE

SPACE = {"gap": (20, 50), "speed": (10, 30)}
INPUT = {"throttle": {"low": 0, "high": 1, "signal": "linear", "knots": 3}, "mass": (1, 2)}


def margin(start: dict[str, Any]) -> float:
    return float(start["gap"] - start["speed"] ** 2 / 30)


def asked(search: pb.Search, tests: int) -> list[dict[str, Any]]:
    found = []
    for _ in range(tests):
        found.append(search.ask())
        search.tell(found[-1], margin(found[-1]))
    return found


def test_the_starts_are_those_of_the_search_and_of_its_seed() -> None:
    search, own = pb.Search(SPACE, seed=7), Falsifier((20.0, 10.0), (50.0, 30.0), seed=7)
    for start in asked(search, 12):
        np.testing.assert_allclose(tuple(start.values()), own.propose(), rtol=1e-7)
        own.observe(tuple(start.values()), margin(start))
    assert asked(pb.Search(SPACE, seed=7), 5) == asked(pb.Search(SPACE, seed=7), 5)
    assert asked(pb.Search(SPACE, seed=7), 5) != asked(pb.Search(SPACE), 5)
    assert repr(search).startswith("<Search over gap, speed: 12 starts told, 0 open, least margin")


def test_the_worst_is_the_least_margin_that_was_told() -> None:
    search = pb.Search(SPACE)
    assert search.worst is None
    starts = asked(search, 6)
    assert search.worst is not None
    assert search.worst == (min(starts, key=margin), min(map(margin, starts)))


def test_several_starts_are_asked_for_before_one_is_told_and_told_in_any_order() -> None:
    search = pb.Search(SPACE)
    asked(search, 4)
    starts = [search.ask() for _ in range(5)]
    assert len({tuple(each.values()) for each in starts}) == 5
    for start in reversed(starts):
        assert search.tell(start, margin(start)) == margin(start)


def test_threads_may_share_a_search() -> None:
    search, together = pb.Search(SPACE), threading.Barrier(4)

    def one(_: int) -> None:
        start = search.ask()
        together.wait(PATIENCE)
        search.tell(start, margin(start))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(one, range(8)))
    assert "8 starts told, 0 open" in repr(search)


def test_a_model_begins_with_what_is_known_beforehand() -> None:
    search, corner = pb.Search(SPACE), {"gap": 20, "speed": 30}
    for gap in (20.0, 35.0, 50.0):
        for speed in (10.0, 20.0, 30.0):
            assert search.add({"gap": gap, "speed": speed}, margin({"gap": gap, "speed": speed})) == gap - speed**2 / 30
    start = search.ask()
    assert abs(start["gap"] - corner["gap"]) < 5, "where it fails"
    assert abs(start["speed"] - corner["speed"]) < 5


def test_steps_choices_and_the_condition_of_a_space_hold() -> None:
    space = {"gap": (20, 50), "speed": {"low": 10, "high": 30, "step": 5}, "gear": {"choices": [1, 4]}}
    search = pb.Search({**space, "where": "gap > 45 and gear >= speed / 10"})
    for start in asked(search, 20):
        assert start["speed"] % 5 == 0
        assert start["gear"] in {1, 4}
        assert start["gap"] > 45
        assert start["gear"] >= start["speed"] / 10


def test_an_input_over_time_is_a_function_and_its_knots_are_parameters() -> None:
    search = pb.Search(INPUT, horizon=4.0, specification="always (speed <= 3) and always (throttle <= 2)")
    assert search.parameters == ("throttle_0", "throttle_1", "throttle_2", "mass")
    t = np.linspace(0.0, 4.0, 9)
    for _ in range(6):
        start = search.ask()
        assert start["throttle"].times == (0.0, 2.0, 4.0)
        told = search.tell(dict(start), {"t": t, "speed": start["mass"] * start["throttle"](t)})
        assert told == min(3 - max(start["mass"] * start["throttle"](t)), 2 - max(start["throttle"](t)))
    known = {"throttle_0": 0.0, "throttle_1": 1.0, "throttle_2": 0.5, "mass": 2.0}
    assert search.add(known, {"speed": [2.5]}) == 0.5


def test_the_parts_of_a_specification_have_their_models(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []

    class Kept(Falsifier):
        def __init__(self, *box: Any, **keys: Any) -> None:
            super().__init__(*box, **keys)
            made.append(keys["goal"])

        def observe(self, *told: Any) -> None:
            made.append(told[1:])
            super().observe(*told)

    monkeypatch.setattr(module, "Falsifier", Kept)
    search = pb.Search(SPACE, specification="always (x < 3 and gear == 1)", discrete=["gear"])
    assert search.tell(search.ask(), {"t": [0, 1], "x": [0, 1], "gear": [1, 2]}) == -0.5
    assert made == [Every((Part(0), Part(1))), (-0.5, (2.0, -0.5))]


def test_a_scale_compares_the_predicates_of_one_part(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []

    class Kept(Falsifier):
        def observe(self, *told: Any) -> None:
            made.append(told[1:])
            super().observe(*told)

    monkeypatch.setattr(module, "Falsifier", Kept)
    formula = "always (speed < 120 or rpm < 4750)"
    search = pb.Search(SPACE, specification=formula, scale={"speed": 100, "rpm": 5000})
    assert search.tell(search.ask(), {"speed": [100.0], "rpm": [5250.0]}) == 20.0, "the margin is the plain one"
    assert search.tell(search.ask(), {"speed": [130.0], "rpm": [5250.0]}) == -10.0
    assert made == [(0.2, ()), (-0.1, ())]


def test_windows_may_end_with_the_trajectory() -> None:
    short = {"t": [0.0, 1.0], "x": [1.0, 2.0]}
    with pytest.raises(pb.PerfboundError, match="the trajectory: "):
        (search := pb.Search(SPACE, specification="always[0,5] x < 3")).tell(search.ask(), short)
    search = pb.Search(SPACE, specification="always[0,5] x < 3", beyond="truncate")
    assert search.tell(search.ask(), pb.Trajectory(("t", "x"), np.array([[0.0, 1.0], [1.0, 2.0]]))) == 1.0


def test_blas_has_one_thread_inside_and_its_own_number_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[set[int]] = []

    def threads() -> set[int]:
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    class Seen(Falsifier):
        def propose(self, *pending: Any) -> tuple[float, ...]:
            found.append(threads())
            return super().propose(*pending)

        def observe(self, *told: Any) -> None:
            found.append(threads())
            super().observe(*told)

    monkeypatch.setattr(module, "Falsifier", Seen)
    with threadpool_limits(2):
        search = pb.Search(SPACE)
        search.tell(search.ask(), 1.0)
        search.add({"gap": 20, "speed": 10}, 1.0)
        with pytest.raises(pb.PerfboundError):
            search.tell(search.ask(), float("nan"))
        assert threads() == {2}
    assert found == [{1}] * 4


def test_what_is_no_outcome_is_refused_and_changes_nothing() -> None:
    search = pb.Search(SPACE)
    start = search.ask()
    for outcome, words in (
        (float("nan"), "the margin is nan; give a finite number"),
        (float("inf"), "the margin is inf"),
        ("2", "the margin is text"),
        (None, "the margin is None"),
        ({"x": [1.0]}, "a trajectory needs a formula"),
    ):
        with pytest.raises(pb.PerfboundError, match=facts(words)):
            search.tell(start, outcome)
    assert search.tell(start, 10**6) == 1e6
    of_formula = pb.Search(SPACE, specification="always x < 3")
    start = of_formula.ask()
    for given, words in (
        (2.0, "2.0 is no trajectory"),
        ({"t": [0.0, 1.0], "y": [0.0, 1.0]}, "the trajectory: unknown column 'x'"),
        ({"t": [0.0, 1.0], "x": [0.0, float("nan")]}, "x is nan"),
    ):
        with pytest.raises(pb.PerfboundError, match=facts(words)):
            of_formula.tell(start, given)
    assert of_formula.worst is None
    assert of_formula.tell(start, {"t": [0.0, 1.0], "x": [0.0, 1.0]}) == 2.0


def test_a_start_that_does_not_wait_is_refused() -> None:
    search = pb.Search(SPACE)
    start = search.ask()
    for other in ({**start, "gap": 21.0}, {"gap": start["gap"]}, {}, 3):
        with pytest.raises(pb.PerfboundError, match="is no start that waits for its outcome"):
            search.tell(other, 1.0)  # type: ignore[arg-type]
    start["gap"] += 1.0  # of the caller alone
    with pytest.raises(pb.PerfboundError, match="waits"):
        search.tell(start, 1.0)
    start["gap"] -= 1.0
    search.tell(start, 1.0)
    with pytest.raises(pb.PerfboundError, match="waits"):
        search.tell(start, 1.0)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ({"gap": 19, "speed": 12}, "add: gap: 19 is not allowed: allowed is 20 to 50"),
        ({"gapp": 30, "speed": 12}, "add: gapp: there is no such parameter; did you mean 'gap'?"),
        ({"gap": 30}, "add: speed: this parameter is missing; give a number from 10 to 30"),
        ({"gap": 30, "speed": float("nan")}, "add: speed is nan"),
        (3, "add: 3 is no start"),
    ],
)
def test_a_known_start_that_is_none_is_refused(start: Any, words: str) -> None:
    search = pb.Search(SPACE)
    with pytest.raises(pb.PerfboundError, match=facts(words)):
        search.add(start, 1.0)
    assert search.worst is None


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"space": [[1.0, 2.0]]}, "Search: space: give that of each parameter"),
        ({"space": {"scenarios": [[1.0], [2.0]]}}, "Search: space: give that of each parameter"),
        ({"space": {"table": [[1.0], [2.0]]}}, "Search: space: give that of each parameter"),
        ({"space": {}}, "Search: space: "),
        ({"space": {"gap": (50, 20)}}, "Search: space.gap.low: 50"),
        ({"space": {"mass": float("nan")}}, "Search: space.mass: nan"),
        ({"space": {"Gap": (20, 50)}}, "space: write gap for 'Gap'"),
        ({"space": INPUT}, "Search: space.throttle.signal: give horizon"),
        ({"space": {**SPACE, "where": "gap > 50"}}, "Search: space.where: 0 of"),
        ({"space": SPACE, "seed": -1}, "Search: seed: -1"),
        ({"space": SPACE, "specification": "always (x <"}, "Search: specification: "),
        ({"space": SPACE, "scale": {"x": 1}}, "Search: scale: specification"),
        ({"space": SPACE, "specification": "x < 1", "scale": {"y": 1}}, "Search: falsify.scale.y: no predicate"),
        ({"space": SPACE, "specification": "x < 1", "scale": {"x": 0}}, "Search: falsify.scale.x: 0"),
        ({"space": SPACE, "specification": "gear == 1"}, "Search: specification: 'gear' discrete"),
    ],
)
def test_a_search_that_is_none_is_refused(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(pb.PerfboundError, match=facts(words)):
        pb.Search(**keys)
