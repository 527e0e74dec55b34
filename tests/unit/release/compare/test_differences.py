"""Differences of two systems: verdicts, the worst listed start by brute force, and how delta is spent."""

from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.one_law import interval
from perfbound.orchestrator.release.compare import differences as module
from perfbound.orchestrator.release.compare.differences import Pairs, differences, overall, verdict
from perfbound.schemas.result.comparison import ComparedQuantity, ComparisonVerdict

CLIP = (-1.0, 1.0)
DIRECTIONS: tuple[Literal["larger", "smaller"], ...] = ("larger", "smaller")
Floats = np.ndarray[Any, np.dtype[np.float64]]


def pairs(a: Any, b: Any, start: list[int] | None = None, **changes: Any) -> Pairs:
    found: dict[str, Any] = {"clip": CLIP, "unit": "m", "listed": 0 if start is None else 1 + max(start)}
    return Pairs(np.array(a, dtype=np.float64), np.array(b, dtype=np.float64), start=start, **found | changes)


def verdicts(found: Pairs, **equal: float) -> dict[ComparedQuantity, ComparisonVerdict]:
    return {each.quantity: each.verdict for each in differences(found, 0.05, equal)}  # type: ignore[arg-type]


def test_a_worse_and_a_better_system_are_found_in_both_directions() -> None:
    good, bad = np.full(500, 0.5), np.where(np.arange(500) % 5, 0.4, -0.2)
    assert verdicts(pairs(good, bad)) == {"mean": "WORSE", "failure_probability": "WORSE"}
    assert verdicts(pairs(bad, good)) == {"mean": "BETTER", "failure_probability": "BETTER"}
    assert verdicts(pairs(good, bad), mean=0.5) == {"mean": "EQUAL", "failure_probability": "WORSE"}
    assert verdicts(pairs(good, bad), mean=0.22)["mean"] == "UNDECIDED", "worse, and perhaps by no more than this"
    assert verdicts(pairs(good, bad), mean=0.1)["mean"] == "WORSE"
    assert verdicts(pairs(good[:3], bad[:3])) == {"mean": "UNDECIDED", "failure_probability": "UNDECIDED"}
    found = differences(pairs(good, bad), 0.05, {})
    assert [(each.a, round(each.b, 9), each.unit) for each in found] == [(0.5, 0.28, "m"), (0.0, 0.2, "")]


def test_a_robustness_of_0_is_read_against_each_verdict() -> None:
    """It may be a violation or none, as in a certificate."""
    zero, good, bad = np.zeros(500), np.full(500, 0.1), np.full(500, -0.1)
    for one, other in ((good, zero), (zero, bad), (zero, good), (bad, zero), (zero, zero)):
        assert verdicts(pairs(one, other))["failure_probability"] == "UNDECIDED"
    assert verdicts(pairs(good, bad))["failure_probability"] == "WORSE"
    (_, found) = differences(pairs(good, zero), 0.05, {})
    assert (found.a, found.b) == (0.0, 0.0)
    assert -0.02 < found.lower < 0
    assert found.upper == 1.0


def test_without_a_clip_no_mean_is_compared() -> None:
    assert list(verdicts(pairs([5.0] * 300, [-7.0] * 300, clip=None))) == ["failure_probability"]


def test_a_difference_as_large_as_the_clip_is_compared() -> None:
    low, high = -0.05, 0.75
    assert verdicts(pairs([high] * 400, [low] * 400, clip=(low, high)))["mean"] == "WORSE"


@pytest.mark.parametrize("listed", [False, True])
def test_all_intervals_together_have_one_delta(monkeypatch: pytest.MonkeyPatch, listed: bool) -> None:
    spent = list[float]()
    own = interval.mean_interval

    def counted(values: Floats, ends: tuple[float, float], delta: float, *, about: float) -> tuple[float, float]:
        spent.append(delta)
        return own(values, ends, delta, about=about)

    monkeypatch.setattr(module, "mean_interval", counted)
    differences(pairs([0.5] * 12, [0.4] * 12, [0, 1, 2] * 4 if listed else None), 0.06, {})
    assert len(spent) == (8 if listed else 2)
    assert sum(spent) == pytest.approx(0.06)


Box = st.tuples(st.floats(-1, 1), st.floats(-1, 1)).map(lambda two: (min(two), max(two)))


@given(st.lists(st.tuples(Box, Box), min_size=1, max_size=4), st.data())
@settings(max_examples=200, deadline=None)
def test_the_worst_listed_start_is_within_its_interval_whatever_the_means_are(
    boxes: list[tuple[tuple[float, float], tuple[float, float]]], data: st.DataObject
) -> None:
    of_a, apart = zip(*boxes, strict=True)
    given_ones = iter([*of_a, *apart])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "mean_interval", lambda *_, **__: next(given_ones))
        values = np.zeros(len(boxes))
        found = module.worst_start_difference(pairs(values, values, list(range(len(boxes)))), 0.05)
    mu, difference = (
        np.array([low + share * (high - low) for (low, high), share in zip(each, shares, strict=True)])
        for each, shares in (
            (of_a, data.draw(st.lists(st.sampled_from([0, 0.5, 1]), min_size=len(boxes), max_size=len(boxes)))),
            (apart, data.draw(st.lists(st.sampled_from([0, 0.5, 1]), min_size=len(boxes), max_size=len(boxes)))),
        )
    )
    truth = (mu + difference).min() - mu.min()
    assert found.lower - 1e-15 <= truth <= found.upper + 1e-15


def test_a_start_that_is_far_from_the_worst_has_to_fall_further(monkeypatch: pytest.MonkeyPatch) -> None:
    intervals = iter([(0.0, 0.1), (0.6, 0.7), (-0.02, 0.02), (-0.3, -0.2)])
    monkeypatch.setattr(module, "mean_interval", lambda *_, **__: next(intervals))
    found = module.worst_start_difference(pairs([0.05, 0.65], [0.05, 0.4], [0, 1]), 0.05)
    assert [found.lower, found.upper] == pytest.approx([-0.02, 0.02]), "the second start does not count"
    assert (found.a, found.b) == (0.05, 0.05)


def test_one_pair_shows_all_of_a_start_without_noise() -> None:
    found = differences(pairs([0.5, 0.2, 0.5], [0.5, 0.1, 0.5], [0, 1, 0], exact=True), 0.05, {})[-1]
    assert [found.lower, found.upper] == pytest.approx([-0.1, -0.1])
    assert found.verdict == "WORSE"


def test_a_system_that_only_says_that_it_has_no_noise_is_not_believed() -> None:
    found = differences(pairs([0.5, 0.2] * 30, [0.5, 0.1, 0.3, 0.1] * 15, [0] * 60, exact=True), 0.05, {})[-1]
    assert found.lower < -0.2
    assert found.upper > 0.0


def test_of_a_start_that_was_not_drawn_yet_nothing_is_known() -> None:
    found = differences(pairs([0.5] * 50, [0.5] * 50, [0] * 50, listed=2, exact=True), 0.05, {})[-1]
    assert (found.lower, found.upper) == (-2.0, 2.0)
    assert found.verdict == "UNDECIDED"


@pytest.mark.parametrize("lower", [-0.2, -0.1, 0.0, 0.05, 0.1, 0.15])
@pytest.mark.parametrize("upper", [-0.15, -0.1, 0.0, 0.1, 0.2])
def test_a_verdict_turns_round_with_the_direction(lower: float, upper: float) -> None:
    if lower > upper:
        return
    swapped: dict[ComparisonVerdict, ComparisonVerdict] = {"BETTER": "WORSE", "WORSE": "BETTER"}
    for equal in (None, 0.1):
        one, other = (verdict(lower, upper, better, equal) for better in DIRECTIONS)
        assert swapped.get(one, one) == other
        assert verdict(-upper, -lower, "larger", equal) == other
        assert (one == "EQUAL") == (equal is not None and -equal <= lower and upper <= equal)
        if equal is None:
            assert (one == "UNDECIDED") == (lower <= 0.0 <= upper)
        elif one in swapped:
            assert min(abs(lower), abs(upper)) > equal


EVERY: list[tuple[list[ComparisonVerdict], ComparisonVerdict]] = [
    (["EQUAL", "EQUAL"], "EQUAL"),
    (["EQUAL", "BETTER"], "BETTER"),
    (["BETTER", "UNDECIDED", "EQUAL"], "UNDECIDED"),
    (["UNDECIDED", "WORSE", "BETTER"], "WORSE"),
]


@pytest.mark.parametrize(("each", "expected"), EVERY)
def test_the_verdict_on_all_is_the_one_that_a_release_must_not_overlook(
    each: list[ComparisonVerdict], expected: ComparisonVerdict
) -> None:
    assert overall(each) == expected
