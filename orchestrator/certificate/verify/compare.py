"""The comparison of recomputed facts with the recorded ones: the tables of the database and the certificate.

Computed numbers may differ by `ROUND_OFF`, because another CPU computes other last digits; everything else is equal.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ....schemas.base import digest
from ....schemas.ids import FileId, RolloutId
from ....schemas.result.block_facts import BatchFact, BlockObservationFact, BlockProposalFact, StoredFact, places
from ....schemas.result.facts import (
    BoundFact,
    DiscardFact,
    ExtensionFact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
    extended_link,
    first_link,
    next_link,
)
from ...campaign.seeds import rollout_seed
from ...store.untrusted import UntrustedFacts

ROUND_OFF = 2e-9
"""Bounds are rounded outward to 1e-9, so that round-off may move one by a step."""
SIX_DIGITS = 1e-5
"""Of a value of an assumption, which has six digits."""


ABSENT = "(nothing)"


def difference(recomputed: Any, recorded: Any, where: str = "", *, tolerance: float = ROUND_OFF) -> str | None:
    """Return the first place in which two JSON values differ, and both sides; None if they are the same.

    Two floats are the same if they are finite and within `tolerance`, absolutely or relatively; with tolerance 0 if
    they are equal. Other values must be equal and of one type: 1, 1.0 and true differ.

    >>> difference({"a": [1.0, "x"]}, {"a": [1.0, "y"]})
    'a[1] is "y", the evidence gives "x"'
    """
    if isinstance(recomputed, Mapping) and isinstance(recorded, Mapping):
        # Keys of both sides: a forger may leave out a field as well as add one.
        keys = [*recomputed, *(key for key in recorded if key not in recomputed)]
        pairs = [
            (f".{key}" if where else str(key), recomputed.get(key, ABSENT), recorded.get(key, ABSENT)) for key in keys
        ]
    elif _is_list(recomputed) and _is_list(recorded) and len(recomputed) == len(recorded):
        pairs = [(f"[{k}]", a, b) for k, (a, b) in enumerate(zip(recomputed, recorded, strict=True))]
    elif _same(recomputed, recorded, tolerance):
        return None
    else:
        return f"{where} is {_text(recorded)}, the evidence gives {_text(recomputed)}"
    inside = (difference(a, b, where + name, tolerance=tolerance) for name, a, b in pairs)
    return next((found for found in inside if found), None)


def _is_list(value: object) -> bool:
    return isinstance(value, list | tuple)


def _same(a: Any, b: Any, tolerance: float) -> bool:
    if tolerance and isinstance(a, float) and isinstance(b, float):
        return math.isfinite(a) and math.isfinite(b) and math.isclose(a, b, rel_tol=tolerance, abs_tol=tolerance)
    return type(a) is type(b) and bool(a == b)


def _text(value: object) -> str:
    text = f'"{value}"' if isinstance(value, str) else str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def tables(header: Header, recomputed: Iterable[StoredFact], stored: UntrustedFacts) -> tuple[str | None, str]:
    """Compare every table with the recomputed facts; return the fault or None, and the tables compared."""
    derived = _by_key(recomputed)
    compared, gone = [], []
    for name, rows in (
        ("tests", stored.proposals),
        ("rollouts", stored.rollouts),
        ("discards", stored.discards),
        ("observations", stored.observations),
        ("bounds", stored.bounds),
        ("extensions", stored.extensions),
    ):
        # The evidence alone is enough: a database that was cut down contradicts nothing.
        if not rows:
            if name not in ("discards", "extensions"):  # which few campaigns have
                gone.append(name)
            # Tests beyond the first budget without what allowed them: this is no table that was merely left out.
            if (
                name == "extensions"
                and stored.bounds
                and any(isinstance(each, ExtensionFact) for each in derived.values())
            ):
                return "table extensions: it is empty, the evidence has more tests than the budget", ""
            continue
        compared.append(f"{sum(map(_number, rows)):,} {name}")
        fault = _table(header, name, derived, rows)
        if fault:
            return fault, ""
    left = f"; missing: {', '.join(gone)}" if gone else ""
    return None, f"{', '.join(compared) or 'nothing'}{left}"


def _table(header: Header, name: str, derived: Mapping[object, StoredFact], rows: Sequence[StoredFact]) -> str | None:
    written = _by_key(rows)
    if len(written) != len(rows):
        return f"table {name}: a row is repeated"
    kinds = KINDS[name]
    wanted = {key: fact for key, fact in derived.items() if isinstance(fact, kinds)}
    for key, fact in wanted.items():
        if key not in written:
            return f"table {name}: {_label(fact)} is missing"
        if fact == written[key]:
            continue
        found = difference(_values(fact), _values(written[key]))
        if found:
            return f"table {name}, {_label(fact)}: {found}"
    extra = [fact for key, fact in written.items() if key not in wanted and not _in_flight(header, derived, fact)]
    return f"table {name}: {_label(extra[0])} does not follow from the evidence" if extra else None


KINDS: Mapping[str, tuple[type, ...]] = {
    "tests": (ProposalFact, BlockProposalFact),
    "rollouts": (RolloutFact, BatchFact),
    "discards": (DiscardFact,),
    "observations": (ObservationFact, BlockObservationFact),
    "bounds": (BoundFact,),
    "extensions": (ExtensionFact,),
}
"""The facts of each table."""


def _in_flight(header: Header, derived: Mapping[object, StoredFact], fact: StoredFact) -> bool:
    """Whether this is a rollout of a test that was proposed, and not observed because its problem had stopped."""
    # It was recorded before the stop, and so depends on the workers; the manifest and the rerun do not have it.
    if isinstance(fact, BatchFact):
        seeds = [rollout_seed(header, rollout) for rollout in fact.rollouts]
        return not _observed(derived, fact.rollout) and fact.seeds.tolist() == seeds
    if not isinstance(fact, RolloutFact | DiscardFact):
        return False
    test = f"{fact.rollout.problem}, test {fact.rollout.test}"
    open_test = (ProposalFact, test) in derived and (ObservationFact, test) not in derived
    return open_test and fact.seed == rollout_seed(header, fact.rollout)


def _observed(derived: Mapping[object, StoredFact], rollout: RolloutId) -> bool:
    """Whether the test of a rollout of a batch is observed."""
    if (ObservationFact, f"{rollout.problem}, test {rollout.test}") in derived:
        return True
    blocks = (fact for fact in derived.values() if isinstance(fact, BlockObservationFact))
    return any(each.problem == rollout.problem and each.test <= rollout.test < each.test + len(each) for each in blocks)


def _by_key(facts: Iterable[StoredFact]) -> dict[object, StoredFact]:
    return {(type(fact), _label(fact)): fact for fact in facts}


def _number(fact: StoredFact) -> int:
    """Return for how many tests or rollouts a row stands."""
    match fact:
        case BatchFact(failures=failures):
            return len(fact) - len(failures)
        case BlockProposalFact() | BlockObservationFact():
            return len(fact)
        case _:
            return 1


def _label(fact: StoredFact) -> str:
    match fact:
        case RolloutFact(rollout) | BatchFact(rollout):
            return str(FileId(rollout, places(fact)))
        case DiscardFact(rollout):
            return f"{rollout}, {fact.sha256[:16]}..."
        case ExtensionFact(number):
            return f"extension {number}"
        case _:
            return f"{fact.problem}, test {fact.test}"


def _values(fact: StoredFact) -> dict[str, Any]:
    # Without the chain, which has a check of its own: it depends on the last digits of the proposals.
    match fact:
        case ProposalFact(proposal=chosen):
            return asdict(chosen)
        case ObservationFact(observation=found):
            return asdict(found)
        case BoundFact(bound=bound):
            return {"upper": bound.upper, "lower": bound.lower, "stopped_by": fact.stopped_by}
        case BlockProposalFact():
            return {"nodes": fact.nodes.tolist(), "x": fact.x.tolist()}
        case BlockObservationFact():
            return {"y": fact.y.tolist(), "each": fact.contributions.tolist()}
        case RolloutFact() | BatchFact() | DiscardFact() | ExtensionFact():
            return asdict(fact)


def chain_head(
    header: Header, recomputed: Sequence[StoredFact], recorded: Sequence[ProposalFact | BlockProposalFact]
) -> str:
    """Return the head of the hash chain over the recomputed facts, with the numbers of the recorded proposals."""
    # Their last digits depend on the CPU. Table `tests` is compared with the recomputed ones on its own.
    written = {(fact.problem, fact.test): fact for fact in recorded if isinstance(fact, ProposalFact)}
    proposals = (fact for fact in recomputed if isinstance(fact, ProposalFact))
    chosen = {(fact.problem, fact.test): written.get((fact.problem, fact.test), fact) for fact in proposals}
    rollouts: dict[tuple[str, int], list[RolloutFact]] = {}
    discards: dict[tuple[str, int], list[DiscardFact]] = {}
    blocks = {fact.problem for fact in recomputed if isinstance(fact, BlockProposalFact)}
    for fact in recomputed:
        if isinstance(fact, BatchFact) and fact.rollout.problem not in blocks:
            for each in fact.each():
                rollouts.setdefault((each.rollout.problem, each.rollout.test), []).append(each)
        if isinstance(fact, RolloutFact):
            rollouts.setdefault((fact.rollout.problem, fact.rollout.test), []).append(fact)
        if isinstance(fact, DiscardFact):
            discards.setdefault((fact.rollout.problem, fact.rollout.test), []).append(fact)
    links: dict[str, str] = {problem.name: first_link(header, problem.name) for problem in header.config.problems}
    for fact in recomputed:
        if isinstance(fact, ExtensionFact):
            links |= {each.name: extended_link(links[each.name], fact) for each in header.config.problems}
        if isinstance(fact, BlockObservationFact):
            links[fact.problem] = fact.chain  # its proposals have no digits that depend on the CPU
        if isinstance(fact, ObservationFact):
            test = (fact.problem, fact.test)
            # A check has its first link when its first test comes.
            link = links.setdefault(fact.problem, first_link(header, fact.problem))
            links[fact.problem] = next_link(
                link, chosen[test], rollouts[test], fact.observation, discards.get(test, ())
            )
    return digest(list(links.values()))
