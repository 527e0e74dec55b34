"""What a claim owes to its constants: its value by the clip, without rollouts, and with other constants.

A claim from a kernel follows from B, the kernel and the prior mean as much as from the rollouts. Every number here is a
function of the campaign file and of the observations, so that `verify` computes it again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ...schemas.file.bases import Basis, bases
from ...schemas.file.composition import composes
from ...schemas.file.config import CampaignConfig
from ...schemas.file.problem_models import KernelProblem, RigorousProblem
from ...schemas.result import certificate as document
from ...schemas.result.facts import Header
from ...schemas.values import Bound
from ..campaign.clip import by_clip, floored, is_vacuous, least_risk, of_drawn_starts
from ..campaign.methods import Methods, ProblemMethod, method
from ..campaign.plan import Plans, ProblemPlan
from ..campaign.series import Account, Rows
from ..mathematics.bounds.kriging.method import KrigingMethod
from ..mathematics.bounds.paper.method import PaperMethod
from ..mathematics.bounds.rigorous.method import RigorousMethod
from ..mathematics.bounds.rounding import decimal
from ..mathematics.bounds.sample import CONTROLLED, SampleMethod
from .claims import bound
from .problem_results import Results, in_sense

Constant = Literal["rkhs_norm", "length_scale", "control"]

VARIATIONS: tuple[tuple[Constant, float], ...] = (("rkhs_norm", 2.0), ("rkhs_norm", 4.0), ("length_scale", 0.5))
"""The constants that a claim is computed again with, in the order of the certificate."""
WITHOUT_CONTROL: tuple[Constant, float] = ("control", 0.0)
"""The last variation of a claim, where it is the only one if no kernel is behind it."""


@dataclass(frozen=True, slots=True)
class Varied:
    """The problems of a campaign with another constant: their results and methods, without those that give no bound."""

    results: Results
    methods: Methods


def with_clip(results: Results, config: CampaignConfig) -> Results:
    """Return the results with what the clip alone proves of each objective."""
    limits = {problem.name: by_clip(config, problem) for problem in config.problems}
    return {key: each.model_copy(update={"by_clip": limits[each.name]}) for key, each in results.items()}


def without_rollouts(
    claims: Sequence[document.CertificateClaim], config: CampaignConfig, plans: Plans, results: Results
) -> tuple[document.CertificateClaim, ...]:
    """Return the first claims, or all, with what follows without any rollout, from the clip and from the constants."""
    alone = {
        name: each.model_copy(update={"bound": _without_data(plans[name], each.bound)})
        for name, each in results.items()
    }
    found = []
    for basis, claim in zip(bases(config)[: len(claims)], claims, strict=True):
        limit = _limit(basis, config, results)
        update: dict[str, float | bool | None] = {"by_clip": limit, "bound": floored(claim.bound, claim.sense, limit)}
        if limit is not None:
            update["vacuous"] = is_vacuous(claim.bound, claim.sense, limit)
        if _from_kernels(basis, plans):
            update["without_data"] = floored(bound(basis, plans, alone, None), claim.sense, limit)
        found.append(claim.model_copy(update=update))
    return tuple(found)


def sensitivity(
    claims: Sequence[document.CertificateClaim],
    header: Header,
    accounts: Mapping[str, Account],
    results: Results,
) -> tuple[document.Sensitivity, ...] | None:
    """Return every claim with other constants of its kernels, and without a control, from the recorded tests.

    None if no claim has either.
    """
    plans = {name: account.plan for name, account in accounts.items()}
    numbered = list(enumerate(bases(header.config)))
    asked = {k: _variations(basis, plans) for k, basis in numbered}
    found: dict[tuple[int, Constant], dict[float, float | None]] = {}
    # One constant after the other, because the methods of each have matrices as large as those of the campaign.
    for constant, factor in (*VARIATIONS, WITHOUT_CONTROL):
        concerned = [(k, basis) for k, basis in numbered if (constant, factor) in asked[k]]
        if concerned:
            # From the recorded tests, in one step: a replay would take as long as the campaign, for the running
            # extremes alone.
            varied = _varied(header, accounts, results, constant, factor)
            for k, basis in concerned:
                found.setdefault((k, constant), {})[factor] = _bound_with(varied, basis, plans, claims[k])
    rows = tuple(
        document.Sensitivity(claim=k, constant=constant, factor=factor, bound=found[k, constant][factor])
        for k, _ in numbered
        for constant, factor in asked[k]
    )
    return rows or None


def _variations(basis: Basis, plans: Plans) -> tuple[tuple[Constant, float], ...]:
    """Return the constants that a claim is computed again with."""
    uses = any(plans[name].controlled for name in basis.problems)
    if basis.drawn is not None:
        uses = uses and plans[basis.problems[0]].claims[basis.drawn].asked.quantity in CONTROLLED
    return (*(VARIATIONS if _from_kernels(basis, plans) else ()), *((WITHOUT_CONTROL,) if uses else ()))


def _bound_with(varied: Varied, basis: Basis, plans: Plans, claim: document.CertificateClaim) -> float | None:
    # One problem without a bound, or with a refuted one: the claim rests on both.
    if not set(basis.problems) <= set(varied.results):
        return None
    if basis.drawn is None:
        return floored(bound(basis, plans, varied.results, varied.methods), claim.sense, claim.by_clip)
    samples = varied.methods[basis.problems[0]]
    assert isinstance(samples, SampleMethod)
    found = samples.found(basis.drawn)
    return None if found is None else floored(found, claim.sense, claim.by_clip)


def _varied(
    header: Header, accounts: Mapping[str, Account], results: Results, constant: Constant, factor: float
) -> Varied:
    found: dict[str, document.ProblemResult] = {}
    methods: dict[str, ProblemMethod] = {}
    for name, account in accounts.items():
        changed = _with_constant(account.plan, constant, factor)
        if changed is None:
            continue
        # A kernel can be out of the range of the mathematics with another constant; then it gives no bound.
        try:
            fresh = method(changed, header)
            again = _bound_again(fresh, account if changed.controlled else _of_values(account))
        except ValueError:
            continue
        if again.upper is None or again.verdict == "refuted":
            continue
        methods[name] = fresh
        found[name] = results[name].model_copy(update={"bound": in_sense(changed.sense, again.upper)})
    return Varied(found, methods)


def _of_values(account: Account) -> Account:
    """Return an account for a method that knows of no disturbance."""
    plan = account.plan
    return account if plan.reports is None else replace(account, each=Rows(map(plan.values_of, account.each)))


def _bound_again(fresh: ProblemMethod, account: Account) -> Bound:
    if isinstance(fresh, PaperMethod | RigorousMethod | KrigingMethod):
        return fresh.bound_after(account.closed)
    # The starts of other methods are not kept: their numbers are enough.
    nodes, y, each = np.array(account.nodes), np.array(account.observations), np.array(account.each[:])
    # Starts that a search chose enter no claim of drawn ones.
    taken = np.fromiter(map(account.plan.is_evidence, range(len(nodes))), np.bool_, len(nodes))
    return fresh.observe_each(nodes[taken], y[taken], each[taken])


def _with_constant(plan: ProblemPlan, constant: Constant, factor: float) -> ProblemPlan | None:
    """Return a plan with one constant multiplied, None for a problem without a kernel; or without a control."""
    problem = plan.problem
    if constant == "control":
        return replace(plan, controlled=False)
    if not isinstance(problem, KernelProblem):
        return None
    if constant == "rkhs_norm":
        return replace(plan, problem=problem.model_copy(update={"rkhs_norm": factor * problem.rkhs_norm}))
    kernel = problem.kernel.scaled(factor)
    return replace(plan, problem=problem.model_copy(update={"kernel": kernel}))


def _without_data(plan: ProblemPlan, otherwise: float) -> float:
    """Return the bound of a problem before its first rollout; `otherwise` for a problem without a kernel."""
    problem = plan.problem
    if not isinstance(problem, KernelProblem):
        return otherwise
    tau = problem.misspecification if isinstance(problem, RigorousProblem) else 0.0
    # k(z, z) = 1: no |J - m0| exceeds the norm bound. Summed as printed: .05 + .1 is .15.
    return in_sense(plan.sense, float(sum(map(decimal, (problem.prior_mean, problem.rkhs_norm, tau)))))


def _limit(basis: Basis, config: CampaignConfig, results: Results) -> float | None:
    """Return what the clip alone proves of the quantity of a claim; a composition is about the risk."""
    if composes(basis.rule):
        return least_risk(config)
    name = basis.problems[0]
    if basis.drawn is None:
        return results[name].by_clip
    problem = next(each for each in config.problems if each.name == name)
    return of_drawn_starts(config, config.claims_of(problem)[basis.drawn].asked)


def _from_kernels(basis: Basis, plans: Plans) -> bool:
    return all(isinstance(plans[name].problem, KernelProblem) for name in basis.problems)
