"""The plan of each problem: its parameters before the first test, with every default and option resolved."""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain, product
from typing import NamedTuple

import numpy as np

from ...schemas.batch import MOST_NUMBERS
from ...schemas.draws.distributions import to_digits
from ...schemas.errors import CampaignError
from ...schemas.file.config import CampaignConfig
from ...schemas.file.drawn_claims import SAMPLED, DrawnClaim
from ...schemas.file.keys import most_kept
from ...schemas.file.objectives import OBJECTIVES, Objective, ProblemName, Reading, Sense, Statement, rolled_out
from ...schemas.file.parameters import parameter_ranges
from ...schemas.file.parts import parts_of
from ...schemas.file.problem_models import (
    Falsify,
    Gap,
    KrigingProblem,
    PaperProblem,
    Problem,
    RigorousProblem,
    SampleProblem,
    ScenarioProblem,
)
from ...schemas.file.space import Scenarios, StartTable
from ...schemas.system import SystemSpec, Variant
from ..mathematics.bounds.composition import derived_noise_scale
from ..mathematics.bounds.one_law.risk import least_without_risk, linearised_range
from ..mathematics.bounds.rounding import round_up
from ..mathematics.bounds.sample import CONTROLLED
from ..mathematics.gp.lattice import Lattice
from ..mathematics.gp.points import Points
from ..mathematics.sobol import sobol_blocks
from ..mathematics.stl.reach import ANY, Range
from . import state
from .clip import hiding, reach_of
from .region import Start, condition
from .starts import DIGITS, LEAST_SHARE

UNBOUNDED = (-math.inf, math.inf)
"""The clip of a campaign that has none."""
NO_GAP = Gap(kind="robustness")
"""The gap of a problem that compares no trajectories, where nothing reads it."""
PLANNED_WINDOW = 256
"""Tests in flight where no start depends on a rollout."""
PLANNED_BLOCKS = 64
"""Blocks in flight, for the same reason."""


class Reports(NamedTuple):
    """What rollouts report of their disturbances: those of a variant, in the first samples of some columns."""

    variant: Variant
    columns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class ProblemPlan:
    """One problem before its first test."""

    problem: Problem
    variants: tuple[Variant, ...]
    """Rolled out by every replicate of a test."""
    candidates: Lattice | Points | None
    """The starts that tests are chosen from, parameters in the order of the system; None where they are drawn."""
    parameters: tuple[str, ...]
    """The names of the parameters, in this order."""
    window: int
    replicates: int
    budget: int
    """Tests at most."""
    noise: float
    """R of one test, in the unit of the objective; 0 without noise."""
    noise_per_rollout: float
    """R of one rollout, from the campaign file or derived."""
    hoeffding: float
    """R of one rollout by Hoeffding's lemma, half the range of the clipped objective; infinite without a clip."""
    clip: tuple[float, float]
    """`UNBOUNDED` where the claim is about the robustness itself."""
    risk_weight: float
    gap: Gap
    regions: bool
    """Whether the box is divided by the sign of the objective."""
    shared: frozenset[str]
    """Variants of which the replicates of a test share one rollout, because it does not depend on the seed."""
    sense: Sense
    claims: tuple[DrawnClaim, ...] = ()
    """What is claimed of drawn starts, the first claim first; empty where none are drawn."""
    batch: int = 1
    """Rollouts of a batch at most."""
    numbers: int = 1
    """Numbers of a start in a request."""
    gradual: bool = False
    """As in the machine's plan."""
    box: bool = False
    """Whether the space is ranges, and listed starts are points of the Sobol sequence in them."""
    deterministic: bool = False
    """Whether no rollout of its variants depends on the seed."""
    controlled: bool = False
    """Whether a control takes out what the declared disturbances explain."""
    reports: Reports | None = None
    """Of rollouts that report disturbances, where a control takes these."""
    requirements: tuple[str, ...] = ()
    """Names of the requirements that are claimed beside the whole specification, where starts are drawn."""
    at_every_moment: bool = False
    """Whether claims hold after every test, however the campaign ends."""
    may_end_early: bool = False
    """Whether outcomes may end it before its budget, besides a tolerance."""
    requirement: str | None = None
    """The one requirement that it is about; None for the whole specification."""
    parts: tuple["ProblemPlan", ...] = ()
    """The plans of the requirements that are bounded each on its own, from the tests of this one."""
    falsify: Falsify | None = None
    """The search that the tests come from; None where they come from the method."""
    reaches: Mapping[str | None, Range] = field(default_factory=dict)
    """The range of robustness that the formula can reach, and that of each requirement by its name."""

    @property
    def name(self) -> ProblemName:
        """Name of the problem."""
        return self.problem.name

    @property
    def key(self) -> str:
        """Name of the problem, with that of the requirement behind it where there is one."""
        return self.name if self.requirement is None else f"{self.name}/{self.requirement}"

    @property
    def machine(self) -> state.Plan:
        """What the campaign machine needs of it."""
        block = block_size(self.batch, self.rollouts, self.numbers) if self.is_planned else 1
        window = self.window if block == 1 else max(1, min(PLANNED_BLOCKS, self.window))
        return state.Plan(
            self.name, window, self.budget, self.rollouts, batch=self.batch, block=block, gradual=self.gradual
        )

    @property
    def is_planned(self) -> bool:
        """Whether no start depends on a rollout."""
        return self.problem.alpha is None and self.falsify is None

    @property
    def objective(self) -> Objective:
        """The properties of the problem that its name alone decides."""
        return OBJECTIVES[self.problem.name]

    @property
    def listed(self) -> int | None:
        """Number of listed starts, the only ones that the bound covers; None on a box."""
        return self.candidates.size if isinstance(self.candidates, Points) else None

    @property
    def chosen_from(self) -> Lattice | Points:
        """The candidates of a method that chooses among them."""
        assert self.candidates is not None, "starts that are drawn have no candidates"
        return self.candidates

    def is_drawn(self, test: int) -> bool:
        """Whether the start of a test is drawn from the distribution of `[space]`, and so is a sample."""
        return self.candidates is None and (self.falsify is None or self.falsify.is_random(test))

    def is_evidence(self, test: int) -> bool:
        """Whether a test enters the bound; where starts are drawn, one that a search proposed does not."""
        return self.candidates is not None or self.is_drawn(test)

    @property
    def reported(self) -> int:
        """Numbers at the end of the contributions to a test that are no values, but what its rollouts report."""
        return 0 if self.reports is None else self.replicates * len(self.reports.columns)

    def values_of(self, each: Sequence[float]) -> Sequence[float]:
        """Return the contributions to a test without what its rollouts report."""
        return each[: len(each) - self.reported]

    def reported_of(self, each: Sequence[float]) -> Sequence[float]:
        """Return what the rollouts of a test report, of its contributions."""
        return each[len(each) - self.reported :]

    def test_of(self, number: int) -> int:
        """Return the test whose observation is the one with this number among those that enter the bound."""
        return number if self.candidates is not None or self.falsify is None else self.falsify.random_test(number)

    @property
    def exact(self) -> bool:
        """Whether an observation is the objective itself: R = 0, which method `rigorous` alone has."""
        if self.parts:
            return all(part.exact for part in self.parts)
        return isinstance(self.problem, RigorousProblem) and self.noise == 0

    @property
    def statement(self) -> Statement:
        """The subject of the bound: the value itself where the claim lists that nothing is random, else a mean."""
        for claim in self.claims[:1]:
            return self.statement_of(claim)
        return (self.objective.exact if self.exact else None) or self.objective.statement

    def statement_of(self, claim: DrawnClaim, bound: float | None = None) -> Statement:
        """Return the subject of a claim about drawn starts; `bound` as of `hidden_by`."""
        value = "robustness" if self.deterministic else "expected robustness"
        return Statement(claim.words(value, self.hidden_by(claim, bound=bound)), claim.asked.quantity)

    def hidden_by(self, claim: DrawnClaim | None = None, *, bound: float | None = None) -> tuple[float, float] | None:
        """Return the clip that the words of a bound, or of a claim about drawn starts, have to name; see `hiding`."""
        clip = None if self.clip == UNBOUNDED else self.clip
        if claim is None and self.claims:
            claim = self.claims[0]
        if claim is not None:
            within, row = self.reaches.get(claim.requirement, ANY), SAMPLED[claim.asked.quantity]
            of_means = claim.asked.quantity == "share_of_starts" and not self.deterministic
            reading: Reading = "mean" if of_means else row.reading
            return hiding(clip, within, reading, row.sense, risk_weight=self.risk_weight, bound=bound)
        if self.objective.measured == "column":
            return None
        if self.objective.measured == "gap":
            # Only the paper's distance of trajectories is not cut off at what two clipped values can differ by.
            return None if self.problem.method == "paper" and self.gap.kind != "robustness" else clip
        reading = "each" if self.exact else "risk" if self.objective.risk else "mean"
        within = self.reaches.get(None, ANY)
        return hiding(clip, within, reading, self.sense, risk_weight=self.risk_weight, bound=bound)

    @property
    def rollouts(self) -> tuple[tuple[str, int], ...]:
        """(variant, replicate) of every rollout of a test."""
        return tuple(
            (variant, replicate)
            for replicate in range(self.replicates)
            for variant in self.variants
            if replicate == 0 or variant not in self.shared
        )

    def replicate(self, variant: str, replicate: int) -> tuple[str, int]:
        """Return the rollout that serves a replicate of a variant."""
        return variant, 0 if variant in self.shared else replicate

    def pairs(self, variant: str, replicate: int) -> list[tuple[tuple[str, int], tuple[str, int]]]:
        """Return the (nominal, true) rollouts of a gap that one rollout of a test is part of."""
        served = range(self.replicates) if variant in self.shared else (replicate,)
        return [(self.replicate("nominal", each), self.replicate("true", each)) for each in served]


def block_size(batch: int, rollouts: Collection[tuple[str, int]], numbers: int) -> int:
    """Return how many tests with these rollouts, (variant, replicate) of each, are a block where none decides another.

    A start has so many `numbers` in a request, where disturbances have the other half of the room.

    >>> block_size(16, [("true", 0), ("true", 1), ("true", 2)], numbers=2), block_size(1, [("true", 0)], 2)
    (5, 1)
    """
    replicates = max(Counter(variant for variant, _ in rollouts).values())
    return max(1, min(batch // replicates, MOST_NUMBERS // 2 // numbers))


def within_starts(plan: ProblemPlan, tests: int) -> int:
    """Return a number of tests, or the largest useful one: without noise one test at a start shows all."""
    without_noise = isinstance(plan.problem, RigorousProblem) and plan.noise == 0
    if plan.candidates is not None and (without_noise or any(part.exact for part in plan.parts)):
        return min(tests, plan.candidates.size)
    return tests


def unsafe_below(plan: ProblemPlan) -> float | None:
    """Return the value of the bounded objective below which a start is unsafe; None if no value of it proves that."""
    if not plan.objective.risk:
        return 0.0
    assert isinstance(plan.problem, RigorousProblem)
    assert plan.problem.linearised is not None
    constants = plan.problem.linearised.centre, plan.problem.linearised.spread
    # The objective is E[X], which is never above the risk: a negative one alone proves nothing of the risk.
    limit = least_without_risk(plan.clip, plan.risk_weight, *constants)
    least, _ = linearised_range(plan.clip, plan.risk_weight, *constants)
    return limit if limit > round_up(least) else None


def value_range(plan: ProblemPlan) -> tuple[float | None, float | None]:
    """Return the least and the largest J of one rollout, in the unit of J; None where nothing bounds it."""
    (low, high), gap = plan.clip, plan.gap
    if plan.objective.measured == "column" or not math.isfinite(high - low):
        return None, None
    if plan.objective.measured == "gap":
        return (low - high if gap.kind == "robustness" else 0.0), (high - low) / gap.lipschitz
    if (constants := plan.problem.observed_through) is not None:
        least, largest = linearised_range(plan.clip, plan.risk_weight, constants.centre, constants.spread)
        return -largest, -least
    return -high, -low


Plans = Mapping[str, ProblemPlan]
"""The plan of each problem by name, in the order of the campaign file."""


def bounded_plans(plans: Plans) -> list[ProblemPlan]:
    """Return the plan of everything that has a bound of its own: each problem, or each of its requirements."""
    return [part for plan in plans.values() for part in plan.parts or (plan,)]


def plans(config: CampaignConfig, spec: SystemSpec) -> Plans:
    """Return the plans of a campaign."""
    return {problem.name: plan(config, spec, problem) for problem in config.problems}


def plan(config: CampaignConfig, spec: SystemSpec, problem: Problem) -> ProblemPlan:
    """Return the plan of one problem of a campaign that was checked."""
    clip, gap = config.clip or UNBOUNDED, config.gap_of(problem) or NO_GAP
    replicates, tests = config.replicates_of(problem), config.max_tests_of(problem)
    objective, variants = OBJECTIVES[problem.name], rolled_out(problem.name, spec)
    candidates = None if isinstance(problem, SampleProblem) else _candidates(config, spec, problem)
    hoeffding = _hoeffding(config, spec, problem, clip, gap)
    noise = _noise(problem, hoeffding)
    # A deterministic variant gives one trajectory for every seed: one rollout serves all replicates of a test.
    common = objective.measured == "gap" and problem.method != "paper"
    parts = [
        replace(plan(part, spec, part.problems[0]), requirement=each.name)
        for part, each in zip(parts_of(config), config.specifications, strict=False)
    ]
    without_noise = isinstance(problem, RigorousProblem) and noise == 0
    if candidates is not None and (without_noise or any(part.exact for part in parts)):
        tests = min(tests, candidates.size)  # without noise a second test at a candidate adds nothing
    # R / sqrt(replicates) is for means; the paper observes mean - r sd, whose R is in the file as it is.
    mean = not (problem.method == "paper" and objective.risk)
    return ProblemPlan(
        problem=problem,
        variants=variants,
        candidates=candidates,
        parameters=tuple(parameter.name for parameter in spec.parameters),
        # A start that is drawn or planned depends on no rollout, so that tests in flight change nothing.
        window=min(tests, PLANNED_WINDOW)
        if problem.alpha is None and not config.falsify
        else config.window_of(problem),
        replicates=replicates,
        budget=tests,
        noise=noise / math.sqrt(replicates) if mean else noise,
        noise_per_rollout=noise,
        hoeffding=hoeffding,
        clip=clip,
        risk_weight=config.risk_weight,
        gap=gap,
        regions=config.regions,
        shared=frozenset(variants) - set(spec.noisy) if common else frozenset(),
        sense=config.sense_of(problem),
        claims=config.claims_of(problem),
        batch=config.batch,
        numbers=spec.numbers,
        gradual=most_kept(config.keep) is not None,
        box=isinstance(config.space, dict),
        deterministic=not set(variants) & set(spec.noisy),
        controlled=(controlled := is_controlled(config, spec, problem, variants)),
        reports=_reports(spec, variants) if controlled and spec.reported else None,
        requirements=tuple(each.name for each in config.specifications),
        at_every_moment=config.at_every_moment,
        may_end_early=config.may_end_early,
        parts=tuple(parts),
        falsify=config.falsify,
        reaches={None: reach_of(config.formula, spec.after_end, config.beyond)}
        | {each.name: reach_of(each.formula, spec.after_end, config.beyond) for each in config.specifications},
    )


def _candidates(config: CampaignConfig, spec: SystemSpec, problem: Problem) -> Lattice | Points:
    if isinstance(config.space, Scenarios):
        return Points(config.space.scenarios)
    assert not isinstance(config.space, StartTable), "no method takes it that chooses among candidates"
    ranges, names = parameter_ranges(config.space), tuple(parameter.name for parameter in spec.parameters)
    ends = tuple((ranges[name].low, ranges[name].high) for name in names)
    starts = config.starts_of(problem)
    if starts is not None:
        return spread_points(names, ends, starts, config.where)
    low, high = zip(*ends, strict=True)
    return Lattice(low, high, config.resolution_of(problem))


def _reports(spec: SystemSpec, variants: Collection[Variant]) -> Reports:
    columns = [column.name for column in spec.columns]
    return Reports(max(set(variants) & set(spec.noisy)), tuple(columns.index(each.name) for each in spec.reported))


def is_controlled(config: CampaignConfig, spec: SystemSpec, problem: Problem, variants: Collection[Variant]) -> bool:
    """Whether a control takes out what the known disturbances explain of the rollouts of a problem."""
    known = bool(spec.explaining and set(variants) & set(spec.noisy))
    return config.control == "on" and known and _bets_on_means(problem, config)


def _bets_on_means(problem: Problem, config: CampaignConfig) -> bool:
    """Whether a bound of the problem follows from bets on means, which a control leaves as they are."""
    if isinstance(problem, SampleProblem):
        return any(claim.asked.quantity in CONTROLLED for claim in config.claims_of(problem))
    return isinstance(problem, KrigingProblem | ScenarioProblem)


def _noise(problem: Problem, hoeffding: float) -> float:
    if not isinstance(problem, PaperProblem | RigorousProblem):
        return hoeffding  # not used: the bound depends on the clip alone
    return hoeffding if problem.noise_scale == "derived" else problem.noise_scale


def _hoeffding(
    config: CampaignConfig, spec: SystemSpec, problem: Problem, clip: tuple[float, float], gap: Gap
) -> float:
    measured = OBJECTIVES[problem.name].measured
    if measured == "column" or clip == UNBOUNDED or isinstance(problem, SampleProblem):
        return math.inf
    if (constants := problem.observed_through) is not None:
        low, high = linearised_range(clip, config.risk_weight, constants.centre, constants.spread)
        return (high - low) / 2
    compared = measured == "gap"
    return derived_noise_scale(
        gap.kind if compared else "nominal_robustness",
        clip,
        # Of a robustness the variant that is observed, of a gap the one that the other is subtracted from.
        deterministic_nominal=rolled_out(problem.name, spec)[0] not in spec.noisy,
        common_seeds=False,
        lipschitz=gap.lipschitz if compared else 1.0,
    )


# Listed starts of a box, where the file asks for a claim about them

MOST_CORNERS = 64
"""Corners of a box that are listed: those of six parameters."""


@lru_cache(maxsize=4)
def spread_points(
    parameters: tuple[str, ...], ends: tuple[tuple[float, float], ...], count: int, where: str | None
) -> Points:
    """Return `count` starts of a box, or of its region: its corners, then the points of the Sobol sequence.

    The worst start of many systems is in a corner, which no sequence visits. They are listed where they are at most
    `MOST_CORNERS` and half of all starts. `ends` are low and high of each parameter, in their order. Coordinates are
    rounded to `DIGITS` digits as those of drawn starts, so that all machines have the same ones.

    Raises:
        CampaignError: almost nothing of the box is in the region.
        ValueError: `where` is no condition.

    """
    admitted = condition(where, parameters)
    low, high = np.array(ends).T
    found: dict[Start, None] = {}
    most = 2 * count / LEAST_SHARE
    corners = [np.array(list(product((0.0, 1.0), repeat=len(ends))))] if _has_corners(len(ends), count) else []
    tried = 0
    # Unscrambled, and the first ones first: a larger number of candidates repeats a smaller one.
    for shares in chain(corners, sobol_blocks(len(parameters))):
        tried += len(shares)
        values = low + shares * (high - low)
        # The region first, to round few points of many; and once more, because rounding may leave it.
        if admitted is not None:
            values = values[admitted(values)]
        columns = [to_digits(values[:, k], *each, DIGITS) for k, each in enumerate(ends)]
        starts = list(zip(*columns, strict=True))
        inside = [True] * len(starts) if admitted is None else admitted(starts).tolist()
        found |= {start: None for start, kept in zip(starts, inside, strict=True) if kept}
        if len(found) >= count:
            return Points(tuple(found)[:count])
        if tried > most:
            break
    raise CampaignError(
        f"space.where: only {len(found):,} of the {count:,} candidates are in the region; give fewer, or choose "
        "narrower ranges"
    )


def _has_corners(parameters: int, count: int) -> bool:
    """Whether the corners of a box are among so many listed starts of it."""
    return bool(2**parameters <= min(MOST_CORNERS, count // 2))
