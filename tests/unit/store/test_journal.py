"""The journal: what is written stays as it was, and a change is found."""

import hashlib
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.campaign.software import software
from perfbound.orchestrator.store import read, tables
from perfbound.orchestrator.store.attempt_record import table_digests
from perfbound.orchestrator.store.changes import ChangeReader, rollouts_of
from perfbound.orchestrator.store.counts import CountReader
from perfbound.orchestrator.store.export import export
from perfbound.orchestrator.store.journal import Journal, open_engine
from perfbound.orchestrator.store.lock import LOCK_FILE, campaign_lock, is_held
from perfbound.orchestrator.store.progress import header_alone, read_progress, session_options
from perfbound.orchestrator.store.rows import DATABASE, SCHEMA_VERSION
from perfbound.orchestrator.store.untrusted import read_untrusted, read_untrusted_header
from perfbound.schemas.batch import alone
from perfbound.schemas.errors import JournalError, PerfboundError
from perfbound.schemas.failure import Failure
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.ids import Attempt, RolloutId
from perfbound.schemas.ranges import MOST_SECONDS
from perfbound.schemas.result.facts import (
    BoundFact,
    ExtensionFact,
    Fact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
)
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.trajectory.trajectory import decode
from perfbound.schemas.values import Bound, Observation, Proposal
from perfbound.workers.simulate import run_request
from perfbound.workers.systems import load_system
from tests.campaigns import UNCHECKED
from tests.facts import facts
from tests.tampering import editing

PRESET = Path(__file__).parents[3] / "deploy" / "campaigns" / "test-function.toml"
R0 = RolloutId("maximum", 0, "true", 0)
FACTS: list[Fact] = [
    ProposalFact("maximum", 0, Proposal(7, (0.5, 1 / 3), 0.0, 1.0, None, None)),
    RolloutFact(R0, 2**53 - 1, "a" * 64, 1234, "trajectories/x", None),
    ObservationFact("maximum", 0, Observation(-0.1, (-0.2, 0.0)), "b" * 64),
    BoundFact("maximum", 0, Bound(None, None, None)),
    ProposalFact("maximum", 1, Proposal(0, (5.0, -0.0), 1e-300, 0.1 + 0.2, 2.0, 3.0)),
    ExtensionFact(1, (("maximum", 9),)),
]


def a_config(**changes: Any) -> CampaignConfig:
    settings: dict[str, Any] = {"resolution": 5, "max_tests": 4, **UNCHECKED, **changes}
    return parse_campaign(PRESET.read_bytes(), "test", **settings)


def a_header() -> Header:
    spec = load_system("test-function").spec
    return Header.new(a_config(), spec, software(spec))


@pytest.mark.parametrize(
    "value", [Proposal(0, (0.0,), -0.0, -0.0, -0.0, -0.0), Observation(-0.0, (0.0,)), Bound(-0.0, -0.0, None)]
)
def test_a_value_has_no_zero_that_a_column_changes(value: Proposal | Observation | Bound) -> None:
    """SQLite keeps no -0.0, and the hash chain is computed from the values."""
    assert "-0.0" not in repr(value)


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    opened = Journal.create(tmp_path, a_header())
    yield opened
    opened.close()


def edit(directory: Path, statement: str) -> None:
    """Change the database behind the journal's back, without its triggers."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        triggers = connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall()
        for (trigger,) in triggers:
            connection.execute(f"DROP TRIGGER {trigger}")
        assert connection.execute(statement).rowcount == 1
        connection.commit()


# Writing


def test_facts_come_back_in_their_order(journal: Journal, tmp_path: Path) -> None:
    with journal.transaction():
        for fact in FACTS[:3]:
            journal.add(fact)
    with journal.transaction():
        for fact in FACTS[3:]:
            journal.add(fact)
    assert list(journal.facts()) == FACTS
    journal.close()
    again = Journal.open(tmp_path)
    assert list(again.facts()) == FACTS
    again.close()


def test_the_header_comes_back(journal: Journal, tmp_path: Path) -> None:
    header = journal.header
    journal.close()
    again = Journal.open(tmp_path)
    again.close()
    assert again.header == header
    assert again.header.config.digest == header.config.digest
    assert again.session == journal.session + 1
    assert not (tmp_path / f"{DATABASE}.partial").exists()


@pytest.mark.parametrize("table", [*tables.FACTS, tables.schema, tables.attempts, tables.outcomes, tables.sessions])
@pytest.mark.parametrize("verb", ["UPDATE {0} SET {1} = {1}", "DELETE FROM {0}"])
def test_nothing_is_changed_or_removed(journal: Journal, tmp_path: Path, table: sa.Table, verb: str) -> None:
    with journal.transaction():
        for fact in FACTS:
            journal.add(fact)
        journal.attempts.started(Attempt(R0, 1), "w", "h", 1)
        journal.attempts.ended(Attempt(R0, 1), "w", "recorded")
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection:
        connection.execute(  # by `perfbound discard` alone, not by the journal
            "INSERT INTO discards SELECT 99, problem, test, variant, replicate, seed, sha256, size, path, robustness, "
            "seq, 'reason' FROM rollouts LIMIT 1"
        )
        connection.commit()
        before = connection.execute(f"SELECT * FROM {table.name}").fetchall()
        assert before
        column = next(iter(table.columns)).name
        with pytest.raises(sqlite3.IntegrityError, match=f"{table.name} is insert-only"):
            connection.execute(verb.format(table.name, column))
        assert connection.execute(f"SELECT * FROM {table.name}").fetchall() == before


@pytest.mark.parametrize(
    "fact",
    [
        ProposalFact("maximum", 0, Proposal(7, (0.5, float("nan")), 0.0, 1.0, None, None)),
        ProposalFact("maximum", 0, Proposal(7, (0.5,), float("nan"), 1.0, None, None)),
        ProposalFact("maximum", 0, Proposal(7, (0.5,), 0.0, 1.0, None, float("inf"))),
        RolloutFact(R0, 1, "a" * 64, 1, "x", float("nan")),
        ObservationFact("maximum", 0, Observation(float("nan"), ()), "b" * 64),
        BoundFact("maximum", 0, Bound(float("nan"), None, None)),
    ],
)
def test_a_number_that_is_not_finite_is_refused(journal: Journal, fact: Fact) -> None:
    with pytest.raises(ValueError, match="JSON"), journal.transaction():
        journal.add(fact)
    assert list(journal.facts()) == []


def test_a_transaction_is_whole_or_nothing(journal: Journal, tmp_path: Path) -> None:
    with journal.transaction():
        journal.add(FACTS[0])

    def interrupted() -> None:
        with journal.transaction():
            journal.add(FACTS[1])
            journal.attempts.started(Attempt(R0, 1), "w", "h", 1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(journal.facts()) == FACTS[:1]
    assert read.attempts(tmp_path) == {}
    with journal.transaction():
        journal.add(FACTS[1])
    assert list(journal.facts()) == FACTS[:2]
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection:
        assert connection.execute("SELECT seq FROM rollouts").fetchall() == [(3,)], "no gap"


@pytest.mark.parametrize("fact", FACTS[:4])
def test_a_fact_is_written_once(journal: Journal, fact: Fact) -> None:
    with journal.transaction():
        for each in FACTS[:4]:
            journal.add(each)
    with pytest.raises(sqlite3.IntegrityError), journal.transaction():
        journal.add(fact)
    assert list(journal.facts()) == FACTS[:4]


def test_a_fact_needs_the_one_before(journal: Journal) -> None:
    for orphan in FACTS[1:4]:
        with pytest.raises(sqlite3.IntegrityError), journal.transaction():
            journal.add(orphan)


def test_the_highest_attempt_is_known_and_the_first_outcome_stands(journal: Journal, tmp_path: Path) -> None:
    other = RolloutId("maximum", 1, "true", 2)
    with journal.transaction():
        for attempt in (Attempt(R0, 1), Attempt(R0, 3), Attempt(other, 2)):
            journal.attempts.started(attempt, "w", "h", 1)
        journal.attempts.ended(Attempt(R0, 1), "w", LOST)
        journal.attempts.ended(Attempt(R0, 1), "w", Failure("infrastructure", "worse"))
    assert read.attempts(tmp_path) == {R0: 3, other: 2}
    assert ended(tmp_path) == [("worker lost for 3 s", "infrastructure")]


def test_the_largest_numbers_of_messages_come_back_and_sums_of_older_ones_are_finite(
    journal: Journal, tmp_path: Path
) -> None:
    with journal.transaction():
        journal.attempts.started(Attempt(R0, 10**6), "w", "h", 2**31 - 1)
        journal.attempts.ended(Attempt(R0, 10**6), "w", "recorded", MOST_SECONDS, MOST_SECONDS)
        for number in (1, 2):  # a message had no ranges once
            journal.attempts.ended(Attempt(R0, number), "w", "recorded", 1.5e308, 1.5e308)
    assert read.attempts(tmp_path) == {R0: 10**6}
    outcomes = ChangeReader(tmp_path).read().outcomes
    assert [each.cpu_seconds for each in outcomes] == [MOST_SECONDS] * 3
    assert sum(each.cpu_seconds + each.wall_seconds for each in outcomes) == 6 * MOST_SECONDS


def test_a_commit_is_on_the_disk_when_it_returns(tmp_path: Path) -> None:
    """A worker drops a result that is committed. SQLite syncs its log at a commit from level 2 on, FULL."""
    engine = open_engine(tmp_path / DATABASE)
    with engine.begin() as connection:
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar_one() >= 2
    engine.dispose()


# Failures and their kinds

LOST, RAISED = Failure("infrastructure", "worker lost for 3 s"), Failure("system", "the solver did not converge")


def ended(directory: Path) -> list[tuple[str, str | None]]:
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        return connection.execute("SELECT outcome, kind FROM outcomes ORDER BY rowid").fetchall()


def end(journal: Journal, *outcomes: tuple[RolloutId, int, str | Failure]) -> None:
    for rollout, number, outcome in outcomes:
        with journal.transaction():
            journal.attempts.ended(Attempt(rollout, number), "w", outcome)


def test_a_failure_of_the_system_is_written_after_one_of_the_infrastructure(journal: Journal, tmp_path: Path) -> None:
    """The worker was given up, and reports later that the system had failed: a retry chooses among outcomes."""
    other = Failure("system", "another reason")
    end(journal, (R0, 1, LOST), (R0, 1, RAISED), (R0, 1, RAISED), (R0, 1, other), (R0, 1, LOST), (R0, 2, "recorded"))
    assert ended(tmp_path) == [
        ("worker lost for 3 s", "infrastructure"),
        ("the solver did not converge", "system"),
        ("recorded", None),
    ]


def test_a_failure_that_is_called_like_a_result_is_none(journal: Journal, tmp_path: Path) -> None:
    """The reason is text of the system under test: such an attempt counted as recorded."""
    end(journal, (R0, 1, Failure("system", "recorded")), (R0, 2, Failure("system", "restored")))
    assert ended(tmp_path) == [("failed: recorded", "system"), ("failed: restored", "system")]
    assert read_progress(tmp_path).failures == 2


def test_an_attempt_that_failed_in_the_system_is_no_opinion(journal: Journal) -> None:
    with journal.transaction():
        for number, worker in enumerate("abc", 1):
            journal.attempts.started(Attempt(R0, number), worker, "h", 1)
            journal.attempts.opinion("compared", Attempt(R0, number), worker, "d" if worker == "c" else "e")
        journal.attempts.ended(Attempt(R0, 3), "c", RAISED)
    with journal.transaction():
        found = [(each.attempt.number, each.worker) for each in journal.attempts.compared()]
        assert (found, journal.attempts.disputed()) == ([(1, "a"), (2, "b")], [])


R1 = RolloutId("maximum", 1, "true", 0)


@pytest.mark.parametrize(
    ("outcomes", "expected"),
    [
        ([], 0),
        ([(R0, 1, "recorded")], 0),
        ([(R0, 1, LOST), (R0, 2, "recorded")], 0),
        ([(R0, 1, RAISED), (R0, 2, RAISED)], 0),
        ([(R0, 1, RAISED), (R1, 1, "recorded")], 0),
        ([(R0, 1, RAISED), (R0, 2, "recorded")], 1),
        ([(R0, 2, "recorded"), (R0, 1, RAISED)], 1),
        ([(R0, 1, LOST), (R0, 1, RAISED), (R0, 2, RAISED), (R0, 3, "recorded")], 1),
        ([(R0, 1, RAISED), (R1, 1, RAISED), (R0, 2, "recorded"), (R1, 2, "recorded")], 2),
        ([(R0, 1, RAISED), (R0, 2, "restored")], 0),
    ],
)
def test_a_rollout_that_failed_in_the_system_and_was_recorded_is_irreproducible(
    journal: Journal, tmp_path: Path, outcomes: list[tuple[RolloutId, int, str | Failure]], expected: int
) -> None:
    end(journal, *outcomes)
    assert read.irreproducible(tmp_path) == expected
    found = read_progress(tmp_path)
    assert found.system_failures == sum(outcome == RAISED for _, _, outcome in outcomes)


def test_hand_backs_of_rollouts_without_a_result_are_counted(journal: Journal, tmp_path: Path) -> None:
    other, done = RolloutId("maximum", 1, "true", 0), RolloutId("maximum", 2, "true", 0)
    end(journal, (R0, 1, "handed back"), (R0, 2, LOST), (R0, 3, "handed back"), (other, 1, LOST))
    end(journal, (done, 1, "handed back"), (done, 2, "recorded"))
    assert read.hand_backs(tmp_path) == {R0: 2}


@pytest.mark.parametrize("change", ["RENAME COLUMN kind TO shape", "DROP COLUMN kind", "ADD COLUMN more"])
def test_a_table_with_other_columns_is_not_perfbound_s(journal: Journal, tmp_path: Path, change: str) -> None:
    journal.close()
    assert read_untrusted(tmp_path).rollouts == ()
    with closing(sqlite3.connect(tmp_path / DATABASE)) as connection:
        connection.execute(f"ALTER TABLE outcomes {change}" + (" TEXT" if "ADD" in change else ""))
    with pytest.raises(JournalError, match="the table outcomes has other columns"):
        read_untrusted(tmp_path)


# Unusable databases


@pytest.mark.integration
def test_the_locks_of_the_database_are_kept_while_it_is_open(journal: Journal, tmp_path: Path) -> None:
    """Another process that finds none of them begins the index of the log anew, below our feet: SIGBUS."""
    for fact in FACTS[:2]:
        with journal.transaction():
            journal.add(fact)
    journal.check_place()
    takes = (  # the lock of a connection on the index (`os_unix.c`: UNIX_SHM_DMS), and the shared one on the database
        "import fcntl, sys\nfcntl.lockf(open(sys.argv[1], 'r+b'), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, int(sys.argv[2]))"
    )
    for name, byte in ((f"{DATABASE}-shm", 128), (DATABASE, 0x40000002)):
        line = [sys.executable, "-c", takes, str(tmp_path / name), str(byte)]
        ended = subprocess.run(line, capture_output=True, text=True, check=False)
        assert "BlockingIOError" in ended.stderr, f"{name}: no lock"


WAYS: dict[str, Callable[[Path], object]] = {
    "open": Journal.open,
    "header": read.stored_header,
    "failures": read.failures,
    "irreproducible": read.irreproducible,
    "contradicted": read.contradicted,
    "progress": read_progress,
    "header alone": header_alone,
    "options": session_options,
    "changes": lambda directory: ChangeReader(directory).read(),
    "rollouts": lambda directory: rollouts_of(directory, "maximum", 0),
    "counts": lambda directory: CountReader(directory).read(),
    "export": lambda directory: export(directory, directory / "export"),
    "digests": table_digests,
    "untrusted": read_untrusted,
    "untrusted header": read_untrusted_header,
}


@pytest.mark.rest
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("version", "named"),
    [
        (0, "schema version 0"),
        (2, "schema version 2"),
        (9, "schema version 9"),
        ("1", "schema version '1'"),
        ("a\n\x1b[2J" + "b" * 99, "schema version 'a\\n\\x1b[2Jbbbbbbbbb"),
        (b"\xff", "schema version b'\\xff'"),
        (None, "no schema version"),
    ],
    ids=["0", "2", "9", "digit", "text", "bytes", "none"],
)
def test_another_schema_version_is_refused(
    journal: Journal, tmp_path: Path, version: Any, named: str, way: str
) -> None:
    journal.close()
    with editing(tmp_path) as database:
        database.execute("DROP TABLE schema")
        database.execute("CREATE TABLE schema (version)")
        database.executemany("INSERT INTO schema VALUES (?)", [] if version is None else [[version]])
        if version == 2:  # whose other tables had other columns
            database.execute("ALTER TABLE outcomes DROP COLUMN kind")
    with pytest.raises(JournalError) as refusal:
        WAYS[way](tmp_path)
    numbers = f"{named}, this perfbound reads {SCHEMA_VERSION}"
    assert str(refusal.value) == f"{tmp_path / DATABASE}: {numbers}; use the perfbound that wrote it"


@pytest.mark.parametrize("way", WAYS)
def test_a_database_without_its_table_of_the_version_is_refused(journal: Journal, tmp_path: Path, way: str) -> None:
    journal.close()
    with editing(tmp_path) as database:
        database.execute("DROP TABLE schema")
    with pytest.raises(JournalError, match=facts("campaign.db: campaign database table:")):
        WAYS[way](tmp_path)


def test_other_rules_are_refused(journal: Journal, tmp_path: Path) -> None:
    journal.close()
    edit(tmp_path, "UPDATE campaign SET rules = 99")
    with pytest.raises(JournalError, match=facts("99 perfbound 1 use")):
        Journal.open(tmp_path)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE campaign SET config = replace(config, '\"seed\":1', '\"seed\":2')",
        "UPDATE campaign SET config = replace(config, '\"seed\":1', '\"seed\":-1')",
        "UPDATE campaign SET config = '{'",
        "UPDATE campaign SET system = '{}'",
        "UPDATE campaign SET software = 'x'",
        "DELETE FROM campaign",
    ],
)
def test_a_header_that_was_changed_is_refused_in_one_line(journal: Journal, tmp_path: Path, statement: str) -> None:
    journal.close()
    edit(tmp_path, statement)
    with pytest.raises(JournalError, match=r"campaign\.db: ") as refusal:
        Journal.open(tmp_path)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("content", [b"", b"not a database" * 100])
def test_what_is_no_database_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / DATABASE).write_bytes(content)
    with pytest.raises(JournalError, match=r"campaign\.db: "):
        Journal.open(tmp_path)


def test_a_directory_without_campaign_is_named(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="no campaign here"):
        Journal.open(tmp_path)


def test_a_database_that_is_gone_or_emptied_is_to_be_restored(tmp_path: Path) -> None:
    (tmp_path / "trajectories").mkdir()
    with pytest.raises(JournalError, match=facts("campaign.db: files campaign")):
        Journal.open(tmp_path)
    (tmp_path / DATABASE).touch()
    with pytest.raises(JournalError, match=facts("campaign.db: copy")):
        Journal.open(tmp_path)


# The hash chain


def simulated(request: RolloutRequest) -> bytes:
    return run_request(request, lambda _: None)


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    """A campaign whose tests are all observed."""
    journal = Journal.create(tmp_path, a_header())
    ledger = Ledger(tmp_path, journal)
    with journal.transaction():
        waiting = ledger.outstanding().wanted
    while waiting:
        rollout = waiting.pop()
        payload = simulated(alone(ledger.request(rollout)))
        with ledger.transaction():
            waiting += ledger.record(rollout, payload, decode(payload), hashlib.sha256(payload).hexdigest()).wanted
    assert ledger.done
    journal.close()
    return tmp_path


def replayed(directory: Path) -> Ledger:
    journal = Journal.open(directory)
    try:
        ledger = Ledger(directory, journal)
        ledger.replay()
    finally:
        journal.close()
    return ledger


def test_a_replay_rebuilds_everything(finished: Path) -> None:
    ledger = replayed(finished)
    assert ledger.done
    account = ledger.accounts["maximum"]
    assert len(account.observations) == account.counts["true"] == 4
    assert account.last_bound is not None
    assert account.last_bound.stopped_by == "budget"


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE observations SET y = y + 1e-12 WHERE test = 2",
        "UPDATE observations SET chain = (SELECT chain FROM observations WHERE test = 1) WHERE test = 2",
        "UPDATE rollouts SET sha256 = replace(sha256, substr(sha256, 1, 1), 'x') WHERE test = 2",
        "UPDATE rollouts SET seed = seed + 1 WHERE test = 3",
        "UPDATE rollouts SET replicate = 1 WHERE test = 0",
        "UPDATE tests SET x = '[0.0,0.0]' WHERE test = 1",
        "UPDATE tests SET node = node + 1 WHERE test = 1",
        "UPDATE tests SET mu = mu + 1e-12 WHERE test = 2",
        "UPDATE tests SET sigma = sigma + 1e-12 WHERE test = 2",
        "UPDATE tests SET beta = beta + 1e-12 WHERE test = 2",
        "UPDATE tests SET F = F + 1e-12 WHERE test = 2",
        "DELETE FROM rollouts WHERE test = 2",
        "DELETE FROM observations WHERE test = 2",
        "DELETE FROM tests WHERE test = 2",
        "DELETE FROM bounds WHERE test = 1",
        "DELETE FROM bounds WHERE test = 3",
        "UPDATE bounds SET upper = upper - 1e-6 WHERE test = 2",
        "UPDATE bounds SET stopped_by = 'converged' WHERE test = 2",
    ],
)
def test_an_edited_fact_is_found(finished: Path, statement: str) -> None:
    edit(finished, statement)
    with pytest.raises(JournalError, match=r"contradict each other"):
        replayed(finished)


# The lock

HOLD = """
import signal, sys
from pathlib import Path
from typing import Any
from perfbound.orchestrator.store.lock import campaign_lock
with campaign_lock(Path(sys.argv[1])):
    print("held", flush=True)
    signal.pause()
"""


@pytest.mark.integration
def test_one_orchestrator_at_a_time_even_after_a_kill(tmp_path: Path) -> None:
    assert not is_held(tmp_path)
    with subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        assert is_held(tmp_path)
        with pytest.raises(PerfboundError, match="another orchestrator is running"), campaign_lock(tmp_path):
            pass
        os.kill(holder.pid, signal.SIGKILL)
    assert not is_held(tmp_path)
    with campaign_lock(tmp_path):
        assert is_held(tmp_path)
    assert not is_held(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [LOCK_FILE]


@pytest.mark.parametrize("name", ["with space", "what?", "50%", "a#b&c=d", "mode=ro"])
def test_a_run_directory_of_any_name_is_written_and_read(tmp_path: Path, name: str) -> None:
    directory = tmp_path / name
    directory.mkdir()
    header = a_header()
    Journal.create(directory, header).close()
    assert {path.name for path in tmp_path.iterdir()} == {name}
    assert read_progress(directory).header == header
