"""Evidence for the opposite of what is required: rollouts, or the bound from the other side.

An expectation below the required margin at some start also shows that a risk is below it. No finding of the rollouts
needs smoothness or a kernel.
"""

import itertools
import math
import struct
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from ...schemas.amounts import counted
from ...schemas.file.config import CampaignConfig
from ...schemas.file.drawn_claims import is_sampled
from ...schemas.file.objectives import OBJECTIVES, Quantity, Reading
from ...schemas.result.certificate import CertificateClaim, Predicate, ProblemResult
from ...schemas.result.facts import Header
from ...schemas.result.known import ByRollouts, VerdictWord, Violations
from ..campaign.clip import SAME, hiding, reach_of
from ..mathematics.bounds.checks.counter_evidence import OppositeTest
from ..store.export_tables import robustness_unit
from ..store.robustness import ObservedValues
from .words.bound_text import as_required, clip_words, if_they_hold, margin_text, outward, parameter_units
from .words.refutation_text import margin_words, named_start
from .words.text import claim_words

WORST: dict[Quantity, str] = {
    "rho_star": "robustness risk: mean less {:g} standard deviations",
    "robustness": "robustness",
    "expected_robustness": "expected robustness: the mean over the noise",
}
"""Quantities of a claim about the worst start, and what their margin is."""

AFTER_SEARCH = (
    "Fix the system and search again, in a new run directory; a campaign without `falsify` bounds how often rollouts "
    "fail."
)
SEARCH_ON = (
    "More tests (`perfbound resume --max-tests`) search further; where some failures are acceptable, say how many with "
    "the key `required_at_most`."
)
SAY_LIMIT = "name it with the key `required_at_most`; the bound stays the same."
"""What to do about the largest acceptable value, where the file names none."""
OF_ROLLOUTS = ("reproducible_rollouts", "independent_rollouts", "one_law_per_start")
"""Assumptions without which rollouts show nothing of a start."""
Values = Iterable[ObservedValues]
ByStart = Iterable[tuple[bytes, Sequence[float]]]
"""The start of each test, and the robustness of its rollouts."""


@dataclass(frozen=True, slots=True)
class Required:
    """What the file requires of the first claim."""

    bound: float | None
    """None where it requires nothing."""
    probability: float
    unit: str
    """Of the robustness."""


@dataclass(frozen=True, slots=True)
class VerdictFinding:
    """A verdict with its reasons, and what would help."""

    word: VerdictWord
    reasons: tuple[str, ...]
    advice: tuple[str, ...] = ()
    by_rollouts: ByRollouts | None = None
    clip: tuple[float, float] | None = None
    """What is found is about values clipped to it, and may be false of the values themselves."""


def capitalised(words: str) -> str:
    """Return words with a capital at their beginning, and no other one changed."""
    return f"{words[0].upper()}{words[1:]}"


def chance_words(claim: CertificateClaim) -> str:
    """Return the probability of a claim, and how many assumptions it rests on.

    >>> chance_words(CertificateClaim(quantity="robustness", sense=">=", bound=0.5, probability=1.0, rule="single",
    ...                               method="rigorous", assumptions=("rkhs_norm/robustness",), refuted=()))
    'if its 1 assumption holds'
    """
    rests = if_they_hold(claim.assumptions)
    # Certainty is that of a system without noise, and of nothing else.
    if claim.probability == 1.0:
        return rests
    chance = f"with probability at least {outward(claim.probability, '>=')}"
    return f"{chance}, {rests}" if claim.assumptions else chance


def too_unlikely(claim: CertificateClaim, required: Required) -> bool:
    """Whether a claim has less than the required probability."""
    return claim.probability < required.probability - SAME


def violated(
    header: Header,
    predicate: Predicate,
    required: Required,
    violations: Violations,
    values: Callable[[], Values],
) -> VerdictFinding | None:
    """Return the finding that what is required of the first claim is wrong; None where nothing shows that."""
    claim = predicate.claims[0]
    if required.bound is not None:
        if _is_clipped_below(header, claim, required.bound):
            return None
        found = None
        if not (_are_all_beyond(claim, required.bound, violations) or _are_unfounded(predicate)):
            found = _by_rollouts(header, claim, required.bound, required.probability, values)
        return found or _by_partner(header, predicate, required)
    if claim.quantity == "failure_probability" and claim.requirement is None:
        return _any_violation(violations, searched=header.config.falsify is not None)
    return None


def _are_all_beyond(claim: CertificateClaim, required: float, violations: Violations) -> bool:
    """Whether no value is below what is required of the worst start: most campaigns need not be read to see that."""
    return claim.quantity in WORST and violations.least is not None and violations.least >= required


def _are_unfounded(predicate: Predicate) -> bool:
    """Whether the data refute what every reading of the rollouts rests on."""
    refuted = {each.id.partition("/")[0] for each in predicate.assumptions if each.status == "refuted"}
    return not refuted.isdisjoint(OF_ROLLOUTS)


def _is_clipped_below(header: Header, claim: CertificateClaim, required: float) -> bool:
    """Whether every clipped value is below what is required, whatever the robustness is."""
    clip = header.config.clip
    return clip is not None and claim.sense == ">=" and required >= clip[1]


def is_deterministic(header: Header) -> bool:
    """Whether nothing is random in the rollouts that the claims are about."""
    return header.claimed_variant not in header.spec.noisy


def _any_violation(violations: Violations, *, searched: bool) -> VerdictFinding | None:
    """Return the finding where some rollout violates the specification: who names no acceptable share accepts none."""
    if not violations.violations:
        return None
    if searched:  # a search asks for no probability
        reason = "A rollout violates the specification: the search has found what it sought."
        return VerdictFinding("VIOLATED", (reason,), (AFTER_SEARCH,), "certain")
    reason = "A rollout violates the specification, and the campaign file names no acceptable probability of that."
    return VerdictFinding("VIOLATED", (reason,), (f"If some are acceptable, {SAY_LIMIT}",), "certain")


def _by_partner(header: Header, predicate: Predicate, required: Required) -> VerdictFinding | None:
    """Return the finding where the bound from the other side is beyond what is required.

    It has the probability and the assumptions of the claim: with a kernel those about B and R, too.
    """
    claim, partner, limit = predicate.claims[0], other_side(predicate), required.bound
    if partner is None or limit is None or claim.refuted or too_unlikely(claim, required):
        return None
    other = "<=" if claim.sense == ">=" else ">="
    if not (partner < limit if claim.sense == ">=" else partner > limit):
        return None
    beyond = margin_text(outward(partner, other), claim, required.unit)
    clip = clip_of_other_side(header.config, claim, partner)
    subject = capitalised(claim_words(claim.model_copy(update={"clipped": clip})))
    return VerdictFinding("VIOLATED", (f"{subject} {other} {beyond}, {chance_words(claim)}.",), clip=clip)


def other_side(predicate: Predicate) -> float | None:
    """Return the bound from the other side of the quantity of a claim about one problem; None where there is none."""
    claim, (first, *others) = predicate.claims[0], predicate.problems
    if claim.rule != "single" or others or is_sampled(claim.quantity) or not _is_two_sided(first):
        return None
    is_of_claim = first.requirement == claim.requirement and first.method == claim.method
    return first.partner if is_of_claim else None


def clip_of_other_side(config: CampaignConfig, claim: CertificateClaim, bound: float) -> tuple[float, float] | None:
    """Return the clip that the words of `bound`, from the other side of the quantity of a claim, have to name."""
    reading: Mapping[Quantity, Reading] = {"rho_star": "risk", "expected_robustness": "mean"}
    other = "<=" if claim.sense == ">=" else ">="
    return hiding(
        config.clip,
        reach_of(config.formula, beyond=config.beyond),
        reading.get(claim.quantity, "each"),
        other,
        bound=bound,
    )


def _is_two_sided(problem: ProblemResult) -> bool:
    """Whether both bounds are about the objective itself.

    A risk is bounded from below through an expectation, and the bound from the other side is one of what comes of this
    expectation, which the risk may exceed. With constants from the past alone it is one of the mean, above any risk.
    """
    return not OBJECTIVES[problem.name].risk or problem.parameters.get("linearised") == "past"


def _by_rollouts(
    header: Header, claim: CertificateClaim, required: float, probability: float, values: Callable[[], Values]
) -> VerdictFinding | None:
    """Return the finding where the robustness of rollouts shows the opposite, which needs no smoothness."""
    if claim.requirement is not None:
        return None  # the stored robustness is that of the whole specification
    if claim.quantity in WORST:
        return _worst_below(header, claim, required, probability, values)
    return _drawn_below(header, claim, required, probability, values) if is_sampled(claim.quantity) else None


def _worst_below(
    header: Header, claim: CertificateClaim, required: float, probability: float, values: Callable[[], Values]
) -> VerdictFinding | None:
    """Return the finding about a worst start; a risk is at most the expectation, which therefore shows it too."""
    if is_deterministic(header):
        return _one_start_below(header, claim, required, values())
    if not _has_means(claim):
        return None
    by_start = _by_start(values())
    found = _mean_below(header.config, required, probability, by_start, "At some start the expected robustness")
    if found is None:
        return None
    # What is shown is that some start is bad, and not which.
    return replace(found, reasons=(*found.reasons, *_most_suspicious(header, by_start, required)))


def _has_means(claim: CertificateClaim) -> bool:
    """Whether the means of the stored robustness are those of a claim about the worst start.

    It is that of the whole specification, and the mean of the least of several requirements may be below that of each.
    """
    return claim.quantity in WORST and claim.requirement is None and claim.rule != "every"


def _drawn_below(
    header: Header, claim: CertificateClaim, required: float, probability: float, values: Callable[[], Values]
) -> VerdictFinding | None:
    """Return the finding about rollouts at drawn starts."""
    samples = drawn_samples(header.config, values())
    if claim.quantity in ("mean", "risk"):
        return _mean_below(
            header.config, required, probability, [(b"", samples)], "The mean robustness at drawn starts"
        )
    # A quantile or CVaR at a level is below the margin if more than this share of the rollouts is.
    if claim.quantity == "failure_probability":
        return _too_many_below(required, 0.0, probability, samples)
    if claim.quantity in ("quantile", "cvar"):
        return _too_many_below(claim.level or 1.0, required, probability, samples)
    return None


def _one_start_below(header: Header, claim: CertificateClaim, required: float, values: Values) -> VerdictFinding | None:
    least, worst = math.inf, b""
    for start, found in _by_start(values):
        if min(found) < least:
            least, worst = min(found), start
    if least >= required:
        return None
    unit = robustness_unit(header.config, header.spec)
    margin = margin_words(least, unit)
    less = "" if required == 0 else f", less than the required {margin_text(as_required(required), claim, unit)}"
    return VerdictFinding(
        "VIOLATED",
        (f"At {_start_words(header, worst)} the robustness is {margin}{less}, and nothing there is random.",),
        by_rollouts="certain",
    )


def suspected(
    header: Header, claim: CertificateClaim, required: Required, violations: Violations, values: Callable[[], Values]
) -> tuple[str, ...]:
    """Return at which start the rollouts most suggest the opposite of a claim, in a sentence; none for nowhere.

    That its mean is below what is required is not shown, so the sentence has the numbers alone.
    """
    limit = required.bound
    if limit is None or is_deterministic(header) or not _has_means(claim):
        return ()
    if _is_clipped_below(header, claim, limit) or _are_all_beyond(claim, limit, violations):
        return ()
    return _most_suspicious(header, _by_start(values()), limit)


def _most_suspicious(header: Header, by_start: ByStart, required: float) -> tuple[str, ...]:
    """Return the sentence on the start where the values are furthest below what is required, all of them together.

    Not that of the lowest mean: among many starts it is one with few rollouts, which show little.
    """
    values: dict[bytes, list[float]] = {}
    for start, found in by_start:
        values.setdefault(start, []).extend(found)
    missing = {start: math.fsum(required - value for value in each) for start, each in values.items()}
    worst = max(missing, key=missing.__getitem__, default=None)  # of several the one that was tested first
    if worst is None or missing[worst] <= 0.0:
        return ()
    number, below = len(values[worst]), sum(value < required for value in values[worst])
    mean = margin_words(math.fsum(values[worst]) / number, robustness_unit(header.config, header.spec))
    clip, within = header.config.clip, reach_of(header.config.formula, header.spec.after_end, header.config.beyond)
    # It is a number and no bound: either end of the clip may hide what it would be.
    clips = (hiding(clip, within, "mean", sense) for sense in (">=", "<="))
    clipped = next((f", {clip_words(each)}," for each in clips if each is not None), "")
    return (
        f"{below:,} of {counted(number, 'rollout')} at {_start_words(header, worst)} "
        f"{'is' if below == 1 else 'are'} below {as_required(required)}; the mean there{clipped} is {mean}.",
    )


def _start_words(header: Header, start: bytes) -> str:
    units = parameter_units(header.spec)
    return named_start(dict(zip(units, struct.unpack(f"<{len(units)}d", start), strict=True)), units)


def _mean_below(
    config: CampaignConfig, required: float, probability: float, by_start: ByStart, whose: str
) -> VerdictFinding | None:
    """Return the finding where some mean of the values, each with its start, is below the margin."""
    if config.clip is None or not config.clip[0] < required < config.clip[1]:
        return None
    low, high = config.clip
    # One test for all starts: a bound at each would share delta among starts whose number nothing fixes.
    test = OppositeTest(required, low, high)
    for start, values in by_start:
        test.observe_each(start, [min(max(value, low), high) for value in values])
    # Values above the upper end may lift the mean itself over what is required.
    clip = hiding(config.clip, reach_of(config.formula, beyond=config.beyond), "mean", "<=")
    clipped = "" if clip is None else f", {clip_words(clip)},"
    found = _refuting(test, probability, f"{whose}{clipped} is below {as_required(required)}")
    return None if found is None else replace(found, clip=clip)


def _too_many_below(share: float, margin: float, probability: float, samples: Sequence[float]) -> VerdictFinding | None:
    """Return the finding where more than a share of the values is below the margin."""
    if not share < 1.0:
        return None
    test = OppositeTest(1.0 - share, 0.0, 1.0)
    test.observe_each("", [float(value >= margin) for value in samples])
    return _refuting(
        test,
        probability,
        f"More than {as_required(100 * share)} % of the rollouts at drawn starts are below {as_required(margin)}",
    )


def _refuting(test: OppositeTest, probability: float, words: str) -> VerdictFinding | None:
    if not test.refutes(1.0 - probability):
        return None
    return VerdictFinding(
        "VIOLATED", (f"{words}, with probability at least {outward(probability, '>=')}.",), by_rollouts="probable"
    )


def drawn_samples(config: CampaignConfig, values: Values) -> Sequence[float]:
    """Return the robustness of the first rollout at each start that was drawn; further ones there are no samples."""
    (problem,), search = config.problems, config.falsify
    samples = array("d")
    for each in values:
        if each.series == problem.name:
            first = each.robustness[:: each.replicates]
            if search is not None:
                first = array("d", itertools.compress(first, map(search.is_random, itertools.count(each.test))))
            # As a whole where none is NaN, which a sum shows: there may be a million.
            whole = not math.isnan(sum(first))
            samples.extend(first if whole else (value for value in first if not math.isnan(value)))
    return samples


def _by_start(values: Values) -> list[tuple[bytes, list[float]]]:
    return [(start, found) for each in values for _, start, found in each.each()]
