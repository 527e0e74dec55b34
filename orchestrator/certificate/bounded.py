"""The set of the bounded disturbances of a campaign, apart from the claims for all of it: its probability."""

from functools import reduce

from ...schemas.file.against_system import searched
from ...schemas.file.disturbance import Disturbance
from ...schemas.result import certificate as document
from ...schemas.result.facts import Header
from ...schemas.system import SCORED, Parameter
from ..mathematics.bounds.rounding import round_up

OF_ROBUSTNESS = {"rho_star", "robustness", "expected_robustness"}
ROUND_OFF = 1e-9
"""Share by which a computed probability may be too small: scipy's have 12 digits or more."""


def bounded_disturbances(header: Header, claim: document.CertificateClaim) -> document.Bounded | None:
    """Return the set that a claim is for; None where no disturbance is bounded."""
    spec = header.spec
    if not spec.as_parameters or searched(header.config):
        return None
    laws = {law.name: law for law in spec.disturbances}
    ranges = spec.parameters[len(spec.own_parameters) :]
    inside = reduce(lambda share, each: share * (1.0 - _outside(laws[each.name], each)), ranges, 1.0)
    outside = min(round_up((1.0 - inside) * (1.0 + ROUND_OFF)), 1.0)
    # Of a rollout in the set nothing is random then, so that a mean, or a risk, is its robustness.
    decided = header.claimed_variant in spec.disturbed and header.claimed_variant not in spec.noisy
    everywhere = claim.starts is None and claim.requirement is None and not claim.refuted
    safe = claim.quantity in OF_ROBUSTNESS and claim.sense == ">=" and claim.bound >= 0.0
    return document.Bounded(
        disturbances=tuple(_described(laws[each.name], each) for each in ranges),
        outside=outside,
        failure_probability=outside if decided and everywhere and safe else None,
    )


def _outside(law: Disturbance, given: Parameter) -> float:
    from ...schemas.draws.laws import outside  # noqa: PLC0415  (scipy, a second that few certificates need)

    return outside(law, given.low, given.high, scored=given.unit == SCORED)


def _described(law: Disturbance, given: Parameter) -> document.BoundedDisturbance:
    from ...schemas.draws.laws import of_scores  # noqa: PLC0415  (as above)

    low, high = given.low, given.high
    if given.unit == SCORED:
        import numpy as np  # noqa: PLC0415  (as above)

        low, high = of_scores(law)(np.array([low, high])).tolist()
    return document.BoundedDisturbance(
        name=law.name, low=given.low, high=given.high, unit=given.unit, values=(low, high), unit_of_values=law.unit
    )
