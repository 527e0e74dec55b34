"""Sentences of the report: claims and current bounds, typeset with real signs and rounded to the safe side."""

from collections.abc import Sequence
from dataclasses import fields

from ....schemas.file.drawn_claims import is_sampled
from ....schemas.file.objectives import Quantity, Reading
from ....schemas.result import certificate as document
from ....schemas.result.facts import Header
from ....schemas.result.known import CampaignVerdict
from ...campaign.clip import hiding, is_vacuous, reach_of
from ...certificate.words.bound_text import as_required, chance, clip_words, outward, parameter_units
from ...certificate.words.confidence import anyway, confidence_sentences
from ...certificate.words.known_text import violation_words
from ...certificate.words.refutation_text import counterexample_parts, refutation_sentence
from ...certificate.words.search_text import failure_parts, search_parts
from ...certificate.words.text import claim_words, notes, nothing_shown, quantity_words
from ...store.export_tables import robustness_unit
from ..data.claims import Claim, VerdictCard
from ..data.page import Problem

OF_CLAIM = {each.name for each in fields(Claim)} - {"sentence", "notes"}
SIGNS = {">=": "≥", "<=": "≤", " -": " \u2212", "rho*": "ρ*"}
"""ASCII of certificate and terminal, and its sign on the page."""


def typeset(text: str) -> str:
    """Return a formula or a sentence of the certificate with real signs.

    >>> typeset("rho* >= -0.17"), typeset("E[robustness] - r sd[robustness]")
    ('ρ* ≥ −0.17', 'E[robustness] − r sd[robustness]')
    """
    for ascii_sign, sign in SIGNS.items():
        text = text.replace(ascii_sign, sign)
    return text


def worded(predicate: document.Predicate) -> tuple[Claim, ...]:
    """Return the claims of a certificate with their sentences."""
    return tuple(
        Claim(
            **claim.model_dump(include=OF_CLAIM),
            sentence=claim_sentence(claim),
            notes=tuple(map(typeset, notes(predicate, number))),
        )
        for number, claim in enumerate(predicate.claims)
    )


def verdict_card(found: CampaignVerdict, predicate: document.Predicate, *, repeated: bool) -> VerdictCard:
    """Return the verdict in sentences with real signs; `repeated` as in `confidence_sentences`."""
    return VerdictCard(
        found.verdict,
        typeset(found.rests_on),
        typeset(f"{found.claim}."),
        tuple(map(typeset, found.reasons)),
        tuple(map(typeset, confidence_sentences(found, predicate, repeated=repeated))),
        typeset(anyway(found, predicate)),
        found.by_rollouts,
        found.advice,
        typeset(violation_words(found)),
        found.repeat,
    )


def claim_sentence(claim: document.CertificateClaim) -> str:
    """Return a claim in words.

    >>> from perfbound.schemas.result.certificate import CertificateClaim
    >>> claim_sentence(CertificateClaim(quantity="J_star", sense="<=", bound=0.51234, probability=0.98765,
    ...                                 rule="single", method="paper", assumptions=(), refuted=()))
    'J* (maximum of the expectation) ≤ 0.5124 with probability at least 0.9876'
    """
    subject = claim_words(claim)
    text = _statement(subject, claim.bound, claim.sense, chance(claim.probability, claim.assumptions))
    if claim.vacuous:
        text += f". {nothing_shown(claim.quantity).removesuffix('.')}"
    if claim.refuted:
        text += f". {refutation_sentence(claim.refuted).removesuffix('.')}"
    return text


def current_bound(problems: Sequence[Problem], claims: Sequence[Claim]) -> str:
    """Return the first claim of a finished campaign, or the current bound of every problem."""
    if claims:
        return claims[0].sentence
    whole = [each for each in problems if each.requirement is None]
    text = " ".join(_problem_bound(each, several=len(problems) > len(whole)) for each in whole)
    return text if len(whole) == 1 else f"{text} The composed claim follows when all problems have stopped."


def counterexample_sentences(found: document.Counterexample, header: Header) -> tuple[str, ...]:
    """Return the sentences on the rollout that ended a campaign, and on what followed it."""
    unit, units = robustness_unit(header.config, header.spec), parameter_units(header.spec)
    return _sentences(counterexample_parts(found, unit, units))


def search_sentences(predicate: document.Predicate, header: Header) -> tuple[str, ...]:
    """Return the sentences on what a search has found beside the counterexample."""
    unit, units = robustness_unit(header.config, header.spec), parameter_units(header.spec)
    return _sentences(failure_parts(predicate.failures, unit, units) + search_parts(predicate.search, unit, units))


def _sentences(parts: Sequence[str]) -> tuple[str, ...]:
    return tuple(typeset(f"{each[0].upper()}{each[1:]}.") for each in parts)


def _problem_bound(problem: Problem, *, several: bool) -> str:
    sense = ">=" if problem.sense == "min" else "<="
    objective = problem.objective.partition(", through")[0]
    quantity = objective
    if problem.quantity is not None and not is_sampled(problem.quantity):
        quantity = quantity_words(problem.quantity, problem.starts, problem.clipped)
    if several and problem.quantity is not None:
        quantity += ", of every requirement"
    if problem.stopped_by == "refuted":
        return f"{problem.name}: its assumptions are refuted, so its bound is worth nothing."
    if problem.bound is None:
        return f"{problem.name}: no bound yet."
    if problem.probability is None:  # its method claims a bound at its end alone
        would_be = typeset(f"{quantity} {sense} {outward(problem.bound, sense)}")
        return (
            f"{problem.name}: not yet a bound. Method {problem.method} claims one only where it stops; if its budget "
            f"ended here, it would be {would_be}."
        )
    vacuous = f" {nothing_shown(problem.quantity)}" if is_vacuous(problem.bound, sense, problem.by_clip) else ""
    return f"{_statement(quantity, problem.bound, sense, chance(problem.probability))}.{vacuous}"


def _statement(quantity: str, bound: float, sense: str, likely: str) -> str:
    joined = " " if likely.startswith("with") else ", "
    return f"{typeset(f'{quantity} {sense} {outward(bound, sense)}')}{joined}{likely}"


# The question of the campaign file

OF_MARGIN: dict[Quantity, tuple[str, Reading]] = {
    "robustness": ("the margin of every rollout", "each"),
    "expected_robustness": ("the mean margin over the noise", "mean"),
    "rho_star": ("the mean margin less {risk:g} standard deviations", "risk"),
    "mean": ("the mean margin", "mean"),
    "risk": ("the mean margin less {risk:g} standard deviations", "risk"),
}
"""Quantities of a claim about a margin, what is bounded, and how it reads the values."""


def question_words(header: Header, quantity: Quantity | None, listed: int | None = None) -> str:
    """Return what the file requires of a quantity; empty where it requires nothing that one sentence says.

    A term of a composition has no quantity: its sum bounds the risk. `listed` is the number of listed starts.
    """
    config, quantity = header.config, quantity or "rho_star"
    unit = robustness_unit(config, header.spec)
    shown = "" if unit == "1" else f" {unit}"
    every = "From every start" if listed is None else f"From each of the {listed:,} listed starts"
    where = "At starts that are drawn as declared" if is_sampled(quantity) else every
    if quantity in OF_MARGIN and config.formula is not None:
        margin, reading = OF_MARGIN[quantity]
        within, required = reach_of(config.formula, header.spec.after_end, config.beyond), config.required_margin
        clip = hiding(config.clip, within, reading, ">=", risk_weight=config.risk_weight, bound=required)
        clipped = "" if clip is None else f", {clip_words(clip)},"
        least = f"{margin.format(risk=config.risk_weight)}{clipped} must be at least {as_required(required)}{shown}"
        cut = " Its windows are truncated at the end of the rollout." if config.beyond == "truncate" else ""
        return (
            f"{where}, {least}. The margin of a rollout is its robustness: 0 is just met, and below 0 it violates.{cut}"
        )
    if quantity == "failure_probability":
        limit = config.required_at_most
        if limit is not None:
            at_most = as_required(limit)
            return f"{where}, the probability that a rollout violates the specification must be at most {at_most}."
        if config.falsify is not None:
            return "Whether some rollout violates the specification: a search chooses the tests."
        return (
            f"{where}, how probable it is that a rollout violates the specification; the campaign file names no limit."
        )
    return ""
