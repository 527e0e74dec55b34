"""The observation of a test: the value y of the maximised objective J and its parts, from the trajectories."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ...schemas.errors import CampaignError
from ...schemas.file.config import CampaignConfig
from ...schemas.file.objectives import OBJECTIVES, replicates_are_robustness
from ...schemas.file.parts import parts_of
from ...schemas.ids import RolloutId
from ...schemas.result.block_facts import BatchFact
from ...schemas.result.facts import RolloutFact
from ...schemas.system import SystemSpec
from ...schemas.trajectory.batch import Batch
from ...schemas.trajectory.early_end import end_of
from ...schemas.trajectory.reduced import Scores
from ...schemas.trajectory.trajectory import Trajectory
from ...schemas.values import Observation
from ..mathematics.bounds.one_law.risk import linearised
from ..mathematics.search.goal import ALONE, Goal, goal_of, margins, scaled
from ..mathematics.stl.parser import Formula, parse_formula
from ..mathematics.stl.predicates import predicate_sup
from ..mathematics.stl.robustness import Evaluated, evaluated_each
from . import objectives
from .plan import UNBOUNDED, ProblemPlan

Floats = NDArray[np.float64]
Trajectories = Mapping[tuple[str, int], Trajectory]
"""(variant, replicate) -> trajectory of one test."""
Others = Callable[[tuple[str, int]], Iterable[Trajectory]]
"""(variant, replicate) -> the trajectories of the same test that are there for it."""


LIMITS = -objectives.LARGEST, objectives.LARGEST


class Score(NamedTuple):
    """What a fact says of the trajectory of a rollout."""

    robustness: float | None
    """Clipped; None without a specification."""
    by_tolerance: bool
    """Whether the tolerance of its time stamps could decide the sign of the specification, or of a requirement."""
    ended: float | None
    """When it ended, in s, if that was before the horizon."""
    parts: tuple[float, ...]
    """The robustness of each part that a search has a model of."""


def goal_of_search(config: CampaignConfig, spec: SystemSpec) -> tuple[Goal, tuple[Formula, ...]]:
    """Return the goal of the search of a campaign, and the parts that are recorded: none where it models the whole."""
    # Of a batch the scores of the whole are recorded, in columns.
    if config.falsify is None or config.formula is None or config.batch > 1:
        return ALONE, ()
    tree, scale = parse_formula(config.formula, spec.units), config.falsify.scale
    goal, parts = goal_of(tree if scale is None else scaled(tree, scale))
    return goal, parts if len(parts) > 1 or scale else ()


def for_search(
    goal: Goal, robustness: float, parts: tuple[float, ...], *, has_scale: bool
) -> tuple[float, tuple[float, ...]]:
    """Return what the search of a campaign observes of the score of a rollout: the whole, and each of several parts.

    With a scale the whole is that of the parts, whose predicates are divided by it; the signs are the same.

    >>> for_search(ALONE, -2000.0, (-0.4,), has_scale=True)
    (-0.4, ())
    """
    whole = float(margins(goal, np.array([parts]))[0]) if has_scale and parts else robustness
    return objectives.clipped(whole, LIMITS), parts if len(parts) > 1 else ()


class Observer:
    """The objectives of a campaign.

    Raises:
        FormulaError: the specification is not a formula over the columns of the system.

    """

    def __init__(self, config: CampaignConfig, spec: SystemSpec) -> None:
        self._columns = tuple(column.name for column in spec.columns)
        self._after_end, self._of_two = spec.after_end, bool(spec.simulators)
        self._beyond = config.beyond
        # Columns alone have no robustness without a clip: their certificates must not depend on a specification.
        columns_alone = all(OBJECTIVES[problem.name].measured == "column" for problem in config.problems)
        self._clip = config.clip or (None if columns_alone else UNBOUNDED)
        self._parsed = None if config.formula is None else parse_formula(config.formula, spec.units)
        self._sought = goal_of_search(config, spec)[1]
        self._requirements = [parse_formula(each.formula, spec.units) for each in config.specifications]
        self._parts = {
            each.name: Observer(part, spec) for each, part in zip(config.specifications, parts_of(config), strict=False)
        }
        self._known: WeakKeyDictionary[Trajectory, dict[int, Evaluated]] = WeakKeyDictionary()
        """By the identity of a formula of this observer: a hash would walk through it, four times a rollout."""
        self._compared: WeakKeyDictionary[Trajectory, WeakKeyDictionary[Trajectory, float]] = WeakKeyDictionary()

    @property
    def _formula(self) -> Formula:
        if self._parsed is None:
            raise CampaignError("specification: required by every problem but 'maximum'")
        return self._parsed

    def robustness(self, trajectory: Trajectory) -> float | None:
        """Return the robustness, clipped if the campaign has a clip; None for a campaign that measures none.

        Raises:
            ValueError: the formula cannot be evaluated on this trajectory.

        """
        if self._parsed is None or self._clip is None:
            return None
        return objectives.clipped(self._evaluated(trajectory, self._parsed).robustness, self._clip)

    def score(self, trajectory: Trajectory) -> Score:
        """Return what is recorded of a rollout. Raises as `robustness`."""
        # A clip of one sign leaves nothing to decide, but changes no word: the sign is that of the specification.
        formulas = ([] if self._parsed is None else [self._parsed]) + self._requirements
        return Score(
            self.robustness(trajectory),
            by_tolerance=any(self._evaluated(trajectory, each).by_tolerance for each in formulas),
            ended=None if self._after_end is None else end_of(trajectory),
            parts=tuple(self._of_part(trajectory, each) for each in self._sought),
        )

    def _of_part(self, trajectory: Trajectory, part: Formula) -> float:
        try:
            found = self._evaluated(trajectory, part).robustness
        except ValueError:
            # What decides nothing alone, as a window that is empty, may be decided by the other parts.
            found = self._evaluated(trajectory, self._formula).robustness
        return objectives.clipped(found, LIMITS)

    def scores_of(self, batch: Batch) -> Scores:
        """Return the scores of a batch: of each rollout those that it has alone."""
        failures = dict(batch.failures)
        by_tolerance = np.zeros(len(batch), dtype=np.bool_)
        ended = np.full(len(batch), math.nan)
        if self._after_end is not None:
            for place in batch.succeeded:
                end = end_of(batch.trajectory(place))
                ended[place] = math.nan if end is None else end
        robustness: Floats | None = None
        for formula in ([] if self._parsed is None else [self._parsed]) + self._requirements:
            found = evaluated_each(formula, batch.columns, batch.time, batch.values, self._beyond)
            margins = found.robustness
            if self._after_end == "fail":
                share = np.nan_to_num(1.0 - ended / float(batch.time[-1]))
                margins, marks = np.minimum(margins, -share), found.by_tolerance & (share == 0.0)
                margins = np.where(share > 0.0, margins, found.robustness)
            else:
                marks = found.by_tolerance
            by_tolerance |= marks
            for place, fault in found.faults.items():
                failures.setdefault(place, f"the objective cannot be computed: {fault}")
            if formula is self._parsed and self._clip is not None:
                robustness = np.clip(margins, *self._clip)
                for place in np.flatnonzero(~(np.abs(robustness) <= objectives.LARGEST)).tolist():
                    failures.setdefault(place, f"the robustness is {robustness[place]:.3g}")
        failed = list(failures)
        by_tolerance[failed], ended[failed] = False, math.nan
        if robustness is not None:
            robustness[failed] = math.nan
        return Scores(robustness, by_tolerance, ended, failures)

    def _evaluated(self, trajectory: Trajectory, formula: Formula) -> Evaluated:
        # Needed when a rollout is checked, when it is recorded, and when its test is observed.
        known = self._known.setdefault(trajectory, {})
        if id(formula) not in known:
            known[id(formula)] = objectives.scored(formula, trajectory, self._after_end, self._beyond)
        return known[id(formula)]

    def robustness_of(self, plan: ProblemPlan, trajectory: Trajectory) -> float | None:
        """Return the robustness that a problem is about: where it has a requirement, of that one."""
        part = self if plan.requirement is None else self._parts.get(plan.requirement, self)
        return part.robustness(trajectory)

    def check(self, plan: ProblemPlan, key: tuple[str, int], trajectory: Trajectory, others: Others) -> None:
        """Compute what one rollout contributes to an observation, alone and with the other one of its pairs.

        Nothing of it is computed again when the test is observed.

        Raises:
            ValueError: it cannot be computed, or is too large for what follows.

        """
        match plan.objective.measured:
            case "robustness":
                pass  # the robustness of every rollout is computed and recorded, whatever its problem
            case "gap":
                for pair in plan.pairs(*key):
                    (other,) = (each for each in pair if each != key)
                    for found in others(other):
                        nominal, true = (found, trajectory) if key[0] == "true" else (trajectory, found)
                        objectives.measured(self._gap(plan, nominal, true), "the gap")
            case "column":
                column = self._column(plan.problem.column)
                objectives.measured(objectives.column_maximum(column, trajectory.samples), "the maximum")

    def observe(self, plan: ProblemPlan, trajectories: Trajectories) -> Observation:
        """Return the observation of a test, in the unit of the objective; J = -rho for a minimum.

        Raises:
            ValueError: a value is not finite, or two trajectories have different time grids.

        """
        found = self._observed(plan, trajectories)
        return found if plan.reports is None else with_reports(found, plan, trajectories)

    def _observed(self, plan: ProblemPlan, trajectories: Trajectories) -> Observation:
        if plan.parts:
            return _together([self._observed(part, trajectories) for part in plan.parts])
        if plan.requirement is not None and plan.requirement in self._parts:
            return self._parts[plan.requirement]._observed(plan, trajectories)
        match plan.objective.measured:
            case "robustness":
                return self._risk(plan, trajectories) if plan.objective.risk else self._robustness(plan, trajectories)
            case "gap":
                return self._sim_gap(plan, trajectories)
            case "column":
                return self._maximum(plan, trajectories)

    def _robustness(self, plan: ProblemPlan, trajectories: Trajectories) -> Observation:
        values = self._scores(trajectories)
        # Some methods take the robustness: they mirror their bounds and not their data.
        if plan.candidates is None:
            # 0 counts as a violation: a simulator that stops a distance at contact gives exactly 0 where it hits.
            y = float(values[0] <= 0) if plan.sense == "max" else -objectives.mean(values)
            return Observation(y, (*values, *self._of_requirements(plan, trajectories)))
        if replicates_are_robustness(plan.name, plan.problem.method):
            return Observation(-objectives.mean(values), tuple(values))
        return _mean([-value for value in values])

    def _of_requirements(self, plan: ProblemPlan, trajectories: Trajectories) -> Iterator[float]:
        for formula in self._requirements:
            for each in trajectories.values():
                yield objectives.clipped(self._evaluated(each, formula).robustness, plan.clip)

    def _risk(self, plan: ProblemPlan, trajectories: Trajectories) -> Observation:
        problem, values, weight = plan.problem, self._scores(trajectories), plan.risk_weight
        # The paper observes the sample risk itself; the replicates are kept for the audit.
        if problem.method == "paper":
            return Observation(-objectives.risk(values, weight), tuple(values))
        # Bounded below by an expectation whose samples are centred; method `scenario` linearises inside its own bet.
        if (constants := problem.observed_through) is not None:
            return _mean([-linearised(value, weight, constants.centre, constants.spread) for value in values])
        return Observation(-objectives.mean(values), tuple(values))

    def _sim_gap(self, plan: ProblemPlan, trajectories: Trajectories) -> Observation:
        gaps = []
        for replicate in range(plan.replicates):
            nominal, true = (trajectories[plan.replicate(variant, replicate)] for variant in ("nominal", "true"))
            gaps.append(self._gap(plan, nominal, true))
        return _mean(gaps)

    def _gap(self, plan: ProblemPlan, nominal: Trajectory, true: Trajectory) -> float:
        compared = self._compared.setdefault(true, WeakKeyDictionary())  # of the one problem with a gap
        if nominal not in compared:  # needed when the second one is recorded, and when the test is observed
            compared[nominal] = self._computed_gap(plan, nominal, true)
        return compared[nominal]

    def _computed_gap(self, plan: ProblemPlan, nominal: Trajectory, true: Trajectory) -> float:
        gap, (low, high) = plan.gap, plan.clip
        if gap.kind == "robustness":
            first, second = self._scores({("nominal", 0): nominal, ("true", 0): true})
            return first - second
        one, other = true.samples, nominal.samples
        if self._of_two:
            one, other = objectives.at_common_times(one, other)
        if gap.kind == "predicate_sup":
            found = predicate_sup(self._formula, nominal.columns, one, other)
        else:
            found = objectives.signal_sup(self._column(gap.column), one, other)
        # The paper does not clip. Elsewhere (M + m)/L is enough: no two clipped values differ by more than M + m.
        return found if plan.problem.method == "paper" else min(found, (high - low) / gap.lipschitz)

    def _maximum(self, plan: ProblemPlan, trajectories: Trajectories) -> Observation:
        column = self._column(plan.problem.column)
        return _mean([objectives.column_maximum(column, trajectory.samples) for trajectory in trajectories.values()])

    def _column(self, name: str | None) -> int:
        return self._columns.index(name or "")

    def _scores(self, trajectories: Trajectories) -> list[float]:
        values = [self.robustness(trajectory) for trajectory in trajectories.values()]
        return [value for value in values if value is not None]


def with_reports(observation: Observation, plan: ProblemPlan, trajectories: Trajectories) -> Observation:
    """Return an observation with what its rollouts report of their disturbances, at the end of its contributions."""
    assert plan.reports is not None
    variant, columns = plan.reports
    found = [
        float(trajectories[plan.replicate(variant, replicate)].samples[0, column])
        for replicate in range(plan.replicates)
        for column in columns
    ]
    return Observation(observation.y, (*observation.each, *found))


def _together(each: Sequence[Observation]) -> Observation:
    """Return the observations of the requirements as one: of the largest J, followed by the replicates of each."""
    return Observation(max(one.y for one in each), tuple(value for one in each for value in one.each))


def by_requirement(plan: ProblemPlan, observation: Observation) -> list[Observation]:
    """Return the observation of each requirement of a problem that bounds each on its own."""
    return [of_requirement(plan, place, observation) for place in range(len(plan.parts))]


def of_requirement(plan: ProblemPlan, place: int, observation: Observation) -> Observation:
    """Return the observation of one of its requirements, by its place among them."""
    values = plan.values_of(observation.each)
    width = len(values) // len(plan.parts)
    each = values[place * width : (place + 1) * width]
    mean = objectives.mean(list(each))
    y = -mean if replicates_are_robustness(plan.name, plan.problem.method) else mean
    # Each has the same rollouts.
    return Observation(y, (*each, *plan.reported_of(observation.each)))


def _mean(each: list[float]) -> Observation:
    return Observation(objectives.mean(each), tuple(each))


# Blocks: the observation of each of their tests, from the batches with its r rollouts

Load = Callable[[BatchFact], Batch]
"""Reads the trajectories of a batch."""


def observed_block(
    observer: Observer, plan: ProblemPlan, tests: int, batches: Sequence[BatchFact], load: Load
) -> tuple[Floats, Floats]:
    """Return y (k,) and the contributions (k, w) of a block of k = `tests` tests; each is what `observe` gives.

    Raises:
        ValueError: a value is not finite, or two trajectories have different time grids.

    """
    if is_robustness(plan):
        return _of_robustness(plan, _by_test(tests, batches))
    rows = [observer.observe(plan, each) for each in block_trajectories(tests, batches, load)]
    return np.array([row.y for row in rows]), np.array([row.each for row in rows])


def observed_scores(plan: ProblemPlan, rollouts: Sequence[RolloutFact]) -> Observation:
    """Return what `observe` gives for a test with these rollouts, in their order, where `is_robustness`."""
    y, each = _of_robustness(plan, np.array([[fact.robustness for fact in rollouts]], dtype=np.float64))
    return Observation(float(y[0]), tuple(each[0].tolist()))


def is_robustness(plan: ProblemPlan) -> bool:
    """Whether a test follows from the recorded robustness of its rollouts."""
    whole = not plan.parts and not plan.requirements and plan.requirement is None
    of_trajectories = plan.reports is not None or plan.problem.method == "paper"
    return whole and plan.objective.measured == "robustness" and not of_trajectories


def _of_robustness(plan: ProblemPlan, values: Floats) -> tuple[Floats, Floats]:
    """Return the observations from robustness (k, r), as `Observer` has them."""
    problem = plan.problem
    if plan.candidates is None:
        y = (values[:, 0] <= 0).astype(np.float64) if plan.sense == "max" else -_means(values)
        return y, values
    if plan.objective.risk and (constants := problem.observed_through) is not None:
        weight, centre, spread = plan.risk_weight, constants.centre, constants.spread
        each = np.array([[-linearised(value, weight, centre, spread) for value in row] for row in values.tolist()])
        return _means(each), each
    if plan.objective.risk or replicates_are_robustness(plan.name, problem.method):
        return -_means(values), values
    return _means(-values), -values


def _means(values: Floats) -> Floats:
    """Return the mean of each row (k, r), correctly summed as that of one test."""
    if values.shape[1] == 1:
        return values[:, 0]
    return np.array([math.fsum(row) / len(row) for row in values.tolist()])


def _by_test(tests: int, batches: Sequence[BatchFact]) -> Floats:
    """Return the robustness of the rollouts of each test, shape (k, r), in the order of their numbers."""
    # One that failed in its batch is in a later batch of its own, with the same test and replicate.
    first = min(batch.rollout.test for batch in batches)
    numbers = sorted({batch.rollout.replicate + each for batch in batches for each in range(batch.replicates)})
    found = np.full((tests, len(numbers)), np.nan)
    for batch in batches:
        assert batch.robustness is not None, "its problem is about the robustness"
        row, place = batch.rollout.test - first, numbers.index(batch.rollout.replicate)
        there = found[row : row + len(batch.tests), place : place + batch.replicates]
        values = batch.robustness.reshape(there.shape)
        np.copyto(there, values, where=batch.succeeded.reshape(there.shape))
    if not np.isfinite(found).all():
        raise ValueError("a rollout's value is not a finite number")
    return found


def block_trajectories(tests: int, batches: Sequence[BatchFact], load: Load) -> list[Trajectories]:
    """Return the trajectories of each test of a block of so many, from its batches."""
    first = min(batch.rollout.test for batch in batches)
    found: list[dict[RolloutId, Trajectory]] = [{} for _ in range(tests)]
    for batch in batches:
        loaded, succeeded = load(batch), batch.succeeded
        for place, rollout in enumerate(batch.rollouts):
            if succeeded[place]:
                found[rollout.test - first][rollout] = loaded.trajectory(place)
    # By id, as those of a single test.
    return [{rollout[2:]: each[rollout] for rollout in sorted(each)} for each in found]
