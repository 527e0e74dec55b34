"""Comparison of the facts that follow from the evidence with the tables of the database and the certificate.

Numbers are the same up to `ROUND_OFF`, because another CPU computes other last digits; everything else is equal.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ....schemas.base import digest
from ....schemas.facts import (
    BoundFact,
    Fact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
    first_link,
    next_link,
)
from ...campaign.seeds import rollout_seed
from ...store.untrusted import UntrustedFacts

ROUND_OFF = 2e-9
"""Bounds are rounded outward to 1e-9, so that round-off may move one by a step."""
SIX_DIGITS = 1e-5
"""Of a value of an assumption, which has six digits."""


def difference(
    ours: Any, theirs: Any, where: str = "", *, same: Callable[[Any, Any], bool] | None = None
) -> str | None:
    """Return the first place in which two JSON values differ, and both sides; None if they are the same.

    `same` compares what is neither a list nor an object: `identical`, `computed` (the default) or `six_digits`.

    >>> difference({"a": [1.0, "x"]}, {"a": [1.0, "y"]})
    'a[1] is "y", the evidence gives "x"'
    """
    same = same or computed
    if isinstance(ours, Mapping) and isinstance(theirs, Mapping):
        keys = [*ours, *(key for key in theirs if key not in ours)]
        inside = (
            difference(
                ours.get(key, ABSENT), theirs.get(key, ABSENT), f"{where}.{key}" if where else str(key), same=same
            )
            for key in keys
        )
        return next((found for found in inside if found), None)
    if _is_list(ours) and _is_list(theirs) and len(ours) == len(theirs):
        pairs = enumerate(zip(ours, theirs, strict=True))
        return next((d for k, (a, b) in pairs if (d := difference(a, b, f"{where}[{k}]", same=same))), None)
    return None if same(ours, theirs) else f"{where} is {_text(theirs)}, the evidence gives {_text(ours)}"


ABSENT = "(nothing)"


def _is_list(value: object) -> bool:
    return isinstance(value, list | tuple)


def identical(a: Any, b: Any) -> bool:
    """Whether two values are the same, and of the same kind: 1, 1.0 and true differ."""
    return type(a) is type(b) and bool(a == b)


def computed(a: Any, b: Any) -> bool:
    """Whether two values are the same where another CPU may have computed other last digits of a float."""
    if isinstance(a, float) and isinstance(b, float):
        return close(a, b, ROUND_OFF)
    return identical(a, b)


def six_digits(a: Any, b: Any) -> bool:
    """Whether two values of an assumption are the same, up to the last digit of a float."""
    if isinstance(a, float) and isinstance(b, float):
        return close(a, b, SIX_DIGITS)
    return identical(a, b)


def close(a: float, b: float, tolerance: float) -> bool:
    """Whether two finite numbers are the same, absolutely or relatively."""
    return math.isfinite(a) and math.isfinite(b) and math.isclose(a, b, rel_tol=tolerance, abs_tol=tolerance)


def _text(value: object) -> str:
    text = f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def tables(header: Header, ours: Iterable[Fact], stored: UntrustedFacts) -> tuple[str | None, str]:
    """Compare every table that is there with the facts that follow; return the fault, or None and what was compared."""
    derived = _by_key(ours)
    compared, gone = [], []
    for name, rows in (
        ("tests", stored.proposals),
        ("rollouts", stored.rollouts),
        ("observations", stored.observations),
        ("bounds", stored.bounds),
    ):
        if not rows:
            gone.append(name)
            continue
        compared.append(f"{len(rows)} {name}")
        fault = _table(header, name, derived, rows)
        if fault:
            return fault, ""
    left = f"; not there: {', '.join(gone)}" if gone else ""
    return None, f"{', '.join(compared) or 'nothing'}{left}"


def _table(header: Header, name: str, derived: Mapping[object, Fact], rows: Sequence[Fact]) -> str | None:
    written = _by_key(rows)
    if len(written) != len(rows):
        return f"table {name}: a row is there twice"
    kind = type(rows[0])
    wanted = {key: fact for key, fact in derived.items() if isinstance(fact, kind)}
    for key, fact in wanted.items():
        if key not in written:
            return f"table {name}: {_label(fact)} is missing"
        found = difference(_values(fact), _values(written[key]))
        if found:
            return f"table {name}, {_label(fact)}: {found}"
    extra = [fact for key, fact in written.items() if key not in wanted and not _in_flight(header, derived, fact)]
    return f"table {name}: {_label(extra[0])} does not follow from the evidence" if extra else None


def _in_flight(header: Header, derived: Mapping[object, Fact], fact: Fact) -> bool:
    """Whether this is a rollout of a test that was proposed, and never observed because its problem had stopped."""
    if not isinstance(fact, RolloutFact):
        return False
    test = f"{fact.rollout.problem}, test {fact.rollout.test}"
    open_test = (ProposalFact, test) in derived and (ObservationFact, test) not in derived
    return open_test and fact.seed == rollout_seed(header.config, fact.rollout)


def _by_key(facts: Iterable[Fact]) -> dict[object, Fact]:
    return {(type(fact), _label(fact)): fact for fact in facts}


def _label(fact: Fact) -> str:
    return str(fact.rollout) if isinstance(fact, RolloutFact) else f"{fact.problem}, test {fact.test}"


def _values(fact: Fact) -> dict[str, Any]:
    # The chain is compared by itself: it rests on the last digits of the proposals.
    match fact:
        case ProposalFact(proposal=chosen):
            return asdict(chosen)
        case ObservationFact(observation=found):
            return asdict(found)
        case BoundFact(bound=bound):
            return {"upper": bound.upper, "lower": bound.lower, "stopped_by": fact.stopped_by}
        case RolloutFact():
            return asdict(fact)


def chain_head(header: Header, ours: Sequence[Fact], proposals: Sequence[ProposalFact]) -> str:
    """Return the head of the hash chain over what follows from the evidence.

    The numbers of the proposals are those that were written down, if they were: their last digits depend on the CPU.
    """
    written = {(fact.problem, fact.test): fact for fact in proposals}
    chosen = {(f.problem, f.test): written.get((f.problem, f.test), f) for f in ours if isinstance(f, ProposalFact)}
    rollouts: dict[tuple[str, int], list[RolloutFact]] = {}
    for fact in ours:
        if isinstance(fact, RolloutFact):
            rollouts.setdefault((fact.rollout.problem, fact.rollout.test), []).append(fact)
    links: dict[str, str] = {problem.name: first_link(header, problem.name) for problem in header.config.problems}
    for fact in ours:
        if isinstance(fact, ObservationFact):
            test = (fact.problem, fact.test)
            links[fact.problem] = next_link(links[fact.problem], chosen[test], rollouts[test], fact.observation)
    return digest(list(links.values()))
