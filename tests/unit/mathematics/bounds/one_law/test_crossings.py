"""Which counts reject a candidate, against a look at every count."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.one_law import failures
from perfbound.orchestrator.mathematics.bounds.one_law.crossings import MARGIN, Counts, Side
from perfbound.orchestrator.mathematics.bounds.one_law.failures import log_wealth_above, log_wealth_below
from perfbound.orchestrator.mathematics.bounds.rounding import STEP

Root = Callable[[int, int, float, int], int]
ABOVE, BELOW = Side(log_wealth_above, falls=True), Side(log_wealth_below, falls=False)


def counts_of(failed: list[bool], start: tuple[int, int] = (0, 0)) -> Counts:
    """Return the counts after each sample, with some failures and samples before the first one."""
    return Counts(start[0] + np.cumsum(failed), start[1] + np.arange(1, len(failed) + 1))


paths = st.lists(st.booleans(), min_size=1, max_size=80)
before = st.tuples(st.integers(0, 300), st.integers(0, 3_000)).map(lambda pair: (pair[0], pair[0] + pair[1]))


class TestFirst:
    @given(paths, before, st.floats(0.001, 0.9), st.floats(-2, 6))
    @settings(max_examples=200, deadline=None)
    def test_it_is_the_first_one(self, failed: list[bool], start: tuple[int, int], p: float, threshold: float) -> None:
        among = counts_of(failed, start)
        wanted = [log_wealth_above(p, *pair) >= threshold for pair in among.pairs()]
        assert ABOVE.first(p, among, threshold) == (wanted.index(True) if True in wanted else None)

    @pytest.mark.parametrize("count", [10**4, 10**6])
    def test_a_threshold_that_is_just_reached_is_found(self, count: int) -> None:
        failed = np.random.default_rng(count).random(2_000) < 0.1
        among = counts_of(failed.tolist(), (count // 10, count))
        wealth = [log_wealth_above(0.1, *pair) for pair in among.pairs()]
        assert ABOVE.first(0.1, among, max(wealth)) == int(np.argmax(wealth))
        assert ABOVE.first(0.1, among, math.nextafter(max(wealth), math.inf)) is None
        assert ABOVE.first(0.1, among, min(wealth)) == 0


class TestBest:
    @given(paths, before, st.sampled_from([0.05, 0.5, 0.95, 1e-9]))
    @settings(max_examples=100, deadline=None)
    def test_the_bound_is_that_of_all_counts_in_their_order(
        self, failed: list[bool], start: tuple[int, int], delta: float
    ) -> None:
        among = counts_of([True, *failed], start)
        sides = (
            (ABOVE, failures._least_rejected, STEP, min),
            (BELOW, failures._largest_rejected, 0, max),
        )
        for side, root, first, best in sides:
            alone = [root(k, n, delta, first) for k, n in among.pairs()]

            def tighten(k: int, n: int, bound: int, root: Root = root) -> int:
                return root(k, n, delta, bound)

            bound = first
            for k, n in among.pairs():
                bound = tighten(k, n, bound)
            assert side.best(first, among, failures._threshold(delta), tighten) == bound == best(alone)

    def test_a_bound_at_the_end_stays(self) -> None:
        def refuse(k: int, n: int, bound: int) -> int:
            raise AssertionError

        among = counts_of([True, False, True])
        assert ABOVE.best(1, among, 3.0, refuse) == 1
        assert BELOW.best(STEP - 1, among, 3.0, refuse) == STEP - 1


@given(paths, before, st.floats(0.001, 0.9))
@settings(max_examples=100, deadline=None)
def test_counts_that_are_passed_over_are_below_the_threshold(
    failed: list[bool], start: tuple[int, int], p: float
) -> None:
    for side, among in ((ABOVE, counts_of(failed, start)), (BELOW, counts_of([True, *failed], start))):
        wealth = max(side.wealth(p, *pair) for pair in among.pairs())
        for more in (0.0, MARGIN, 0.01, 0.1, 1.0, 10.0):
            passed_over = side._likeliest(p, among, wealth + more) is None
            assert not passed_over or more >= MARGIN
