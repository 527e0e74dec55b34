"""The band of a problem at given starts, from all observations so far."""

from pathlib import Path

import numpy as np

from ....schemas.errors import PerfboundError
from ....schemas.values import Band, Bound
from ...campaign.methods import PartMethod, method
from ...campaign.observation import of_requirement
from ...campaign.plan import ProblemPlan, plans
from ...mathematics.blocks import blocks
from ...mathematics.bounds.rigorous.method import RigorousMethod
from ...mathematics.gp.kernels import Floats
from ...mathematics.gp.lattice import Lattice
from ...store import facts as recorded_facts
from ...store import read

NEAR = 1e-9
"""Distance of a start from a candidate, as a share of the range, at which it counts as this candidate."""


def posterior(directory: Path, problem: str | None, x: Floats) -> tuple[Floats, Floats, Floats]:
    """Return (mean, lower, upper), (N,) each, of a problem's objective at the starts `x` (N, p).

    Without `problem` it is that of the first one. Method `rigorous` has a band anywhere in the box, the others at their
    candidates.

    Raises:
        PerfboundError: there is no such problem, it has no observation, or a start is none of its method.

    """
    with read.reading(directory) as connection:
        header = read.read_header(connection, directory)
    found = {each.key: each for plan in plans(header.config, header.spec).values() for each in (plan, *plan.parts)}
    name = problem or next(iter(found))
    if name not in found:
        raise PerfboundError(f"{directory}: no problem {name!r}; choose one of {', '.join(found)}")
    plan, tests = found[name], recorded_facts.history(directory)[found[name].name]
    if plan.candidates is None:
        raise PerfboundError(f"{directory}: method {plan.problem.method!r} has no band: it draws its starts")
    if not tests:
        raise PerfboundError(f"{directory}: problem {name} has no observation yet; retry later")
    _check_starts(plan, x)
    fed = method(plan, header)
    pairs, bound = [(each.proposal, each.observation) for each in tests], tests[-1].bound
    if plan.requirement is not None and isinstance(fed, PartMethod):
        whole = found[plan.name]
        place = whole.parts.index(plan)
        # The database has the bound of the whole.
        bound = fed.bound_after([(proposal, of_requirement(whole, place, each)) for proposal, each in pairs])
    else:
        fed.recall(pairs)
    if isinstance(fed, RigorousMethod) and isinstance(plan.candidates, Lattice):
        mean, lower, upper = anywhere(fed, bound, plan, x)
    else:
        mean, lower, upper = _at_candidates(fed.band(bound), plan, x)
    # The facts are about J = -objective for a minimum.
    return (mean, lower, upper) if plan.sense == "max" else (0.0 - mean, 0.0 - upper, 0.0 - lower)


def _check_starts(plan: ProblemPlan, x: Floats) -> None:
    names = plan.parameters
    if x.ndim != 2 or x.shape[1] != len(names):
        raise PerfboundError(f"x has the shape {x.shape}; give one row a start, with {', '.join(names)}")
    nodes = plan.chosen_from.nodes
    outside = ~((x >= nodes.min(axis=0)) & (x <= nodes.max(axis=0))).all(axis=1)  # also NaN
    if outside.any():
        raise PerfboundError(f"x: {x[int(np.argmax(outside))].tolist()} is outside the space of the campaign")


def _at_candidates(band: Band, plan: ProblemPlan, x: Floats) -> tuple[Floats, Floats, Floats]:
    nodes = plan.chosen_from.nodes
    span = np.maximum(nodes.max(axis=0) - nodes.min(axis=0), 1e-300)
    index, nearest = np.empty(len(x), dtype=np.intp), np.empty(len(x))
    for part in blocks(len(x), nodes.size):
        distance = np.max(np.abs(x[part, None, :] - nodes[None, :, :]) / span, axis=2)  # (N, m)
        index[part], nearest[part] = np.argmin(distance, axis=1), np.min(distance, axis=1)
    away = nearest > NEAR
    if away.any():
        raise PerfboundError(
            f"x: {x[int(np.argmax(away))].tolist()} is no candidate; method {plan.problem.method!r} has the band of "
            f"{plan.key} at the {len(nodes):,} candidates alone; method 'rigorous' on a box has that of one "
            "specification everywhere"
        )
    mean, lower, upper = (np.array(values)[index] for values in (band.mean, band.lower, band.upper))
    return mean, lower, upper


def anywhere(fed: RigorousMethod, bound: Bound, plan: ProblemPlan, x: Floats) -> tuple[Floats, Floats, Floats]:
    """Return (mean, lower, upper), (N,) each, of J at any starts `x` (N, p) of the box."""
    envelope = fed.envelope
    upper, lower = envelope.at(x)
    # The mean at one a for all starts: that of the band over the candidates.
    mu, sd = envelope.moments_at(plan.chosen_from.nodes)
    column = int(np.argmin(np.max(mu + envelope.g * sd, axis=0)))
    mean = np.clip(envelope.prior_mean + envelope.moments_at(x)[0][:, column], lower, upper)
    if bound.verdict == "refuted":  # refuted premises have no band
        return mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan)
    return mean, lower, upper
