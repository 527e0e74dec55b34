"""The audit of a finished campaign: every assumption of its claims, with its status by the data."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

from ....schemas.file.composition import PAIR
from ....schemas.file.problem_models import (
    KrigingProblem,
    Linearised,
    PaperProblem,
    RigorousProblem,
    SampleProblem,
    ScenarioProblem,
)
from ....schemas.result.certificate import Assumption, CertifiedRegions, Recheck, SpotCheck, Status
from ...campaign.assumption_tests import is_dominated, same_values, spread
from ...campaign.closing.spot_check import SpotSeries
from ...campaign.ledger import Ledger, observed_discards
from ...campaign.methods import Methods, kernel
from ...campaign.plan import UNBOUNDED, ProblemPlan
from ...campaign.series import Account, Remarked
from ...mathematics.bounds.checks import audit
from ...mathematics.bounds.kriging.method import KrigingMethod
from ...mathematics.bounds.paper.formulas import mills_probability
from ...mathematics.bounds.rigorous.method import RigorousMethod
from ...mathematics.gp.lattice import Lattice
from .logs import of_rig
from .sampled import kriging_assumptions, sampled_assumptions
from .sentences import assumption, form_at_start

DISCARDED = "discarded_"
"""Of the ids of discarded rollouts, before their number."""
EXTENDED = "extended_"
"""Of the ids of extensions, before their number and the problem."""
# Listed always, and not counted: a lost cable must not change a byte, so crashes that choose outcomes show nowhere.
UNRELATED = "unrelated_crashes"
TRUSTED = (
    UNRELATED,
    "only_campaign",
    "fixed_beforehand",
    "sampled_at_sample_times",
    "simulator_is_the_system",
    "workers_honest",
)
"""Assumptions of every campaign that no data of its own can test."""
MEASURED = {
    UNRELATED: "unrelated_losses",
    "simulator_is_the_system": "measured_system",
    "workers_honest": "told_honestly",
}
"""The sentences of those of a system whose rollouts no simulator makes."""


@dataclass(frozen=True, slots=True)
class ClosingResults:
    """What came after the problems, as far as there is any."""

    spot_check: SpotCheck | None
    recheck: Recheck | None
    regions: CertifiedRegions | None = None


def assumptions(
    ledger: Ledger,
    accounts: Mapping[str, Account],
    checks: ClosingResults,
    *,
    failed: int,
    honest: Assumption | None = None,
    sampled: Callable[[Account], Iterable[Assumption]] | None = None,
) -> list[Assumption]:
    """Return every assumption of the campaign, bound by bound, then those of the whole.

    `accounts` has everything with a bound of its own, see `campaign.bounded`.
    `failed` attempts at rollouts that were recorded later have failed in the system. `honest` takes the place of what
    is assumed of the workers. Regions that a fresh start contradicts refute the norm. `sampled` takes the place of the
    tests of independence and of one law, which read trajectories.
    """
    tested = sampled or partial(sampled_assumptions, ledger)
    repeated = ledger.header.spec.repeated
    measured = repeated == "nowhere"
    found: list[Assumption] = []
    for name, account in accounts.items():
        found_here = _spot_checked(_of_problem(account, ledger.methods), name, checks.spot_check)
        regional = _of_regions([*found_here, *tested(account)], name, checks.regions)
        found += of_rig(regional, account.plan, ledger.header)
        found += _of_gap(account, accounts, ledger)
        # A campaign without specification has no robustness, and so no clip; a claim without noise needs none.
        if account.robustness and account.plan.clip != UNBOUNDED:
            found.append(_clip(account, _at_fresh_starts(ledger, account.plan)))
    rollouts: dict[str, int | float | str] = {
        "rollouts": sum(sum(account.counts.values()) for account in ledger.accounts.values())
    }
    found.append(assumption("finite_rollouts", "derived", rollouts))
    usual = "reproducible_batches" if ledger.header.spec.batch_is_the_unit else None
    found.append(_reproducible(checks.recheck, usual, measured=measured, failed=failed))
    found += [*_remarked(ledger), *_reduced(ledger), *_discarded(ledger), *_extended(ledger)]
    if set(PAIR) <= set(accounts):
        # The product needs that neither problem uses the other's data; only method `paper` claims it.
        if all(accounts[name].plan.problem.method == "paper" for name in PAIR):
            found.append(assumption("independence", "derived"))
        found.append(assumption("accounting", "derived"))
    if ledger.config.draws is not None:
        found.append(assumption("common_draws", "assumed"))
    extended = {"fixed_beforehand": "fixed_beforehand_extended"} if ledger.extensions else {}
    if repeated == "session":
        found.append(assumption("defined_in_session", "assumed"))
    forms = extended | (MEASURED if measured else {})
    if ledger.config.keep != "all":
        forms |= {"workers_honest": "honest_scores"}
    trusted = [assumption(name, "assumed", form=forms.get(name)) for name in TRUSTED]
    return [*found, *(honest if honest and each.id == honest.id else each for each in trusted)]


def _remarked(ledger: Ledger) -> Iterator[Assumption]:
    """Yield a line on stamps at borders of windows, where there are any, on cut windows, and on declared early ends."""
    series = ledger.series.values()
    rollouts = sum(sum(each.counts.values()) for each in series)
    borders, ended = ([getattr(each, name) for each in series] for name in ("by_tolerance", "ended"))
    if sum(each.number for each in borders):
        yield assumption("borders", "assumed", {**_counted(borders), "rollouts": rollouts})
    if ledger.config.beyond == "truncate":
        yield assumption("truncated", "assumed")
    if (after_end := ledger.header.spec.after_end) is not None:
        none = "" if sum(each.number for each in ended) else "_none"
        status: Status = "assumed" if after_end == "hold" else "derived"
        values = {**_counted(ended), "rollouts": rollouts}
        yield assumption("early_ends", status, values, form=f"early_ends_{after_end}{none}")


def _reduced(ledger: Ledger) -> Iterator[Assumption]:
    """Yield a line on the rollouts whose samples were not kept, where a campaign keeps not all."""
    if (keep := ledger.config.keep) != "all":
        rollouts = sum(sum(account.counts.values()) for account in ledger.accounts.values())
        kept = sum(account.kept.number for account in ledger.accounts.values())
        values: dict[str, int | float | str] = {"keep": keep, "kept": kept, "reduced": rollouts - kept}
        yield assumption("scores_as_computed", "assumed", values)


def _counted(remarked: Iterable[Remarked]) -> dict[str, float | int | str]:
    found = [each for each in remarked if each.first is not None]
    return {"number": sum(each.number for each in found), "first": str(found[0].first) if found else ""}


def _discarded(ledger: Ledger) -> Iterator[Assumption]:
    """Yield a line for each discarded rollout."""
    for number, fact in enumerate(observed_discards(ledger), start=1):
        values = {"rollout": str(fact.rollout), "sha256": fact.sha256, "reason": fact.reason}
        yield assumption(f"{DISCARDED}{number}", "derived", values, form="discarded")


def _extended(ledger: Ledger) -> Iterator[Assumption]:
    """Yield a line for each extension of each problem: after which test, and from how many tests to how many."""
    budgets = {name: account.plan.budget for name, account in ledger.accounts.items()}
    for fact in ledger.extensions:
        for name, tests in fact.budgets:
            values: dict[str, float | int | str] = {"problem": name, "after": budgets[name], "max_tests": tests}
            plan = ledger.plans[name]
            for part in plan.parts or (plan,):
                yield assumption(f"{EXTENDED}{fact.number}/{part.key}", "derived", values, form="extended")
            budgets[name] = tests


def _spot_checked(found: Iterable[Assumption], name: str, check: SpotCheck | None) -> Iterator[Assumption]:
    """Yield the assumptions of a problem; the one on its norm is refuted where the spot check refutes the bound."""
    result = next((each for each in check.problems if each.key == name), None) if check else None
    for each in found:
        if each.id != f"rkhs_norm/{name}" or result is None or result.status != "refuted":
            yield each
            continue
        start = "one of its starts" if result.start is None else ", ".join(f"{v:.6g}" for v in result.start)
        values: dict[str, int | float | str] = {"limit": result.limit, "start": start}
        yield assumption(each.id, "refuted", values, form=form_at_start(result))


def _of_regions(found: Iterable[Assumption], name: str, regions: CertifiedRegions | None) -> Iterator[Assumption]:
    """Yield the assumptions of a problem; the one on its norm is refuted by a sign that a certified box excludes."""
    contradicted = regions.contradicted if regions else None
    for each in found:
        if contradicted and each.id == f"rkhs_norm/{name}" and each.status != "refuted":
            yield assumption(each.id, "refuted", {"starts": contradicted}, form="norm_regions")
        else:
            yield each


def _reproducible(recheck: Recheck | None, usual: str | None, *, measured: bool, failed: int) -> Assumption:
    """Return the assumption that a rollout follows from its seed, in fixed words where an attempt failed."""
    name, values = "reproducible_rollouts", dict[str, int | float | str]()
    if recheck is not None and recheck.rollouts:
        percent = math.ceil(1000 * recheck.unseen_share) / 10
        values = {"rechecked": recheck.rollouts, "agreed": recheck.agreed, "percent": percent}
    if failed and not (recheck and recheck.agreed < recheck.rollouts):
        return assumption(name, "refuted", {"failed": failed, **values}, form="failures_vary")
    if not values:
        return assumption(name, "assumed", form="measured" if measured else usual)
    status: Status = "not refuted" if recheck and recheck.agreed == recheck.rollouts else "refuted"
    return assumption(name, status, values, form=usual)


def _of_problem(account: Account, methods: Methods) -> Iterator[Assumption]:
    problem, method = account.plan.problem, methods.get(account.plan.key)
    match problem:
        case PaperProblem():
            return _paper(account, problem)
        case RigorousProblem():
            assert isinstance(method, RigorousMethod)
            return _rigorous(account, problem, method)
        case KrigingProblem():
            assert isinstance(method, KrigingMethod)
            return _weighted(account, problem, method)
        case ScenarioProblem():
            return _scenario(account, problem)
        case SampleProblem():
            return _sample(account, problem)


def _paper(account: Account, problem: PaperProblem) -> Iterator[Assumption]:
    name, plan = account.plan.key, account.plan
    # k(z, z) = 1, so |J - m0| <= B everywhere: an observation far above B refutes it.
    norm = audit.norm_from_tests(
        account.observations,
        prior_mean=problem.prior_mean,
        rkhs_norm=problem.rkhs_norm,
        noise_scale=plan.noise,
        delta=problem.delta,
    )
    yield assumption(f"rkhs_norm/{name}", *norm, form="norm_from_tests")
    yield _mean_noise(account)
    # Mill's inequality is a Gaussian tail; for noise that is only sub-Gaussian the probability is lower.
    gaussian, sub_gaussian = (
        mills_probability(problem.c, problem.delta, plan.noise, tail) for tail in ("gaussian", "sub-gaussian")
    )
    tail: Status = "assumed" if problem.tail == "gaussian" else "derived"
    yield assumption(f"tail/{name}", tail, {"gaussian": gaussian, "sub_gaussian": sub_gaussian})
    yield assumption(f"sigma/{name}", "assumed", {"sigma": problem.sigma}, form=f"sigma_{problem.sigma}")
    form = "regulariser_eta" if problem.regulariser == "1+eta" else "regulariser_fixed"
    yield assumption(f"regulariser/{name}", "assumed", {"regulariser": problem.regulariser}, form=form)
    lattice = plan.candidates
    # The paper maximises over the box, the method over nodes: the audit bounds the difference.
    if isinstance(lattice, Lattice):
        rise = audit.rise_between_nodes(lattice, kernel(plan, problem), problem.rkhs_norm)
        values = {"nodes": lattice.size, "resolution": lattice.resolution, "rise": rise, "rkhs_norm": problem.rkhs_norm}
        form = "lattice_refined" if problem.refine else "lattice_alone"
        yield assumption(f"lattice/{name}", "assumed", values, form=form)
    # E[s] < sd: the sample risk is biased to the unsafe side, by derivation and not by data.
    if plan.name == "true_risk":
        yield assumption(f"centred_noise/{name}", *audit.centred_risk(plan.replicates))


def _rigorous(account: Account, problem: RigorousProblem, method: RigorousMethod) -> Iterator[Assumption]:
    name, bound, last = account.plan.key, method.bound(), account.last_bound
    # Without noise the observations are the function: no delta is spent, and the norm that they need is certain.
    confidence = 1.0 if account.plan.noise == 0 else 1.0 - problem.delta
    norm = audit.norm_from_set(b_min=bound.b_min, rkhs_norm=problem.rkhs_norm, confidence=confidence)
    yield assumption(f"rkhs_norm/{name}", *norm, form="norm_from_set")
    values = {
        "tau": problem.misspecification,
        "nu": problem.kernel.nu,
        "length_scale": problem.kernel.described,
        "rkhs_norm": problem.rkhs_norm,
    }
    form = "kernel_near" if problem.misspecification else "kernel_ball"
    yield assumption(f"kernel/{name}", "assumed", values, form=form)
    if last is not None and last.bound.upper is not None and last.bound.lower is not None:
        agree = audit.bounds_agree(upper=last.bound.upper, lower=last.bound.lower)
        yield assumption(f"bounds_agree/{name}", *agree)
    yield from _noise_assumptions(account, problem)
    # On a box the cover bounds J between the nodes as well; on a list the maximum is exact.
    if isinstance(account.plan.candidates, Lattice):
        box = {"candidates_upper": bound.candidates_upper, "slack": bound.slack}
        yield assumption(f"lattice/{name}", "derived", box, form="certified_box")
    else:
        yield _listed(account)
    if problem.linearised is not None:
        yield _linearised(name, problem.linearised)


def _weighted(account: Account, problem: KrigingProblem, method: KrigingMethod) -> Iterator[Assumption]:
    yield from kriging_assumptions(account, problem, method)
    if problem.linearised is not None:
        yield _linearised(account.plan.key, problem.linearised)


def _noise_assumptions(account: Account, problem: RigorousProblem) -> Iterator[Assumption]:
    name, plan = account.plan.key, account.plan
    if plan.noise == 0:
        yield assumption(f"deterministic/{name}", *same_values(account))
        return
    per_rollout = plan.noise_per_rollout
    # A column has no clip, so Hoeffding's lemma gives no scale to compare with.
    if plan.name == "maximum":
        yield _mean_noise(account)
    else:
        noise = audit.noise_range(noise_scale=per_rollout, hoeffding=plan.hoeffding)
        yield assumption(f"noise_scale/{name}", *noise, form="noise_range")
    found = spread(account, problem.delta)
    if found is None:
        yield assumption(f"replicate_spread/{name}", "assumed", form="no_replicates")
    else:
        yield assumption(f"replicate_spread/{name}", *found)


def _scenario(account: Account, problem: ScenarioProblem) -> Iterator[Assumption]:
    name, last = account.plan.key, account.last_bound
    yield _listed(account)
    if last is not None and last.bound.upper is not None and last.bound.lower is not None:
        # J = -risk. The limit bounds the expectation from above: a bound beyond it would refute the single law.
        ell, limit = -last.bound.upper, -last.bound.lower
        status: Status = "refuted" if limit < ell else "not refuted"
        yield assumption(f"limit_agrees/{name}", status, {"ell": ell, "limit": limit}, form="limit_agrees")
    if problem.linearised is not None:
        yield _linearised(name, problem.linearised)


def _sample(account: Account, problem: SampleProblem) -> Iterator[Assumption]:
    """Yield what claims about drawn starts rest on: the distribution, and that nothing chose a start by its outcome."""
    yield assumption(f"declared_distribution/{problem.name}", "assumed")
    form = "drawn_at_every_moment" if account.plan.at_every_moment else "drawn_fixed"
    drawn, values = account.each.firsts(0), dict[str, int | float | str]()
    if account.plan.falsify is not None:
        form, values = "drawn_beside_a_search", {"random_every": account.plan.falsify.random_every}
        drawn = drawn[list(map(account.plan.is_drawn, range(len(drawn))))]
    values |= {"samples": len(drawn), "at_zero": int((drawn == 0.0).sum())}
    yield assumption(f"drawn_starts/{problem.name}", "derived", values, form=form)


def _mean_noise(account: Account) -> Assumption:
    plan = account.plan
    values = {"noise_scale": plan.noise, "replicates": plan.replicates}
    return assumption(f"noise_scale/{plan.key}", "assumed", values, form="mean_noise")


def _listed(account: Account) -> Assumption:
    form = "finite_box" if account.plan.box else "finite_space"
    values = {"starts": account.plan.chosen_from.size}
    return assumption(f"finite_space/{account.plan.key}", "derived", values, form=form)


def _linearised(name: str, constants: Linearised | Literal["past"]) -> Assumption:
    if not isinstance(constants, Linearised):
        return assumption(f"linearised/{name}", "derived", form="linearised_past")
    return assumption(f"linearised/{name}", "derived", {"centre": constants.centre, "spread": constants.spread})


def _at_fresh_starts(ledger: Ledger, plan: ProblemPlan) -> list[float]:
    """Return the robustness that spot checks saw of the variants of a problem."""
    checks = [each for each in ledger.series.values() if isinstance(each, SpotSeries)]
    return [value for check in checks for variant in plan.variants for value in check.clipped.get(variant, ())]


def _clip(account: Account, fresh: Sequence[float]) -> Assumption:
    low, high = account.plan.clip
    seen = [*account.robustness, *fresh]
    values = {
        "values": len(seen),
        "low": low,
        "at_low": sum(value <= low for value in seen),
        "high": high,
        "at_high": sum(value >= high for value in seen),
    }
    return assumption(f"clip/{account.plan.key}", "derived", values)


def _of_gap(account: Account, accounts: Mapping[str, Account], ledger: Ledger) -> Iterator[Assumption]:
    """Yield what a composition needs of a gap; nothing for a problem that compares no trajectories."""
    if account.plan.key != "sim_gap":
        return
    check = ledger.closing.spot_check
    fresh = check.excess if check is not None else -math.inf
    yield _dominates(account, max(account.excess, fresh))
    if ledger.header.spec.simulators and account.plan.gap.kind != "robustness":
        yield assumption("common_times/sim_gap", "assumed", {})
    if "nominal" in account.plan.shared:
        yield _deterministic_nominal(accounts.get("nominal_robustness"))


def _dominates(account: Account, excess: float) -> Assumption:
    """Return the assumption that the gap dominates the robustness difference, tested on every pair of rollouts.

    A composed claim has no test of its own: where it is false at a start, one of its two bounds is, or the gap does not
    dominate there.
    """
    gap, name = account.plan.gap, "lipschitz/sim_gap"
    forms = {"signal_sup": "lipschitz_column", "predicate_sup": "lipschitz_predicates"}
    form = forms.get(gap.kind, "lipschitz_itself")
    values: dict[str, float | int | str] = {"kind": gap.kind, "lipschitz": gap.lipschitz}
    if gap.column is not None:
        values["column"] = gap.column
    # Two kinds of gap dominate by proof; an excess then shows a fault of the software, and refutes as well.
    if not is_dominated(excess):
        return assumption(name, "refuted", values | {"excess": excess}, form=form)
    return assumption(name, "assumed" if gap.kind == "signal_sup" else "derived", values, form=form)


def _deterministic_nominal(nominal: Account | None) -> Assumption:
    """Return the assumption behind replicates of a gap test that share one nominal rollout."""
    found = audit.deterministic_variant(nominal.each if nominal else ())
    return assumption("deterministic_nominal/sim_gap", *found)
