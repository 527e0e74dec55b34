"""Method `scenario`: betting sequences against brute force, exact small cases, replay, allocation, bad input."""

import itertools
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.method import Integers
from perfbound.orchestrator.mathematics.bounds.one_law.betting import (
    BOLD_AND_CAREFUL,
    CAREFUL,
    BettingSequence,
    Past,
)
from perfbound.orchestrator.mathematics.bounds.one_law.predictable import RiskSequence
from perfbound.orchestrator.mathematics.bounds.one_law.risk import bhatia_davis, linearised, linearised_range
from perfbound.orchestrator.mathematics.bounds.one_law.wealth import GRID, Strategy
from perfbound.orchestrator.mathematics.bounds.rounding import ROUND_OFF
from perfbound.orchestrator.mathematics.bounds.scenario import MAX_SCENARIOS, ScenarioMethod, _ConstantScenario
from perfbound.orchestrator.mathematics.gp.kernels import Floats
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.schemas.values import Bound
from tests.fakes.observations import an_observation
from tests.fakes.states import blocks, sizes, state_of

CLIP = (-0.05, 0.75)
units = st.one_of(st.sampled_from([0.0, 0.25, 0.5, 1.0]), st.floats(0, 1))


def sequence_of(values: list[float], deltas: tuple[float, ...], imaginary: int = 1) -> BettingSequence:
    sequence, past = BettingSequence(deltas), Past(imaginary)
    for x in values:
        sequence.observe(x, past)
        past.add(x)
    return sequence


class TestRisk:
    @pytest.mark.rest
    @given(st.floats(-1, 0), st.floats(0.01, 1), st.floats(0, 2), st.floats(-1, 1), st.floats(0.01, 1))
    def test_the_range_is_that_of_a_dense_grid(self, low: float, width: float, r: float, c: float, s: float) -> None:
        clip = (low, low + width)
        least, largest = linearised_range(clip, r, c, s)
        xs = [linearised(float(v), r, c, s) for v in np.linspace(*clip, 2001)]
        slack = 1e-9 * (1 + abs(least))
        assert least - slack <= min(xs) <= least + slack
        assert max(xs) <= largest + slack
        assert largest <= max(xs) + slack + r / (2 * s) * (width / 2000) ** 2

    def test_the_range_of_the_segway(self) -> None:
        low, high = linearised_range(CLIP, 0.2, 0.7, 0.09)
        assert (low, high) == pytest.approx((-0.684, 0.75 - 0.1 * (0.0025 / 0.09 + 0.09)), abs=1e-15)
        assert linearised_range((0.0, 1.0), 0.5, 0.25, 0.25)[1] == pytest.approx(0.75 - 0.25 * (0.25 / 0.25 + 0.25))
        assert linearised_range(CLIP, 0.0, 0.7, 0.09) == pytest.approx(CLIP, abs=1e-15)

    @given(st.lists(st.floats(*CLIP), min_size=1, max_size=6), st.floats(0, 2), st.floats(-1, 1), st.floats(0.01, 1))
    def test_both_are_below_the_risk_of_any_law(self, values: list[float], r: float, c: float, s: float) -> None:
        mean, sd = float(np.mean(values)), float(np.std(values))
        risk = mean - r * sd
        assert np.mean([linearised(v, r, c, s) for v in values]) <= risk + 1e-9
        assert bhatia_davis(mean, CLIP, r) <= risk + 1e-7
        if sd > 1e-3:
            assert np.mean([linearised(v, r, mean, sd) for v in values]) == pytest.approx(risk, abs=1e-9)

    def test_bhatia_davis_vectors(self) -> None:
        assert bhatia_davis(0.558, CLIP, 0.2) == pytest.approx(0.489667, abs=5e-7)
        assert bhatia_davis(0.75, CLIP, 0.2) == bhatia_davis(9.0, CLIP, 0.2) == 0.75
        assert bhatia_davis(-0.05, CLIP, 0.2) == pytest.approx(0.35 - 0.4 * math.sqrt(1.04))

    @given(st.floats(-0.1, 0.8), st.floats(0, 0.1), st.floats(0, 2))
    def test_bhatia_davis_is_monotone(self, mean: float, more: float, r: float) -> None:
        assert bhatia_davis(mean, CLIP, r) <= bhatia_davis(mean + more, CLIP, r) + 1e-15

    @pytest.mark.parametrize(
        "call",
        [
            lambda: linearised_range((0.75, -0.05), 0.2, 0.7, 0.09),
            lambda: linearised_range((-math.inf, 0.75), 0.2, 0.7, 0.09),
            lambda: linearised_range(CLIP, -0.2, 0.7, 0.09),
            lambda: linearised_range(CLIP, 0.2, math.nan, 0.09),
            lambda: linearised_range(CLIP, 0.2, 0.7, 0.0),
            lambda: bhatia_davis(math.nan, CLIP, 0.2),
            lambda: bhatia_davis(0.5, (1.0, 1.0), 0.2),
        ],
    )
    def test_bad_input_is_refused(self, call: Any) -> None:
        with pytest.raises(ValueError, match=r"must|clip|constants"):
            call()


def brute_force(values: list[float], delta: float) -> int:
    """Return the largest g with candidates 1 .. g rejected, one candidate after the other, from the definition."""
    for g in range(1, GRID):
        m, peak, wealths = g / GRID, 1.0, [strategy.share for strategy in BOLD_AND_CAREFUL]
        for i, x in enumerate(values):
            past = [1.0, *values[:i]]
            mean = math.fsum(past) / len(past)
            variance = math.fsum(v * v for v in past) / len(past) - mean**2
            error = math.sqrt(max(variance, 0) / len(past))
            for j, strategy in enumerate(BOLD_AND_CAREFUL):
                edge = mean + strategy.optimism * error - m
                bet = min(edge / (max(variance, 0) + edge**2), strategy.cap / m) if edge > 0 else 0.0
                wealths[j] *= 1 + bet * (x - m)
            peak = max(peak, math.fsum(wealths))
        if peak < (1 + ROUND_OFF) / delta:
            return g - 1
    return GRID - 1


class TestBetting:
    @pytest.mark.rest
    @given(st.lists(units, max_size=12), st.sampled_from([0.05, 0.5]))
    @settings(max_examples=25, deadline=None)
    def test_the_bound_is_that_of_brute_force(self, values: list[float], delta: float) -> None:
        assert abs(sequence_of(values, (delta,)).rejected() - brute_force(values, delta)) <= 1

    @pytest.mark.parametrize("p", [0.25, 0.3, 0.9])
    def test_the_mean_wealth_never_exceeds_one(self, p: float) -> None:
        """Every path of 8 coin flips: E W_n(m) <= 1 at m >= p, equal at m = p; the wealth is never negative."""
        total = np.zeros(GRID)
        for path in itertools.product((0.0, 1.0), repeat=8):
            ones = sum(path)
            wealth = sequence_of(list(path), (1e-299,)).wealth()
            assert (wealth > 0).all()
            total += p**ones * (1 - p) ** (8 - ones) * wealth
        at = math.ceil(p * GRID)
        assert (total[at:] <= 1 + 1e-12).all()
        if p == 0.25:
            assert total[at] == pytest.approx(1, abs=1e-12)

    @pytest.mark.parametrize("p", [0.3, 0.5, 0.9])
    @pytest.mark.parametrize("strategies", [BOLD_AND_CAREFUL, CAREFUL])
    def test_the_exact_failure_probability_is_below_delta(self, p: float, strategies: tuple[Strategy, ...]) -> None:
        """Every path of 8 flips, the bound being looked at after each of them."""
        delta, failure = 0.3, 0.0
        for path in itertools.product((0.0, 1.0), repeat=8):
            sequence, past = BettingSequence((delta,), strategies), Past(1)
            for x in path:
                sequence.observe(x, past)
                past.add(x)
            ones = sum(path)
            failure += p**ones * (1 - p) ** (9 - ones) * (sequence.lower() > p)
        assert failure <= delta

    @pytest.mark.parametrize("value", [0.0, 0.25, 0.3, 0.5, 0.99, 1.0])
    def test_constant_values_lead_to_the_constant(self, value: float) -> None:
        lower = [sequence_of([value] * n, (0.05,)).lower() for n in (20, 200, 2000)]
        assert lower == sorted(lower)
        assert value - 0.003 < lower[-1] <= value

    @given(st.lists(units, max_size=40))
    @settings(max_examples=30, deadline=None)
    def test_monotone_in_delta_and_in_time(self, values: list[float]) -> None:
        deltas = (0.5, 0.05, 0.002)
        both, past = BettingSequence(deltas), Past(1)
        seen = [0.0]
        for x in values:
            both.observe(x, past)
            past.add(x)
            seen.append(both.lower(1))
        assert seen == sorted(seen)
        assert both.lower(0) >= both.lower(1) >= both.lower(2)
        assert [both.lower(k) for k in range(3)] == [sequence_of(values, (delta,)).lower() for delta in deltas]

    def test_nothing_is_bet_without_a_past(self) -> None:
        sequence = sequence_of([1.0], (0.05,), imaginary=0)
        assert np.array_equal(sequence.wealth(), np.ones(GRID))

    def test_the_wealth_stays_finite(self) -> None:
        sequence = sequence_of([1.0] * 200 + [0.0] * 200, (1e-299,))
        assert np.isfinite(sequence.wealth()).all()
        assert sequence.wealth().max() <= 2e300

    @pytest.mark.parametrize("bad", [-1e-9, 1.0000001, math.nan, math.inf])
    def test_a_value_outside_is_refused(self, bad: float) -> None:
        sequence = sequence_of([0.5, 0.7], (0.05,))
        before = sequence.wealth().tobytes()
        with pytest.raises(ValueError, match="must be in"):
            sequence.observe(bad, Past(1))
        assert sequence.wealth().tobytes() == before

    @pytest.mark.parametrize(
        "call",
        [
            lambda: BettingSequence(()),
            lambda: BettingSequence((0.0,)),
            lambda: BettingSequence((0.05, 1.0)),
            lambda: BettingSequence((0.05,), ()),
            lambda: BettingSequence((0.05,), (Strategy(0.5, 0.5),)),
            lambda: Strategy(0.0, 0.5),
            lambda: Strategy(1.0, 1.0),
            lambda: Strategy(1.0, 0.5, -1.0),
            lambda: Past(-1),
        ],
    )
    def test_bad_parameters_are_refused(self, call: Any) -> None:
        with pytest.raises(ValueError, match=r"must|needs"):
            call()


def method(size: int = 3, **changed: Any) -> ScenarioMethod:
    arguments: dict[str, Any] = {
        "clip": CLIP,
        "risk_weight": 0.2,
        "delta": 0.05,
        "alpha": 0.05,
        "constants": (0.7, 0.09),
    }
    return ScenarioMethod(Points(tuple((float(k),) for k in range(size))), **{**arguments, **changed})


def sequences(running: ScenarioMethod) -> list[BettingSequence]:
    bets = [scenario._sequence for scenario in running._scenarios if isinstance(scenario, _ConstantScenario)]
    assert len(bets) == running.size
    return [*bets, running._upper]


def bhatia(size: int = 3, **changed: Any) -> ScenarioMethod:
    return method(size, risk="bhatia-davis", constants=None, **changed)


def predictable(size: int = 3, **changed: Any) -> ScenarioMethod:
    return method(size, risk="predictable", constants=None, **changed)


def fed(running: ScenarioMethod, tests: int, seed: int = 3) -> ScenarioMethod:
    """Observe tests of ten rollouts where the method proposes them; start k has the mean .6 + k/50."""
    rng = np.random.default_rng(seed)
    for _ in range(tests):
        node = running.propose().node
        values = np.clip(rng.normal(0.6 + node / 50, 0.09, 10), *CLIP)
        running.observe(*an_observation(node, values.tolist()))
    return running


class TestConstantsFromThePast:
    def test_the_bound_is_the_sequence_of_the_worst_start(self) -> None:
        running = fed(predictable(1), 20)
        values = np.clip(np.random.default_rng(3).normal(0.6, 0.09, 200), *CLIP)
        alone = RiskSequence(0.2, CLIP, delta=0.05)
        for value in values.tolist():
            alone.add(value)
        assert running.bound().ell == alone.lower()

    @pytest.mark.rest
    def test_it_is_close_to_the_best_constants_and_far_above_bhatia_davis(self) -> None:
        past, best, without = (fed(make(), 200).bound().ell for make in (predictable, method, bhatia))
        assert best - 0.005 < past < 0.6 - 0.2 * 0.09
        assert past > without + 0.03

    @pytest.mark.rest
    def test_the_claims_about_all_starts_at_once_are_bets_too(self) -> None:
        running = fed(predictable(), 200)
        least = predictable().bound().ell
        for state in running.bound().scenarios:
            assert least < state.simultaneous_lower < state.lower

    @pytest.mark.rest
    def test_the_opposite_bound_is_one_of_the_least_mean(self) -> None:
        running, of_mean = fed(predictable(), 100), method(risk="mean", constants=None)
        rng = np.random.default_rng(3)
        replayed = predictable()
        for _ in range(100):
            node = replayed.propose().node
            test = an_observation(node, np.clip(rng.normal(0.6 + node / 50, 0.09, 10), *CLIP).tolist())
            replayed.observe(*test)
            of_mean.observe(*test)
        assert running.bound() == replayed.bound()
        assert running.bound().upper == of_mean.bound().upper > 0.6

    def test_without_a_rollout_it_says_what_the_clip_says(self) -> None:
        assert predictable().bound().ell == bhatia().bound().ell

    def test_tests_in_flight_spread(self) -> None:
        running = fed(predictable(), 30)
        first = running.propose().node
        assert running.propose(pending=(first,) * 50).node != first


def of_mean(size: int = 3, **changed: Any) -> ScenarioMethod:
    return method(size, risk="mean", constants=None, **changed)


batches = st.lists(st.tuples(st.integers(0, 2), st.lists(st.floats(*CLIP), min_size=1, max_size=5)), max_size=8)


class TestScenarioMethod:
    @pytest.mark.parametrize("make", [method, bhatia])
    def test_without_a_rollout_it_says_what_the_clip_says(self, make: Any) -> None:
        bound = make().bound()
        least = 0.35 - 0.4 * math.sqrt(1.04)
        assert least - 2e-9 <= bound.ell <= least
        assert bound.upper == pytest.approx(0.75 if make is bhatia else 0.738222223, abs=1e-9)
        assert bound.worst == 0
        assert [state.mean for state in bound.scenarios] == [None] * 3

    @pytest.mark.parametrize("make", [method, bhatia])
    @given(tests=batches)
    @settings(max_examples=20, deadline=None)
    def test_bounds_keep_to_the_clip_and_to_each_other(self, make: Any, tests: Any) -> None:
        running = make()
        for index, values in tests:
            before = running.bound()
            running.observe(*an_observation(index, values))
            bound = running.bound()
            assert before.ell <= bound.ell <= 0.75
            assert bound.upper <= before.upper <= 0.75
            assert bound.ell >= 0.35 - 0.4 * math.sqrt(1.04) - 2e-9
            assert all(state.simultaneous_lower <= state.lower for state in bound.scenarios)
            assert bound.ell == bound.scenarios[bound.worst].lower == min(state.lower for state in bound.scenarios)
        assert sum(state.rollouts for state in running.bound().scenarios) == sum(len(values) for _, values in tests)

    @given(tests=batches, window=st.integers(1, 4))
    @settings(max_examples=20, deadline=None)
    def test_a_replay_rebuilds_the_state_to_the_bit(self, tests: Any, window: int) -> None:
        one, other = method(), method()
        for index, values in tests:
            one.propose(pending=(0,) * window)
            one.bound()
            one.stops()
            one.observe(*an_observation(index, values))
        for index, values in tests:
            other.observe(*an_observation(index, values))
        assert one.bound() == other.bound()
        for a, b in zip(sequences(one), sequences(other), strict=True):
            assert a.wealth().tobytes() == b.wealth().tobytes()
            assert a._bets.peak.tobytes() == b._bets.peak.tobytes()
        assert one.propose() == other.propose()

    @given(tests=batches, r=st.floats(0, 2))
    @settings(max_examples=20, deadline=None)
    def test_the_mean_has_no_term_of_the_variance(self, tests: Any, r: float) -> None:
        """Its bets are those of `bhatia-davis`: phi maps one bound to the other, whatever r is."""
        running, other = of_mean(risk_weight=r), bhatia()
        for index, values in tests:
            running.observe(*an_observation(index, values))
            other.observe(*an_observation(index, values))
        mean, risk = running.bound(), other.bound()
        assert CLIP[0] - 2e-9 <= mean.ell
        assert mean.upper <= CLIP[1]
        assert risk.ell == pytest.approx(bhatia_davis(mean.ell, CLIP, 0.2), abs=5e-9)
        assert mean.ell >= risk.ell
        assert [each.mean for each in mean.scenarios] == [each.mean for each in risk.scenarios]

    @pytest.mark.rest
    def test_constant_rollouts_lead_to_their_risk(self) -> None:
        cases = ((method, 0.7, 0.7 - 0.1 * 0.09), (bhatia, 0.75, 0.75), (of_mean, 0.3, 0.3), (of_mean, -0.05, -0.05))
        for make, value, target in cases:
            running = make(2)
            for _ in range(400):
                running.observe(*an_observation(running.propose().node, [value] * 10))
            bound = running.bound()
            assert target - 0.03 < bound.ell <= target <= bound.upper + 1e-9
            assert running.stops()
            assert running.bound().gap >= 0.0

    def test_the_first_round_visits_every_scenario(self) -> None:
        running = method(4)
        assert running.propose(2).node == 0, "the starts come in their order, whatever was drawn"
        assert running.propose(pending=(2,)).node == 0
        assert running.propose(pending=(2, 0, 1)).node == 3
        running.observe(*an_observation(2, [0.7]))
        assert running.propose(pending=(0, 1)).node == 3
        assert method(4).propose().node == 0

    def test_the_lowest_bound_is_next_and_ties_go_to_the_lowest_index(self) -> None:
        running = method(3)
        for index in (2, 1, 0):
            running.observe(*an_observation(index, [0.7] * 20))
        assert running.propose().node == 0
        running.observe(*an_observation(1, [0.2] * 5))
        for index in (0, 2):
            running.observe(*an_observation(index, [0.7] * 50))
        assert running.bound().worst == running.propose().node == 1

    def test_tests_in_flight_spread(self) -> None:
        running = method(3)
        for index in range(3):
            running.observe(*an_observation(index, [0.7] * 20))
        pending: list[int] = []
        for _ in range(9):
            pending.append(running.propose(pending=pending).node)
        assert sorted(pending) == [0, 0, 0, 1, 1, 1, 2, 2, 2]
        assert pending[:3] == [0, 1, 2]

    def test_a_drifting_system_is_refuted(self) -> None:
        running = method(1)
        for value in (0.74, 0.3):
            running.observe(*an_observation(0, [value] * 2000))
        assert running.bound().gap < 0.0
        assert not running.stops()
        assert running.bound().gap < 0

    def test_a_system_that_always_falls_is_no_refutation(self) -> None:
        """E[X] is below what a law on the clip can have as its risk; neither bound follows it there."""
        running = method(2)
        for index in (0, 1) * 3:
            running.observe(*an_observation(index, [-0.05] * 300))
        bound = running.bound()
        assert bound.ell == bound.upper == pytest.approx(0.35 - 0.4 * math.sqrt(1.04), abs=2e-9)
        assert running.stops()
        assert running.bound().gap >= 0.0

    def test_more_failure_probability_gives_no_less(self) -> None:
        values = np.random.default_rng(5).uniform(0.3, 0.75, (20, 10))
        ells, eaches = [], []
        for delta in (0.01, 0.05, 0.2):
            running = method(2, delta=delta)
            for i, batch in enumerate(values):
                running.observe(*an_observation(i % 2, batch.tolist()))
            ells.append(running.bound().ell)
            eaches.append(running.bound().scenarios[0].simultaneous_lower)
        assert ells == sorted(set(ells))
        assert eaches == sorted(set(eaches))

    @pytest.mark.parametrize("values", [[], [0.76], [0.5, -0.06], [math.nan], [0.5, math.inf]])
    def test_values_outside_the_clip_change_nothing(self, values: list[float]) -> None:
        running = method()
        running.observe(*an_observation(0, [0.5]))
        before = running.bound()
        with pytest.raises(ValueError, match="clip"):
            running.observe(*an_observation(0, values))
        assert running.bound() == before
        assert running.n == 1

    @pytest.mark.parametrize("index", [-1, 3])
    def test_an_unknown_scenario_is_refused(self, index: int) -> None:
        running = method(3)
        for call in (
            lambda: running.observe(*an_observation(index, [0.5])),
            lambda: running.propose(pending=(index,)),
        ):
            with pytest.raises(IndexError, match="outside"):
                call()

    @pytest.mark.parametrize(
        ("changed", "message"),
        [
            ({"delta": 0.0}, "delta"),
            ({"delta": 1.0}, "delta"),
            ({"alpha": 0.0}, "alpha"),
            ({"alpha": math.nan}, "alpha"),
            ({"clip": (0.5, 0.5)}, "clip"),
            ({"risk_weight": -0.1}, "risk_weight"),
            ({"constants": None}, "constants"),
            ({"constants": (0.7, 0.0)}, "constants"),
            ({"risk": "bhatia-davis"}, "constants"),
            ({"risk": "mean"}, "constants"),
            ({"risk": "popoviciu"}, "risk"),
        ],
    )
    def test_bad_parameters_are_refused(self, changed: dict[str, Any], message: str) -> None:
        with pytest.raises(ValueError, match=message):
            method(**changed)

    @pytest.mark.parametrize(
        "scenarios",
        [
            [[0.0], [1.0], [0.0]],
            [[0.0], [-0.0]],
            [],
            [[0.0], [1.0, 2.0]],
            [[math.nan]],
            [[k] for k in range(MAX_SCENARIOS + 1)],
        ],
    )
    def test_bad_scenarios_are_refused(self, scenarios: Any) -> None:
        with pytest.raises(ValueError, match=r"points?|scenarios"):
            ScenarioMethod(Points(scenarios), clip=CLIP, risk_weight=0.2, delta=0.05, alpha=0.1, constants=(0.7, 0.09))


MADE = {"linearised": method, "predictable": predictable, "bhatia-davis": bhatia, "mean": of_mean}
OF_TWO = st.lists(st.tuples(st.integers(0, 2), st.floats(*CLIP), st.floats(*CLIP)), min_size=1, max_size=30)


def facts(running: ScenarioMethod, bound: Bound) -> object:
    return bound, running.bound(), running.propose(), running.acquisition((0, 2)).tolist(), state_of(running)


class TestManyAtOnce:
    """Everything is to the bit as after one test after the other."""

    @staticmethod
    def check(make: Any, nodes: Integers, each: Floats, cuts: Iterable[int]) -> None:
        one, many, listed = make(), make(), make()
        for part in blocks(len(nodes), cuts):
            tests = [an_observation(*test) for test in zip(nodes[part].tolist(), each[part].tolist(), strict=True)]
            for test in tests:
                bound = one.observe(*test)
            found = many.observe_each(nodes[part], -each[part].mean(axis=1), each[part])
            assert facts(one, bound) == facts(many, found) == facts(listed, listed.bound_after(tests))

    @pytest.mark.parametrize("risk", MADE)
    @given(tests=OF_TWO, cuts=st.lists(st.integers(1, 12), max_size=5))
    @settings(max_examples=15, deadline=None)
    def test_any_values_in_any_blocks(self, risk: str, tests: Any, cuts: list[int]) -> None:
        self.check(MADE[risk], np.array([node for node, *_ in tests]), np.array([pair for _, *pair in tests]), cuts)

    @pytest.mark.parametrize("width", [1, 7])
    @pytest.mark.parametrize("risk", MADE)
    def test_some_hundred_tests(self, risk: str, width: int) -> None:
        rng = np.random.default_rng(width)
        nodes = rng.integers(0, 3, 400 // width)
        each = np.clip(rng.normal(0.55 + nodes[:, None] / 20, 0.1, (len(nodes), width)), *CLIP)
        self.check(MADE[risk], nodes, each, sizes(len(nodes), width))

    def test_more_tests_than_are_taken_at_a_time(self, monkeypatch: pytest.MonkeyPatch) -> None:
        nodes, each = np.arange(50) % 3, np.random.default_rng(9).uniform(*CLIP, (50, 2))
        whole = method()
        whole.recall_each(nodes, each[:, 0], each)
        monkeypatch.setattr("perfbound.orchestrator.mathematics.bounds.scenario.PIECE", 7)
        other = method()
        other.recall_each(nodes, each[:, 0], each)
        assert state_of(whole) == state_of(other)

    def test_tests_of_several_widths_are_recalled(self) -> None:
        tests = [an_observation(0, [0.5]), an_observation(1, [0.6, 0.7]), an_observation(0, [0.4, 0.3])]
        one, other = method(), method()
        for test in tests:
            one.observe(*test)
        other.recall(tests)
        assert state_of(one) == state_of(other)

    @pytest.mark.parametrize("risk", MADE)
    @pytest.mark.parametrize(
        ("node", "value", "error"),
        [(1, 0.76, ValueError), (1, math.nan, ValueError), (3, 0.5, IndexError), (-1, 0.5, IndexError)],
    )
    def test_an_error_changes_nothing(self, risk: str, node: int, value: float, error: type[Exception]) -> None:
        running = MADE[risk]()
        running.observe(*an_observation(0, [0.5, 0.5]))
        before = state_of(running)
        for call in (running.observe_each, running.recall_each):
            with pytest.raises(error, match=r"clip|outside"):
                call(np.array([0, node, 2]), np.zeros(3), np.array([[0.5, 0.5], [0.5, value], [0.5, 0.5]]))
        with pytest.raises(ValueError, match="clip"):
            running.recall_each(np.array([0]), np.zeros(1), np.empty((1, 0)))
        running.recall_each(np.array([], dtype=np.int64), np.zeros(0), np.empty((0, 2)))
        assert state_of(running) == before
