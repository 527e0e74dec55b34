"""The facts in a campaign database: as rows of their tables, and read back, those of blocks among them."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa
from sqlalchemy import Connection

from ...schemas.base import canonical_json
from ...schemas.ids import RolloutId, series_order
from ...schemas.result.block_facts import BatchFact, BlockObservationFact, BlockProposalFact, StoredFact, each_fact
from ...schemas.result.facts import (
    BoundFact,
    DiscardFact,
    ExtensionFact,
    Fact,
    ObservationFact,
    ProposalFact,
    RolloutFact,
)
from ...schemas.values import Bound, Observation, Proposal, StoppedBy
from . import tables
from .read import read_header, reading
from .rows import bound_fact, extension_fact

# From rows to facts; a row has the columns of its table as attributes.


def proposal_fact(row: Any) -> ProposalFact | BlockProposalFact:
    """Read a row of `tests`."""
    if row.nodes is not None:
        return BlockProposalFact(row.problem, row.test, row.nodes, row.starts)
    x = tuple(json.loads(row.x))
    return ProposalFact(row.problem, row.test, Proposal(row.node, x, row.mu, row.sigma, row.beta, row.F))


def rollout_fact(row: Any) -> RolloutFact | BatchFact:
    """Read a row of `rollouts`.

    Raises:
        ValueError: its counts are not those of its rollouts.

    """
    fact = _rollout_fact(row)
    # `status` and the verdict add these up, without what they are about.
    if any(getattr(row, name) != value for name, value in _sums(fact).items()):
        raise ValueError(f"the counts of rollout {fact.rollout} are not those of its values")
    return fact


def _rollout_fact(row: Any) -> RolloutFact | BatchFact:
    rollout = RolloutId(row.problem, row.test, row.variant, row.replicate)
    file = (row.sha256, row.size, row.path)
    if row.seeds is not None:
        failures = tuple((int(place), str(reason)) for place, reason in json.loads(row.failures))
        optional = (row.robustness_of, row.by_tolerance_of, row.ended_of, row.kept_of)
        robustness, tolerance, ended, kept = (each or b"" for each in optional)
        columns = (row.seeds, row.digests, robustness, tolerance, ended, kept)
        return BatchFact(rollout, row.block, row.replicates, *file, *columns, failures)
    marks = (bool(row.by_tolerance), row.ended)
    return RolloutFact(rollout, row.seed, *file, row.robustness, *marks, parts=_parts(row))


def each_rollout_fact(row: Any) -> RolloutFact:
    """Read a row of the view `each_rollout`."""
    rollout = RolloutId(row.problem, row.test, row.variant, row.replicate)
    file = (row.sha256, row.size, row.path)
    marks = (bool(row.by_tolerance), row.ended, row.batch, bool(row.kept))
    return RolloutFact(rollout, row.seed, *file, row.robustness, *marks, parts=_parts(row))


def _parts(row: Any) -> tuple[float, ...]:
    return () if row.parts is None else tuple(map(float, json.loads(row.parts)))


def discard_fact(row: Any) -> DiscardFact:
    """Read a row of `discards`."""
    rollout = RolloutId(row.problem, row.test, row.variant, row.replicate)
    return DiscardFact(rollout, row.seed, row.sha256, row.size, row.path, row.reason)


def observation_fact(row: Any) -> ObservationFact | BlockObservationFact:
    """Read a row of `observations`."""
    if row.y_of is not None:
        return BlockObservationFact(row.problem, row.test, row.y_of, row.each_of, row.chain)
    found = Observation(row.y, tuple(json.loads(row.each)))
    return ObservationFact(row.problem, row.test, found, row.chain)


READERS: dict[str, Callable[[Any], StoredFact]] = {
    "tests": proposal_fact,
    "rollouts": rollout_fact,
    "discards": discard_fact,
    "observations": observation_fact,
    "bounds": bound_fact,
    "extensions": extension_fact,
}
"""By the name of the table."""


# From facts to rows


def fact_row(fact: StoredFact) -> tuple[str, dict[str, Any]]:
    """Return the table of a fact, and its row without the sequence number.

    Raises:
        ValueError: a number is not finite.

    """
    match fact:
        case ProposalFact(problem, test, chosen):
            row = {"problem": problem, "test": test, **_fields(chosen), "x": canonical_json(list(chosen.x))}
            row |= {"tests": 1, "nodes": None, "starts": None}
            table = "tests"
        case BlockProposalFact(problem, test):
            row = {"problem": problem, "test": test, "node": int(fact.nodes[0]), **dict.fromkeys(_CHOSEN)}
            row |= {"x": canonical_json(fact.x[0].tolist()), "tests": len(fact)}
            row |= {"nodes": fact.node_column, "starts": fact.x_column}
            table = "tests"
        case RolloutFact(rollout):
            row = rollout._asdict() | {name: getattr(fact, name) for name in _OF_ROLLOUT}
            row |= {"block": rollout.test, "replicates": 1, "places": 1, **_sums(fact), **dict.fromkeys(_OF_BATCH)}
            row["parts"] = canonical_json(list(fact.parts)) if fact.parts else None
            table = "rollouts"
        case BatchFact():
            row, table = _batch_row(fact), "rollouts"
        case DiscardFact():
            raise TypeError("a discard moves a row of `rollouts`: see store.discard")
        case ObservationFact(problem, test, found, chain):
            row = {"problem": problem, "test": test, "y": found.y, "each": canonical_json(list(found.each))}
            row |= {"chain": chain, "tests": 1, "y_of": None, "each_of": None}
            table = "observations"
        case BlockObservationFact(problem, test):
            if not (np.isfinite(fact.y).all() and np.isfinite(fact.contributions).all()):
                raise ValueError(f"an observation of test {test} or one after it is not finite")
            row = {"problem": problem, "test": test, "y": float(fact.y.max()), "each": "[]", "chain": fact.chain}
            row |= {"tests": len(fact), "y_of": fact.y_column, "each_of": fact.each_column}
            table = "observations"
        case BoundFact(problem, test, bound):
            row = {"problem": problem, "test": test, "upper": bound.upper, "lower": bound.lower}
            row |= {"stopped_by": fact.stopped_by, "block": test + 1 - fact.tests}
            table = "bounds"
        case ExtensionFact(number, budgets):
            row = {"number": number, "budgets": canonical_json([list(each) for each in budgets])}
            table = "extensions"
    # SQLite stores NaN as NULL without an error; this raises, for every kind of fact.
    canonical_json({name: value for name, value in row.items() if not isinstance(value, bytes)})
    return table, row


_CHOSEN = ("mu", "sigma", "beta", "F")
_OF_ROLLOUT = ("seed", "sha256", "size", "path", "by_tolerance", "ended")
_OF_BATCH = ("seeds", "digests", "robustness_of", "by_tolerance_of", "ended_of", "kept_of", "failures")


def _sums(fact: RolloutFact | BatchFact) -> dict[str, Any]:
    """Return the columns of what the rollouts of a file are together: their number, violations, least robustness."""
    if isinstance(fact, RolloutFact):
        return {"rollouts": 1, "violations": int(fact.violates), "robustness": fact.robustness}
    rollouts = len(fact) - len(fact.failures)
    if fact.robustness is None:
        return {"rollouts": rollouts, "violations": 0, "robustness": None}
    values = fact.robustness[fact.succeeded]
    return {"rollouts": rollouts, "violations": int((values < 0).sum()), "robustness": float(values.min())}


def _batch_row(fact: BatchFact) -> dict[str, Any]:
    return fact.rollout._asdict() | {
        "seed": int(fact.seeds[0]),
        "sha256": fact.sha256,
        "size": fact.size,
        "path": fact.path,
        "by_tolerance": int(fact.by_tolerance.any()),
        "ended": None,
        "parts": None,
        "block": fact.block,
        "replicates": fact.replicates,
        "places": len(fact),
        **_sums(fact),
        "seeds": fact.seed_column,
        "digests": fact.digest_column,
        "robustness_of": fact.robustness_column or None,
        "by_tolerance_of": fact.tolerance_column or None,
        "ended_of": fact.ended_column or None,
        "kept_of": fact.kept_column or None,
        "failures": canonical_json([list(each) for each in fact.failures]),
    }


def _fields(value: Proposal) -> dict[str, Any]:
    return {name: getattr(value, name) for name in value.__slots__}


# Reading


@dataclass(frozen=True, slots=True)
class ObservedTest:
    """The facts of one observed test, joined; all in terms of the maximised objective J."""

    test: int
    proposal: Proposal
    observation: Observation
    bound: Bound
    stopped_by: StoppedBy | None

    @classmethod
    def of(cls, proposal: ProposalFact, observation: ObservationFact, bound: BoundFact) -> "ObservedTest":
        """Join the facts of a test with the next bound: that after it, or after the last test of its block."""
        stopped_by = bound.stopped_by if bound.test == observation.test else None
        return cls(observation.test, proposal.proposal, observation.observation, bound.bound, stopped_by)


def read_facts(connection: Connection) -> Iterator[Fact]:
    """Yield all facts after the header in the order in which they were written, those of a block one by one."""
    return each_fact(stored_facts(connection))


def stored_facts(connection: Connection) -> Iterator[StoredFact]:
    """Yield all facts after the header as they were written."""
    rows = [
        (row.seq, make(row))
        for table, make in READERS.items()
        for row in connection.execute(sa.select(tables.metadata.tables[table]))
    ]
    rows.sort(key=lambda pair: pair[0])  # the order of the decisions: a replay takes the same way as the run
    for _, fact in rows:
        yield fact


def observed_rollouts(directory: Path) -> list[RolloutFact]:
    """Return every rollout behind an observation, by series, test and id.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    rollouts, seen = tables.each_rollout.c, tables.each_observation.c
    joined = tables.each_rollout.join(
        tables.each_observation, (rollouts.problem == seen.problem) & (rollouts.test == seen.test)
    )
    with reading(directory) as connection:
        order = [problem.name for problem in read_header(connection, directory).config.problems]
        rows = connection.execute(sa.select(tables.each_rollout).select_from(joined)).all()
    found = map(each_rollout_fact, rows)
    return sorted(found, key=lambda fact: (*series_order(order, fact.rollout.problem), *fact.rollout[1:]))


def history(directory: Path) -> dict[str, tuple[ObservedTest, ...]]:
    """Return the observed tests of every problem, in their order.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.

    """
    with reading(directory) as connection:
        header = read_header(connection, directory)
        return {problem.name: _observed(connection, problem.name) for problem in header.config.problems}


def _observed(connection: Connection, name: str) -> tuple[ObservedTest, ...]:
    by_test: list[dict[int, Any]] = []
    for table in (tables.tests, tables.observations, tables.bounds):
        rows = connection.execute(sa.select(table).where(table.c.problem == name).order_by(table.c.test))
        facts: Iterator[Any] = each_fact(map(READERS[table.name], rows))
        by_test.append({fact.test: fact for fact in facts})
    tests, seen, bounds = by_test
    firsts = [0, *(test + 1 for test in bounds)]
    return tuple(
        ObservedTest.of(tests[test], seen[test], bounds[last])
        for first, last in zip(firsts, bounds, strict=False)
        for test in range(first, last + 1)
    )
