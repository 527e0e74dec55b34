"""The verdict on a finished campaign: does its first claim show what the campaign file requires?"""

import math
from collections.abc import Callable
from dataclasses import replace

from ...schemas.file.bases import bases
from ...schemas.file.config import CampaignConfig
from ...schemas.file.drawn_claims import PROBABILITIES, is_sampled
from ...schemas.file.parts import parts_of
from ...schemas.file.problem_models import KernelProblem
from ...schemas.ids import SPOT_CHECK, RolloutId, closing_check
from ...schemas.result.certificate import CertificateClaim, Predicate
from ...schemas.result.facts import Header
from ...schemas.result.known import CampaignVerdict, Violations
from ..campaign.clip import SAME
from .assumptions.sentences import value_text
from .counter_evidence import (
    SAY_LIMIT,
    SEARCH_ON,
    WORST,
    Required,
    Values,
    VerdictFinding,
    capitalised,
    chance_words,
    clip_of_other_side,
    drawn_samples,
    is_deterministic,
    other_side,
    suspected,
    too_unlikely,
    violated,
)
from .words.advice import (
    NO_COMMANDS,
    TEST_ALONE,
    Commands,
    Progress,
    ShortBound,
    for_a_better_bound,
    for_the_probability,
    instead_of_refuted,
)
from .words.bound_text import as_required, claim_unit, clip_words, margin_text, outward
from .words.confidence import anyway, rests_on
from .words.refutation_text import refutation_words
from .words.text import CERTAIN, NO_SHARE, VACUOUS, claim_words, clip_in_words, nothing_shown

EMPTY = {
    VACUOUS: "The bound shows nothing: it is an end of the clip, and holds without any rollout.",
    CERTAIN: "The bound shows nothing: every probability is at most 1.",
    NO_SHARE: "The bound shows nothing: no start is certified safe.",
}
"""The reasons, by the sentences beside such claims."""
ONE_ROLLOUT = "This is about one next rollout alone: it does not say how many of many rollouts are below the bound."


def campaign_verdict(
    header: Header,
    predicate: Predicate,
    violations: Violations,
    values: Callable[[], Values],
    *,
    unit: str = "",
    commands: Commands = NO_COMMANDS,
    progress: Progress = tuple,
) -> CampaignVerdict:
    """Return the verdict; `values` are the rollouts of the tested variant in test order, read only where needed.

    `unit` is that of the robustness, and `progress` that of the problems, asked for where a forecast would help.
    """
    claim, config = predicate.claims[0], header.config
    limit = config.required_margin if claim.sense == ">=" else config.required_at_most
    required = Required(limit, _required_probability(config, claim), unit)

    def failed() -> int:
        return sum(value < 0.0 for value in drawn_samples(config, values()))

    def better(limit: float) -> str:
        noisy = not is_deterministic(header)
        short = ShortBound(config, predicate, limit, violations, commands, noisy, progress, failed)
        return for_a_better_bound(short)

    # Rollouts that show the opposite need no kernel, so they come before a claim that rests on one.
    found = violated(header, predicate, required, violations, values)
    contradicted = _is_contradicted(header, claim, violations)
    if found is None and not contradicted:
        found = _shown(header, predicate, required)
    if found is None:
        where = suspected(header, claim, required, violations, values)
        found = _not_shown(header, predicate, required, better, where)
        if contradicted:
            least, bound = outward(violations.least or 0.0, ">="), outward(claim.bound, ">=")
            false = f"A rollout has the robustness {least}, less than the bound {bound}: the claim is false."
            found = replace(found, reasons=(false, *found.reasons))
    if found.by_rollouts:
        found = replace(found, reasons=(*found.reasons, *_between(claim, violations), *_by_tolerance(predicate)))
    stated = claim.model_copy(update={"refuted": ("by a rollout",)}) if contradicted else claim
    is_clipped = violations.least is not None and config.clip is not None and violations.least <= config.clip[0]
    decisive = "" if found.word != "SHOWN" or found.by_rollouts else rests_on(predicate, config, required.bound)
    verdict = CampaignVerdict(
        verdict=found.word,
        campaign=config.name,
        seed=config.seed,
        claim=claim_in_plain_words(stated, unit, config.risk_weight),
        reasons=found.reasons,
        advice=found.advice,
        bound=claim.bound,
        sense=claim.sense,
        required=required.bound,
        probability=claim.probability,
        required_probability=required.probability,
        unit=unit,
        bound_unit=claim_unit(claim, unit),
        violations=violations,
        clip=found.clip or claim.clipped,
        clipped=is_clipped,
        by_rollouts=found.by_rollouts,
        repeat=commands.repeat if violations.violations else "",
        rests_on=decisive,
    )
    return verdict.model_copy(update={"without_kernel": anyway(verdict, predicate)}) if decisive else verdict


UNDER_REFUTED = "Not proven, an assumption is refuted"
"""In place of the claim's own first words."""


def claim_in_plain_words(claim: CertificateClaim, unit: str, risk_weight: float) -> str:
    """Return the first claim in plain words, as a margin where it is one.

    >>> claim = CertificateClaim(quantity="robustness", sense=">=", bound=0.58125, probability=0.95, rule="single",
    ...                          method="rigorous", assumptions=(), refuted=())
    >>> claim_in_plain_words(claim, "rad", 0.2)
    'Margin at least 0.5812 rad (robustness) from every start, with probability at least 0.9500'
    """
    bound, chance = outward(claim.bound, claim.sense), chance_words(claim)
    meaning = WORST.get(claim.quantity)
    if meaning is None:
        words = f"{UNDER_REFUTED}: {claim_words(claim)}" if claim.refuted else capitalised(claim_words(claim))
        return f"{words} {claim.sense} {margin_text(bound, claim, unit)}, {chance}"
    where = "every start" if claim.starts is None else f"each of the {claim.starts:,} listed starts"
    of = {"every": ", of every requirement"}.get(claim.rule, f", of {claim.requirement}" if claim.requirement else "")
    ends = "" if claim.clipped is None else f", {clip_words(claim.clipped)}"
    margin = f"{margin_text(bound, claim, unit)} ({meaning.format(risk_weight)}{of}{ends})"
    head = f"{UNDER_REFUTED}: margin at least" if claim.refuted else "Margin at least"
    return f"{head} {margin} from {where}, {chance}"


def _by_tolerance(predicate: Predicate) -> tuple[str, ...]:
    """Return the sentence on rollouts whose sign may depend on how a time stamp at a border is read; none for none."""
    found = next((each for each in predicate.assumptions if each.id == "borders"), None)
    if found is None:
        return ()
    # The file is anyone's: an edited one may lack a value.
    number, rollouts, first = (value_text(found.values.get(key, "?")) for key in ("number", "rollouts", "first"))
    return (
        f"Whether {number} of {rollouts} rollouts violate the specification may depend on a time stamp that counts as "
        f"the border of a window (the first: {first}; assumption `borders`).",
    )


def _required_probability(config: CampaignConfig, claim: CertificateClaim) -> float:
    """Return what the file requires; by default 1 - delta, with the deltas of a composed claim added up."""
    if config.required_probability is not None:
        return config.required_probability
    if is_sampled(claim.quantity):
        return claim.probability
    # Of method `paper` as well, whose claims miss it: their probability is another one, by Mill's inequality.
    deltas: dict[str, float] = {problem.name: problem.delta or 0.0 for problem in config.problems}
    for each, part in zip(config.specifications, parts_of(config), strict=False):
        deltas |= {f"{problem.name}/{each.name}": problem.delta or 0.0 for problem in part.problems}
    basis = bases(config)[0]
    found = [deltas[key] for key in basis.problems]
    # A claim about every requirement fails with the largest delta alone, see `JointMethod`; other rules add them up.
    return 1.0 - (max(found) if basis.rule == "every" else math.fsum(found))


def _shown(header: Header, predicate: Predicate, required: Required) -> VerdictFinding | None:
    claim = predicate.claims[0]
    if claim.refuted or claim.vacuous or _falls_short(claim, required) or too_unlikely(claim, required):
        return None
    if _ended_untested(header, predicate):
        return None
    assert required.bound is not None, "every bound falls short of it"
    limit = margin_text(as_required(required.bound), claim, required.unit)
    reasons = [f"Required {'at least' if claim.sense == '>=' else 'at most'} {limit}."]
    reasons += clip_in_words(predicate, claim)
    if claim.quantity == "next_rollout":
        reasons.append(ONE_ROLLOUT)
    if (partner := other_side(predicate)) is not None:
        least = claim.sense == ">="
        other = margin_text(outward(partner, "<=" if least else ">="), claim, required.unit)
        side, clip = "most" if least else "least", clip_of_other_side(header.config, claim, partner)
        clipped = "" if clip is None or claim.clipped is not None else f", {clip_words(clip)},"
        found = f"it is{clipped} at {side} {other} at the worst start"
        reasons.append(f"With the same probability and assumptions {found}.")
    if _is_about_a_box(header, predicate) and predicate.spot_check is None and not header.config.spot_check:
        reasons.append("No fresh start tested this bound: `spot_check = 0`.")
    return VerdictFinding("SHOWN", tuple(reasons))


def _is_contradicted(header: Header, claim: CertificateClaim, violations: Violations) -> bool:
    """Whether one rollout without noise is below the bound."""
    if violations.least is None or not is_deterministic(header) or claim.quantity not in WORST or claim.requirement:
        return False
    if _is_between(claim, violations):
        return False
    return violations.least < claim.bound - SAME


def _is_between(claim: CertificateClaim, violations: Violations) -> bool:
    """Whether the worst rollout is at a fresh start of the box, and the claim about listed starts of it alone."""
    if claim.starts is None or violations.rollout is None:
        return False
    return closing_check(RolloutId.parse(violations.rollout).problem) == SPOT_CHECK


def _between(claim: CertificateClaim, violations: Violations) -> tuple[str, ...]:
    """Return the sentence on a worst start of which the claim says nothing; none where it is one of the claim's."""
    if not _is_between(claim, violations):
        return ()
    return (f"The worst rollout is at a fresh start, none of the {claim.starts:,} listed ones of the claim.",)


def _is_about_a_box(header: Header, predicate: Predicate) -> bool:
    """Whether a claim about every start of a box rests on its kernel: fresh starts alone test what is between tests."""
    problems = {name.partition("/")[0] for name in bases(header.config)[0].problems}
    kernel = any(each.name in problems and isinstance(each, KernelProblem) for each in header.config.problems)
    return kernel and predicate.claims[0].starts is None and predicate.claims[0].quantity in WORST


def _ended_untested(header: Header, predicate: Predicate) -> bool:
    """Whether a violation ended the campaign before any fresh start was tested, and says nothing of the mean."""
    ended = predicate.counterexample is not None and predicate.spot_check is None
    return ended and not is_deterministic(header) and _is_about_a_box(header, predicate)


def _falls_short(claim: CertificateClaim, required: Required) -> bool:
    """Whether the bound is on the wrong side of what is required, or nothing is."""
    if required.bound is None:
        return True
    return claim.bound < required.bound if claim.sense == ">=" else claim.bound > required.bound


# Neither


def _not_shown(
    header: Header, predicate: Predicate, required: Required, better: Callable[[float], str], where: tuple[str, ...]
) -> VerdictFinding:
    """Return the reasons, and what would help.

    `better` says what would bring the bound to a limit, and `where` at which start the opposite is suspected.
    """
    claim, reasons, advice = predicate.claims[0], list[str](), list[str]()
    if claim.refuted:
        reasons.append(f"{refutation_words(claim.refuted)} Do not rely on the bound.")
        # Where its value is false, no other constants make it true.
        advice += [TEST_ALONE, instead_of_refuted(claim)] if where else [instead_of_refuted(claim)]
    if _ended_untested(header, predicate):
        reasons.append("A violation ended the campaign before any fresh start tested the bound.")
        checked = "" if header.config.spot_check else ", and that has a `spot_check`"
        advice.append(
            f"A new campaign with a new seed that no violation ends{checked}: its fresh starts test the bound."
        )
    if claim.vacuous:
        reasons.append(EMPTY[nothing_shown(claim.quantity)])
    if required.bound is None and header.config.falsify is not None and claim.quantity == "failure_probability":
        reasons.append(
            "The search found no rollout that violates the specification, which does not show there is none."
        )
        advice.append(SEARCH_ON)
    elif required.bound is None:
        what = "probability" if claim.quantity in PROBABILITIES else "value"
        reasons.append(f"The campaign file does not say the largest acceptable {what}.")
        advice.append(SAY_LIMIT.capitalize())
    elif _falls_short(claim, required):
        limit, bound = margin_text(as_required(required.bound), claim, required.unit), outward(claim.bound, claim.sense)
        reasons.append(f"The bound {bound} does not reach the required {limit}{_budget_words(predicate)}.")
        if not claim.refuted:
            advice.append(better(required.bound))
    if too_unlikely(claim, required):
        chance = outward(claim.probability, ">=")
        # What is refuted holds with no probability.
        holds = f"Its probability would be {chance}" if claim.refuted else f"It holds with probability {chance}"
        reasons.append(f"{holds}, and {as_required(required.probability)} is required.")
        advice.append(for_the_probability(header.config, claim, required.probability))
    return VerdictFinding("NOT SHOWN", (*reasons, *where), tuple(advice))


def _budget_words(predicate: Predicate) -> str:
    spent = [each for each in predicate.problems if each.stopped_by == "budget"]
    if not spent:
        return ""
    whose = f" of {' and '.join(each.key for each in spent)}" if len(predicate.problems) > 1 else ""
    tests = f"the budget of {spent[0].tests:,} tests is" if len(spent) == 1 else "the budgets are"
    return f"; {tests.replace(' is', f'{whose} is').replace(' are', f'{whose} are')} spent"
