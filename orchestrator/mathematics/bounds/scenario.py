"""Method `scenario`: the least risk, or the least mean, of K scenarios from rollouts alone, without a kernel.

| symbol  | name          | meaning                                                | shape  | unit               |
|---------|---------------|--------------------------------------------------------|--------|--------------------|
| z_k     | `scenarios`   | the K starting conditions that Z consists of           | (K, p) | parameter          |
| rho     | `values`      | robustness of the rollouts, clipped to [-m, M]         | ()     | unit of robustness |
| [-m, M] | `clip`        |                                                        | (2,)   | unit of robustness |
| r       | `risk_weight` | weight of the standard deviation; 0 for `mean`         | ()     | -                  |
| risk_k  |               | E rho - r sd(rho) in scenario k; rho* = min_k risk_k   | (K,)   | unit of robustness |
| c, s    | `constants`   | of the linearised risk X, fixed beforehand             | ()     | unit of robustness |
| x       |               | X (or rho, without constants) moved and scaled to [0, 1] | ()   | -                  |
| L_k     | `lower`       | betting lower bound of risk_k at the full delta        | (K,)   | unit of robustness |
| ell     | `ell`         | min_k L_k                                              | ()     | unit of robustness |
| U       | `upper`       | upper bound of the limit of ell                        | ()     | unit of robustness |
| delta   | `delta`       | failure probability                                    | ()     | -                  |
| alpha   | `alpha`       | tolerance                                              | ()     | unit of robustness |

Assumed: rollouts are independent, those of one scenario have one law, and robustness is clipped. Nothing else.

Three claims, each with its own 1 - delta, each at all times at once (two of them together fail with the sum):

`ell`   rho* >= ell. No union over scenarios [B82]: ell > rho* needs L_k > risk_k for the fixed k that attains rho*.
`simultaneous_lower`  risk_k >= its value for all k at once, by a union: each runs at delta/K.
`upper` min_k E[X_k] <= U (phi(min_k E[rho_k]) <= U for `bhatia-davis`). That is what ell tends to with ever more
        rollouts, and not above rho*; so U limits the gain of further rollouts, and is no upper bound of rho* itself.
        For `mean` the limit is rho* = min_k E[rho_k] itself, and U an upper bound of it. For `predictable`, where c and
        s of every scenario follow from its earlier rollouts, ell tends to rho* itself; U bounds min_k E[rho_k], which
        is not below it.
        (Neither ell nor U is ever reported below c0 - h sqrt(1 + r^2), the least risk that a law on the clip can have.)
        One wealth for all scenarios: if every mean of 1 - x is at most m, then betting on any of them loses.

Stop when upper - ell <= alpha. `ell` is valid at every stopping time, so the stop rule spends nothing of its delta.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import groupby
from typing import Literal, get_args

import numpy as np

from ....schemas.values import Band, Bound, Observation, Proposal, Verdict
from ..control.one_law import LawControl
from ..control.sequence import Control, Disturbed
from ..gp.acquisition import rival_node
from ..gp.kernels import Floats
from ..gp.lattice import check_index
from ..gp.points import Candidates, point_at
from .method import Integers, Method
from .one_law.betting import CAREFUL, BettingSequence, Past
from .one_law.many import are_within, units
from .one_law.predictable import RiskSequence
from .one_law.risk import RiskReading
from .one_law.wealth import GRID

Risk = Literal["linearised", "predictable", "bhatia-davis", "mean"]

MAX_SCENARIOS = 1000
"""Each scenario keeps about 100 kB of wealth."""
PIECE = 2**12
"""Tests whose moments are kept at a time."""


@dataclass(frozen=True, slots=True)
class ScenarioState:
    """The bounds of one scenario; all but `rollouts` in the unit of robustness, bounds rounded down to 1e-9.

    `lower` serves the minimum over scenarios alone; `simultaneous_lower` (delta/K) is the claim about this scenario
    that is valid together with those about all others. `mean` is the mean of X so far, or of rho without constants;
    None without a rollout.
    """

    rollouts: int
    mean: float | None
    lower: float
    simultaneous_lower: float


@dataclass(frozen=True, slots=True)
class ScenarioBound:
    """The bounds so far: `ell` with probability 1 - delta, `upper` with its own 1 - delta; scenario `worst` has ell."""

    ell: float
    upper: float
    worst: int
    scenarios: tuple[ScenarioState, ...]

    @property
    def gap(self) -> float:
        """Largest gain of further rollouts; negative: an assumption is wrong, or an event of probability 2 delta."""
        return self.upper - self.ell

    def verdict(self, alpha: float) -> Verdict | None:
        """Return whether further rollouts can gain at most `alpha`, or whether the two bounds contradict each other."""
        if self.gap > alpha:
            return None
        # Both bounds are valid at once with probability 1 - 2 delta, so U < ell contradicts one law per scenario.
        return "converged" if self.gap >= 0.0 else "refuted"


class ScenarioMethod(Method):
    """Betting bounds of K scenarios, and the choice of the next one to test.
    Implements eq. (scenario) of [PB].

    A test is a batch of rollouts of one scenario. `constants` are (c, s) and belong to `linearised`; `mean` bounds
    E rho and has no use for `risk_weight`. With `disturbed` rollouts each scenario has a control.

    Raises:
        ValueError: a parameter is outside its range, constants are missing or too many, or there are more than
            MAX_SCENARIOS scenarios.

    >>> from perfbound.orchestrator.mathematics.gp.points import Points
    >>> method = ScenarioMethod(Points(((0.0,), (1.0,))), clip=(-0.05, 0.75), risk_weight=0.2, delta=0.05, alpha=0.02,
    ...                         constants=(0.7, 0.09))
    >>> method.propose().node, method.propose(pending=(0,)).node
    (0, 1)
    >>> for value in (0.7, 0.65):
    ...     _ = method.observe(method.propose(), Observation(-value, (value,) * 100))
    >>> bound = method.bound()
    >>> bound.worst, method.propose().node, bound.ell <= 0.65 - 0.1 * (0.05**2 / 0.09 + 0.09) <= bound.upper
    (1, 1, True)

    """

    def __init__(
        self,
        scenarios: Candidates,
        *,
        clip: tuple[float, float],
        risk_weight: float,
        delta: float,
        alpha: float,
        risk: Risk = "linearised",
        constants: tuple[float, float] | None = None,
        disturbed: Disturbed | None = None,
    ) -> None:
        if not (0.0 < delta < 1.0 and math.isfinite(alpha) and alpha > 0):
            raise ValueError(f"delta must be in (0, 1) and alpha be positive, not {delta!r} and {alpha!r}")
        if risk not in get_args(Risk) or (constants is None) == (risk == "linearised"):
            raise ValueError(
                f"risk is 'linearised' with constants (c, s), or one of {get_args(Risk)[1:]} without; not {risk!r}"
            )
        if scenarios.size > MAX_SCENARIOS:
            raise ValueError(f"{scenarios.size} scenarios exceed {MAX_SCENARIOS}: shorten the list")
        self._candidates, self._delta, self._alpha = scenarios, delta, alpha
        of_mean = risk in {"mean", "predictable"}
        self._reading = RiskReading(clip, 0.0 if of_mean else risk_weight, constants)
        # Level 0 serves ell, level 1 the claim about one scenario that is valid together with those about all others.
        levels = (delta, delta / scenarios.size)
        # Of several scenarios the worst has half of the rollouts, or more.
        half = min(scenarios.size, 2)
        law = None if disturbed is None else replace(disturbed, planned=disturbed.planned // half)
        self._disturbed = disturbed
        self._scenarios: list[_Scenario] = [
            _PredictableScenario(levels, self._reading, law, risk_weight)
            if risk == "predictable"
            else _ConstantScenario(levels, self._reading, law)
            for _ in range(scenarios.size)
        ]
        # On the largest mean of 1 - x, all scenarios together.
        self._upper = BettingSequence((delta,), CAREFUL)

    @property
    def n(self) -> int:
        """Number of tests observed."""
        return sum(scenario.tests for scenario in self._scenarios)

    @property
    def control(self) -> tuple[Control, int] | None:
        """The control of the worst scenario, with the rollouts before its first fit; None where there is none."""
        return self._scenarios[self.bound().worst].control

    @property
    def size(self) -> int:
        """Number of scenarios."""
        return len(self._scenarios)

    @property
    def probability(self) -> float:
        """1 - delta."""
        return 1.0 - self._delta

    def propose(self, first: int | None = None, pending: Sequence[int] = ()) -> Proposal:  # noqa: ARG002
        """Return the scenario of the next test; it changes nothing, and `first` has no effect here.

        First every scenario once, in order. Then the one whose lower bound is least, a test in flight counting as one
        that brings the bound nearer to the mean: bound = mean - constant/tests. Ties go to the lowest index. `pending`
        has the scenarios of the tests in flight, one entry per test.

        Raises:
            IndexError: an entry of `pending` is no scenario.

        """
        flying = _in_flight(pending, self.size)
        for k, scenario in enumerate(self._scenarios):
            if not scenario.tests and not flying[k]:
                return self.proposal_at(k)
        return self.proposal_at(min(range(self.size), key=lambda k: (self._scenarios[k].outlook(flying[k]), k)))

    def acquisition(self, pending: Sequence[int]) -> Floats:
        """Return how large J is expected to be proven at each scenario (K,), unit J; inf where no test has been.

        Raises as `propose`.
        """
        flying = _in_flight(pending, self.size)
        pairs = zip(self._scenarios, flying, strict=True)
        return np.array(
            [-scenario.expected(flown) if scenario.tests or flown else math.inf for scenario, flown in pairs]
        )

    def proposal_at(self, index: int, pending: Sequence[int] = ()) -> Proposal:  # noqa: ARG002
        """Return the proposal of a scenario, whatever rule chose it."""
        lower = self._scenarios[index].state.lower
        return Proposal(index, point_at(self._candidates, index), -lower, 0.0, None, None)

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:
        """Return the scenario at `x` (p,) if another CPU could have proposed it."""
        flying = _in_flight(pending, self.size)
        pairs = list(zip(self._scenarios, flying, strict=True))
        # The first round goes by number, without arithmetic that a CPU could round differently.
        if not all(scenario.tests or flown for scenario, flown in pairs):
            return None
        outlook = np.array([scenario.outlook(flown) for scenario, flown in pairs])
        index = rival_node(-outlook, self._candidates.nodes, x)
        return None if index is None else self.proposal_at(index)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Add the robustness of every rollout of one test and return the bound; on an error nothing changes.

        Raises:
            ValueError: there is no value, or one is outside the clip or not finite.
            IndexError: no scenario has this index.

        """
        return self.bound_after([(proposal, observation)])

    def observe_each(self, nodes: Integers, y: Floats, each: Floats) -> Bound:
        """Add the robustness of every rollout of k tests and return the bound; raises as `observe`."""
        self.recall_each(nodes, y, each)
        return self._bound()

    def bound_after(self, tests: Sequence[tuple[Proposal, Observation]]) -> Bound:
        """Add observations, and return the bound that follows from all of them; raises as `observe`."""
        self.recall(tests)
        return self._bound()

    def recall(self, tests: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations; raises as `observe`."""
        for width, alike in groupby(tests, key=lambda test: len(test[1].each)):
            found = list(alike)
            each = np.array([observation.each for _, observation in found], dtype=np.float64)
            self._add(np.array([proposal.node for proposal, _ in found]), each.reshape(len(found), width))

    def recall_each(self, nodes: Integers, y: Floats, each: Floats) -> None:  # noqa: ARG002
        """Add observations; raises as `observe`."""
        self._add(nodes, np.asarray(each, dtype=np.float64))

    def band(self, bound: Bound) -> Band:  # noqa: ARG002  (the bounds of the scenarios are stored)
        """Return the band; no scenario has a lower bound of its own, and the upper ones are valid one by one."""
        found = self.bound()
        refuted = found.gap < 0.0
        return Band(
            mean=tuple(math.nan if state.mean is None else -state.mean for state in found.scenarios),
            lower=(math.nan,) * self.size,
            upper=tuple(-state.lower for state in found.scenarios),
            possible=tuple(refuted or state.simultaneous_lower <= found.upper for state in found.scenarios),
        )

    def bound(self) -> ScenarioBound:
        """Return the bounds so far, valid at every time; units as in ScenarioBound.
        Implements eq. (intersection-union) of [B82].

        Formula: ell = min_k L_k; {min_k L_k > rho*} is a subset of {L_k* > risk_k*} for the fixed k* with risk_k* =
        rho*, so that the full delta serves every scenario. Assumes what the head of this module lists.
        """
        states = tuple(scenario.state for scenario in self._scenarios)
        worst = min(range(self.size), key=lambda k: (states[k].lower, k))
        # L bounds the largest mean of 1 - x from below, so 1 - L bounds the least mean of x from above.
        upper = _upper(self._reading, self._upper.rejected())
        return ScenarioBound(states[worst].lower, upper, worst, states)

    def stops(self) -> bool:
        """Return whether further rollouts can gain at most alpha: 0 <= upper - ell <= alpha."""
        return self.bound().verdict(self._alpha) == "converged"

    def _bound(self) -> Bound:
        found = self.bound()
        return Bound(-found.ell, -found.upper, found.verdict(self._alpha))

    def _add(self, nodes: Integers, values: Floats) -> None:
        """Add the values of tests (k, b) at their scenarios (k,)."""
        if not len(nodes):
            return
        low, high = self._reading.clip
        reported = np.empty((len(nodes), values.shape[1], 0))
        if self._disturbed is not None:
            values, reported = self._disturbed.split(values)
        for index in () if are_within(nodes, 0, self.size - 1) else nodes.tolist():
            check_index(index, self.size)
        # Checked before the first bet: half a test would change the state.
        if not values.shape[1] or not are_within(values, low, high):
            wrong = values[~((values >= low) & (values <= high)).all(axis=1)][:1].ravel().tolist()
            raise ValueError(f"a test needs values within the clip [{low}, {high}], not {wrong}")
        if self._disturbed is not None:
            # Each test may change the control of the next one.
            for number, (node, row, own) in enumerate(zip(nodes, values, reported, strict=True), self.n):
                scores, scenario = self._disturbed.scores(number, own), self._scenarios[node]
                self._bet(node[None], row[None], scores)
                if scenario.learn(row, scores):
                    # What is least of 1 - x + g at any scenario: each may have the next test.
                    least, most = zip(*(each.reach for each in self._scenarios), strict=True)
                    self._upper.reach(min(least), 1.0 + max(most))
            return
        for first in range(0, len(nodes), PIECE):
            self._bet(nodes[first : first + PIECE], values[first : first + PIECE])

    def _bet(self, nodes: Integers, values: Floats, scores: Floats | None = None) -> None:
        """Bet on the values of tests (k, b); of one test alone there may be scores (b, m)."""
        x = units(values.ravel(), self._reading).reshape(values.shape)
        if scores is not None:
            x -= self._scenarios[nodes[0]].explained(scores)
        complement = 1.0 - x
        visited, past = sorted(set(nodes.tolist())), np.empty((*values.shape, 3))
        places = [np.flatnonzero(nodes == index) if len(visited) > 1 else slice(None) for index in visited]
        for index, tests in zip(visited, places, strict=True):
            # A bet is a function of the rollouts before, of the scenario alone.
            found = self._scenarios[index].complement.before(complement[tests].ravel().tolist())
            past[tests] = found.reshape(-1, values.shape[1], 3)
        self._upper.observe_each(complement.ravel(), past.reshape(-1, 3))
        for index, tests in zip(visited, places, strict=True):
            self._scenarios[index].observe(values[tests], x[tests], scores)


def _in_flight(pending: Sequence[int], size: int) -> list[int]:
    """Return the number of tests in flight of every scenario."""
    flying = [0] * size
    for index in pending:
        check_index(index, size)
        flying[index] += 1
    return flying


class _Scenario(ABC):
    """The rollouts of one scenario, the bets on them, and the bounds that follow; begun by the bets of a subclass.

    With a control everything is about x less what it explains, but for the values that it learns from.
    """

    def __init__(self, reading: RiskReading) -> None:
        self._reading = reading
        self.complement = Past()  # of 1 - x
        self.tests = 0
        self.state = self._state()

    @property
    def control(self) -> tuple[Control, int] | None:
        """The last control, with the rollouts before its first fit; None where there is none."""
        return None

    @property
    def reach(self) -> tuple[float, float]:
        """The least and the largest that is explained of x."""
        return 0.0, 0.0

    def explained(self, scores: Floats) -> Floats:
        """Return what the control explains of x for the scores of rollouts (b, k)."""
        return np.zeros(len(scores))

    def learn(self, values: Floats, scores: Floats) -> bool:  # noqa: ARG002
        """Give the control the values of a test (b,), and return whether it explains the next ones otherwise."""
        return False

    def observe(self, values: Floats, x: Floats, scores: Floats | None = None) -> None:
        """Bet on the values (k, b) of k tests, which are x in [0, 1]; scores (b, k) are those of one test."""
        self._bet(values.ravel(), x.ravel(), scores)
        self.tests += len(values)
        self.state = self._state()

    def expected(self, flying: int) -> float:
        """Return the outlook in the unit of robustness."""
        low, high = self.scale
        return low + (high - low) * self.outlook(flying)

    @property
    def scale(self) -> tuple[float, float]:
        """The values, unit of robustness, that 0 and 1 of an outlook stand for."""
        return 0.0, 1.0

    def outlook(self, flying: int) -> float:
        """Return the lower bound that is expected after the tests in flight, on a scale that all scenarios share."""
        lower, mean = self._outlook()
        return mean - (mean - lower) * (self.tests / (self.tests + flying)) if flying else lower

    @abstractmethod
    def _bet(self, values: Floats, x: Floats, scores: Floats | None) -> None:
        """Bet on values, which are x in [0, 1]."""

    @abstractmethod
    def _outlook(self) -> tuple[float, float]:
        """Return lower bound and mean, on a scale that all scenarios share."""

    @abstractmethod
    def _lower(self, level: int) -> float:
        """Return the lower bound of the risk at one level, unit of robustness."""

    def _state(self) -> ScenarioState:
        lower, simultaneous = (self._lower(level) for level in (0, 1))
        low, high = self._reading.ends
        mean = high - (high - low) * self.complement.mean if self.complement.count else None
        return ScenarioState(self.complement.count, mean, lower, simultaneous)


class _ConstantScenario(_Scenario):
    """Bets on x, which is X with constants, or the robustness."""

    @property
    def scale(self) -> tuple[float, float]:
        """The values of X that 0 and 1 stand for."""
        return self._reading.ends

    def __init__(self, levels: tuple[float, float], reading: RiskReading, law: Disturbed | None) -> None:
        self._sequence = BettingSequence(levels)
        self._past = Past(imaginary=1)  # of x
        self._law = None if law is None else LawControl(law, (0.0, 1.0), levels[0])
        self._first: list[tuple[Floats, Floats]] = []
        """Scores and x before the first fit."""
        super().__init__(reading)

    @property
    def reach(self) -> tuple[float, float]:
        """The least and the largest of what is explained of x."""
        return (0.0, 0.0) if self._law is None else (self._law.least, self._law.most)

    @property
    def control(self) -> tuple[Control, int] | None:
        """The last control, in the unit of X, with the rollouts before its first fit."""
        if self._law is None or self._law.control is None:
            return None
        low, high = self._reading.ends
        return self._law.control.times(high - low), self._law.before_fit

    def explained(self, scores: Floats) -> Floats:
        """Return what the control explains of x."""
        assert self._law is not None
        return self._law.g(scores)

    def learn(self, values: Floats, scores: Floats) -> bool:
        """Give the control the values of a test, and return whether it explains the next ones otherwise."""
        assert self._law is not None
        x, begins = units(values, self._reading), not self._law.has_begun
        if begins:
            self._first.append((x, scores))
        if not self._law.add(scores, x, lambda: max(self._past.mean, 1.0 / GRID)):
            return False
        if begins:
            self._read_again()
        self._sequence.reach(-self._law.most, 1.0 - self._law.least)
        return True

    def _read_again(self) -> None:
        """Take the moments of all values so far with the first control."""
        self._past, self.complement = Past(imaginary=1), Past()
        for x, scores in self._first:
            for value in (x - self.explained(scores)).tolist():
                self._past.add(value)
                self.complement.add(1.0 - value)
        self._first.clear()

    def _bet(self, values: Floats, x: Floats, scores: Floats | None) -> None:  # noqa: ARG002
        self._sequence.observe_each(x, self._past.before(x.tolist()))

    def _outlook(self) -> tuple[float, float]:
        """Return lower bound and mean of x."""
        return self._sequence.lower(), 1.0 - self.complement.mean if self.complement.count else 1.0

    def _lower(self, level: int) -> float:
        return _lower(self._reading, self._sequence.rejected(level))


@lru_cache(maxsize=GRID)
def _lower(reading: RiskReading, rejected: int) -> float:
    # Exact arithmetic takes longer than a bet, and few bets reject a candidate.
    return reading.lower(Fraction(rejected, GRID))


@lru_cache(maxsize=GRID)
def _upper(reading: RiskReading, rejected: int) -> float:
    return reading.upper(Fraction(GRID - rejected, GRID))


class _PredictableScenario(_Scenario):
    """Bets with c and s from the earlier rollouts of the scenario; x is the robustness, for `upper`."""

    def __init__(
        self, levels: tuple[float, float], reading: RiskReading, law: Disturbed | None, risk_weight: float
    ) -> None:
        self._risks = [RiskSequence(risk_weight, reading.clip, delta=level, disturbed=law) for level in levels]
        super().__init__(reading)

    @property
    def control(self) -> tuple[Control, int] | None:
        """The last control, with the rollouts before its first fit."""
        return self._risks[0].control

    def _bet(self, values: Floats, x: Floats, scores: Floats | None) -> None:  # noqa: ARG002
        for risk in self._risks:
            risk.add_each(values, scores)

    def _outlook(self) -> tuple[float, float]:
        """Return lower bound and estimate of the risk, unit of robustness."""
        risk = self._risks[0]
        return risk.lower(), risk.estimate if risk.count else self._reading.clip[1]

    def _lower(self, level: int) -> float:
        return self._risks[level].lower()
