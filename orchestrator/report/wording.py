"""What is claimed, and what holds right now, in words that promise no more than the numbers do."""

from collections.abc import Sequence

from ...schemas import certificate as document
from ...schemas.certificate import Certificate
from ..certificate.text import QUANTITIES, outward
from .data import Assumption, Claim, Composition, Problem


def claims(certificate: Certificate | None) -> tuple[Claim, ...]:
    """Return the claims of a finished campaign, the one that was chosen beforehand first."""
    if certificate is None:
        return ()
    return tuple(
        Claim(
            quantity=claim.quantity,
            sense=claim.sense,
            bound=claim.bound,
            probability=claim.probability,
            rule=claim.rule,
            method=claim.method,
            sentence=sentence(claim),
            assumptions=claim.assumptions,
            refuted=claim.refuted,
        )
        for claim in certificate.predicate.claims
    )


def sentence(claim: document.Claim) -> str:
    """Return a claim in words.

    >>> from perfbound.schemas.certificate import Claim
    >>> sentence(Claim(quantity="J_star", sense="<=", bound=0.51234, probability=0.98765, rule="single",
    ...                method="paper", assumptions=(), refuted=()))
    'J* (maximum of the expectation) <= 0.5124 with probability at least 0.9876'
    """
    text = f"{QUANTITIES[claim.quantity]} {_at_least(claim.bound, claim.sense, claim.probability)}"
    if claim.refuted:
        text += f". It rests on {_count(len(claim.refuted))} that the data refute: do not rely on it"
    return text


def composition(certificate: Certificate | None) -> Composition | None:
    """Return the terms of the first claim, if it is composed."""
    found = certificate.predicate.composition if certificate else None
    if found is None:
        return None
    return Composition(found.rule, found.nominal_bound, found.gap_term, found.risk_term, found.bound)


def assumptions(certificate: Certificate | None) -> tuple[Assumption, ...]:
    """Return what the claims rest on; it is known at the end."""
    found = certificate.predicate.assumptions if certificate else ()
    return tuple(Assumption(each.id, each.status, each.detail) for each in found)


def now(problems: Sequence[Problem], found: Sequence[Claim]) -> str:
    """Return the bound that holds right now: the first claim, or what each problem has."""
    if found:
        return found[0].sentence
    text = " ".join(_now(problem) for problem in problems)
    return text if len(problems) == 1 else f"{text} The composed claim comes at the end."


def _now(problem: Problem) -> str:
    sense = ">=" if problem.sense == "min" else "<="
    if problem.stopped_by == "refuted":
        return f"{problem.name}: its assumptions are refuted, so its bound is worth nothing."
    if problem.bound is None:
        return f"{problem.name}: no bound yet."
    if problem.probability is None:
        what = f"{_quantity(problem)} {sense} {outward(problem.bound, sense)}"
        return (
            f"{problem.name}: not yet a bound. Method {problem.method} claims one only where it stops; if its budget "
            f"ended here, it would be {what}."
        )
    return f"{_quantity(problem)} {_at_least(problem.bound, sense, problem.probability)}."


def _quantity(problem: Problem) -> str:
    """Return what a problem bounds, as the claims call it where it is a claim by itself."""
    direct = {"true_risk": "rho_star", "maximum": "J_star"}.get(problem.name)
    return QUANTITIES[direct] if direct else problem.objective.partition(", through")[0]


def _at_least(bound: float, sense: str, probability: float) -> str:
    return f"{sense} {outward(bound, sense)} with probability at least {outward(probability, '>=')}"


def _count(number: int) -> str:
    return f"{number} assumption{'' if number == 1 else 's'}"
