"""Beta mixtures against exact integrals, and failure probability and quantile against small exact cases."""

import itertools
import math
from collections.abc import Callable
from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.one_law.failures import (
    FailureSequence,
    QuantileSequence,
    beta_mixture_lower,
    beta_mixture_upper,
    log_wealth_above,
    log_wealth_below,
)
from perfbound.orchestrator.mathematics.bounds.one_law.share import clopper_pearson_lower, clopper_pearson_upper
from tests.fakes.states import blocks, sizes, state_of

STEP = Fraction(1, 10**9)


@cache
def exact_above(p: Fraction, failures: int, count: int) -> Fraction:
    """Return W against P >= p by expanding (1 - p u)^(n - k) in the integral, exactly."""
    good = count - failures
    terms = (math.comb(good, i) * (-p) ** i / (2 * (failures + i) + 1) for i in range(good + 1))
    return sum(terms, Fraction(0)) / (1 - p) ** good


def numeric_below(p: float, failures: int, count: int) -> float:
    """Return W against P <= p by the midpoint rule in w = sqrt(u)."""
    w = math.sqrt(p) + (1 - math.sqrt(p)) * (np.arange(200_000) + 0.5) / 200_000
    u = w * w
    return float((u**-failures * ((1 - p / u) / (1 - p)) ** (count - failures)).mean() * (1 - math.sqrt(p)))


class TestWealth:
    @pytest.mark.parametrize("p", [Fraction(1, 1000), Fraction(1, 10), Fraction(1, 2), Fraction(99, 100)])
    @pytest.mark.parametrize(("failures", "count"), [(0, 1), (1, 1), (0, 40), (3, 40), (20, 40), (39, 40), (40, 40)])
    def test_above_is_the_integral(self, failures: int, count: int, p: Fraction) -> None:
        exact = math.log(exact_above(p, failures, count))
        assert log_wealth_above(float(p), failures, count) == pytest.approx(exact, abs=1e-9)

    @pytest.mark.parametrize("p", [0.001, 0.1, 0.5, 0.99])
    @pytest.mark.parametrize(("failures", "count"), [(1, 1), (1, 40), (3, 40), (20, 40), (40, 40)])
    def test_below_is_the_integral(self, failures: int, count: int, p: float) -> None:
        assert log_wealth_below(p, failures, count) == pytest.approx(
            math.log(numeric_below(p, failures, count)), rel=1e-3, abs=1e-3
        )

    @pytest.mark.parametrize("p", [0.05, 0.5, 0.9])
    def test_the_mean_wealth_is_what_was_bet(self, p: float) -> None:
        """Exactly 1 for the upper bound; u < p and a record without failures are left out for the lower one."""
        chances = [math.comb(30, k) * p**k * (1 - p) ** (30 - k) for k in range(31)]
        above, below = (
            sum(chance * math.exp(wealth(p, k, 30)) for k, chance in enumerate(chances))
            for wealth in (log_wealth_above, log_wealth_below)
        )
        assert above == pytest.approx(1, abs=1e-9)
        assert below + chances[0] * numeric_below(p, 0, 30) == pytest.approx(1 - math.sqrt(p), abs=1e-4)

    @given(st.integers(1, 400), st.floats(0, 1), st.floats(1e-6, 0.999), st.floats(1e-6, 0.999))
    @settings(max_examples=200, deadline=None)
    def test_it_is_monotone_in_the_candidate(self, count: int, part: float, a: float, b: float) -> None:
        low, high, failures = min(a, b), max(a, b), int(part * count)
        assert log_wealth_above(low, failures, count) <= log_wealth_above(high, failures, count) + 1e-9
        assert log_wealth_below(low, failures, count) >= log_wealth_below(high, failures, count) - 1e-9

    @pytest.mark.parametrize("count", [300, 322, 323, 324, 400])
    def test_a_tail_below_the_least_double_is_no_error(self, count: int) -> None:
        assert log_wealth_above(0.1, count, count) < 0
        assert log_wealth_below(0.9, 1, count) < 0

    @pytest.mark.parametrize("count", [10**3, 10**6, 10**9])
    def test_errors_of_the_functions_are_far_below_the_margin(self, count: int) -> None:
        """Failure-free, W is a known integral: sqrt(pi/(4 n p)) (1 - p)^-n for small p, to first order in 1/(n p)."""
        p = 20 / count
        about = -count * math.log1p(-p) + math.log(0.5 * math.sqrt(math.pi / 20)) + math.log(math.erf(math.sqrt(20)))
        assert log_wealth_above(p, 0, count) == pytest.approx(about, abs=3 * p + 1e-5)


class TestBounds:
    @given(st.integers(1, 60), st.floats(0, 1), st.sampled_from([0.05, 0.01, 0.5]))
    @settings(max_examples=40, deadline=None)
    def test_the_upper_one_is_rejected_in_exact_arithmetic_and_least(
        self, count: int, part: float, delta: float
    ) -> None:
        failures, level = int(part * count), 1 / Fraction(repr(delta))
        p = Fraction(repr(beta_mixture_upper(failures, count, delta)))
        assert p == 1 or exact_above(p, failures, count) >= level
        assert exact_above(p - 2 * STEP, failures, count) < level * (1 + Fraction(2, 10**4))

    @given(st.integers(1, 60), st.floats(0, 1), st.sampled_from([0.05, 0.01, 0.5]))
    @settings(max_examples=40, deadline=None)
    def test_the_lower_one_is_the_root(self, count: int, part: float, delta: float) -> None:
        failures = int(part * count)
        p = beta_mixture_lower(failures, count, delta)
        assert p == 0 or log_wealth_below(p, failures, count) >= math.log(1 / delta)
        assert log_wealth_below(p + 2e-9, failures, count) < math.log((1 + 2e-4) / delta)

    @pytest.mark.parametrize("count", [299, 1000, 10_000])
    def test_the_price_of_all_n_at_once(self, count: int) -> None:
        """At most 30 % above Clopper-Pearson without failures, and 45 % with 1 to 10: the limits that are promised."""
        ratio = [beta_mixture_upper(k, count, 0.05) / clopper_pearson_upper(k, count, 0.05) for k in range(11)]
        assert ratio[0] <= 1.30
        assert max(ratio[1:]) <= 1.45
        assert min(ratio) > 1

    @given(st.integers(2, 500), st.floats(0, 1))
    @settings(max_examples=60, deadline=None)
    def test_it_is_never_inside_clopper_pearson(self, count: int, part: float) -> None:
        failures = int(part * count)
        assert beta_mixture_upper(failures, count, 0.05) >= clopper_pearson_upper(failures, count, 0.05) - 1e-9
        assert beta_mixture_lower(failures, count, 0.05) <= clopper_pearson_lower(failures, count, 0.05) + 1e-9

    @pytest.mark.parametrize("given", [(-1, 5, 0.05), (6, 5, 0.05), (0, 0, 0.05), (0, 5, 0.0), (0, 5, 1.0)])
    @pytest.mark.parametrize("bound", [beta_mixture_lower, beta_mixture_upper])
    def test_bad_input(self, bound: Callable[..., float], given: tuple[int, int, float]) -> None:
        with pytest.raises(ValueError, match="must be"):
            bound(*given)


class TestFailureSequence:
    @pytest.mark.rest
    @given(st.lists(st.booleans(), min_size=1, max_size=60), st.sampled_from([0.05, 0.4]))
    @settings(max_examples=60, deadline=None)
    def test_it_has_the_extremes_of_all_moments(self, record: list[bool], delta: float) -> None:
        bounds, uppers, lowers = FailureSequence(delta=delta), [1.0], [0.0]
        assert (bounds.lower(), bounds.upper()) == (0.0, 1.0)
        for n, failed in enumerate(record, start=1):
            bounds.add(failed)
            uppers.append(beta_mixture_upper(sum(record[:n]), n, delta))
            lowers.append(beta_mixture_lower(sum(record[:n]), n, delta))
            assert (bounds.count, bounds.failures) == (n, sum(record[:n]))
            assert (bounds.lower(), bounds.upper()) == (max(lowers), min(uppers))

    @pytest.mark.rest
    @pytest.mark.parametrize("p", [0.1, 0.5, 0.9])
    def test_the_exact_failure_probabilities_are_below_delta(self, p: float) -> None:
        """Every path of 10 samples."""
        too_low = too_high = 0.0
        for path in itertools.product((False, True), repeat=10):
            bounds, chance = FailureSequence(delta=0.3), p ** sum(path) * (1 - p) ** (10 - sum(path))
            for failed in path:
                bounds.add(failed)
            too_low += chance * (bounds.upper() < p)
            too_high += chance * (bounds.lower() > p)
        assert too_low <= 0.3
        assert too_high <= 0.3

    @given(
        st.lists(st.tuples(st.booleans(), st.integers(1, 40)), min_size=1, max_size=12),
        st.lists(st.integers(1, 60), max_size=8),
        st.sampled_from([0.05, 0.4, 1e-9]),
    )
    @settings(max_examples=60, deadline=None)
    def test_many_samples_at_once_leave_the_state_of_one_after_the_other(
        self, series: list[tuple[bool, int]], cuts: list[int], delta: float
    ) -> None:
        record = np.repeat([failed for failed, _ in series], [length for _, length in series])
        for only in (None, "upper", "lower"):
            one, other = (FailureSequence(delta=delta, only=only) for _ in range(2))
            for failed in record.tolist():
                one.add(failed)
            for part in blocks(len(record), cuts):
                other.add_each(record[part])
            assert state_of(one) == state_of(other)
            assert (one.upper(), one.lower()) == (other.upper(), other.lower())

    @pytest.mark.parametrize("p", [0.0, 0.002, 0.1, 0.5, 0.9, "falling", "rising"])
    def test_so_do_some_thousand(self, p: float | str) -> None:
        rng = np.random.default_rng(3)
        chances = np.linspace(0.0, 0.6, 5_000)[:: 1 if p == "rising" else -1] if isinstance(p, str) else p
        record = rng.random(5_000) < chances
        one, other, whole = (FailureSequence(delta=0.05) for _ in range(3))
        for failed in record.tolist():
            one.add(failed)
        for part in blocks(len(record), sizes(len(record), 3)):
            other.add_each(record[part])
        whole.add_each(record)
        assert state_of(one) == state_of(other) == state_of(whole)
        assert (one.upper(), one.lower()) == (whole.upper(), whole.lower())

    def test_one_side_has_the_bound_of_both(self) -> None:
        record = np.random.default_rng(4).random(500) < 0.2
        both, upper, lower = (
            FailureSequence(delta=0.05),
            *(FailureSequence(delta=0.05, only=only) for only in ("upper", "lower")),
        )
        for each in (both, upper, lower):
            each.add_each(record)
        assert (upper.upper(), lower.lower()) == (both.upper(), both.lower())

    def test_bad_input(self) -> None:
        with pytest.raises(ValueError, match="must be"):
            FailureSequence(delta=1.0)


GRID = [0.0, 1.0, 2.0, 3.0]


def quantile_of(values: list[float], share: float = 0.5, delta: float = 0.3) -> QuantileSequence:
    bound = QuantileSequence(share, GRID, delta=delta)
    for value in values:
        bound.add(value)
    return bound


class TestQuantileSequence:
    @given(
        st.lists(st.sampled_from([-math.inf, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, math.inf]), max_size=60),
        st.sampled_from([0.1, 0.5, 0.9]),
    )
    @settings(max_examples=60, deadline=None)
    def test_it_is_the_rule_that_all_below_are_rejected_at_some_time(self, values: list[float], share: float) -> None:
        bound, rejected = QuantileSequence(share, GRID, delta=0.3), [False] * len(GRID)
        for n, value in enumerate(values, start=1):
            bound.add(value)
            below = [sum(v < t for v in values[:n]) for t in GRID]
            rejected = [
                old or log_wealth_above(share, k, n) >= math.log((1 + 1e-4) / 0.3)
                for old, k in zip(rejected, below, strict=True)
            ]
            passed = [t for g, t in enumerate(GRID) if all(rejected[: g + 1])]
            assert bound.lower() == (passed[-1] if passed else None)
        assert bound.count == len(values)

    @pytest.mark.parametrize(("atoms", "chances"), [((-1.0, 2.5), (0.5, 0.5)), ((0.5, 1.0, 9.0), (0.3, 0.3, 0.4))])
    def test_the_exact_failure_probability_is_below_delta(
        self, atoms: tuple[float, ...], chances: tuple[float, ...]
    ) -> None:
        """Every path of 8 values; the median is the first atom at which the chances reach 1/2."""
        median, failure = atoms[0] if chances[0] >= 0.5 else atoms[1], 0.0
        for path in itertools.product(range(len(atoms)), repeat=8):
            found = quantile_of([atoms[i] for i in path]).lower()
            failure += math.prod(chances[i] for i in path) * (found is not None and found > median)
        assert failure <= 0.3

    @given(
        st.lists(st.sampled_from([-math.inf, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, math.inf]), max_size=80),
        st.lists(st.integers(1, 30), max_size=8),
        st.sampled_from([0.1, 0.5, 0.9]),
    )
    @settings(max_examples=60, deadline=None)
    def test_many_values_at_once_leave_the_state_of_one_after_the_other(
        self, values: list[float], cuts: list[int], share: float
    ) -> None:
        one, other = quantile_of(values, share), quantile_of([], share)
        for part in blocks(len(values), cuts):
            other.add_each(np.array(values)[part])
        assert state_of(one) == state_of(other)

    @pytest.mark.parametrize("share", [0.02, 0.3, 0.8])
    @pytest.mark.parametrize("law", ["uniform", "rising", "falling", "on the grid"])
    def test_so_do_some_thousand(self, law: str, share: float) -> None:
        rng, grid = np.random.default_rng(5), np.linspace(0, 1, 301).tolist()
        values = {
            "uniform": rng.uniform(0, 1, 6_000),
            "rising": np.linspace(0, 1, 6_000),
            "falling": np.linspace(1, 0, 6_000),
            "on the grid": rng.choice(grid, 6_000),
        }[law]
        one, other, whole = (QuantileSequence(share, grid, delta=0.05) for _ in range(3))
        for value in values.tolist():
            one.add(value)
        for part in blocks(len(values), sizes(len(values), 5)):
            other.add_each(values[part])
        whole.add_each(values)
        assert state_of(one) == state_of(other) == state_of(whole)
        assert one.lower() is not None

    def test_below_the_grid_there_is_no_bound(self) -> None:
        assert quantile_of([-1.0] * 200).lower() is None
        assert quantile_of([9.0] * 200).lower() == 3.0
        assert quantile_of([]).lower() is None

    def test_a_value_on_the_grid_is_not_below_it(self) -> None:
        assert quantile_of([2.0] * 200).lower() == 2.0

    @pytest.mark.parametrize(
        "call",
        [
            lambda: QuantileSequence(1.0, GRID, delta=0.05),
            lambda: QuantileSequence(0.1, [], delta=0.05),
            lambda: QuantileSequence(0.1, [0.0, 0.0], delta=0.05),
            lambda: QuantileSequence(0.1, [0.0, math.inf], delta=0.05),
            lambda: QuantileSequence(0.1, GRID, delta=0.0),
            lambda: quantile_of([math.nan]),
            lambda: quantile_of([]).add_each(np.array([1.0, math.nan])),
        ],
    )
    def test_bad_input(self, call: Callable[[], object]) -> None:
        with pytest.raises(ValueError, match="must"):
            call()
