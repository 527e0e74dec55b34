"""Method `scenario`: the least risk of K scenarios from rollouts alone, without a kernel.

| symbol  | name          | meaning                                                | shape  | unit               |
|---------|---------------|--------------------------------------------------------|--------|--------------------|
| z_k     | `scenarios`   | the K starting conditions that Z consists of           | (K, p) | parameter          |
| rho     | `values`      | robustness of true rollouts, clipped to [-m, M]        | ()     | unit of robustness |
| [-m, M] | `clip`        |                                                        | (2,)   | unit of robustness |
| r       | `risk_weight` | weight of the standard deviation                       | ()     | -                  |
| risk_k  |               | E rho - r sd(rho) in scenario k; rho* = min_k risk_k   | (K,)   | unit of robustness |
| c, s    | `constants`   | of the linearised risk X, fixed beforehand             | ()     | unit of robustness |
| x       |               | X (or rho, for `bhatia-davis`) moved and scaled to [0, 1] | ()  | -                  |
| L_k     | `lower`       | betting lower bound of risk_k at the full delta        | (K,)   | unit of robustness |
| ell     | `ell`         | min_k L_k                                              | ()     | unit of robustness |
| U       | `upper`       | upper bound of what ell tends to                       | ()     | unit of robustness |
| delta   | `delta`       | failure probability                                    | ()     | -                  |
| alpha   | `alpha`       | tolerance                                              | ()     | unit of robustness |

Assumed: rollouts are independent, those of one scenario have one law, and robustness is clipped. Nothing else.

Three claims, each with its own 1 - delta, each at all times at once (whoever reads two of them pays the sum):

`ell`   rho* >= ell. No union over scenarios [B82]: ell > rho* needs L_k > risk_k for the fixed k that attains rho*.
`each`  risk_k >= each_k for all k at once, by a union: each_k runs at delta/K.
`upper` min_k E[X_k] <= U (phi(min_k E[rho_k]) <= U for `bhatia-davis`). That is what ell tends to with ever more
        rollouts, and not above rho*; so U says what rollouts can still bring, and is no upper bound of rho* itself.
        (Neither ell nor U is ever reported below c0 - h sqrt(1 + r^2), the least risk that a law on the clip can have.)
        One wealth for all scenarios: if every mean of 1 - x is at most m, then betting on any of them loses.

Stop when upper - ell <= alpha. `ell` holds at every stopping time, so the stop rule spends nothing of its delta.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from ....schemas.values import Band, Bound, Observation, Proposal, Verdict
from ..gp.acquisition import rivals
from .betting import CAREFUL, GRID, BettingSequence, Floats, Past
from .composition import STEP
from .method import Method
from .risk import bhatia_davis, check_range, linearised, linearised_range

Risk = Literal["linearised", "bhatia-davis"]

MAX_SCENARIOS = 1000
"""Each scenario keeps about 100 kB of wealth."""


@dataclass(frozen=True, slots=True)
class ScenarioState:
    """What is known of one scenario; all but `rollouts` in the unit of robustness, bounds rounded down to 1e-9.

    `lower` serves the minimum over scenarios alone, `each` is the claim about this scenario (delta/K). `mean` is the
    mean of X so far, or of rho for `bhatia-davis`; None without a rollout.
    """

    rollouts: int
    mean: float | None
    lower: float
    each: float


@dataclass(frozen=True, slots=True)
class ScenarioBound:
    """What holds now: `ell` with probability 1 - delta, `upper` with its own 1 - delta; scenario `worst` has ell."""

    ell: float
    upper: float
    worst: int
    scenarios: tuple[ScenarioState, ...]

    @property
    def gap(self) -> float:
        """What rollouts can still bring; negative: an assumption is wrong, or an event of probability 2 delta."""
        return self.upper - self.ell


class ScenarioMethod(Method):
    """Betting bounds of K scenarios, and which of them is to be tested next.
    Implements eq. (scenario) of [PB].

    A test is a batch of true rollouts of one scenario. `constants` are (c, s) and belong to `linearised`.

    Raises:
        ValueError: a parameter is outside its range, constants are missing or too many, scenarios are not finite, are
            doubled, or are more than MAX_SCENARIOS.

    >>> method = ScenarioMethod(np.array([[0.0], [1.0]]), clip=(-0.05, 0.75), risk_weight=0.2, delta=0.05, alpha=0.02,
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
        scenarios: Floats,
        *,
        clip: tuple[float, float],
        risk_weight: float,
        delta: float,
        alpha: float,
        risk: Risk = "linearised",
        constants: tuple[float, float] | None = None,
    ) -> None:
        self.scenarios = _checked_scenarios(scenarios)
        check_range(clip, risk_weight)
        if not (0.0 < delta < 1.0 and math.isfinite(alpha) and alpha > 0):
            raise ValueError(f"delta must lie in (0, 1) and alpha be positive, not {delta!r} and {alpha!r}")
        if risk not in {"linearised", "bhatia-davis"} or (constants is None) == (risk == "linearised"):
            raise ValueError(f"risk is 'linearised' with constants (c, s), or 'bhatia-davis' without; not {risk!r}")
        size = len(self.scenarios)
        self._probability = 1.0 - delta
        self._clip, self._risk_weight, self._alpha, self._constants = clip, risk_weight, alpha, constants
        self._range = clip if constants is None else linearised_range(clip, risk_weight, *constants)
        least = bhatia_davis(clip[0], clip, risk_weight)  # no law on the clip has a lower risk
        self._least = math.floor(Fraction(least - 1e-12) * STEP) / STEP
        self._lower = [BettingSequence((delta, delta / size)) for _ in range(size)]
        self._upper = BettingSequence((delta,), CAREFUL)  # of the largest mean of 1 - x, all scenarios together
        self._above = [Past(imaginary=1) for _ in range(size)]
        self._below = [Past() for _ in range(size)]
        self._tests = [0] * size
        self._states = [self._state(k) for k in range(size)]

    @property
    def n(self) -> int:
        """Number of tests observed."""
        return sum(self._tests)

    @property
    def size(self) -> int:
        """Number of scenarios."""
        return len(self.scenarios)

    @property
    def probability(self) -> float:
        """1 - delta."""
        return self._probability

    def propose(self, first: int | None = None, pending: Sequence[int] = ()) -> Proposal:  # noqa: ARG002
        """Return the scenario of the next test; it changes nothing, and `first` is of no use here.

        First every scenario once, in order. Then the one whose lower bound is least, a test in flight counting as one
        that brings the bound nearer to the mean: bound = mean - constant/tests. Ties go to the lowest index. `pending`
        holds the scenarios of the tests in flight, one entry per test.

        Raises:
            IndexError: an entry of `pending` is no scenario.

        """
        size = self.size
        for index in pending:
            _check_index(index, size)
        flying = [0] * size
        for index in pending:
            flying[index] += 1
        for k in range(size):
            if not self._tests[k] and not flying[k]:
                return self._at(k)
        return self._at(min(range(size), key=lambda k: (self._outlook(k, flying[k]), k)))

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:
        """Return the scenario at `x` (p,) if another CPU could have proposed it."""
        flying = [pending.count(k) for k in range(len(self._tests))]
        if not all(tests or flown for tests, flown in zip(self._tests, flying, strict=True)):
            return None
        outlook = np.array([self._outlook(k, flown) for k, flown in enumerate(flying)])
        index = rivals(-outlook, self.scenarios, x)
        return None if index is None else self._at(index)

    def _at(self, index: int) -> Proposal:
        x = tuple(float(value) for value in self.scenarios[index])
        return Proposal(index, x, -self._states[index].lower, 0.0, None, None)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Add the robustness of every rollout of one test and return the bound; on an error nothing changes.

        Raises:
            ValueError: there is no value, or one is outside the clip or not finite.
            IndexError: no scenario has this index.

        """
        self.recall([(proposal, observation)])
        found = self.bound()
        verdict: Verdict | None = None
        if found.gap <= self._alpha:
            verdict = "converged" if found.gap >= 0.0 else "refuted"
        return Bound(-found.ell, -found.upper, verdict)

    def recall(self, seen: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations; raises as `observe`."""
        for proposal, observation in seen:
            self._add(proposal.node, observation.each)

    def _add(self, index: int, values: Sequence[float]) -> None:
        _check_index(index, len(self._tests))
        low, high = self._clip
        if not values or not all(low <= value <= high for value in values):
            raise ValueError(f"a test needs values within the clip [{low}, {high}], not {list(values)}")
        for value in values:
            x = self._scaled(value)
            self._lower[index].observe(x, self._above[index])
            self._upper.observe(1.0 - x, self._below[index])
            self._above[index].add(x)
            self._below[index].add(1.0 - x)
        self._tests[index] += 1
        self._states[index] = self._state(index)

    def band(self, bound: Bound) -> Band:  # noqa: ARG002  (the bounds of the scenarios are at hand)
        """Return the band; no scenario has a lower bound of its own, and the upper ones hold one by one."""
        found = self.bound()
        refuted = found.gap < 0.0
        return Band(
            mean=tuple(math.nan if each.mean is None else -each.mean for each in found.scenarios),
            lower=(math.nan,) * self.size,
            upper=tuple(-each.lower for each in found.scenarios),
            possible=tuple(refuted or each.each <= found.upper for each in found.scenarios),
        )

    def bound(self) -> ScenarioBound:
        """Return what holds now, whenever it is asked for; units as in ScenarioBound.
        Implements eq. (intersection-union) of [B82].

        Formula: ell = min_k L_k; {min_k L_k > rho*} lies in {L_k* > risk_k*} for the fixed k* with risk_k* = rho*, so
        that the full delta serves every scenario. Assumes what the head of this module says.
        """
        worst = min(range(len(self._states)), key=lambda k: (self._states[k].lower, k))
        upper = self._risk_of(GRID - self._upper.rejected(), up=True)
        return ScenarioBound(self._states[worst].lower, upper, worst, tuple(self._states))

    def stops(self) -> bool:
        """Return whether further rollouts can bring at most alpha: 0 <= upper - ell <= alpha."""
        return 0.0 <= self.bound().gap <= self._alpha

    @property
    def refuted(self) -> bool:
        """Whether upper < ell: at confidence 1 - 2 delta, rollouts are not independent with one law per scenario."""
        return self.bound().gap < 0.0

    def _outlook(self, k: int, flying: int) -> float:
        """Return the lower bound of x that is to be expected once the tests in flight are in."""
        past, lower = self._below[k], self._lower[k].lower()
        mean = 1.0 - past.mean if past.count else 1.0
        tests = self._tests[k]
        return mean - (mean - lower) * (tests / (tests + flying)) if flying else lower

    def _scaled(self, value: float) -> float:
        low, high = self._range
        found = value if self._constants is None else linearised(value, self._risk_weight, *self._constants)
        return min(max((found - low) / (high - low), 0.0), 1.0)  # leaves [0, 1] by rounding at most

    def _state(self, k: int) -> ScenarioState:
        lower, each = (self._risk_of(self._lower[k].rejected(level), up=False) for level in (0, 1))
        low, high = self._range
        mean = high - (high - low) * self._below[k].mean if self._below[k].count else None
        return ScenarioState(self._below[k].count, mean, lower, each)

    def _risk_of(self, g: int, *, up: bool) -> float:
        """Return the bound of the risk that the candidate g/G stands for, rounded outward to 1e-9."""
        low, high = (Fraction(end) for end in self._range)
        unit = low + (high - low) * Fraction(g, GRID)
        if self._constants is None:  # 1e-12 is far more than phi can lose to rounding
            unit = Fraction(bhatia_davis(float(unit), self._clip, self._risk_weight) + (1e-12 if up else -1e-12))
        bound = min(math.ceil(unit * STEP) / STEP, self._clip[1]) if up else math.floor(unit * STEP) / STEP
        return max(bound, self._least)  # for the upper bound too: ell never tends to less


def _checked_scenarios(scenarios: Floats) -> Floats:
    found = np.array(scenarios, dtype=np.float64)
    if found.ndim != 2 or not 1 <= len(found) <= MAX_SCENARIOS or not np.isfinite(found).all():
        raise ValueError(f"scenarios are 1 to {MAX_SCENARIOS} rows of finite numbers, not an array of {found.shape}")
    seen: dict[tuple[float, ...], int] = {}
    for k, x in enumerate(tuple(row) for row in (found + 0.0).tolist()):  # + 0.0: -0.0 and 0.0 are one number
        if x in seen:
            raise ValueError(f"scenarios {seen[x]} and {k} are the same, {x}; keep one of them")
        seen[x] = k
    found.setflags(write=False)
    return found


def _check_index(index: int, size: int) -> None:
    if not 0 <= index < size:
        raise IndexError(f"scenario {index} is outside the {size} scenarios")
