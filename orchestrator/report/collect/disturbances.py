"""What declared disturbances do to the rollouts of a problem: the share of each, the rollouts by the two that matter
most, and the values in the worst rollout.

With a control the shares are those of its parts, else they are estimated from the rollouts, which says less: a
disturbance that acts only together with another one has a share of 0.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....schemas.draws.laws import of_scores
from ....schemas.file.disturbance import Disturbance
from ....schemas.ids import RolloutId
from ....schemas.result.facts import Header
from ...campaign.plan import ProblemPlan
from ...campaign.seeds import seeds_of
from ...mathematics.control.basis import REACH
from ...mathematics.control.sequence import Control
from ...mathematics.importance import Floats
from ..data.charts import DisturbanceCharts, DisturbanceScatter, DisturbanceShare, WorstRollout
from ..rollout.disturbances import drawn_values
from .importance import FEWEST, GROUP, GROUPS, MOST_PARAMETERS, MOST_POINTS

MOST_SAMPLED = 4096
"""Rollouts from which shares are estimated, an even choice of all."""
MOST_DOTS, MOST_WORST = 2000, 500
"""Rollouts in the picture: the worst ones, and an even choice of the others."""
MARKED = 10
"""The worst rollouts that are marked where none violates the specification."""

Integers = NDArray[np.int_]


class RecordedRollouts(NamedTuple):
    """The rollouts of one variant: test, replicate and robustness of each, (n,)."""

    tests: Integers
    replicates: Integers
    robustness: Floats


def noisy_variant(header: Header, plan: ProblemPlan) -> str | None:
    """Return the variant in which the disturbances of a problem act; None where there is none."""
    return max(set(plan.variants) & set(header.spec.noisy), default=None) if header.spec.explaining else None


def disturbance_charts(
    header: Header, plan: ProblemPlan, control: tuple[Control, int] | None, rollouts: RecordedRollouts | None, unit: str
) -> DisturbanceCharts | None:
    """Return the charts of a problem; `rollouts` are those of its noisy variant, `unit` is that of their robustness.

    None before there is anything to show.
    """
    # What rollouts report is in their files alone.
    sampler = None if rollouts is None or not header.spec.drawn else _Sampler(header, plan, rollouts)
    shares, sampled, chance = list[DisturbanceShare](), 0, None
    if control is not None:
        shares = _of_control(header, control[0], 1.0 if plan.sense == "min" else -1.0)
    elif sampler is not None and len(sampler) >= FEWEST:
        sampled = min(len(sampler), MOST_SAMPLED)
        shares, chance = _of_rollouts(header, sampler)
    if not shares:
        return None
    found = None if control is None else control[0]
    places, drawn = [each.place for each in shares], len(header.spec.disturbances)
    return DisturbanceCharts(
        unit=unit,
        explained=None if found is None else found.explained,
        left=None if found is None else found.residual,
        before_fit=0 if control is None else control[1],
        sampled=sampled,
        chance=chance,
        shares=tuple(shares),
        scatter=None if sampler is None else sampler.scatter([each for each in places if each < drawn][:2]),
        worst=None if sampler is None else sampler.worst(),
    )


class _Sampler:
    """The rollouts of a problem with their disturbances, which follow from the seeds: those asked for are drawn."""

    def __init__(self, header: Header, plan: ProblemPlan, rollouts: RecordedRollouts) -> None:
        self._header, self._rollouts = header, rollouts
        variant = noisy_variant(header, plan)
        assert variant is not None, "the rollouts are those of a noisy variant"
        self._series = RolloutId(plan.name, 0, variant, 0)
        self._order = np.argsort(rollouts.robustness, kind="stable")

    def __len__(self) -> int:
        return len(self._order)

    def robustness(self, chosen: Integers) -> Floats:
        return self._rollouts.robustness[chosen]

    def seeds(self, chosen: Integers) -> list[int]:
        return seeds_of(self._header, self._series, self._rollouts.tests[chosen], self._rollouts.replicates[chosen])

    def scores(self, chosen: Integers) -> Floats:
        laws = self._header.template.laws
        assert laws is not None, "the system declares disturbances"
        return laws.scores(self.seeds(chosen))

    def scatter(self, axes: Sequence[int]) -> DisturbanceScatter | None:
        """Return the picture; None without an axis: those that matter are reported."""
        if not axes:
            return None
        chosen = self._dots()
        scores, robustness = self.scores(chosen), self._rollouts.robustness
        violations = int((robustness < 0.0).sum())
        marked = robustness < 0.0 if violations else np.isin(np.arange(len(self)), self._order[:MARKED])
        laws = self._header.spec.disturbances
        return DisturbanceScatter(
            axes=tuple(axes),
            at=tuple(tuple(of_scores(laws[k])(scores[:, k]).tolist()) for k in axes),
            margin=tuple(robustness[chosen].tolist()),
            marked=tuple(marked[chosen].tolist()),
            test=tuple(self._rollouts.tests[chosen].tolist()),
            rollouts=len(self),
            violations=violations,
        )

    def worst(self) -> WorstRollout:
        first = self._order[:1]
        test, replicate = int(self._rollouts.tests[first][0]), int(self._rollouts.replicates[first][0])
        (drawn,) = drawn_values(self._header, self._series.variant, self.seeds(first))
        rollout = self._series._replace(test=test, replicate=replicate)
        return WorstRollout(str(rollout), test, float(self.robustness(first)[0]), drawn)

    def _dots(self) -> Integers:
        """Return the rollouts of the picture in their order."""
        if len(self) <= MOST_DOTS:
            return np.arange(len(self))
        others = np.sort(self._order[MOST_WORST:])
        return np.sort(np.concatenate([self._order[:MOST_WORST], others[even(len(others), MOST_DOTS - MOST_WORST)]]))


def even(number: int, most: int) -> Integers:
    """Return the places of an even choice of so many things, at most `most`.

    >>> even(3, 5).tolist(), even(9, 3).tolist()
    ([0, 1, 2], [0, 4, 8])
    """
    return np.unique(np.rint(np.linspace(0, number - 1, min(number, most))).astype(np.intp))


def _of_control(header: Header, control: Control, sign: float) -> list[DisturbanceShare]:
    """Return the parts of a control, with the sign of the objective, which is that of X or the other one.

    What it explains of recorded rollouts is divided by the variances of its parts under their laws.
    """
    found, total = [], sum(each**2 for each in control.deviations)
    spec = header.spec
    laws = (*spec.disturbances, *spec.reported)
    places = (*spec.drawn_places, *range(len(spec.disturbances), len(laws)))
    for place, basis, levels, deviation in zip(places, control.bases, control.levels, control.deviations, strict=True):
        law = laws[place]
        scores = np.linspace(-REACH, REACH, MOST_POINTS) if law.choices is None else _numbers(law)
        effect = sign * (basis.hats(scores) @ levels[0] - float(basis.means @ levels[0]))
        share = control.explained * deviation**2 / total if total else 0.0
        found.append(DisturbanceShare(place, share, deviation, *_curve(law, scores, effect)))
    return _largest(found)


def _of_rollouts(header: Header, sampler: _Sampler) -> tuple[list[DisturbanceShare], float]:
    """Return what groups of rollouts with neighbouring values explain, and what may be chance.

    The share is the adjusted R^2 of the means of the groups: of a disturbance without effect it is 0 in the mean, with
    a standard deviation of sqrt(2 (groups - 1)) / rollouts.
    """
    chosen = even(len(sampler), MOST_SAMPLED)
    scores, y = sampler.scores(chosen), sampler.robustness(chosen)
    centred, number = y - y.mean(), len(y)
    total, most = float(centred @ centred), 1
    found = []
    for place in header.spec.drawn_places:
        law = header.spec.disturbances[place]
        labels = _groups(scores[:, place], max(5, min(GROUPS, number // GROUP)))
        counts = np.bincount(labels)
        means = np.bincount(labels, centred) / counts
        left = 1.0 - float(counts @ means**2) / total if total else 1.0
        share = max(1.0 - left * (number - 1) / (number - len(counts)), 0.0)
        at = np.bincount(labels, scores[:, place]) / counts
        found.append(DisturbanceShare(place, share, None, *_curve(law, at, means + y.mean())))
        most = max(most, len(counts))
    return _largest(found) if total else [], 2.0 * math.sqrt(2.0 * (most - 1)) / number


def _groups(scores: Floats, most: int) -> Integers:
    """Return the number of the group of each rollout: one for each score, or groups of neighbours of equal sizes."""
    different, labels = np.unique(scores, return_inverse=True)
    if len(different) <= most:
        return labels
    labels[np.argsort(scores, kind="stable")] = np.arange(len(scores)) * most // len(scores)
    return labels


def _curve(law: Disturbance, scores: Floats, effect: Floats) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the values with these scores in their order, and the effect at each."""
    at = of_scores(law)(scores)
    order = np.argsort(at, kind="stable")
    return tuple(at[order].tolist()), tuple(effect[order].tolist())


def _largest(found: Sequence[DisturbanceShare]) -> list[DisturbanceShare]:
    return sorted(found, key=lambda each: -each.share)[:MOST_PARAMETERS]


def _numbers(law: Disturbance) -> Floats:
    """Return the numbers of the choices of a law, or an even choice of them."""
    return even(len(law.choices or ()), MOST_POINTS).astype(np.float64)
