"""Construction of the method and the kernel of each problem from its plan."""

import math
from collections.abc import Mapping
from functools import partial

import numpy as np

from ...schemas.draws.laws import ReportedLaws
from ...schemas.errors import CampaignError
from ...schemas.file.drawn_claims import DrawnClaim
from ...schemas.file.problem_models import (
    KernelProblem,
    KrigingProblem,
    Linearised,
    PaperProblem,
    RigorousProblem,
    SampleProblem,
    ScenarioProblem,
)
from ...schemas.ids import RolloutId
from ...schemas.result.facts import Header
from ...schemas.system import SystemSpec
from ..mathematics.bounds.joint import JointMethod
from ..mathematics.bounds.kriging.bound import KrigingPremises
from ..mathematics.bounds.kriging.design import points_per_parameter
from ..mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from ..mathematics.bounds.paper.formulas import PaperParameters
from ..mathematics.bounds.paper.method import PaperMethod
from ..mathematics.bounds.rigorous.confidence import Premises, mixture
from ..mathematics.bounds.rigorous.method import RigorousMethod
from ..mathematics.bounds.sample import SampleMethod, Terms
from ..mathematics.bounds.scenario import Risk, ScenarioMethod
from ..mathematics.control.basis import MOST_KNOTS, Basis, choice_basis, normal_basis
from ..mathematics.control.sequence import MOST_FUNCTIONS, Disturbed
from ..mathematics.gp.kernels import Matern
from ..mathematics.gp.lattice import Lattice
from .observation import by_requirement
from .plan import UNBOUNDED, Plans, ProblemPlan, unsafe_below, value_range
from .seeds import Floats, rollout_seeds
from .starts import drawn_starts

PartMethod = RigorousMethod | KrigingMethod | ScenarioMethod
"""A method that bounds one of several requirements."""
OneMethod = PaperMethod | PartMethod | SampleMethod
"""The method of one objective."""
ProblemMethod = OneMethod | JointMethod[PartMethod]
Methods = Mapping[str, ProblemMethod]
"""The method of each problem and of each requirement with one of its own, by the key of its plan."""
AT_ONCE = 2**12
"""Rollouts whose scores are computed together: of one they take as long as of a hundred."""


def methods(plans: Plans, header: Header) -> Methods:
    """Return the method of every problem, before its first observation; raises as `method`."""
    found: dict[str, ProblemMethod] = {}
    for plan in plans.values():
        found[plan.key] = whole = method(plan, header)
        if isinstance(whole, JointMethod):
            found |= {part.key: each for part, each in zip(plan.parts, whole.parts, strict=True)}
    return found


def method(plan: ProblemPlan, header: Header) -> ProblemMethod:
    """Return the method of one problem, before its first observation; the header decides the starts that are drawn.

    Raises:
        ValueError: a parameter is outside the range of the method.

    """
    if not plan.parts:
        return _one_method(plan, header)
    # Each requirement on its own, from the same tests.
    # Without a tolerance the tests are planned, and the same for every requirement.
    alphas = [part.problem.alpha or math.inf for part in plan.parts]
    parts = [_one_method(part, header) for part in plan.parts]
    shared = [each for each in parts if isinstance(each, PartMethod)]
    return JointMethod(shared, alphas, partial(by_requirement, plan), plan.chosen_from.nodes)


def _one_method(plan: ProblemPlan, header: Header) -> OneMethod:
    problem = plan.problem
    match problem:
        case PaperProblem() | RigorousProblem() | KrigingProblem():
            return kernel_method(plan, disturbed(plan, header))
        # Of a risk without constants the method bounds the mean, and [BD] the variance: no risk is observed.
        case ScenarioProblem():
            constants = problem.linearised if isinstance(problem.linearised, Linearised) else None
            return ScenarioMethod(
                plan.chosen_from,
                clip=plan.clip,
                risk_weight=plan.risk_weight,
                delta=problem.delta,
                alpha=problem.alpha,
                risk=_scenario_risk(problem) if plan.objective.risk else "mean",
                constants=None if constants is None else (constants.centre, constants.spread),
                disturbed=disturbed(plan, header, plan.budget * plan.replicates),
            )
        case SampleProblem():
            samples = plan.budget if plan.falsify is None else plan.falsify.random(plan.budget)
            known = disturbed(plan, header, samples)
            return SampleMethod(
                [_terms(plan, claim, known) for claim in plan.claims],
                drawn_starts(header, plan.name),
                # An exact bound needs a number of samples that no outcome decides, and a counterexample decides it.
                fixed=None if plan.at_every_moment else samples,
                largest=plan.sense == "max",
            )


def _scenario_risk(problem: ScenarioProblem) -> Risk:
    if problem.linearised is None:
        return "bhatia-davis"
    return "predictable" if problem.linearised == "past" else "linearised"


def kernel_method(plan: ProblemPlan, known: Disturbed | None = None) -> PaperMethod | RigorousMethod | KrigingMethod:
    """Return the method of a problem with a kernel, with the disturbances of its rollouts; raises as `method`."""
    problem = plan.problem
    if isinstance(problem, PaperProblem):
        parameters = PaperParameters(
            rkhs_norm=problem.rkhs_norm,
            noise_scale=plan.noise,
            delta=problem.delta,
            alpha=problem.alpha,
            c=problem.c,
            prior_mean=problem.prior_mean,
            regulariser=problem.regulariser,
            sigma=problem.sigma,
            tail=problem.tail,
        )
        return PaperMethod(_lattice(plan), kernel(plan, problem), parameters, refine=problem.refine)
    if isinstance(problem, KrigingProblem):
        return _kriging_method(plan, problem, known)
    assert isinstance(problem, RigorousProblem)
    premises = Premises(
        rkhs_norm=problem.rkhs_norm,
        noise_scale=plan.noise,
        delta=problem.delta,
        regularisers=_mixture(problem, plan.noise),
        tau=problem.misspecification,
        round_off=problem.round_off,
    )
    return RigorousMethod(
        plan.chosen_from,
        kernel(plan, problem),
        premises,
        alpha=problem.alpha,
        prior_mean=problem.prior_mean,
        slack=problem.slack,
        unsafe_above=_unsafe_above(plan) if plan.regions else None,
    )


def _kriging_method(plan: ProblemPlan, problem: KrigingProblem, known: Disturbed | None) -> KrigingMethod:
    low, high = value_range(plan)
    assert low is not None, "the campaign file is checked for a clip"
    assert high is not None
    constants, lattice = problem.observed_through, _lattice(plan)
    default = min(points_per_parameter(lattice.dimension, plan.budget, plan.replicates), lattice.resolution)
    return KrigingMethod(
        lattice,
        kernel(plan, problem),
        KrigingPremises(problem.rkhs_norm, problem.prior_mean, (low, high), problem.delta),
        # A guess is allowed: it decides how tight the bound is, and not whether it holds.
        spread=problem.spread or (constants.spread if constants else (high - low) / 10),
        budget=KrigingBudget(plan.budget, plan.replicates, problem.points or default),
        disturbed=known,
    )


def kernel(plan: ProblemPlan, problem: KernelProblem) -> Matern:
    """Return the kernel of a problem; its length scales in the order of the parameters."""
    length = problem.kernel.length_scale
    if isinstance(length, dict):
        return Matern(problem.kernel.nu, tuple(length[name] for name in plan.parameters))
    return Matern(problem.kernel.nu, length)


def _terms(plan: ProblemPlan, claim: DrawnClaim, disturbed: Disturbed | None) -> Terms:
    asked = claim.asked
    return Terms(
        quantity=asked.quantity,
        delta=claim.delta,
        level=1.0 if asked.level is None else asked.level,
        ratio=asked.factor,
        clip=None if plan.clip == UNBOUNDED else plan.clip,
        risk_weight=plan.risk_weight,
        deterministic=plan.deterministic,
        place=claim.place,
        disturbed=disturbed,
    )


def _unsafe_above(plan: ProblemPlan) -> float:
    limit = unsafe_below(plan)
    return math.inf if limit is None else -limit


def _lattice(plan: ProblemPlan) -> Lattice:
    if not isinstance(plan.candidates, Lattice):
        where = f"problems.{plan.name}.method: {plan.problem.method!r}"
        raise CampaignError(f"{where} needs a box under [space]: low and high per parameter")
    return plan.candidates


def _mixture(problem: RigorousProblem, noise: float) -> tuple[tuple[float, float], ...]:
    # Without noise Q needs no mixture and spends no delta.
    if noise == 0:
        return ()
    if problem.regulariser is None:
        return mixture(problem.rkhs_norm, noise)
    if isinstance(problem.regulariser, tuple):
        return tuple((each.value, each.weight) for each in problem.regulariser)
    return ((problem.regulariser, 1.0),)


def disturbed(plan: ProblemPlan, header: Header, values: int = 1) -> Disturbed | None:
    """Return the disturbances of the rollouts of a problem; None where no control is asked for, or possible.

    `values` are the planned ones of one law.
    """
    if not plan.controlled:
        return None
    reported = 0 if plan.reports is None else len(plan.reports.columns)
    return Disturbed(bases(header.spec), _Scores(plan, header).of, values, reported)


def bases(spec: SystemSpec) -> tuple[Basis, ...]:
    """Return the functions of each disturbance whose value is known, of which there is one at least."""
    laws = spec.explaining
    knots = min(max(MOST_FUNCTIONS // len(laws), 2), MOST_KNOTS)
    return tuple(choice_basis(law.shares, knots) if law.choices else normal_basis(knots) for law in laws)


class _Scores:
    """The scores of the rollouts of a problem; they follow from the seeds, and from what rollouts report."""

    def __init__(self, plan: ProblemPlan, header: Header) -> None:
        self._plan, self._header, self._template = plan, header, header.template
        self._tests = max(AT_ONCE // plan.replicates, 1)
        self._variant = max(set(plan.variants) & set(header.spec.noisy))
        self._block: tuple[int, Floats] = (-1, np.empty(0))
        self._laws = ReportedLaws(header.spec.reported)

    def of(self, number: int, reported: Floats) -> Floats:
        """Return the scores of the replicates (b, k) of a test, by its number among those that enter the bound.

        `reported` (b, m) is what they report.
        """
        drawn = self._of_seeds(number) if self._header.spec.drawn else np.empty((len(reported), 0))
        return self._laws.beside(drawn, reported)

    def _of_seeds(self, number: int) -> Floats:
        block, place = divmod(self._plan.test_of(number), self._tests)
        if self._block[0] != block:
            self._block = block, self._drawn(block * self._tests)
        found: Floats = self._block[1][place]
        return found

    def _drawn(self, first: int) -> Floats:
        # Both variants of a pair have the same seeds, and so the same disturbances.
        rollout = RolloutId(self._plan.name, first, self._variant, 0)
        seeds = rollout_seeds(self._header, rollout, self._tests, self._plan.replicates)
        return self._template.scores(seeds).reshape(self._tests, self._plan.replicates, -1)
