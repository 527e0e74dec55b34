"""Limits of growth: the memory of a long campaign, and the rows that a turn writes."""

import gc
import inspect
import pathlib
import shutil
import sqlite3
import sys
import tracemalloc
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.fleet.dispatch import events, machine
from perfbound.orchestrator.fleet.dispatch.events import HandOut, Reported, Start, Wanted, WorkerUp
from perfbound.orchestrator.fleet.dispatch.limits import Limits
from perfbound.orchestrator.fleet.dispatch.state import DispatchState
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.changes import ChangeReader
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.progress import read_progress
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.ids import RolloutId, first_of
from tests.campaigns import cheap
from tests.fakes.invariants import check_invariants
from tests.fakes.puppets import Stage

SIZES = {"first": 48, "short": 96, "long": 768}
"""Rollouts; the first campaign pays for what is made once."""
BEATS = 10
KEPT = 300 if sys.version_info[:2] == (3, 12) else 200
"""Bytes that a rollout may leave; pathlib of Python 3.12 keeps every name of a file."""


@pytest.fixture
def no_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have nothing wait for the disk; what is durable is not the question here."""
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


@pytest.mark.rest
@pytest.mark.usefixtures("no_disk")
def test_a_long_campaign_keeps_numbers_and_no_messages(tmp_path: Path) -> None:
    """8,000 heartbeats leave nothing; a rollout leaves less than its digest and path would take."""
    tracemalloc.start()
    try:
        _, short, long = (kept(tmp_path / name, size) for name, size in SIZES.items())
    finally:
        tracemalloc.stop()
    grown = (long - short) / (SIZES["long"] - SIZES["short"])
    assert grown < KEPT, grown


def kept(directory: Path, rollouts: int) -> int:
    """Return the bytes that a campaign holds at its end, when no message waits any longer."""
    before = traced()
    stage = Stage(directory, cheap(rollouts), 16, beats=BEATS)
    stage.play()
    assert stage.ledger.done
    assert stage.puppets.beaten >= BEATS * rollouts
    held = traced() - before
    stage.journal.close()
    return held


def traced() -> int:
    """Return the bytes in use, without Python's one table of names, which doubles at a moment of its own."""
    gc.collect()
    source = str(inspect.getsourcefile(pathlib.PurePath))
    lines = enumerate(Path(source).read_text().splitlines(), start=1)
    tables = [tracemalloc.Filter(False, source, number) for number, line in lines if "sys.intern(" in line]
    found = tracemalloc.take_snapshot().filter_traces(tables)
    return sum(trace.size for trace in found.traces)


@pytest.mark.rest
@pytest.mark.usefixtures("no_disk")
def test_what_is_open_is_all_that_the_orchestrator_holds(tmp_path: Path) -> None:
    stage = Stage(tmp_path, cheap(400), 16)
    stage.play()
    (account,), ledger = stage.ledger.accounts.values(), stage.ledger
    assert len(account.robustness) == 400
    held = (account.proposals, account.rollouts, ledger.recorded._kept, ledger._requests)
    assert [len(each) for each in held] == [0, 0, 0, 0]
    stage.journal.close()


@pytest.mark.rest
@pytest.mark.usefixtures("no_disk")
@pytest.mark.parametrize("waiting", [1, 8, 64])
def test_what_waits_together_is_committed_together(tmp_path: Path, waiting: int) -> None:
    stage, commits = Stage(tmp_path, cheap(256), waiting), list[object]()
    sa.event.listen(stage.journal._engine, "commit", commits.append)
    stage.play()
    assert len(commits) <= 256 / waiting + 6  # the start, the first assignments, the end in smaller turns
    stage.journal.close()


@pytest.mark.usefixtures("no_disk")
def test_a_turn_is_one_statement_a_table(tmp_path: Path) -> None:
    stage, statements = Stage(tmp_path, cheap(128), 64), list[str]()

    def note(_c: Any, _cursor: Any, statement: str, *_: Any) -> None:
        statements.append(statement.split("(", maxsplit=1)[0])

    sa.event.listen(stage.journal._engine, "before_cursor_execute", note)
    stage.play()
    assert sum("INTO rollouts" in statement for statement in statements) <= 4, "128 rollouts, two full turns"
    stage.journal.close()


@pytest.mark.rest
@pytest.mark.usefixtures("no_disk")
def test_readers_in_between_see_whole_turns_and_stop_nothing(tmp_path: Path) -> None:
    """A reader holds the database open in the middle of a refresh while the writer continues to the end."""
    stage, seen, watch = Stage(tmp_path, cheap(256), 8), list[int](), ChangeReader(tmp_path)

    def look() -> bool:
        added = sum(watch.read().rollouts.values())
        seen.append(seen[-1] + added if seen else added)
        there = sum(problem.rollouts for problem in read_progress(tmp_path).problems)
        assert seen[-1] == there, "what was added up is what is there"
        return False

    with read.reading(tmp_path) as held:
        before = held.execute(sa.text("SELECT COUNT(*) FROM rollouts")).scalar()
        stage.play(look)
        assert held.execute(sa.text("SELECT COUNT(*) FROM rollouts")).scalar() == before == 0
    assert stage.ledger.done
    assert seen == sorted(seen)
    assert seen[-1] == 256
    stage.journal.close()


@pytest.mark.usefixtures("no_disk")
def test_whoever_reads_at_the_end_leaves_nothing_outside_the_database(tmp_path: Path) -> None:
    """A copy of campaign.db alone has every fact, although a connection of another process outlives the writer's."""
    stage = Stage(tmp_path, cheap(32), 8)
    stage.play()
    with closing(sqlite3.connect(f"file:{tmp_path / DATABASE}?mode=ro", uri=True)) as reader:
        reader.execute("SELECT COUNT(*) FROM rollouts").fetchone()
        stage.journal.close()
        (tmp_path / "copy").mkdir()
        shutil.copy(tmp_path / DATABASE, tmp_path / "copy" / DATABASE)
    assert sum(problem.rollouts for problem in read_progress(tmp_path / "copy").problems) == 32


@pytest.mark.rest
@pytest.mark.usefixtures("no_disk")
def test_a_replay_of_a_long_campaign_ends_where_it_was(tmp_path: Path) -> None:
    stage = Stage(tmp_path, cheap(400), 64)
    stage.play()
    stage.journal.close()
    journal = Journal.open(tmp_path)
    again = Ledger(tmp_path, journal)
    again.replay()
    journal.close()
    assert again.state == stage.ledger.state
    assert again.accounts == stage.ledger.accounts


# The dispatch core


def crowd(workers: int, rollouts: int) -> DispatchState:
    """Return so many idle workers, and rollouts that wait."""
    state = DispatchState(Limits())
    wanted = tuple((RolloutId("p", number, "true", 0), 0) for number in range(rollouts))
    arrivals: list[events.Event] = [
        *(WorkerUp(0.0, f"w{number}") for number in range(workers)),
        *(Reported(0.0, f"w{number}", None, 0) for number in range(workers)),
        Wanted(0.0, wanted),
    ]
    for event in arrivals:
        state, _ = machine.advance(state, event)
    return state


@pytest.mark.parametrize(("workers", "rollouts"), [(3, 5), (5, 3), (4, 4), (0, 2), (2, 0)])
def test_all_idle_workers_get_the_oldest_rollouts_at_once(workers: int, rollouts: int) -> None:
    state, actions = machine.advance(crowd(workers, rollouts), HandOut(1.0))
    check_invariants(state)
    starts = [(each.worker, first_of(each.attempt.rollout).test) for each in actions if isinstance(each, Start)]
    assert starts == [(f"w{number}", number) for number in range(min(workers, rollouts))]
    assert [first_of(each).test for each in state.waiting] == list(range(len(starts), rollouts))


def test_a_heartbeat_of_an_idle_worker_changes_nothing() -> None:
    state = crowd(1000, 0)
    after, actions = machine.advance(state, Reported(1.0, "w500", None, 0))
    assert after is state
    assert actions == ()
