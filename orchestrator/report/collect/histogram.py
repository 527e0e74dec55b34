"""The robustness of all rollouts of each problem, by variant, as histograms."""

from array import array
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ...store.rollout_values import AddedValue
from ..data.bars import bar_counts, edges_over
from ..data.charts import RolloutHistogram, VariantCounts

Clip = tuple[float, float] | None


class RolloutValues:
    """The robustness of the rollouts so far, by problem and variant: 12 bytes a rollout. Not thread-safe."""

    def __init__(self) -> None:
        self._values: dict[tuple[str, str], tuple[array[float], array[int]]] = {}

    def add(self, added: Iterable[AddedValue]) -> None:
        """Add rollouts."""
        for each in added:
            key = each.problem, each.variant
            values, tests = self._values.setdefault(key, (array("d"), array("l")))
            values.append(each.robustness)
            tests.append(each.test)

    def histogram(self, problem: str, clip: Clip, unit: str) -> RolloutHistogram | None:
        """Return the histogram of a problem, with common edges for its variants; None without a robustness."""
        found = {
            variant: (np.array(values), np.array(tests))
            for (name, variant), (values, tests) in sorted(self._values.items())
            if name == problem
        }
        if not found:
            return None
        low, high = (float(pick([pick(values) for values, _ in found.values()])) for pick in (np.min, np.max))
        edges = edges_over(low, high, (low, high))
        variants = tuple(_counts(variant, *each, edges, clip) for variant, each in found.items())
        return RolloutHistogram(tuple(edges), unit, variants)


def _counts(
    variant: str, values: NDArray[np.float64], tests: NDArray[np.int_], edges: list[float], clip: Clip
) -> VariantCounts:
    least = values == values.min()
    low, high = clip or (-np.inf, np.inf)
    return VariantCounts(
        variant=variant,
        counts=tuple(bar_counts(values.tolist(), edges)),
        rollouts=len(values),
        violations=int((values < 0).sum()),
        least=float(values.min()),
        test=int(tests[least].min()),
        at_clip=(int((values <= low).sum()), int((values >= high).sum())),
    )
