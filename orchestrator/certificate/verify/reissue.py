"""The reissue of the certificate from the evidence, and its comparison with the verified one, part by part."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from ....schemas.amounts import counted
from ....schemas.file.parts import parts_of
from ....schemas.result.certificate import Assumption, Certificate
from ....schemas.result.facts import Header
from ...campaign.ledger import observed_discards
from ..assumptions.sentences import is_in_its_words, is_worded_here
from ..issue import issue, manifest
from . import compare
from .checks import ABSENT
from .compare import ROUND_OFF
from .rerun import Rerun

PROBABILITIES = ("probability", "probabilities")


def reissue(rerun: Rerun, *, irreproducible: int, contradicted: Sequence[str]) -> Certificate:
    """Return the certificate that follows from the evidence, and from what no trajectory file shows, as for `issue`."""
    found = manifest(rerun.observed(), observed_discards(rerun.ledger))
    return issue(rerun.ledger, found, irreproducible=irreproducible, contradicted=contradicted)


def compared(header: Header, reissued: Certificate, certificate: Certificate) -> Iterator[tuple[str, str | None, str]]:
    """Yield (check, fault or None, detail) for every part of the certificate."""
    recomputed, recorded = (each.predicate.model_dump(mode="json") for each in (reissued, certificate))
    _drop_later_keys(header, recomputed["problems"])
    problems, claims = len(recomputed["problems"]), len(recomputed["claims"])
    composition = recomputed["composition"]
    spot_check, recheck = recomputed["spot_check"], recomputed["recheck"]
    starts = ABSENT["spot check"] if spot_check is None else counted(spot_check["starts"], "start")
    repeated = ABSENT["recheck"] if recheck is None else counted(recheck["rollouts"], "rollout")
    rule = ABSENT["composition"] if composition is None else f"rule {composition['rule']}"
    for name, part, tolerance, detail in (
        # Parameters were fixed beforehand, so they are equal; only computed numbers have a tolerance.
        ("problems", _parameters_of, 0.0, ""),
        (
            "problems",
            lambda predicate: _without_probabilities(predicate["problems"]),
            ROUND_OFF,
            f"problems: {problems}",
        ),
        (
            "problems",
            lambda side: {key: side.get(key) for key in ("counterexample", "failures", "search")},
            ROUND_OFF,
            "",
        ),
        ("probabilities", _probabilities_of, ROUND_OFF, f"problems: {problems}, claims: {claims}"),
        ("composition", lambda side: side["composition"], ROUND_OFF, rule),
        ("spot check", lambda side: _without_wealth(side["spot_check"]), ROUND_OFF, ""),
        ("spot check", lambda side: side["spot_check"], compare.SIX_DIGITS, starts),
        ("recheck", lambda side: side["recheck"], ROUND_OFF, repeated),
        ("claims", lambda side: {"bounded": side.get("bounded")}, ROUND_OFF, ""),
        ("claims", lambda side: side["sensitivity"], ROUND_OFF, ""),
        (
            "claims",
            lambda side: _without_shares(_without_probabilities(side["claims"])),
            ROUND_OFF,
            f"claims: {claims}",
        ),
    ):
        fault = compare.difference(part(recomputed), part(recorded), name, tolerance=tolerance)
        if fault or detail:
            yield name, fault, detail
    assumptions = reissued.predicate.assumptions, certificate.predicate.assumptions
    worded_here = is_worded_here(header.software)
    yield "audit", *_audit(*assumptions, worded_here=worded_here)


def _audit(
    recomputed: Sequence[Assumption], recorded: Sequence[Assumption], *, worded_here: bool
) -> tuple[str | None, str]:
    """Compare ids, statuses, values and sentences; return the fault or None, and the detail."""
    ids, recorded_ids = ([[each.id, each.status] for each in side] for side in (recomputed, recorded))
    fault = compare.difference(ids, recorded_ids, "assumptions")
    pairs = list(zip(recomputed, recorded, strict=False))
    for ours, found in pairs:
        if fault is None:
            fault = compare.difference(ours.values, found.values, ours.id, tolerance=compare.SIX_DIGITS)
    if worded_here and fault is None:
        forms, recorded_forms = ([each.form for each in side] for side in (recomputed, recorded))
        fault = compare.difference(forms, recorded_forms, "assumptions") or next(
            (
                f"{each.id}: its sentence is not the one of its form and its values"
                for each in recorded
                if not is_in_its_words(each)
            ),
            None,
        )
    # Another perfbound may word them otherwise: there a difference is only counted.
    differing = sum(ours.detail != found.detail for ours, found in pairs)
    worded = f"; in the certificate {differing} are worded otherwise than below" if differing else ""
    return fault, f"assumptions: {len(recomputed)}{worded}"


def _parameters_of(predicate: Mapping[str, Any]) -> Any:
    return [row["parameters"] for row in predicate["problems"]]


def _drop_later_keys(header: Header, problems: Sequence[Mapping[str, Any]]) -> None:
    """Drop the keys of a campaign file that did not exist when this campaign was run."""
    config = header.config
    # Of several requirements each has a result.
    bounded = [part.problems[0] for part in parts_of(config)] or config.problems
    for problem, result in zip(bounded, problems, strict=True):
        for key in set(type(problem).model_fields) - problem.model_fields_set:
            result["parameters"].pop(key, None)


def _probabilities_of(predicate: Mapping[str, Any]) -> Any:
    return [
        {key: row[key] for key in PROBABILITIES if key in row} for row in predicate["problems"] + predicate["claims"]
    ]


def _without_probabilities(rows: Sequence[Mapping[str, Any]]) -> Any:
    return _without(rows, PROBABILITIES)


def _without_shares(claims: Sequence[Mapping[str, Any]]) -> Any:
    # A box whose bound is next to 0 may have another status by round-off: check `regions` compares the shares.
    return [row if row["quantity"] != "safe_share" else {**row, "bound": None, "vacuous": None} for row in claims]


def _without_wealth(spot_check: Mapping[str, Any] | None) -> Any:
    return spot_check and {**spot_check, "problems": _without(spot_check["problems"], ("wealth",))}


def _without(rows: Sequence[Mapping[str, Any]], keys: Collection[str]) -> Any:
    return [{key: value for key, value in row.items() if key not in keys} for row in rows]
