"""The data of each problem, completed by what its own facts do not have: all rollouts, the spot check, the regions."""

from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ....schemas.ids import RolloutId
from ....schemas.result.certificate import Counterexample, Predicate, ProblemResult
from ....schemas.result.facts import Header, RolloutFact
from ...mathematics.bounds.kriging.method import KrigingMethod
from ...store.export_tables import robustness_unit
from ...store.rollout_values import AddedValues, RolloutValueReader
from ..data.bars import bar_counts, edges_over
from ..data.charts import DisturbanceCharts, Prediction, ProblemCharts, RolloutHistogram, VariantCounts
from ..data.page import Problem, RegionMap
from ..data.rollouts import FoundCounterexample
from . import wording
from .disturbances import RecordedRollouts, disturbance_charts, noisy_variant
from .fresh_starts import FreshStarts, is_refuted
from .prediction import prediction
from .problem import ProblemCollector

# The robustness of all rollouts, as histograms

Clip = tuple[float, float] | None


class RolloutValues:
    """The robustness of the rollouts so far, by problem and variant: 24 bytes a rollout. Not thread-safe."""

    def __init__(self) -> None:
        self._values: dict[tuple[str, str], tuple[array[float], array[int], array[int]]] = {}

    def add(self, added: Iterable[AddedValues]) -> None:
        """Add rollouts."""
        for each in added:
            key = each.problem, each.variant
            values, tests, replicates = self._values.setdefault(key, (array("d"), array("q"), array("q")))
            values.frombytes(each.robustness.tobytes())
            tests.frombytes(each.tests.tobytes())
            replicates.frombytes(each.replicates.tobytes())

    def recorded(self, problem: str, variant: str) -> RecordedRollouts | None:
        """Return the rollouts of a variant of a problem; None where there are none."""
        if (problem, variant) not in self._values:
            return None
        # Copies: an array that lends its memory cannot grow.
        values, tests, replicates = map(np.array, self._values[problem, variant])
        order = np.lexsort((replicates, tests))  # not that in which workers were done
        return RecordedRollouts(tests[order], replicates[order], values[order])

    def number(self, problem: str, variant: str) -> int:
        """Return how many rollouts of a variant of a problem there are."""
        found = self._values.get((problem, variant))
        return len(found[0]) if found else 0

    def histogram(self, problem: str, clip: Clip, unit: str) -> RolloutHistogram | None:
        """Return the histogram of a problem, with common edges for its variants; None without a robustness."""
        found = {
            variant: (np.array(values), np.array(tests))
            for (name, variant), (values, tests, _) in sorted(self._values.items())
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
        counts=tuple(bar_counts(values, edges)),
        rollouts=len(values),
        violations=int((values < 0).sum()),
        least=float(values.min()),
        test=int(tests[least].min()),
        at_clip=(int((values <= low).sum()), int((values >= high).sum())),
    )


class ProblemCompleter:
    """Completes the data of the problems of one campaign. Not thread-safe."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._reader, self._values = RolloutValueReader(directory), RolloutValues()
        self._fresh = FreshStarts()
        # A certificate is final, and so is what follows from it.
        self._predicted: dict[str, Prediction | None] = {}
        self._divided: dict[str, RegionMap | None] = {}
        self._disturbed: dict[str, tuple[tuple[int, int], DisturbanceCharts | None]] = {}
        """With the numbers of tests and rollouts that each is about."""

    def add(self, facts: Iterable[object], violations: Iterable[RolloutFact]) -> None:
        """Add the next facts and violations, those of a spot check, and read the rollouts since the last call.

        Raises:
            JournalError: there is no campaign, or its database is damaged.

        """
        for fact in facts:
            self._fresh.add(fact)
        for violation in violations:
            self._fresh.add_violation(violation)
        self._values.add(self._reader.read())

    def reopen(self) -> None:
        """Forget what followed from a certificate, because the campaign was extended."""
        self._predicted.clear()
        self._divided.clear()

    def data(
        self, collector: ProblemCollector, result: ProblemResult | None, header: Header, predicate: Predicate | None
    ) -> Problem:
        """Return the data of a problem; `result` is its part of the certificate.

        Raises:
            ValueError: the method cannot continue.

        """
        found = collector.data(result)
        charts = self._charts(collector, header, predicate)
        refuted = predicate is not None and is_refuted(predicate, collector.plan)
        return replace(found, regions=self._regions(collector, predicate), charts=charts, refuted=refuted)

    def _charts(self, collector: ProblemCollector, header: Header, predicate: Predicate | None) -> ProblemCharts:
        plan, fed = collector.plan, collector.fed
        spot = predicate.spot_check if predicate else None
        if spot is not None and fed is not None and plan.key not in self._predicted:
            self._predicted[plan.key] = prediction(spot, self._fresh, plan, *fed)
        failing = () if predicate is None else self._fresh.failing(predicate, plan)
        # Where starts are drawn another histogram has the bounds; a requirement has the rollouts of the whole.
        by_itself = plan.candidates is None or plan.requirement is not None
        unit = robustness_unit(header.config, header.spec)
        rollouts = None if by_itself else self._values.histogram(plan.name, header.config.clip, unit)
        predicted = self._predicted.get(plan.key)
        return replace(
            collector.charts,
            prediction=predicted,
            failing=failing,
            rollouts=rollouts,
            disturbances=self._disturbances(collector, header, unit),
        )

    def _disturbances(self, collector: ProblemCollector, header: Header, unit: str) -> DisturbanceCharts | None:
        plan, (method, _) = collector.plan, collector.fed or (None, None)
        variant = noisy_variant(header, plan)
        if variant is None:
            return None
        of = len(collector.observed), self._values.number(plan.name, variant)
        if plan.key not in self._disturbed or self._disturbed[plan.key][0] != of:
            control = method.control if isinstance(method, KrigingMethod) else None
            # The robustness of the whole says nothing about one requirement.
            rollouts = None if plan.requirement is not None else self._values.recorded(plan.name, variant)
            self._disturbed[plan.key] = of, disturbance_charts(header, plan, control, rollouts, unit)
        return self._disturbed[plan.key][1]

    def _regions(self, collector: ProblemCollector, predicate: Predicate | None) -> RegionMap | None:
        name = collector.problem.name
        if predicate is not None and name not in self._divided:
            self._divided[name] = collector.regions(self._directory, predicate)
        return self._divided.get(name)


def ending_counterexample(
    problems: Iterable[ProblemCollector],
    violations: Sequence[RolloutFact],
    predicate: Predicate | None,
    header: Header,
    command: Callable[[str], str],
) -> FoundCounterexample | None:
    """Return the rollout that ended a campaign, or the worst one of a search that continued; None without one.

    `violations` have the least robustness first, `predicate` is that of the certificate, and `command` returns the
    command that simulates a rollout again.
    """
    if predicate is not None and (certified := predicate.counterexample) is not None:
        sentences = wording.counterexample_sentences(certified, header) + wording.search_sentences(predicate, header)
        problem = RolloutId.parse(certified.rollout).problem
        return FoundCounterexample(problem, certified.test, sentences, command(certified.rollout))
    for each in problems:
        last = each.ended_by_counterexample
        if last is None:
            continue
        # A block ends as a whole, and the rollout may be of any of its tests.
        tests = range(last.test + 1 - each.plan.machine.block, last.test + 1)
        of_end = (
            fact for fact in violations if fact.rollout.problem == each.problem.name and fact.rollout.test in tests
        )
        worst = next(of_end, None)
        if worst is not None:
            sentences = wording.counterexample_sentences(_of_facts(each, worst), header)
            again = command(str(worst.rollout))
            return FoundCounterexample(worst.rollout.problem, worst.rollout.test, sentences, again)
    return None


def _of_facts(problem: ProblemCollector, worst: RolloutFact) -> Counterexample:
    plan, start = problem.plan, problem.proposed.proposal(worst.rollout.test).x
    return Counterexample(
        rollout=str(worst.rollout),
        test=worst.rollout.test,
        rollouts=len(plan.rollouts),
        start=dict(zip(plan.parameters, start, strict=True)),
        seed=worst.seed,
        robustness=worst.robustness or 0.0,
    )
