"""Issue the certificate of a finished campaign; nothing in it depends on time, host or the number of workers."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from orchestrator.bounds import audit
from orchestrator.bounds.composition import compose, round_down, round_up
from orchestrator.bounds.paper import mills_probability
from orchestrator.gp.kernels import Matern
from orchestrator.ledger import Account
from orchestrator.proposer import lattice, noise_per_test
from orchestrator.store.journal import Header
from schemas import certificate as document
from schemas.base import digest
from schemas.campaign import SENSES, CampaignConfig, Problem

TAILS: tuple[Literal["gaussian", "sub-gaussian"], ...] = ("gaussian", "sub-gaussian")
OBJECTIVES = {
    "nominal_robustness": "min over d of E[robustness of the nominal system]",
    "sim_gap": "max over d of E[sup over t of |true - nominal|]",
    "true_risk": "min over d of E[robustness] - r sd[robustness] of the true system",
    "maximum": "max over d of E[column]",
}


@dataclass(frozen=True, slots=True)
class Evidence:
    """The trajectory files behind the observations, in the order of the manifest."""

    manifest: str
    rollouts: int


def manifest(entries: Iterable[tuple[str, str]]) -> Evidence:
    """Return the manifest of (sha256, path) pairs, in the format of sha256sum."""
    lines = [f"{sha256}  {path}\n" for sha256, path in entries]
    return Evidence("".join(lines), len(lines))


def issue(header: Header, accounts: Mapping[str, Account], evidence: Evidence) -> document.Certificate:
    """Return the certificate of a campaign whose problems have all stopped."""
    config = header.config
    results = tuple(_result(config, account) for account in accounts.values())
    assumptions = tuple(_assumption(each) for each in _assumptions(header, accounts))
    claim, composition = _claim(config, {result.name: result for result in results}, [a.id for a in assumptions])
    manifest_sha256 = hashlib.sha256(evidence.manifest.encode()).hexdigest()
    predicate = document.Predicate(
        campaign=document.CampaignId(name=config.name, seed=config.seed, config_sha256=config.digest),
        claims=(claim,),
        problems=results,
        composition=composition,
        assumptions=assumptions,
        evidence=document.Evidence(
            manifest_sha256=manifest_sha256,
            chain_head=digest([account.link for account in accounts.values()]),
            rollouts=evidence.rollouts,
        ),
        software=header.software,
    )
    subject = document.Subject(name="manifest.sha256", digest={"sha256": manifest_sha256})
    return document.Certificate(subject=(subject,), predicate=predicate)


def _result(config: CampaignConfig, account: Account) -> document.ProblemResult:
    problem, bound, proposal = account.problem, account.last_bound, account.last_proposal
    assert bound is not None
    assert bound.epsilon is not None
    assert bound.stopped_by is not None
    assert proposal is not None
    assert proposal.F is not None
    noise = noise_per_test(config, problem)
    probabilities = {tail: round_down(mills_probability(problem.c, problem.delta, noise, tail)) for tail in TAILS}
    sense = SENSES[problem.name]
    return document.ProblemResult(
        name=problem.name,
        objective=OBJECTIVES[problem.name],
        method=problem.method,
        sense=sense,
        bound=round_down(-bound.epsilon) if sense == "min" else round_up(bound.epsilon),
        probability=probabilities[problem.tail],
        probabilities=probabilities,
        tests=len(account.observations),
        rollouts=document.Rollouts(nominal=account.counts["nominal"], true=account.counts["true"]),
        stopped_by=bound.stopped_by,
        parameters=_parameters(config, problem),
        last_F=proposal.F,
    )


def _parameters(config: CampaignConfig, problem: Problem) -> dict[str, object]:
    """Return what was fixed beforehand, defaults written out."""
    gap = config.gap_of(problem) if problem.name == "sim_gap" else None
    return problem.model_dump(mode="json", exclude_none=True, exclude={"name", "method", "sense"}) | {
        "window": config.window_of(problem),
        "replicates": config.replicates_of(problem),
        "resolution": config.resolution_of(problem),
        "max_tests": config.max_tests_of(problem),
        "noise_scale_per_test": noise_per_test(config, problem),
        **({"gap": gap.model_dump(mode="json")} if gap else {}),
    }


def _claim(
    config: CampaignConfig, results: Mapping[str, document.ProblemResult], assumptions: list[str]
) -> tuple[document.Claim, document.Composition | None]:
    if config.composition == "single":
        (result,) = results.values()
        minimum = result.sense == "min"
        claim = document.Claim(
            quantity="rho_star" if minimum else "J_star",
            sense=">=" if minimum else "<=",
            bound=result.bound,
            probability=result.probability,
            rule="single",
            method=result.method,
            assumptions=tuple(assumptions),
        )
        return claim, None
    nominal, gap = results["nominal_robustness"], results["sim_gap"]
    measure = next(config.gap_of(problem) for problem in config.problems if problem.name == "sim_gap")
    assert measure is not None
    assert config.clip is not None
    composed = compose(
        nominal.bound,
        gap.bound,
        lipschitz=measure.lipschitz,
        risk_weight=config.risk_weight,
        clip=config.clip,
        probabilities=(nominal.probability, gap.probability),
        rule=config.composition,
    )
    claim = document.Claim(
        quantity="rho_star",
        sense=">=",
        bound=composed.ell,
        probability=composed.probability,
        rule=config.composition,
        method=nominal.method,
        assumptions=tuple(_used(assumptions, {"nominal_robustness", "sim_gap"})),
    )
    terms = document.Composition(
        rule=config.composition,
        nominal_bound=nominal.bound,
        gap_bound=gap.bound,
        lipschitz=measure.lipschitz,
        gap_term=composed.gap,
        risk_term=composed.spread,
        bound=composed.ell,
    )
    return claim, terms


def _used(assumptions: list[str], problems: set[str]) -> list[str]:
    """Keep the assumptions of these problems and those of the whole campaign."""
    return [each for each in assumptions if "/" not in each or each.split("/")[1] in problems]


def _assumption(found: audit.Assumption) -> document.Assumption:
    return document.Assumption(id=found.id, status=found.status, detail=found.detail)


def _assumptions(header: Header, accounts: Mapping[str, Account]) -> list[audit.Assumption]:
    config = header.config
    found = [each for account in accounts.values() for each in _of_problem(header, account)]
    if config.composition != "single":
        names = [name for name in accounts if name in ("nominal_robustness", "sim_gap")]
        found.append(audit.independent_problems(names, config.composition))
    return [*found, audit.workers_honest()]


def _of_problem(header: Header, account: Account) -> list[audit.Assumption]:
    config, problem = header.config, account.problem
    name, noise, replicates = problem.name, noise_per_test(config, problem), config.replicates_of(problem)
    kernel = Matern(problem.kernel.nu, problem.kernel.length_scale)
    found = [
        audit.rkhs_norm(
            name,
            account.observations,
            prior_mean=problem.prior_mean,
            rkhs_norm=problem.rkhs_norm,
            noise_scale=noise,
            delta=problem.delta,
        ),
        audit.noise_scale(name, noise_scale=noise, replicates=replicates),
        audit.noise_tail(name, c=problem.c, delta=problem.delta, noise_scale=noise, tail=problem.tail),
        audit.sigma_reading(name, problem.sigma),
        audit.regulariser(name, problem.regulariser),
        audit.lattice_for_box(name, lattice(config, header.spec, problem), kernel, problem.rkhs_norm),
    ]
    if account.robustness and config.clip is not None:
        found.append(audit.clipped_share(name, account.robustness, config.clip))
    if name == "true_risk":
        found.append(audit.centred_risk(name, replicates))
    return found
