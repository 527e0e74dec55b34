"""Construction of the result of a stopped problem: its bound, probability and parameters."""

from typing import Literal

from ...schemas import certificate as document
from ...schemas.campaign import SENSES, PaperProblem, Problem, ProblemName, RigorousProblem
from ..campaign.account import Account
from ..campaign.plan import ProblemPlan
from ..mathematics.bounds.paper_formulas import Tail, mills_probability
from ..mathematics.bounds.rounding import round_down, round_up

TAILS: tuple[Tail, ...] = ("gaussian", "sub-gaussian")
OBJECTIVES: dict[ProblemName, str] = {
    "nominal_robustness": "min over d of E[robustness of the nominal system]",
    "true_risk": "min over d of E[robustness] - r sd[robustness] of the true system",
    "maximum": "max over d of E[column]",
}
GAPS = {
    "signal_sup": "max over d of E[sup over t of |true - nominal|]",
    "predicate_sup": "max over d of E[sup over t and predicates of |true - nominal|]",
    "robustness": "max over d of E[robustness of the nominal - of the true system]",
}


def result(account: Account) -> document.ProblemResult:
    """Return the bound of a problem that has stopped, rounded outward to 1e-9."""
    plan, last, proposal = account.plan, account.last_bound, account.last_proposal
    assert proposal is not None
    assert last is not None
    upper, lower = last.bound.upper, last.bound.lower
    assert upper is not None
    assert last.stopped_by is not None
    problem = plan.problem
    minimum = SENSES[problem.name] == "min"
    # The method bounds J, and J = -rho for a minimum: its upper bound is a lower one of the objective.
    partner = None if lower is None else round_up(-lower) if minimum else round_down(lower)
    chances = _probabilities(plan)
    return document.ProblemResult(
        name=problem.name,
        objective=objective(plan),
        method=problem.method,
        sense=SENSES[problem.name],
        bound=in_sense(problem, upper),
        partner=partner,
        probability=chances[problem.tail] if isinstance(problem, PaperProblem) else chances["bound"],
        probabilities=chances,
        tests=len(account.observations),
        rollouts=document.Rollouts(nominal=account.counts["nominal"], true=account.counts["true"]),
        stopped_by=last.stopped_by,
        parameters=_parameters(plan),
        last_F=proposal.F,
    )


def in_sense(problem: Problem, upper: float) -> float:
    """Return the bound of the objective that follows from an upper bound of J, rounded outward to 1e-9."""
    return round_down(-upper) if SENSES[problem.name] == "min" else round_up(upper)


def objective(plan: ProblemPlan) -> str:
    """Return the objective of a problem in words."""
    problem = plan.problem
    text = GAPS[plan.gap.kind] if problem.name == "sim_gap" else OBJECTIVES[problem.name]
    linear = not isinstance(problem, PaperProblem) and problem.linearised is not None
    return f"{text}, through the expectation that bounds it" if linear else text


def _probabilities(plan: ProblemPlan) -> dict[Literal["gaussian", "sub-gaussian", "bound"], float]:
    problem = plan.problem
    if isinstance(problem, PaperProblem):
        return {tail: round_down(mills_probability(problem.c, problem.delta, plan.noise, tail)) for tail in TAILS}
    # Without noise no delta is spent: given B, the bound is certain.
    certain = isinstance(problem, RigorousProblem) and plan.noise == 0
    return {"bound": 1.0 if certain else round_down(1.0 - problem.delta)}


def _parameters(plan: ProblemPlan) -> dict[str, object]:
    """Return the parameters that were fixed beforehand, with the defaults."""
    problem = plan.problem
    found: dict[str, object] = problem.model_dump(mode="json", exclude_none=True, exclude={"name", "method", "sense"})
    found |= {
        "window": plan.window,
        "replicates": plan.replicates,
        "candidates": plan.candidates.size,
        "max_tests": plan.budget,
    }
    if isinstance(problem, PaperProblem | RigorousProblem):
        found["noise_scale_per_test"] = plan.noise
    # The file says "derived": the certificate has the number.
    if isinstance(problem, RigorousProblem) and problem.noise_scale == "derived":
        found["noise_scale_derived"] = plan.hoeffding
    if problem.name == "sim_gap":
        found["gap"] = plan.gap.model_dump(mode="json", exclude_none=True)
    return found
