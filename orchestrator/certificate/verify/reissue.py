"""The certificate once more, from the evidence, and beside it part by part the one that is verified."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ....schemas.certificate import Certificate
from ....schemas.facts import Header
from ..issue import issue, manifest
from . import compare
from .rerun import Rerun

CHANCES = ("probability", "probabilities")


def reissued(rerun: Rerun, certificate: Certificate) -> Iterator[tuple[str, str | None, str]]:
    """Yield (check, fault or None, what was compared) for every part of the certificate."""
    ledger = rerun.ledger
    again = issue(ledger, manifest(rerun.observed()))
    ours, theirs = again.predicate.model_dump(mode="json"), certificate.predicate.model_dump(mode="json")
    _forget_later_keys(ledger.header, ours["problems"])
    problems, claims = len(ours["problems"]), len(ours["claims"])
    rule = "nothing is composed" if ours["composition"] is None else f"rule {ours['composition']['rule']}"
    for name, part, same, detail in (
        ("problems", _fixed, compare.identical, ""),
        ("problems", _bounds, compare.computed, f"problems: {problems}"),
        ("probabilities", _probabilities, compare.computed, f"problems: {problems}, claims: {claims}"),
        ("composition", lambda predicate: predicate["composition"], compare.computed, rule),
        ("claims", _claims, compare.computed, f"claims: {claims}"),
        ("audit", _audit, compare.told, f"assumptions: {len(ours['assumptions'])}"),
    ):
        fault = compare.difference(part(ours), part(theirs), name, same=same)
        if fault or detail:
            yield name, fault, detail


def _fixed(predicate: Mapping[str, Any]) -> Any:
    return [row["parameters"] for row in predicate["problems"]]


def _audit(predicate: Mapping[str, Any]) -> Any:
    return [[row["id"], row["status"], row["detail"]] for row in predicate["assumptions"]]


def _forget_later_keys(header: Header, problems: Sequence[Mapping[str, Any]]) -> None:
    """Leave out the keys of a campaign file that perfbound did not know when this one was run."""
    for problem, result in zip(header.config.problems, problems, strict=True):
        for key in set(type(problem).model_fields) - problem.model_fields_set:
            result["parameters"].pop(key, None)


def _bounds(predicate: Mapping[str, Any]) -> Any:
    return _without(predicate["problems"])


def _claims(predicate: Mapping[str, Any]) -> Any:
    return _without(predicate["claims"])


def _probabilities(predicate: Mapping[str, Any]) -> Any:
    return [{key: row[key] for key in CHANCES if key in row} for row in predicate["problems"] + predicate["claims"]]


def _without(rows: Sequence[Mapping[str, Any]]) -> Any:
    return [{key: value for key, value in row.items() if key not in CHANCES} for row in rows]
