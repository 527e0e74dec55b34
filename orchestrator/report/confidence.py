"""How sure the first claim is, in plain sentences: its probability, its constants, and what holds without them."""

from collections.abc import Iterator

from ...schemas.certificate import CertificateClaim, MostStarts, Predicate, Sensitivity
from ...schemas.errors import one_line
from ...schemas.problems import Quantity
from ...schemas.verdict import ByRollouts, CampaignVerdict
from ..campaign.clip import is_vacuous
from ..certificate.text import outward

CHANGES = {
    ("rkhs_norm", 2.0): "If the norm bound B were twice as large",
    ("rkhs_norm", 4.0): "four times",
    ("length_scale", 0.5): "with half the length scale",
}
"""Variations of the sensitivity, in the order of the sentence."""
IN_UNIT: tuple[Quantity, ...] = ("rho_star", "robustness", "expected_robustness")
"""Quantities of a claim that have the unit of the robustness."""


def confidence_sentences(verdict: CampaignVerdict, predicate: Predicate) -> Iterator[str]:
    """Yield how sure a verdict is."""
    unit = "" if verdict.unit == "1" else one_line(verdict.unit)
    if verdict.by_rollouts:
        yield _by_rollouts(verdict.by_rollouts, verdict.required_probability)
        return
    claim = predicate.claims[0]
    if claim.refuted:
        yield "Not at all: the campaign refutes one of its assumptions."
    elif not claim.vacuous:
        yield _chance(claim)
        yield from _with_other_constants(predicate, unit)
    most = predicate.spot_check and predicate.spot_check.most_starts
    if most:
        yield _most_starts(most, unit)


def _by_rollouts(how: ByRollouts, probability: float) -> str:
    if how == "certain":
        return "Certain of the simulator: the rollout shows it, and whoever repeats it sees the same."
    wrong = outward(1.0 - probability, "<=")
    return f"Wrong with probability at most {wrong}, by the chance in the rollouts. Kernel and norm bound are not used."


def _with_other_constants(predicate: Predicate, unit: str) -> Iterator[str]:
    claim = predicate.claims[0]
    of_claim = unit if claim.quantity in IN_UNIT else ""
    rows = [row for row in predicate.sensitivity or () if row.claim == 0]
    if rows:
        changed = (f"{CHANGES[row.constant, row.factor]}: {_varied(claim, row, of_claim)}" for row in rows)
        yield f"{'; '.join(changed)}."


def _chance(claim: CertificateClaim) -> str:
    if claim.probability == 1.0:
        return "Certain, if its assumptions hold: nothing is random."
    wrong = outward(1.0 - claim.probability, "<=")
    return f"Wrong with probability at most {wrong}, by the chance in the rollouts, if its assumptions hold."


def _varied(claim: CertificateClaim, row: Sensitivity, unit: str) -> str:
    if row.bound is None:
        return "no bound"
    if is_vacuous(row.bound, claim.sense, claim.by_clip):
        return "nothing shown"
    return f"{claim.sense} {outward(row.bound, claim.sense)} {unit}".rstrip()


def _most_starts(found: MostStarts, unit: str) -> str:
    margin = "robustness" if found.quantity == "robustness" else "expected robustness"
    bound = f"{outward(found.bound, '>=')} {unit}".rstrip()
    return (
        f"Without B and the kernel, from fresh starts alone: {margin} at least {bound} from all but "
        f"{100 * found.share:g} % of the starts, with probability at least {outward(found.probability, '>=')}."
    )
