"""What the claims rest on, and what the data say about it: the audit of a finished campaign."""

import itertools
from collections.abc import Iterator, Mapping
from typing import Literal

from ...schemas.campaign import Linearised, PaperProblem, RigorousProblem, ScenarioProblem
from ..campaign.ledger import Account
from ..campaign.methods import Methods, kernel
from ..mathematics.bounds import audit
from ..mathematics.bounds.audit import Assumption
from ..mathematics.bounds.rigorous import RigorousMethod
from ..mathematics.gp.lattice import Lattice
from .claims import PAIR

ROUNDING = 1e-9


def assumptions(accounts: Mapping[str, Account], methods: Methods) -> list[Assumption]:
    """Return every assumption of the campaign, problem by problem, then those of the whole."""
    found: list[Assumption] = []
    for name, account in accounts.items():
        plan, problem = account.plan, account.plan.problem
        if isinstance(problem, PaperProblem):
            found += _paper(account, problem)
        elif isinstance(problem, RigorousProblem):
            method = methods[name]
            assert isinstance(method, RigorousMethod)
            found += _rigorous(account, problem, method)
        else:
            found += _scenario(account, problem, size=methods[name].size)
        if name == "sim_gap":
            found.append(_dominates(account))
            if "nominal" in plan.shared:
                found.append(_deterministic_nominal(accounts.get("nominal_robustness")))
        if account.robustness:
            found.append(audit.clipped_share(name, account.robustness, plan.clip))
    found.append(_finite(accounts))
    pair = [name for name in accounts if name in PAIR]
    if len(pair) == len(PAIR):
        methods_used = {accounts[name].plan.problem.method for name in PAIR}
        rules: tuple[Literal["product", "sum"], ...] = ("product", "sum") if methods_used == {"paper"} else ("sum",)
        found += [audit.independent_problems(pair, rule) for rule in rules]
    return [*found, _fixed_beforehand(), audit.workers_honest()]


def _dominates(account: Account) -> Assumption:
    """Say why the gap dominates the difference of the robustness; test it on every pair of rollouts."""
    gap, name = account.plan.gap, "lipschitz/sim_gap"
    if account.excess > ROUNDING:
        return Assumption(
            name,
            "refuted",
            f"on some pair of rollouts the robustness differs by {account.excess:.6g} more than L times the gap, so L "
            "or the column is wrong and the composition does not follow.",
        )
    if gap.kind == "signal_sup":
        detail = (
            f"robustness is taken to change by at most L = {gap.lipschitz:g} times the largest difference in "
            f"{gap.column}; all pairs of rollouts obey it, which is not evidence for the others."
        )
        return Assumption(name, "assumed", detail)
    why = "is the difference itself" if gap.kind == "robustness" else "dominates it for every min/max robustness"
    return Assumption(
        name, "derived", f"the gap {why}, so that L = 1 needs no assumption; all pairs of rollouts obey it."
    )


def _deterministic_nominal(nominal: Account | None) -> Assumption:
    """Say what the replicates of a gap test rest on that share one nominal rollout."""
    shared_one = "the replicates of a test share one nominal rollout, because the system declares that variant "
    if nominal is not None and any(len(each) > 1 for each in nominal.each):
        found = audit.deterministic_variant("sim_gap", nominal.each)
        detail = f"{shared_one}deterministic; in nominal_robustness, {found.detail}"
        return Assumption("deterministic_nominal/sim_gap", found.status, detail)
    detail = f"{shared_one}deterministic; nothing was repeated to test it."
    return Assumption("deterministic_nominal/sim_gap", "assumed", detail)


def _fixed_beforehand() -> Assumption:
    detail = (
        "norm bounds, noise scales, kernels, prior means, constants, replicates, budgets and the seed are taken to be "
        "chosen without looking at rollouts with these seeds: a campaign that was changed after a look at its results "
        "needs a new seed."
    )
    return Assumption("fixed_beforehand", "assumed", detail)


def _listed(name: str, size: int) -> Assumption:
    detail = f"the claim is about the {size} listed starts and no others; for these the optimum is exact."
    return Assumption(f"finite_space/{name}", "derived", detail)


def _linearised(name: str, constants: Linearised) -> Assumption:
    detail = (
        f"the risk is bounded by an expectation with the constants {constants.centre:g} and {constants.spread:g}, "
        "fixed beforehand: any constants are valid, good ones lose less. What the bound tends to is not above the risk."
    )
    return Assumption(f"linearised/{name}", "derived", detail)


def _finite(accounts: Mapping[str, Account]) -> Assumption:
    rollouts = sum(sum(account.counts.values()) for account in accounts.values())
    detail = (
        f"all {rollouts} rollouts behind the bounds are finite, and none was dropped or redrawn because of its "
        "outcome: one that is never finite ends the campaign without a certificate."
    )
    return Assumption("finite_rollouts", "derived", detail)


def _paper(account: Account, problem: PaperProblem) -> Iterator[Assumption]:
    name, noise, replicates = problem.name, account.plan.noise, account.plan.replicates
    yield audit.rkhs_norm(
        name,
        account.observations,
        prior_mean=problem.prior_mean,
        rkhs_norm=problem.rkhs_norm,
        noise_scale=noise,
        delta=problem.delta,
    )
    yield audit.noise_scale(name, noise_scale=noise, replicates=replicates)
    yield audit.noise_tail(name, c=problem.c, delta=problem.delta, noise_scale=noise, tail=problem.tail)
    yield audit.sigma_reading(name, problem.sigma)
    yield audit.regulariser(name, problem.regulariser)
    lattice = account.plan.candidates
    if isinstance(lattice, Lattice):
        yield audit.lattice_for_box(name, lattice, kernel(problem), problem.rkhs_norm, refine=problem.refine)
    if name == "true_risk":
        yield audit.centred_risk(name, replicates)


def _rigorous(account: Account, problem: RigorousProblem, method: RigorousMethod) -> Iterator[Assumption]:
    name, bound, noise, last = problem.name, method.bound(), account.plan.noise, account.last_bound
    yield audit.norm_from_data(
        name, b_min=bound.b_min, rkhs_norm=problem.rkhs_norm, delta=problem.delta, noise_scale=noise
    )
    yield audit.misspecification(
        name,
        tau=problem.misspecification,
        nu=problem.kernel.nu,
        length_scale=problem.kernel.length_scale,
        rkhs_norm=problem.rkhs_norm,
    )
    if last is not None and last.bound.upper is not None and last.bound.lower is not None:
        yield audit.bounds_agree(name, upper=last.bound.upper, lower=last.bound.lower)
    yield from _noise(account, problem)
    if isinstance(method.candidates, Lattice):
        yield audit.certified_box(name, nodes=bound.candidates_upper, slack=bound.slack)
    else:
        yield _listed(name, method.size)
    if problem.linearised is not None:
        yield _linearised(name, problem.linearised)


def _noise(account: Account, problem: RigorousProblem) -> Iterator[Assumption]:
    name, plan = problem.name, account.plan
    if plan.noise == 0:
        places = sorted(zip(account.nodes, account.each, strict=True))
        by_place = itertools.groupby(places, key=lambda place: place[0])
        yield audit.deterministic_variant(name, [[v for _, each in group for v in each] for _, group in by_place])
        return
    per_rollout = plan.noise_per_rollout
    if name != "maximum":
        yield audit.noise_range(name, noise_scale=per_rollout * (1 + 1e-12), hoeffding=plan.hoeffding)
    else:
        yield audit.noise_scale(name, noise_scale=plan.noise, replicates=plan.replicates)
    planned = plan.budget * plan.replicates
    yield audit.replicate_spread(name, account.each, noise_scale=per_rollout, delta=problem.delta, planned=planned)


def _scenario(account: Account, problem: ScenarioProblem, *, size: int) -> Iterator[Assumption]:
    name, last = problem.name, account.last_bound
    rollouts = sum(account.counts.values())
    yield _listed(name, size)
    yield Assumption(
        f"independent_rollouts/{name}",
        "derived",
        f"the {rollouts} rollouts have seeds of their own, and those of one start differ in nothing else; the bound "
        "needs no more of the noise than this and the clip.",
    )
    if last is not None and last.bound.upper is not None and last.bound.lower is not None:
        ell, reach = -last.bound.upper, -last.bound.lower
        yield Assumption(
            f"one_law_per_start/{name}",
            "refuted" if reach < ell else "not refuted",
            f"the bound is {ell:.6g} and what it tends to is at most {reach:.6g}, each at its own confidence; "
            + (
                "they contradict each other, so the rollouts of a start do not have one law."
                if reach < ell
                else "that they agree is not evidence."
            ),
        )
    if problem.linearised is not None:
        yield _linearised(name, problem.linearised)
