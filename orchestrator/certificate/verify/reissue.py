"""The certificate once more, from the evidence, compared part by part with the one that is verified."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ....schemas.certificate import Assumption, Certificate
from ....schemas.facts import Header
from ..issue import issue, manifest
from . import compare
from .rerun import Rerun

CHANCES = ("probability", "probabilities")


def reissued(rerun: Rerun) -> Certificate:
    """Return the certificate that follows from the evidence."""
    return issue(rerun.ledger, manifest(rerun.observed()))


def compared(header: Header, own: Certificate, certificate: Certificate) -> Iterator[tuple[str, str | None, str]]:
    """Yield (check, fault or None, what was compared) for every part of the certificate."""
    ours, theirs = own.predicate.model_dump(mode="json"), certificate.predicate.model_dump(mode="json")
    _drop_later_keys(header, ours["problems"])
    problems, claims = len(ours["problems"]), len(ours["claims"])
    rule = "nothing is composed" if ours["composition"] is None else f"rule {ours['composition']['rule']}"
    for name, part, same, detail in (
        ("problems", _fixed, compare.identical, ""),
        ("problems", _bounds, compare.computed, f"problems: {problems}"),
        ("probabilities", _probabilities, compare.computed, f"problems: {problems}, claims: {claims}"),
        ("composition", lambda predicate: predicate["composition"], compare.computed, rule),
        ("claims", _claims, compare.computed, f"claims: {claims}"),
    ):
        fault = compare.difference(part(ours), part(theirs), name, same=same)
        if fault or detail:
            yield name, fault, detail
    yield "audit", *_audit(own.predicate.assumptions, certificate.predicate.assumptions)


def _audit(ours: Sequence[Assumption], theirs: Sequence[Assumption]) -> tuple[str | None, str]:
    """Compare what was found; the sentences are presentation, and another perfbound may word them otherwise."""
    fault = compare.difference([[a.id, a.status] for a in ours], [[a.id, a.status] for a in theirs], "assumptions")
    for own, given in zip(ours, theirs, strict=False):
        if fault is None and given.values is not None:
            fault = compare.difference(own.values, given.values, own.id, same=compare.six_digits)
    differing = sum(own.detail != given.detail for own, given in zip(ours, theirs, strict=False))
    worded = f"; {differing} of its sentences differ from those below" if differing else ""
    return fault, f"assumptions: {len(ours)}{worded}"


def _fixed(predicate: Mapping[str, Any]) -> Any:
    return [row["parameters"] for row in predicate["problems"]]


def _drop_later_keys(header: Header, problems: Sequence[Mapping[str, Any]]) -> None:
    """Leave out the keys of a campaign file that perfbound did not have when this one was run."""
    for problem, result in zip(header.config.problems, problems, strict=True):
        for key in set(type(problem).model_fields) - problem.model_fields_set:
            result["parameters"].pop(key, None)


def _bounds(predicate: Mapping[str, Any]) -> Any:
    return _without_chances(predicate["problems"])


def _claims(predicate: Mapping[str, Any]) -> Any:
    return _without_chances(predicate["claims"])


def _probabilities(predicate: Mapping[str, Any]) -> Any:
    return [{key: row[key] for key in CHANCES if key in row} for row in predicate["problems"] + predicate["claims"]]


def _without_chances(rows: Sequence[Mapping[str, Any]]) -> Any:
    return [{key: value for key, value in row.items() if key not in CHANCES} for row in rows]
