"""Assumptions behind the bound of method `kriging`, with their status by the data."""

from collections.abc import Iterator

from ...schemas.file.problem_models import KrigingProblem
from ...schemas.result.certificate import Assumption, Status
from ..campaign.plan import value_range
from ..campaign.series import Account
from ..mathematics.bounds.checks import audit
from ..mathematics.bounds.kriging.method import KrigingMethod
from .sentences import assumption


def kriging_assumptions(account: Account, problem: KrigingProblem, method: KrigingMethod) -> Iterator[Assumption]:
    """Yield what the bound rests on: the norm, the kernel, and what is derived of the design and of the values."""
    name, plan = account.plan.key, account.plan
    norm = audit.norm_from_set(b_min=method.b_min, rkhs_norm=problem.rkhs_norm, confidence=method.probability)
    yield assumption(f"rkhs_norm/{name}", *norm, form="norm_from_weights")
    values = {
        "tau": 0.0,
        "nu": problem.kernel.nu,
        "length_scale": problem.kernel.described,
        "rkhs_norm": problem.rkhs_norm,
    }
    yield assumption(f"kernel/{name}", "assumed", values, form="kernel_ball")
    status: Status = "refuted" if method.beyond_ball else "not refuted"
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
