"""The assumptions behind noisy rollouts: that they are independent, and have one law at each start."""

from collections.abc import Iterator, Mapping, Sequence, Set

from ....schemas.file.disturbance import Disturbance
from ....schemas.file.problem_models import KrigingProblem
from ....schemas.result.certificate import Assumption, Status
from ....schemas.system import Variant
from ...campaign.assumption_tests import DeclaredLaws, OneLaw
from ...campaign.copies import copies, tested_copies
from ...campaign.ledger import Ledger
from ...campaign.plan import ProblemPlan, value_range
from ...campaign.series import Account
from ...mathematics.bounds.checks import audit
from ...mathematics.bounds.checks.copied_blocks import LEVEL
from ...mathematics.bounds.kriging.method import KrigingMethod
from .sentences import assumption


def noisy_variants(ledger: Ledger, account: Account) -> set[Variant]:
    """Return the variants of a problem whose rollouts depend on their seeds."""
    return set(account.plan.variants) & set(ledger.header.spec.noisy)


def sampled_assumptions(ledger: Ledger, account: Account) -> Iterator[Assumption]:
    """Yield what the bound of a noisy problem needs of its samples: independence, and one law per start."""
    plan, noisy = account.plan, noisy_variants(ledger, account)
    if not noisy:
        return
    compared, copied = copies(account, noisy, ledger.recorded.digest)
    values: dict[str, int | float | str] = {
        "rollouts": sum(account.counts[variant] for variant in noisy),
        "compared": compared,
        "copies": copied,
    }
    yield _independent(ledger, account, noisy, values)
    yield one_law(plan, OneLaw(plan).finding(account.nodes, account.each))
    if plan.reports is not None:
        laws = ledger.header.spec.reported
        yield declared_laws(plan, laws, DeclaredLaws(plan, laws).finding(account.each))


def _independent(
    ledger: Ledger, account: Account, noisy: Set[str], values: Mapping[str, int | float | str]
) -> Assumption:
    """Return the assumption that rollouts are independent; `values` has how many agree bit by bit."""
    name, copied = f"independent_rollouts/{account.plan.key}", values["copies"]
    if not copied:
        return assumption(name, "assumed", values)
    found = tested_copies(account, noisy, ledger.recorded.digest)
    tested = {**values, "evidence": found.evidence, "threshold": 1 / LEVEL, "level": LEVEL}
    if found.refuted:
        return assumption(name, "refuted", tested, form="copied_tests")
    form = {None: "single_rollouts", True: "all_alike", False: "repeated_results"}[found.all_alike]
    return assumption(name, "assumed", tested, form=form)


def one_law(plan: ProblemPlan, finding: audit.Finding) -> Assumption:
    """Return the assumption that the rollouts of a start have one law during the campaign."""
    form = "one_law" if plan.candidates is None else None
    return assumption(f"one_law_per_start/{plan.key}", *finding, form=form)


def declared_laws(plan: ProblemPlan, laws: Sequence[Disturbance], finding: audit.Finding) -> Assumption:
    """Return the assumption that what rollouts report has the declared laws."""
    values = dict(finding.values)
    if "kind" in values:
        law = laws[int(values["kind"])]
        values |= {"kind": law.name, "law": law.words}
    values["reported"] = ", ".join(f"{law.name} ({law.words})" for law in laws)
    form = "impossible_values" if values.get("impossible") else None
    return assumption(f"declared_laws/{plan.key}", finding.status, values, form=form)


# The assumptions behind the bound of method `kriging`


def kriging_assumptions(account: Account, problem: KrigingProblem, method: KrigingMethod) -> Iterator[Assumption]:
    """Yield what the bound rests on: the norm, the kernel, and what is derived of the design and of the values."""
    name, plan = account.plan.key, account.plan
    norm = audit.norm_from_set(b_min=method.bets.b_min, rkhs_norm=problem.rkhs_norm, confidence=method.probability)
    yield assumption(f"rkhs_norm/{name}", *norm, form="norm_from_weights")
    values = {
        "tau": 0.0,
        "nu": problem.kernel.nu,
        "length_scale": problem.kernel.described,
        "rkhs_norm": problem.rkhs_norm,
    }
    yield assumption(f"kernel/{name}", "assumed", values, form="kernel_ball")
    status: Status = "refuted" if method.bets.beyond_ball else "not refuted"
    yield assumption(f"bounds_agree/{name}", status, {"rkhs_norm": problem.rkhs_norm}, form="within_ball")
    low, high = value_range(plan)
    assert low is not None, "the campaign file is checked for a clip"
    assert high is not None
    # Of the objective: J = -objective for a minimum.
    ends = {"low": -high, "high": -low} if plan.sense == "min" else {"low": low, "high": high}
    yield assumption(f"bounded_values/{name}", "derived", ends)
    yield assumption(f"lattice/{name}", "derived", {"nodes": method.size}, form="certified_cells")
    design = {"points": method.design.size, "tests": len(method.design.order)}
    yield assumption(f"design/{name}", "derived", design, form="fixed_design")
