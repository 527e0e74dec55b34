"""A recorded rollout: its fact, its file, and the request that it answers."""

from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy import Connection

from ....schemas.errors import EvidenceError, PerfboundError, TrajectoryError
from ....schemas.facts import Header, ProposalFact, RolloutFact
from ....schemas.ids import RolloutId
from ....schemas.rollout import RolloutRequest
from ....schemas.trajectory import File, Trajectory, read
from ...campaign.seeds import rollout_seed
from ...store import files, tables
from ...store.read import read_header, reading
from ...store.rows import READERS
from ..rollouts import inside


@dataclass(frozen=True, slots=True)
class RecordedRollout:
    """One rollout of a campaign; `trajectory` is None where its file is damaged, and `damage` says how."""

    header: Header
    fact: RolloutFact
    request: RolloutRequest
    trajectory: Trajectory | None
    damage: str = ""


def load_recorded(directory: Path, text: str) -> RecordedRollout:
    """Return the rollout `text`, e.g. `sim_gap.3.true.0`, of the campaign in `directory`.

    Raises:
        JournalError: there is no campaign, or it cannot be read.
        PerfboundError: it has no such rollout.
        EvidenceError: the file is whole, and answers another request than the one that follows from the facts.

    """
    with reading(directory) as connection:
        header = read_header(connection, directory)
        fact, proposal = _find(connection, header, directory, text)
    wanted = header.template.request(fact.rollout, proposal.proposal.x, rollout_seed(header.config, fact.rollout))
    try:
        file = _read(directory, fact)
    except EvidenceError as error:
        return RecordedRollout(header, fact, wanted, None, str(error))
    if file.request != wanted.model_dump(mode="json"):
        raise EvidenceError(
            f"{directory / fact.path}: it answers another request than the one that follows from the facts; "
            "check the campaign with `perfbound verify`"
        )
    return RecordedRollout(header, fact, wanted, file.trajectory)


def _find(connection: Connection, header: Header, directory: Path, text: str) -> tuple[RolloutFact, ProposalFact]:
    try:
        rollout = RolloutId.parse(text.replace("-", "."))
    except ValueError:
        raise PerfboundError(
            f"{text!r} names no rollout; a name is problem.test.variant.replicate, e.g. "
            f"{_example(connection) or 'sim_gap.0.true.0'}"
        ) from None
    columns = tables.rollouts.c
    this = (columns.problem == rollout.problem) & (columns.test == rollout.test)
    facts = [READERS[tables.rollouts.name](row) for row in connection.execute(sa.select(tables.rollouts).where(this))]
    found = {fact.rollout: fact for fact in facts if isinstance(fact, RolloutFact)}
    if rollout not in found:
        there = _there(connection, header, rollout, [str(each) for each in sorted(found)])
        raise PerfboundError(f"{directory}: no rollout {rollout} is recorded; {there}")
    where = (tables.tests.c.problem == rollout.problem) & (tables.tests.c.test == rollout.test)
    proposal = READERS[tables.tests.name](connection.execute(sa.select(tables.tests).where(where)).one())
    assert isinstance(proposal, ProposalFact)
    return found[rollout], proposal


def _example(connection: Connection) -> str | None:
    row = connection.execute(sa.select(tables.rollouts).order_by(tables.rollouts.c.seq).limit(1)).first()
    return None if row is None else f"{row.problem}.{row.test}.{row.variant}.{row.replicate}"


def _there(connection: Connection, header: Header, rollout: RolloutId, of_test: list[str]) -> str:
    """Say what there is instead."""
    if of_test:
        return f"of its test there are {', '.join(of_test[:4])}{', ...' if len(of_test) > 4 else ''}"
    columns = tables.rollouts.c
    query = sa.select(sa.func.max(columns.test)).where(columns.problem == rollout.problem)
    last = connection.execute(query).scalar()
    if last is not None:
        return f"{rollout.problem} has the tests 0 to {last}"
    return f"the problems are {', '.join(problem.name for problem in header.config.problems)}"


def _read(directory: Path, fact: RolloutFact) -> File:
    if not inside(fact.path):
        raise EvidenceError(f"{directory}: {fact.path!r} is not a path in the run directory")
    try:
        return read(files.read(directory, fact.path, fact.sha256))
    except TrajectoryError as error:
        raise EvidenceError(f"{directory / fact.path}: {error}") from None
