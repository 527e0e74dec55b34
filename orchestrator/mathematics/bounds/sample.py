"""Method `sample`: claims about rollouts at starts that are drawn from one distribution, in any dimension.

| symbol | name       | meaning                                                                     | shape | unit |
|--------|------------|-----------------------------------------------------------------------------|-------|------|
| n      | `count`    | samples so far: one start each, with its rollouts                           | ()    | -    |
| v      | `values`   | robustness of the rollouts of one start, the first one read where one counts | (b,) | v    |
| v-bar  |            | their mean                                                                  | ()    | v    |
| q      | `share`    | level of a claim, divided by Lambda                                         | ()    | -    |
| Lambda | `ratio`    | dP'/dP <= Lambda for every distribution P' that the claim covers            | ()    | -    |
| delta  | `delta`    | failure probability of one claim                                            | ()    | -    |

Every claim has a bound that is valid after each sample, and at a number of samples that was fixed beforehand some have
a better one: the exact bound of `share`. A start depends on its number alone, so the samples are independent whatever
the order of the rollouts, and nothing that was chosen by its outcome enters.

Shift. dP'/dP <= Lambda makes P'(A) <= Lambda P(A) for every set A of starts, so that Q'_q >= Q_(q/Lambda) and CVaR'_q
>= CVaR_(q/Lambda): the worst share q under P' has at most Lambda/q times the density of P. The mean is CVaR_1. Given
its start, a rollout has one law under both.
"""

import math
from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from ....schemas.values import Band, Bound, Observation, Proposal, SampledQuantity
from ..control.sequence import Control, Disturbed
from ..gp.kernels import Floats
from .method import Integers, Method
from .one_law.failures import FailureSequence, QuantileSequence
from .one_law.many import are_within
from .one_law.predictable import CvarSequence, PredictableSequence, RiskSequence
from .one_law.share import (
    clopper_pearson_lower,
    clopper_pearson_upper,
    next_rollout_rank,
    quantile_lower,
    ranked,
    shifted_failure_upper,
    shifted_share,
)
from .rounding import round_down

STEPS = 1000
"""Candidates of a quantile between the ends of the clip, where it is bounded after every sample."""
SAME_START = 1e-8
"""Of a start, relative to its size: another machine draws it within this distance, see `campaign.draws`."""


@dataclass(frozen=True, slots=True)
class Terms:
    """One claim, and what its bound follows from; `level` is 1 for a quantity without one."""

    quantity: SampledQuantity
    delta: float
    level: float = 1.0
    ratio: float = 1.0
    clip: tuple[float, float] | None = None
    risk_weight: float = 0.0
    deterministic: bool = False
    """Whether the robustness follows from the start alone."""
    place: int = 0
    """Of the requirement that it is about, from 1; 0 for the whole specification."""
    disturbed: Disturbed | None = None
    """The disturbances of the rollouts, for a control; None without one."""


class Estimate(ABC):
    """The bounds of one claim; samples enter in test order, and those of `add` and `add_each` give the same bits."""

    better_when_fixed = True
    """Whether a number of samples that was fixed beforehand has a bound of its own."""

    @property
    def control(self) -> tuple[Control, int] | None:
        """The last control, with the samples before its first fit; None where there is none."""
        return None

    def add(self, values: Sequence[float]) -> None:
        """Add the robustness of the rollouts of the next start."""
        self.add_each(np.array([values], dtype=np.float64))

    @abstractmethod
    def add_each(self, values: Floats) -> None:
        """Add the robustness of the rollouts of the next k starts (k, b), in their order."""

    def add_disturbed(self, values: Floats, scores: Floats) -> None:  # noqa: ARG002
        """Add those of the next starts, with the scores of their disturbances (k, b, m)."""
        self.add_each(values)

    @abstractmethod
    def anytime(self) -> float | None:
        """Return the bound that is valid after every sample; None where there is none."""

    @abstractmethod
    def exact(self) -> float | None:
        """Return the best bound at a number of samples that was fixed beforehand."""

    def partner(self, *, fixed: bool) -> float | None:  # noqa: ARG002
        """Return a bound from the other side, with its own 1 - delta; None where there is none."""
        return None


class FailureEstimate(Estimate):
    """P'(violation) for every P' at once, from the first rollout of each start.

    v < 0 is a violation and v > 0 is none; v = 0 may be one, so that it counts for the bound from above, and not for
    the one from below.
    """

    def __init__(self, terms: Terms) -> None:
        self._possible = FailureSequence(delta=terms.delta, only="upper")
        self._certain = FailureSequence(delta=terms.delta, only="lower")
        self._delta, self._ratio = terms.delta, terms.ratio

    def add(self, values: Sequence[float]) -> None:
        """Count the next start, in a fraction of the time of an array."""
        self._possible.add(values[0] <= 0.0)
        self._certain.add(values[0] < 0.0)

    def add_each(self, values: Floats) -> None:
        """Count the next starts."""
        self._possible.add_each(values[:, 0] <= 0.0)
        self._certain.add_each(values[:, 0] < 0.0)

    def anytime(self) -> float | None:
        """Return Lambda times the bound of the beta mixture."""
        upper = self._possible.upper()  # a multiple of 1e-9 already
        return upper if self._ratio == 1.0 else shifted_failure_upper(upper, self._ratio)

    def exact(self) -> float | None:
        """Return Lambda times the bound of Clopper and Pearson."""
        counts = self._possible.failures, self._possible.count
        return shifted_failure_upper(clopper_pearson_upper(*counts, self._delta), self._ratio)

    def partner(self, *, fixed: bool) -> float | None:
        """Return a lower bound of P(v < 0), of the declared distribution alone."""
        if self._ratio != 1.0:
            return None
        if not fixed:
            return self._certain.lower()
        return clopper_pearson_lower(self._certain.failures, self._certain.count, self._delta)


class QuantileEstimate(Estimate):
    """Q_q of the first rollouts; of a deterministic system also the robustness on all starts but a share q."""

    def __init__(self, terms: Terms) -> None:
        self._share, self._delta, self._values = shifted_share(terms.ratio, terms.level), terms.delta, array("d")
        self._least = None if terms.clip is None else terms.clip[0]
        self._sequence = None
        if terms.clip is not None:
            low, high = terms.clip
            grid = [low + (high - low) * step / STEPS for step in range(1, STEPS + 1)]
            self._sequence = QuantileSequence(self._share, grid, delta=terms.delta)

    def add(self, values: Sequence[float]) -> None:
        """Add the next value, in a fraction of the time of an array."""
        self._values.append(values[0])
        if self._sequence is not None:
            self._sequence.add(values[0])

    def add_each(self, values: Floats) -> None:
        """Add the next values."""
        self._values.frombytes(values[:, 0].tobytes())
        if self._sequence is not None:
            self._sequence.add_each(values[:, 0])

    def anytime(self) -> float | None:
        """Return the bound on the grid; without a clip there is none."""
        if self._sequence is None or self._least is None:
            return None
        found = self._sequence.lower()
        return round_down(self._least if found is None else found)

    def exact(self) -> float | None:
        """Return the value with the rank that the number of samples allows."""
        found = quantile_lower(self._values, self._share, self._delta)
        return self._least if found is None else found


class NextEstimate(Estimate):
    """The robustness of the next rollout, from a number of samples that was fixed beforehand; nothing before."""

    def __init__(self, terms: Terms) -> None:
        self._chance, self._values = shifted_share(terms.ratio, terms.level), array("d")

    def add(self, values: Sequence[float]) -> None:
        """Add the next value, in a fraction of the time of an array."""
        self._values.append(values[0])

    def add_each(self, values: Floats) -> None:
        """Add the next values."""
        self._values.frombytes(values[:, 0].tobytes())

    def anytime(self) -> float | None:
        """Return None."""
        return None

    def exact(self) -> float | None:
        """Return the value with the rank that the number of samples allows."""
        rank = next_rollout_rank(len(self._values), self._chance)
        return None if rank is None else round_down(ranked(self._values, rank))


class MeanEstimate(Estimate):
    """A bound by betting on bounded values: CVaR, mean or risk."""

    better_when_fixed = False

    def __init__(
        self, sequence: PredictableSequence, read: Callable[[Floats], Floats], *, of_means: bool = False
    ) -> None:
        self._sequence, self._read, self._of_means = sequence, read, of_means

    @property
    def control(self) -> tuple[Control, int] | None:
        """The last control, with the samples before its first fit; None where there is none."""
        return self._sequence.control

    def add_each(self, values: Floats) -> None:
        """Add the next values."""
        self._sequence.add_each(self._read(values))

    def add_disturbed(self, values: Floats, scores: Floats) -> None:
        """Add the next values, with the disturbances of the rollouts that are read."""
        self._sequence.add_each(self._read(values), scores if self._of_means else scores[:, 0])

    def anytime(self) -> float | None:
        """Return the bound; that of no evidence is what the clip proves."""
        return self._sequence.lower()

    def exact(self) -> float | None:
        """Return the same bound."""
        return self._sequence.lower()


def _first(values: Floats) -> Floats:
    return values[:, 0]


def _average(terms: Terms) -> Callable[[Floats], Floats]:
    low, high = _clip_of(terms)

    def read(values: Floats) -> Floats:
        if values.shape[1] == 1:
            return values[:, 0]
        means = [math.fsum(row) / len(row) for row in values.tolist()]
        # A mean of clipped values may leave the clip by round-off.
        return np.clip(means, low, high)

    return read


def _cvar(terms: Terms) -> Estimate:
    return MeanEstimate(_worst(terms, terms.level), _first)


def _of_means(terms: Terms) -> Estimate:
    return MeanEstimate(_worst(terms), _average(terms), of_means=True)


def _risk(terms: Terms) -> Estimate:
    clip = _clip_of(terms)
    return MeanEstimate(RiskSequence(terms.risk_weight, clip, delta=terms.delta, disturbed=terms.disturbed), _first)


def _share_of_starts(terms: Terms) -> Estimate:
    # Of a value that its start decides, a quantile says it of the value itself.
    if terms.deterministic:
        return QuantileEstimate(terms)
    return MeanEstimate(_worst(terms, terms.level), _average(terms), of_means=True)


def _worst(terms: Terms, share: float = 1.0) -> CvarSequence:
    worst = shifted_share(terms.ratio, share)
    return CvarSequence(worst, _clip_of(terms), delta=terms.delta, disturbed=terms.disturbed)


def _clip_of(terms: Terms) -> tuple[float, float]:
    if terms.clip is None:
        raise ValueError(f"clip: required by a bound of {terms.quantity!r}")
    return terms.clip


ESTIMATES: Mapping[SampledQuantity, Callable[[Terms], Estimate]] = {
    "failure_probability": FailureEstimate,
    "quantile": QuantileEstimate,
    "cvar": _cvar,
    "mean": _of_means,
    "risk": _risk,
    "share_of_starts": _share_of_starts,
    "next_rollout": NextEstimate,
}
"""The estimate of each quantity."""
CONTROLLED: frozenset[SampledQuantity] = frozenset({"cvar", "mean", "risk", "share_of_starts"})
"""Quantities with a bound by bets on means. Counts of failures and ranks have no mean that a control could keep."""


class SampleMethod(Method):
    """Claims about drawn starts; the first one is the bound of the problem.
    Implements eq. (shift) of [PB].

    An observation has the replicates of the whole specification, then those of each requirement.
    `start` returns the start with a number (p,). `fixed` is the number of samples at which exact bounds are claimed,
    fixed beforehand; None where the end depends on outcomes. `largest` says whether the first claim bounds its quantity
    from above; the bound of J is then that bound, and else its negative. All claims have the same disturbances.

    Raises:
        ValueError: a claim has no bound with these terms.

    >>> terms = Terms("failure_probability", 0.05)
    >>> method = SampleMethod([terms], lambda number: (float(number),), fixed=299, largest=True)
    >>> for _ in range(299):
    ...     bound = method.observe(method.propose(), Observation(-1.0, (1.0,)))
    >>> method.propose().x, bound.upper, method.found(0), method.is_exact
    ((299.0,), 0.009969147, 0.009969147, True)

    """

    def __init__(
        self,
        claims: Sequence[Terms],
        start: Callable[[int], tuple[float, ...]],
        *,
        fixed: int | None,
        largest: bool,
    ) -> None:
        self._claims, self._estimates = tuple(claims), [ESTIMATES[each.quantity](each) for each in claims]
        self._parts = 1 + max(each.place for each in claims)
        self._range = self._claims[0].clip or (-math.inf, math.inf)
        self._start, self._fixed, self._largest = start, fixed, largest
        self._disturbed = self._claims[0].disturbed
        self._count = 0

    @property
    def size(self) -> int:
        """1: a drawn start has no number among candidates."""
        return 1

    @property
    def probability(self) -> float:
        """1 - delta of the first claim."""
        return 1.0 - self._claims[0].delta

    @property
    def control(self) -> tuple[Control, int] | None:
        """The control of the first claim that has one, with the samples before its first fit."""
        return next((each.control for each in self._estimates if each.control is not None), None)

    @property
    def is_exact(self) -> bool:
        """Whether the number of samples is the one that was fixed beforehand."""
        return self._count == self._fixed

    def needs_fixed_number(self, claim: int) -> bool:
        """Whether the bound of a claim, by its place, is valid because the number of samples was fixed beforehand."""
        return self.is_exact and self._estimates[claim].better_when_fixed

    def found(self, claim: int) -> float | None:
        """Return the bound of a claim by its place, in the unit of its quantity; None while there is none."""
        estimate = self._estimates[claim]
        return estimate.exact() if self.is_exact else estimate.anytime()

    def propose(self, first: int | None = None, pending: Sequence[int] = ()) -> Proposal:  # noqa: ARG002
        """Return the next start; it depends on the number of tests so far alone."""
        number = self._count + len(pending)
        return Proposal(number, self._start(number), None, None, None, None)

    def propose_each(self, tests: int, pending: int) -> tuple[Integers, Floats]:
        """Return the next starts."""
        first = self._count + pending
        nodes = np.arange(first, first + tests, dtype=np.int64)
        return nodes, np.array([self._start(number) for number in nodes.tolist()])

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:
        """Return the proposal of `x` (p,) if another machine could have drawn it."""
        number = self._count + len(pending)
        own = self._start(number)
        if any(abs(a - b) > SAME_START * max(abs(a), abs(b)) for a, b in zip(own, x, strict=True)):
            return None
        return Proposal(number, tuple(x), None, None, None, None)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:  # noqa: ARG002
        """Add the rollouts of the next start, and return the bound of the first claim; on an error nothing changes.

        Raises:
            ValueError: there is no value, or one is outside the clip or not finite.

        """
        self._add(observation.each)
        return self.bound()

    def observe_each(self, nodes: Integers, y: Floats, each: Floats) -> Bound:
        """Add the rollouts of the next starts; return the bound of the first claim. Raises as `observe`."""
        self.recall_each(nodes, y, each)
        return self.bound()

    def bound(self) -> Bound:
        """Return the bound of the first claim from the samples so far, of which there may be none."""
        found = self.found(0)
        if found is None:
            return Bound(None, None, None)
        partner = self._estimates[0].partner(fixed=self.is_exact)
        if self._largest:
            return Bound(found, partner, None)
        return Bound(-found, None if partner is None else -partner, None)

    def recall(self, tests: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations; raises as `observe`."""
        if len(tests) == 1:
            self._add(tests[0][1].each)
            return
        for _, alike in groupby((observation.each for _, observation in tests), key=len):
            self._add_each(np.array(list(alike), dtype=np.float64))

    def recall_each(self, nodes: Integers, y: Floats, each: Floats) -> None:  # noqa: ARG002
        """Add observations; raises as `observe`."""
        self._add_each(np.asarray(each, dtype=np.float64))

    def band(self, bound: Bound) -> Band:  # noqa: ARG002
        """Return an empty band: there are no candidates."""
        return Band((), (), (), ())

    def _add(self, values: Sequence[float]) -> None:
        if self._disturbed is not None:
            self._add_each(np.array([values]))
            return
        low, high = self._range
        # Before the first bet: half a sample would change the state.
        if not values or not all(low <= value <= high for value in values):
            raise self._error(values)
        width = len(values) // self._parts
        for terms, estimate in zip(self._claims, self._estimates, strict=True):
            estimate.add(values[terms.place * width : (terms.place + 1) * width])
        self._count += 1

    def _add_each(self, each: Floats) -> None:
        low, high = self._range
        if not len(each):
            return
        reported = np.empty((len(each), 0, 0))
        if self._disturbed is not None:
            each, reported = self._disturbed.split(each, self._parts)
        if not each.shape[1] or not are_within(each, low, high):
            raise self._error(each[~((each >= low) & (each <= high)).all(axis=1)][:1].ravel().tolist())
        width = each.shape[1] // self._parts
        scores = None
        if self._disturbed is not None:
            numbered = enumerate(reported, self._count)
            scores = np.stack([self._disturbed.scores(number, own) for number, own in numbered])
        for terms, estimate in zip(self._claims, self._estimates, strict=True):
            values = each[:, terms.place * width : (terms.place + 1) * width]
            if scores is None:
                estimate.add_each(values)
            else:
                estimate.add_disturbed(values, scores)
        self._count += len(each)

    def _error(self, values: Sequence[float]) -> ValueError:
        low, high = self._range
        return ValueError(f"a sample needs values within the clip [{low}, {high}], not {list(values)}")
