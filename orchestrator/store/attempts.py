"""The part of the journal that depends on chance: attempts and their ends, pauses and comparisons of workers."""

import time
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from ...schemas.failure import Failure
from ...schemas.ids import Attempt, FileId, RolloutId, WorkId, parse_work
from ...schemas.ranges import DIGEST
from ...schemas.result.facts import RECORDED
from . import tables
from .pending import PendingRows
from .rows import attempt_key, outcome_fields, work_name


@dataclass(frozen=True, slots=True)
class StoredOpinion:
    """A result that was compared; without a name of its host if its start was lost in a crash."""

    attempt: Attempt
    worker: str
    host: str
    sha256: str
    each: tuple[bytes, ...] = ()
    """Of a batch the digest of each rollout, empty for one that failed."""


class AttemptLog:
    """Attempts of one session; everything is written inside the transaction of the journal."""

    def __init__(self, rows: PendingRows, session: int) -> None:
        self._rows, self._session = rows, session

    def started(self, attempt: Attempt, worker: str, host: str, pid: int) -> None:
        """Write a new attempt, before it is assigned."""
        row = {"worker": worker, "host": host, "pid": pid, "session": self._session, "started": time.time()}
        self._rows.add(tables.attempts, attempt_key(attempt) | row)

    def ended(self, attempt: Attempt, worker: str, outcome: str | Failure, cpu: float = 0.0, wall: float = 0.0) -> None:
        """Write the outcome of an attempt: RECORDED, RESTORED, HANDED_BACK or a failure.

        A worker that was given up may still deliver its result, or report a failure. A result is written in any case,
        a failure of the infrastructure as the first outcome alone, a failure of the system as the first of its kind.
        """
        if isinstance(outcome, Failure) and self._rows.read(_failures_of(attempt, outcome)):
            return
        row = {"worker": worker, "ended": time.time(), "cpu_seconds": cpu, "wall_seconds": wall}
        self._rows.add(tables.outcomes, attempt_key(attempt) | row | outcome_fields(outcome))

    def set_aside(self, kind: str, name: str, seconds: float, reason: str) -> None:
        """Write the pause of a worker or host, or 0 s for the end of one."""
        row = {"kind": kind, "name": name, "seconds": seconds, "reason": reason}
        self._rows.add(tables.set_aside, {"session": self._session, "at": time.time(), **row})

    def opinion(self, kind: str, attempt: Attempt, worker: str, sha256: str, each: Iterable[bytes] = ()) -> None:
        """Write the digest of a result that is compared, outvoted or reviewed; `each` as in `StoredOpinion`."""
        digests = b"".join(digest or bytes(DIGEST) for digest in each) or None
        row = {"kind": kind, "worker": worker, "sha256": sha256, "at": time.time(), "digests": digests}
        self._rows.add(tables.opinions, attempt_key(attempt) | row)

    def outvoted(self) -> list[str]:
        """Return the workers that were outvoted, in this session or an earlier one."""
        seen = tables.opinions.c
        query = sa.select(seen.worker).where(seen.kind == "outvoted").group_by(seen.worker)
        return [str(row[0]) for row in self._rows.read(query.order_by(sa.func.min(seen.entry)))]

    def suspects(self) -> list[WorkId]:
        """Return what an outvoted worker recorded and nobody else has confirmed or reviewed, by rollout or batch."""
        outvoted = set(self.outvoted())
        if not outvoted:
            return []
        rollouts, ended, seen = tables.rollouts.c, tables.outcomes.c, tables.opinions.c
        rows: Sequence[Any] = self._rows.read(sa.select(rollouts.path, rollouts.sha256))
        recorded = {work_name(path): sha256 for path, sha256 in rows}
        opinions = self._rows.read(sa.select(seen.kind, seen.rollout, seen.sha256).where(seen.worker.not_in(outvoted)))
        # A worker that was alone has agreed with itself, which says nothing for it; so does another's that differs.
        settled = {
            each.rollout for each in opinions if each.kind == "reviewed" or each.sha256 == recorded.get(each.rollout)
        }
        query = sa.select(ended.rollout).distinct().where(ended.outcome == RECORDED, ended.worker.in_(outvoted))
        found = [row[0] for row in self._rows.read(query)]
        # A discarded rollout has an attempt, and no row.
        return [parse_work(each) for each in found if each in recorded and each not in settled]

    def disputed(self) -> list[WorkId]:
        """Return the rollouts and batches on which workers differ of which none has been outvoted."""
        outvoted, seen, ended = set(self.outvoted()), tables.opinions.c, tables.outcomes.c
        # Two that agree on a batch may differ in the rollouts that failed in it, and need no further decision.
        reviewed = self._rows.read(sa.select(seen.rollout).where(seen.kind == "reviewed"))
        recorded = self._rows.read(sa.select(ended.rollout).where(ended.outcome == RECORDED))
        decided = {name for (name,) in (*reviewed, *recorded)}
        digests: dict[WorkId, set[str]] = {}
        for each in self.compared():
            of_batch = isinstance(each.attempt.rollout, FileId)
            if each.worker not in outvoted and not (of_batch and str(each.attempt.rollout) in decided):
                digests.setdefault(each.attempt.rollout, set()).add(each.sha256)
        return sorted((work for work, found in digests.items() if len(found) > 1), key=str)

    def compared(self, rollouts: Container[WorkId] | None = None) -> list[StoredOpinion]:
        """Return the results that were compared, of all rollouts or of these, in their order.

        Without those that were failures of the system, and without discarded rollouts, whose results fail today.
        """
        seen, began, ended, gone = tables.opinions.c, tables.attempts.c, tables.outcomes.c, tables.discards.c
        started = tables.opinions.outerjoin(
            tables.attempts, (seen.rollout == began.rollout) & (seen.attempt == began.attempt)
        )
        columns = (seen.rollout, seen.attempt, seen.worker, began.host, seen.sha256, seen.digests)
        query = sa.select(*columns).select_from(started)
        failed: Sequence[Any] = self._rows.read(sa.select(ended.rollout, ended.attempt).where(ended.kind == "system"))
        excluded = {(name, number) for name, number in failed}
        discarded: Sequence[Any] = self._rows.read(sa.select(gone.problem, gone.test, gone.variant, gone.replicate))
        without = {str(RolloutId(*row)) for row in discarded}
        found: list[StoredOpinion] = []
        rows: Sequence[Any] = self._rows.read(query.where(seen.kind == "compared").order_by(seen.entry))
        for name, number, worker, host, sha256, digests in rows:
            if name in without or (name, number) in excluded:
                continue
            rollout = parse_work(name)
            if rollouts is None or rollout in rollouts:
                found.append(StoredOpinion(Attempt(rollout, number), worker, host or "", sha256, _each(digests or b"")))
        return found

    def worker_of(self, rollout: WorkId) -> str | None:
        """Return the worker whose result was recorded, after a discard the last one; also outside a transaction."""
        ended = tables.outcomes.c
        query = sa.select(ended.worker).where(ended.rollout == str(rollout), ended.outcome == RECORDED)
        rows = self._rows.read(query.order_by(ended.attempt.desc()).limit(1))
        return str(rows[0][0]) if rows else None


def _each(digests: bytes) -> tuple[bytes, ...]:
    each = (digests[first : first + DIGEST] for first in range(0, len(digests), DIGEST))
    return tuple(digest if any(digest) else b"" for digest in each)


def _failures_of(attempt: Attempt, failure: Failure) -> sa.Select[Any]:
    """Return the query of the outcomes of an attempt to which a failure adds nothing."""
    columns = tables.outcomes.c
    this = (columns.rollout == str(attempt.rollout)) & (columns.attempt == attempt.number)
    if failure.kind == "system":
        this &= columns.kind == "system"
    return sa.select(columns.attempt).where(this)
