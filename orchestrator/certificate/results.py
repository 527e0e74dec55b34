"""The bound of each problem, as its method has it at the end."""

from typing import Literal

from orchestrator.bounds.composition import round_down, round_up
from orchestrator.bounds.paper import Tail, mills_probability
from orchestrator.ledger import Account
from orchestrator.methods import budget, derived_noise, noise_per_test
from orchestrator.store.journal import Header
from schemas import certificate as document
from schemas.campaign import SENSES, PaperProblem, Problem, RigorousProblem

TAILS: tuple[Tail, ...] = ("gaussian", "sub-gaussian")
OBJECTIVES = {
    "nominal_robustness": "min over d of E[robustness of the nominal system]",
    "true_risk": "min over d of E[robustness] - r sd[robustness] of the true system",
    "maximum": "max over d of E[column]",
}
GAPS = {
    "signal_sup": "max over d of E[sup over t of |true - nominal|]",
    "predicate_sup": "max over d of E[sup over t and predicates of |true - nominal|]",
    "robustness": "max over d of E[robustness of the nominal - of the true system]",
}


def result(header: Header, account: Account) -> document.ProblemResult:
    """Return the bound of a problem that has stopped, rounded outward to 1e-9."""
    problem, bound, proposal = account.problem, account.last_bound, account.last_proposal
    assert bound is not None
    assert bound.upper is not None
    assert bound.stopped_by is not None
    assert proposal is not None
    minimum = SENSES[problem.name] == "min"
    partner = None if bound.lower is None else round_up(-bound.lower) if minimum else round_down(bound.lower)
    chances = _probabilities(header, problem)
    return document.ProblemResult(
        name=problem.name,
        objective=objective(header, problem),
        method=problem.method,
        sense=SENSES[problem.name],
        bound=round_down(-bound.upper) if minimum else round_up(bound.upper),
        partner=partner,
        probability=chances[problem.tail] if isinstance(problem, PaperProblem) else chances["bound"],
        probabilities=chances,
        tests=len(account.observations),
        rollouts=document.Rollouts(nominal=account.counts["nominal"], true=account.counts["true"]),
        stopped_by=bound.stopped_by,
        parameters=_parameters(header, problem),
        last_F=proposal.F,
    )


def objective(header: Header, problem: Problem) -> str:
    """Return what a problem bounds, in words."""
    gap = header.config.gap_of(problem) if problem.name == "sim_gap" else None
    text = GAPS[gap.kind] if gap else OBJECTIVES[problem.name]
    linear = not isinstance(problem, PaperProblem) and problem.linearised is not None
    return f"{text}, through the expectation that bounds it" if linear else text


def _probabilities(header: Header, problem: Problem) -> dict[Literal["gaussian", "sub-gaussian", "bound"], float]:
    if isinstance(problem, PaperProblem):
        noise = noise_per_test(header.config, header.spec, problem)
        return {tail: round_down(mills_probability(problem.c, problem.delta, noise, tail)) for tail in TAILS}
    certain = isinstance(problem, RigorousProblem) and noise_per_test(header.config, header.spec, problem) == 0
    return {"bound": 1.0 if certain else round_down(1.0 - problem.delta)}


def _parameters(header: Header, problem: Problem) -> dict[str, object]:
    """Return what was fixed beforehand, defaults written out."""
    config = header.config
    gap = config.gap_of(problem) if problem.name == "sim_gap" else None
    found: dict[str, object] = problem.model_dump(mode="json", exclude_none=True, exclude={"name", "method", "sense"})
    found |= {
        "window": config.window_of(problem),
        "replicates": config.replicates_of(problem),
        "candidates": config.candidates_of(problem),
        "max_tests": budget(config, header.spec, problem),
    }
    if isinstance(problem, PaperProblem | RigorousProblem):
        found["noise_scale_per_test"] = noise_per_test(config, header.spec, problem)
    if isinstance(problem, RigorousProblem) and problem.noise_scale == "derived":
        found["noise_scale_derived"] = derived_noise(config, header.spec, problem)
    if gap:
        found["gap"] = gap.model_dump(mode="json", exclude_none=True)
    return found
