"""How sure the first claim is, in plain sentences: its probability, its constants, and what holds without them."""

from collections.abc import Iterator

from ....schemas.amounts import counted
from ....schemas.errors import one_line
from ....schemas.file.config import CampaignConfig
from ....schemas.file.objectives import Quantity
from ....schemas.file.problem_models import KernelProblem
from ....schemas.result.certificate import CertificateClaim, MostStarts, Predicate, Sensitivity
from ....schemas.result.known import ByRollouts, CampaignVerdict
from ...campaign.clip import is_vacuous
from .bound_text import outward
from .text import is_irreproducible, margin_at_most_starts

CHANGES = {
    ("rkhs_norm", 2.0): "With a norm bound B twice as large the same tests prove",
    ("rkhs_norm", 4.0): "with one four times as large",
    ("length_scale", 0.5): "with half the length scale",
    ("control", 0.0): "without the control of disturbances",
}
"""Variations of the sensitivity, in the order of the sentence."""
DOUBTS = {("rkhs_norm", 2.0), ("length_scale", 0.5)}
"""The variations that decide whether SHOWN rests on a constant."""
IN_UNIT: tuple[Quantity, ...] = ("rho_star", "robustness", "expected_robustness")
"""Quantities of a claim that have the unit of the robustness."""


def confidence_sentences(verdict: CampaignVerdict, predicate: Predicate, *, repeated: bool = False) -> Iterator[str]:
    """Yield how sure a verdict is; `repeated` tells whether a repetition of the worst rollout gave the same."""
    unit = "" if verdict.unit == "1" else one_line(verdict.unit)
    if verdict.by_rollouts:
        measured = any(each.form == "measured_system" for each in predicate.assumptions)
        of = "system that was measured" if measured else "simulator"
        yield _shown_by_rollouts(verdict.by_rollouts, verdict.required_probability, of, repeated=repeated)
        if any(each.id == "borders" for each in predicate.assumptions):
            yield "It may depend on how time stamps at borders of windows are read: see the assumption `borders`."
        return
    claim = predicate.claims[0]
    if claim.refuted:
        number = len(claim.assumptions)
        its = counted(number, "assumption")
        yield f"Not at all: the campaign refutes {len(claim.refuted)} of its {its}."
    # The bound from the other side shows a violation with the probability of the claim, however weak its own bound is.
    elif not claim.vacuous or verdict.verdict == "VIOLATED":
        yield _wrong_at_most(claim)
        if verdict.verdict == "SHOWN":
            yield from _with_other_constants(predicate, unit, verdict.required)
    else:
        yield "Nothing is claimed that could be wrong: the bound holds without any rollout."


def _shown_by_rollouts(how: ByRollouts, probability: float, of: str, *, repeated: bool) -> str:
    if how == "certain" and repeated:
        return f"Certain of the {of}: the rollout shows it, and its repetition shows the same."
    if how == "certain":
        return f"Certain of the {of}: the rollout shows it. This rollout was not repeated."
    wrong = outward(1.0 - probability, "<=")
    return f"Wrong with probability at most {wrong}, by the chance in the rollouts. Kernel and norm bound are not used."


def anyway(verdict: CampaignVerdict, predicate: Predicate) -> str:
    """Return what fresh starts prove without B and kernel; empty where they prove nothing, or a violation is shown."""
    most = predicate.spot_check and predicate.spot_check.most_starts
    if verdict.verdict == "VIOLATED" or is_irreproducible(predicate.claims[0]):
        return ""
    unit = "" if verdict.unit == "1" else one_line(verdict.unit)
    return _of_fresh_starts(most, unit, listed=predicate.claims[0].starts is not None) if most else ""


def _with_other_constants(predicate: Predicate, unit: str, required: float | None) -> Iterator[str]:
    claim = predicate.claims[0]
    of_claim = unit if claim.quantity in IN_UNIT else ""
    rows = _of_first_claim(predicate)
    if rows:
        changed = (f"{CHANGES[row.constant, row.factor]} {_bound_with(claim, row, of_claim, required)}" for row in rows)
        yield f"{'; '.join(changed)}."


def _of_first_claim(predicate: Predicate) -> list[Sensitivity]:
    """Return the first claim with other constants."""
    return [row for row in predicate.sensitivity or () if row.claim == 0]


def _wrong_at_most(claim: CertificateClaim) -> str:
    if claim.probability == 1.0:
        return "Certain, if its assumptions hold: nothing is random."
    wrong = outward(1.0 - claim.probability, "<=")
    return f"If its assumptions hold, it is wrong with probability at most {wrong}: by the chance in the rollouts."


def _bound_with(claim: CertificateClaim, row: Sensitivity, unit: str, required: float | None) -> str:
    if row.bound is None or is_vacuous(row.bound, claim.sense, claim.by_clip):
        return "nothing, so NOT SHOWN"
    bound = f"{claim.sense} {outward(row.bound, claim.sense)} {unit}".rstrip()
    return f"{bound}, still SHOWN" if _is_enough(claim, row, required) else f"{bound}, so NOT SHOWN"


def _is_enough(claim: CertificateClaim, row: Sensitivity, required: float | None) -> bool:
    """Whether the bound with other constants still meets the requirement."""
    if row.bound is None or is_vacuous(row.bound, claim.sense, claim.by_clip):
        return False
    return required is None or (row.bound >= required if claim.sense == ">=" else row.bound <= required)


def rests_on(predicate: Predicate, config: CampaignConfig, required: float | None) -> str:
    """Return the constants without whose exact size the first claim is not shown; empty for none.

    A norm bound B that would have to be twice as large, or a length scale half as long, are mistakes that nothing in
    the tests need show.
    """
    claim = predicate.claims[0]
    doubts = (row for row in _of_first_claim(predicate) if (row.constant, row.factor) in DOUBTS)
    decisive = {row.constant for row in doubts if not _is_enough(claim, row, required)}
    norms = {each.rkhs_norm for each in config.problems if isinstance(each, KernelProblem)}
    found = []
    if "rkhs_norm" in decisive:
        found.append(f"B = {norms.pop():g}" if len(norms) == 1 else "the norm bounds B")
    if "length_scale" in decisive:
        found.append("the length scale")
    return " and ".join(found)


def _of_fresh_starts(found: MostStarts, unit: str, *, listed: bool = False) -> str:
    bound = f"{outward(found.bound, '>=')} {unit}".rstrip()
    share, probability = f"{100 * found.share:g} %", outward(found.probability, ">=")
    starts = "whole ranges, listed or not" if listed else "starts"
    return (
        f"Without B and the kernel, by fresh starts alone: {margin_at_most_starts(found)} at least {bound} from all "
        f"but {share} of the {starts}, with probability at least {probability}. Of those {share} it says nothing."
    )
