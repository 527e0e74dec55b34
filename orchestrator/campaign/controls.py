"""What a method gets of declared disturbances: the scores of its rollouts, and functions with known means."""

import numpy as np

from ...schemas.ids import RolloutId
from ...schemas.result.facts import Header
from ..mathematics.control.basis import MOST_KNOTS, Basis, choice_basis, normal_basis
from ..mathematics.control.sequence import MOST_FUNCTIONS, Disturbed
from .plan import ProblemPlan
from .seeds import Floats, rollout_seeds

AT_ONCE = 2**12
"""Rollouts whose scores are computed together: of one they take as long as of a hundred."""


def disturbed(plan: ProblemPlan, header: Header) -> Disturbed | None:
    """Return the disturbances of the rollouts of a problem; None where no control is asked for, or possible."""
    if not plan.controlled:
        return None
    laws = header.spec.disturbances
    knots = min(max(MOST_FUNCTIONS // len(laws), 2), MOST_KNOTS)
    bases: list[Basis] = [choice_basis(law.shares, knots) if law.choices else normal_basis(knots) for law in laws]
    return Disturbed(tuple(bases), _Scores(plan, header).of)


class _Scores:
    """The scores of the rollouts of a problem, by the number of their test; they follow from the seeds."""

    def __init__(self, plan: ProblemPlan, header: Header) -> None:
        self._plan, self._header, self._laws = plan, header, header.template.laws
        self._tests = max(AT_ONCE // plan.replicates, 1)
        self._variant = max(set(plan.variants) & set(header.spec.noisy))
        self._block: tuple[int, Floats] = (-1, np.empty(0))

    def of(self, test: int) -> Floats:
        """Return the scores of the replicates of a test (b, k)."""
        block, place = divmod(test, self._tests)
        if self._block[0] != block:
            self._block = block, self._drawn(block * self._tests)
        found: Floats = self._block[1][place]
        return found

    def _drawn(self, first: int) -> Floats:
        assert self._laws is not None, "a plan without disturbances is not controlled"
        # Both variants of a pair have the same seeds, and so the same disturbances.
        rollout = RolloutId(self._plan.name, first, self._variant, 0)
        seeds = rollout_seeds(self._header, rollout, self._tests, self._plan.replicates)
        return self._laws.scores(seeds).reshape(self._tests, self._plan.replicates, -1)
