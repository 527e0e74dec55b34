"""The rollouts at drawn starts as a histogram of their robustness, with the bounds that are numbers of its axis."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ....schemas.file.drawn_claims import PROBABILITIES, SAMPLED, ClaimRequest
from ...campaign.plan import ProblemPlan
from ...mathematics.bounds.sample import SampleMethod
from ..data.bars import bar_counts, edges_over
from ..data.page import Drawn, Mark
from .recorded_tests import Floats

REACH = 0.5
"""The axis reaches a bound that is at most this share of the spread beyond the values."""


def histograms(
    plan: ProblemPlan, method: SampleMethod, tests: NDArray[np.intp], each: Floats, unit: str
) -> list[Drawn]:
    """Return the histogram of the whole specification, then that of each requirement.

    `tests` (n,) are the numbers of the drawn tests, at least one, and `each` (n, w) the contributions to them.
    """
    names = (None, *plan.requirements)
    width = (int((~np.isnan(each[0])).sum()) - plan.reported) // len(names)
    return [
        _histogram(plan, method, (tests, each[:, place * width]), (place, name), unit)
        for place, name in enumerate(names)
    ]


def _histogram(
    plan: ProblemPlan,
    method: SampleMethod,
    drawn: tuple[NDArray[np.intp], Floats],
    which: tuple[int, str | None],
    unit: str,
) -> Drawn:
    tests, values = drawn
    low, high = float(values.min()), float(values.max())
    bounds = [
        (claim.asked, method.found(number)) for number, claim in enumerate(plan.claims) if claim.place == which[0]
    ]
    marks = tuple(_bound_mark(asked, bound) for asked, bound in bounds if _is_value(asked) and bound is not None)
    least, most = _axis_ends(low, high, [mark.value for mark in marks])
    edges = edges_over(least, most, (low, high))
    return Drawn(
        requirement=which[1],
        edges=tuple(edges),
        counts=tuple(bar_counts(values, edges)),
        violations=int((values < 0).sum()),
        zeros=int((values == 0).sum()),
        unit=unit,
        marks=marks,
        failure=next((bound for asked, bound in bounds if asked.quantity == "failure_probability"), None),
        worst=int(tests[values.argmin()]),  # of equal ones the first
        least=low,
    )


def _is_value(asked: ClaimRequest) -> bool:
    return asked.quantity not in PROBABILITIES


def _bound_mark(asked: ClaimRequest, bound: float) -> Mark:
    level = "" if asked.level is None else f" {100 * asked.level:.6g} %"
    factor = "" if asked.factor == 1 else f", factor {asked.factor:g}"
    return Mark(f"{asked.quantity.replace('_', ' ')}{level}{factor}", bound, SAMPLED[asked.quantity].sense)


def _axis_ends(low: float, high: float, bounds: Sequence[float]) -> tuple[float, float]:
    """Return the ends of the values, or of the bounds beyond them that are not far away.

    >>> _axis_ends(0.0, 10.0, [-2.0, 4.0, -100.0])
    (-2.0, 10.0)
    """
    reach = REACH * (high - low)
    near = [bound for bound in bounds if low - reach <= bound <= high + reach]
    return min([low, *near]), max([high, *near])
