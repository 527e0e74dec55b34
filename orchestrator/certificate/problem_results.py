"""Construction of the result of a stopped problem: its bound, probability and parameters."""

from collections.abc import Mapping
from typing import Literal

from ...schemas.file.objectives import Sense
from ...schemas.file.problem_models import Linearised, PaperProblem, RigorousProblem, ScenarioProblem
from ...schemas.result import certificate as document
from ...schemas.result.facts import Header
from ..campaign.methods import Methods, ProblemMethod
from ..campaign.plan import ProblemPlan
from ..campaign.series import Account
from ..mathematics.bounds.kriging.method import KrigingMethod
from ..mathematics.bounds.paper.formulas import Tail, mills_probability
from ..mathematics.bounds.rounding import decimal, floor_to_step, round_down, round_up
from ..mathematics.bounds.sample import SampleMethod
from ..mathematics.bounds.scenario import ScenarioMethod
from .words.bound_text import clip_words

TAILS: tuple[Tail, ...] = ("gaussian", "sub-gaussian")
GAPS = {
    "signal_sup": "sup over t of |true - nominal|",
    "predicate_sup": "sup over t and predicates of |true - nominal|",
    "robustness": "robustness of the nominal - of the true system",
}


def result(account: Account) -> document.ProblemResult:
    """Return the bound of a problem that has stopped, rounded outward to 1e-9."""
    plan, last, proposal = account.plan, account.last_bound, account.last_proposal
    assert proposal is not None
    assert last is not None
    upper, lower = last.bound.upper, last.bound.lower
    assert upper is not None
    assert last.stopped_by is not None
    problem, sense = plan.problem, plan.sense
    minimum = sense == "min"
    # The method bounds J, and J = -rho for a minimum: its upper bound is a lower one of the objective.
    partner = None if lower is None else round_up(-lower) if minimum else round_down(lower)
    chances = _probabilities(plan)
    return document.ProblemResult(
        name=problem.name,
        objective=objective(plan, in_sense(sense, upper)),
        method=problem.method,
        sense=sense,
        bound=in_sense(sense, upper),
        partner=partner,
        probability=chances[problem.tail] if isinstance(problem, PaperProblem) else chances["bound"],
        probabilities=chances,
        tests=len(account.observations),
        rollouts=document.Rollouts(nominal=account.counts["nominal"], true=account.counts["true"]),
        stopped_by=last.stopped_by,
        parameters=_parameters(plan),
        last_F=proposal.F,
        requirement=plan.requirement,
    )


Results = Mapping[str, document.ProblemResult]


def with_controls(results: Results, methods: Methods, header: Header) -> Results:
    """Return the results with the controls of their methods."""
    found = {name: _control(methods[name], header) for name in results}
    return {name: each.model_copy(update={"control": found[name]}) for name, each in results.items()}


def _control(method: ProblemMethod, header: Header) -> document.ControlResult | None:
    if not isinstance(method, KrigingMethod | ScenarioMethod | SampleMethod) or method.control is None:
        return None
    control, before_fit = method.control
    return document.ControlResult(
        explained=_digits(control.explained),
        standard_deviation=_digits(control.residual),
        before_fit=before_fit,
        disturbances=tuple(
            document.ControlOfDisturbance(
                name=law.name,
                standard_deviation=_digits(deviation),
                knots=tuple(basis.knots.tolist()),
                # X is minus the J of which the facts speak for a maximum; it has the sense of the robustness.
                levels=tuple(tuple(map(_digits, row)) for row in levels.tolist()),
            )
            for law, basis, levels, deviation in zip(
                header.spec.explaining, control.bases, control.levels, control.deviations, strict=True
            )
        ),
    )


def _digits(value: float) -> float:
    """Return a number with six digits, of which every machine finds the same."""
    return float(f"{value:.6g}")


def in_sense(sense: Sense, upper: float) -> float:
    """Return the bound of the objective that follows from an upper bound of J, rounded outward to 1e-9."""
    return round_down(-upper) if sense == "min" else round_up(upper)


def objective(plan: ProblemPlan, bound: float | None = None) -> str:
    """Return the objective of a problem in words, with its clip where `bound` may be false of the values."""
    problem = plan.problem
    statement = plan.statement_of(plan.claims[0], bound) if plan.claims else plan.statement
    text = statement.words.format(gap=GAPS[plan.gap.kind])
    # A reader takes "over d" for the box.
    if plan.listed is not None:
        text = text.replace("over d", f"over the {plan.listed} listed starts", 1)
    if plan.parts:
        text = f"{text}, of every requirement"
    elif plan.requirement is not None:
        text = f"{text}, of requirement {plan.requirement}"
    if not plan.claims and (clip := plan.hidden_by(bound=bound)) is not None:
        text = f"{text}, of values {clip_words(clip)}"
    inside = isinstance(problem, ScenarioProblem) and isinstance(problem.linearised, Linearised)
    linear = inside or problem.observed_through is not None
    return f"{text}, through the expectation that bounds it" if linear else text


def _probabilities(plan: ProblemPlan) -> dict[Literal["gaussian", "sub-gaussian", "bound"], float]:
    problem = plan.problem
    if isinstance(problem, PaperProblem):
        return {tail: round_down(mills_probability(problem.c, problem.delta, plan.noise, tail)) for tail in TAILS}
    for claim in plan.claims[:1]:
        return {"bound": confidence(claim.delta)}
    # Without noise no delta is spent: given B, the bound is certain.
    return {"bound": 1.0 if plan.exact else round_down(1.0 - problem.delta)}


def confidence(delta: float) -> float:
    """Return 1 - delta, rounded down to 1e-9 and so below 1.

    >>> confidence(0.05), confidence(1e-17)
    (0.95, 0.999999999)
    """
    return floor_to_step(1 - decimal(delta))


def _parameters(plan: ProblemPlan) -> dict[str, object]:
    """Return the parameters that were fixed beforehand, with the defaults."""
    problem = plan.problem
    found: dict[str, object] = problem.model_dump(mode="json", exclude_none=True, exclude={"name", "method", "sense"})
    found |= {
        "window": plan.window,
        "replicates": plan.replicates,
        "max_tests": plan.budget,
    }
    if plan.candidates is not None:
        found["candidates"] = plan.candidates.size
    if isinstance(problem, PaperProblem | RigorousProblem):
        found["noise_scale_per_test"] = plan.noise
    # The file says "derived": the certificate has the number.
    if isinstance(problem, RigorousProblem) and problem.noise_scale == "derived":
        found["noise_scale_derived"] = plan.hoeffding
    if plan.objective.measured == "gap":
        found["gap"] = plan.gap.model_dump(mode="json", exclude_none=True)
    return found
