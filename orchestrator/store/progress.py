"""Progress of a campaign from its database, by a few aggregates.

The queries go to the SQLite driver directly: loading SQLAlchemy takes longer than everything else that `perfbound
status` does.
"""

import json
import math
import sqlite3
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

from ...schemas.errors import one_line
from ...schemas.result.facts import HANDED_BACK, NO_FAILURE, RECORDED, Header
from ...schemas.values import MARKED, Bound, ProblemProgress, distance_after
from .readonly import snapshot
from .rows import bound_fact, check_version, checked_header, extension_fact

RECENT = 1000
MINUTE = 60.0
"""The rate is that of at least the last minute of work, or of its last `RECENT` rollouts."""

_VERSION = "SELECT version FROM schema"
_HEADER = "SELECT run, name, seed, config, config_sha256, system, software, rules FROM campaign LIMIT 2"
_ROLLOUTS = "SELECT problem, sum(rollouts) FROM rollouts GROUP BY problem"
_LAST_BOUNDS = """
    SELECT bounds.seq, problem, test, block, upper, lower, stopped_by, F
    FROM bounds LEFT JOIN tests USING (problem, test)
    WHERE bounds.seq IN (SELECT max(seq) FROM bounds GROUP BY problem)
"""
_COURSE = """
    SELECT test + 1, upper, lower, F FROM bounds JOIN tests USING (problem, test) WHERE problem = ?
    AND upper IS NOT NULL AND test IN (SELECT value FROM json_each(?)) ORDER BY test
"""
_COURSE_OF_BLOCKS = """
    SELECT block, test + 1, upper, lower, F FROM bounds LEFT JOIN tests USING (problem, test)
    WHERE problem = ? AND upper IS NOT NULL ORDER BY test
"""
_BATCH = "SELECT total(rollouts) / count(*) FROM rollouts"
_MARKED = json.dumps([tests - 1 for tests in sorted(MARKED)])
_EXTENSIONS = "SELECT seq, number, budgets FROM extensions ORDER BY seq"
_WORKERS = "SELECT worker, count(*), max(ended) FROM outcomes WHERE outcome = ? GROUP BY worker ORDER BY worker"
ROLLOUTS_OF_WORKERS = """
    SELECT worker, sum(rollouts) FROM (
        SELECT worker, rollouts, max(attempt)
        FROM rollouts CROSS JOIN outcomes WHERE seq > :since AND outcome = :recorded
        AND rollout = problem || '.' || test || '.' || variant || '.' || replicate
            || CASE WHEN seeds IS NULL THEN '' ELSE '.' || places END
        GROUP BY seq
    ) GROUP BY worker
"""
"""The rollouts that each worker has recorded, in rows after a sequence number.

Attempts at a batch have the name of its file. What was recorded again after a discard is of the last one. The worker
beside max(...) is that of its row: an extension of SQLite.
"""
_FAILURES = "SELECT count(*) FROM outcomes WHERE outcome NOT IN (?, ?, ?)"
_HANDED_BACK = "SELECT count(*) FROM outcomes WHERE outcome = ?"
_SYSTEM_FAILURES = "SELECT count(*) FROM outcomes WHERE kind = 'system'"
_FAILED_IN_BATCHES = "SELECT coalesce(sum(places - rollouts), 0) FROM rollouts"
_RECENT = "SELECT ended FROM outcomes WHERE outcome = ? ORDER BY rowid DESC LIMIT ?"
_SET_ASIDE = """
    SELECT kind, name, sum(seconds > 0), max(at), seconds, session = (SELECT max(session) FROM sessions) FROM set_aside
    GROUP BY kind, name ORDER BY kind, name
"""
_REASON = "SELECT reason FROM set_aside WHERE kind = ? AND name = ? AND seconds > 0 ORDER BY entry DESC LIMIT 1"
_OPINIONS = "SELECT kind, count(*) FROM opinions GROUP BY kind ORDER BY kind"
_SESSIONS = "SELECT started FROM sessions ORDER BY session"
_LAST_SESSION = "SELECT host, pid FROM sessions ORDER BY session DESC LIMIT 1"
_OPTIONS = "SELECT options FROM sessions WHERE options IS NOT NULL ORDER BY session DESC LIMIT 1"


@dataclass(frozen=True, slots=True)
class Pauses:
    """The pauses of a worker or host that was set aside."""

    kind: str
    name: str
    count: int
    until: float
    """Unix time of the end of the last one, if the session that began it still runs; those for good have none."""
    reason: str


@dataclass(frozen=True, slots=True)
class CampaignProgress:
    """The state of a campaign, from its database alone."""

    header: Header
    problems: tuple[ProblemProgress, ...]
    """In the order of the campaign file."""
    workers: tuple[tuple[str, int, float], ...]
    """(worker, rollouts recorded, Unix time of the last one)."""
    failures: int
    """Attempts without a result; a rollout that failed in its batch is one of its own."""
    system_failures: int
    """Failures of the system among them."""
    handed_back: int
    """Attempts that workers gave back because they were stopped; none of them is a failure."""
    sessions: int
    began: float
    """Unix time of the start of the last session; 0 without one."""
    pauses: tuple[Pauses, ...]
    opinions: dict[str, int]
    """Results that were compared, outvoted and reviewed, by these words."""
    rate: float
    """Rollouts per second over the last minute of work, or over its last thousand rollouts."""


def read_progress(directory: Path) -> CampaignProgress:
    """Return the progress of the campaign in `directory`.

    Raises:
        JournalError: there is none, or it is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        return _campaign_progress(connection, directory)


def header_alone(directory: Path) -> Header:
    """Return the first fact of the campaign in `directory`, as `read.stored_header` does.

    Raises:
        JournalError: there is none, or it is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        return header_in(connection, directory)


def last_session(directory: Path) -> tuple[str | None, int | None]:
    """Return host and process id of the last orchestrator of the campaign in `directory`; both None if there is none.

    Raises:
        JournalError: there is no campaign, or its database is damaged.

    """
    with snapshot(directory) as connection:
        found = connection.execute(_LAST_SESSION).fetchone()
    return (None, None) if found is None else (one_line(str(found[0])), int(found[1]))


def session_options(directory: Path) -> str | None:
    """Return the options, as JSON, with which the last session that had workers continues; None if none is known.

    Raises:
        JournalError: there is no campaign, or its database is damaged.
        OSError: the disk is full or fails.

    """
    with snapshot(directory) as connection:
        header_in(connection, directory)
        found = connection.execute(_OPTIONS).fetchone()
    return None if found is None else str(found[0])


def header_in(connection: sqlite3.Connection, directory: Path) -> Header:
    """Return the first fact, of a database of this schema version."""
    version = connection.execute(_VERSION).fetchone()
    check_version(directory, version and version[0])
    return checked_header(directory, _named(connection.execute(_HEADER)))


def _campaign_progress(connection: sqlite3.Connection, directory: Path) -> CampaignProgress:
    header = header_in(connection, directory)
    started = [float(row[0]) for row in connection.execute(_SESSIONS)]
    rollouts = {str(row[0]): int(row[1]) for row in connection.execute(_ROLLOUTS)}
    extended = _last_extensions(connection)
    last = {str(row.problem): row for row in _named(connection.execute(_LAST_BOUNDS))}
    # Without batches no rollout is among others, and a million of them take long to look up.
    in_batches = 0 if header.config.batch == 1 else int(connection.execute(_FAILED_IN_BATCHES).fetchone()[0])
    return CampaignProgress(
        header,
        tuple(
            replace(
                _problem_progress(last.get(each.name), rollouts.get(each.name, 0), extended.get(each.name)),
                course=_course(connection, each.name, blocks=header.config.batch > 1),
            )
            for each in header.config.problems
        ),
        _workers(connection, blocks=header.config.batch > 1),
        int(connection.execute(_FAILURES, NO_FAILURE).fetchone()[0]) + in_batches,
        int(connection.execute(_SYSTEM_FAILURES).fetchone()[0]) + in_batches,
        int(connection.execute(_HANDED_BACK, [HANDED_BACK]).fetchone()[0]),
        len(started),
        max(started, default=0.0),
        _pauses(connection),
        dict(connection.execute(_OPINIONS).fetchall()),
        rate([row[0] for row in connection.execute(_RECENT, [RECORDED, RECENT])], started) * _batch(connection, header),
    )


def _workers(connection: sqlite3.Connection, *, blocks: bool) -> tuple[tuple[str, int, float], ...]:
    # Without batches a result is a rollout, and there may be a million of them to look up.
    query, keys = ROLLOUTS_OF_WORKERS, {"since": 0, "recorded": RECORDED}
    in_batches = dict(connection.execute(query, keys).fetchall()) if blocks else None
    return tuple(
        (str(worker), int(results if in_batches is None else in_batches.get(worker, 0)), float(last))
        for worker, results, last in connection.execute(_WORKERS, [RECORDED])
    )


def _batch(connection: sqlite3.Connection, header: Header) -> float:
    """Return the rollouts of a result."""
    return 1.0 if header.config.batch == 1 else float(connection.execute(_BATCH).fetchone()[0] or 1.0)


def _course(
    connection: sqlite3.Connection, problem: str, *, blocks: bool
) -> tuple[tuple[int, float, float | None], ...]:
    if blocks:  # a block is marked where one of its tests is
        every = connection.execute(_COURSE_OF_BLOCKS, [problem])
        rows = [row for first, *row in every if not MARKED.isdisjoint(range(first + 1, row[0] + 1))]
    else:
        rows = connection.execute(_COURSE, [problem, _MARKED]).fetchall()
    return tuple((tests, upper, distance_after(Bound(upper, lower, None), f)) for tests, upper, lower, f in rows)


def _last_extensions(connection: sqlite3.Connection) -> dict[str, tuple[int, int]]:
    """Return the sequence number of the last extension of each problem that has one, and its budget since."""
    found: dict[str, tuple[int, int]] = {}
    for row in _named(connection.execute(_EXTENSIONS)):
        found |= {problem: (int(row.seq), tests) for problem, tests in extension_fact(row).budgets}
    return found


def _problem_progress(last: SimpleNamespace | None, rollouts: int, extended: tuple[int, int] | None) -> ProblemProgress:
    if last is None:  # no test is observed yet
        return ProblemProgress(0, rollouts, None, None, None)
    fact = bound_fact(last)
    seq, budget = extended or (0, None)
    # A bound from before the extension ended the problem then, and does no longer.
    stopped_by = fact.stopped_by if last.seq > seq else None
    return ProblemProgress(fact.test + 1, rollouts, last.F, fact.bound, stopped_by, budget)


def _pauses(connection: sqlite3.Connection) -> tuple[Pauses, ...]:
    found = []
    # `seconds` beside max(at) is that of the same row: an extension of SQLite.
    for kind, name, count, at, seconds, current in connection.execute(_SET_ASIDE).fetchall():
        (reason,) = connection.execute(_REASON, [kind, name]).fetchone()
        found.append(Pauses(kind, name, int(count), at + seconds if current or seconds == math.inf else at, reason))
    return tuple(found)


def _named(cursor: sqlite3.Cursor) -> list[SimpleNamespace]:
    names = [column[0] for column in cursor.description]
    return [SimpleNamespace(**dict(zip(names, row, strict=True))) for row in cursor]


def rate(ended: Sequence[float], started: Iterable[float] = ()) -> float:
    """Return rollouts per second over the last minute of work, from the Unix times of the latest results.

    The time from the last result before one of the sessions that `started` to its start is no work.

    >>> rate([0.0, 2.0, 4.0], [-2.0]), rate([0.0, 2.0, 4.0, 900.0], [-2.0, 898.0])
    (0.5, 0.5)
    """
    if not ended:
        return 0.0
    times, begins = sorted(ended), sorted(started)
    if len(times) < RECENT:  # all there are: the work began with the session of the first one
        times = [*begins[: bisect_right(begins, times[0])][-1:], *times]
    # Backwards from the newest, not from now: a stopped campaign shows the rate of its last minute of work. By whole
    # gaps: two results that come together, after a resume or a lost link, must not count as a rate of hundreds.
    seconds, rollouts = 0.0, 0
    for before, after in reversed(list(pairwise(times))):
        if seconds >= MINUTE:
            break
        session = begins[: bisect_right(begins, after)][-1:]
        seconds, rollouts = seconds + after - max([before, *session]), rollouts + 1
    return rollouts / seconds if seconds > 0 else 0.0
