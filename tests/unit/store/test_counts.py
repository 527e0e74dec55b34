"""The counts of a campaign, read in increments; and the times of its commits."""

import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.run import service
from perfbound.orchestrator.run.service import RunStatus
from perfbound.orchestrator.store import counts
from perfbound.orchestrator.store.commit_times import EDGES, CommitTimes, cumulative
from perfbound.orchestrator.store.counts import CampaignCounts, CountReader
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.lock import campaign_lock
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import JournalError
from perfbound.schemas.result.facts import ProposalFact
from perfbound.schemas.values import Proposal
from tests.campaigns import config
from tests.fakes.inmemory import Log, campaign


class Watching(Log):
    """Reads the counts at every tick, as a page does."""

    def __init__(self, directory: Path) -> None:
        super().__init__()
        self._reader = CountReader(directory)
        self.found: list[CampaignCounts] = []
        self.commits: list[CommitTimes] = []

    def show(self, status: RunStatus) -> None:
        self.found.append(self._reader.read())
        self.commits.append(status.loop.commits)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Watching]:
    """A finished campaign, and what was counted while it ran."""
    directory = tmp_path_factory.mktemp("counts") / "run"
    log = Watching(directory)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(service, "TICK", 0.002)
        campaign(directory, config("test-function", resolution=7, max_tests=20, replicates=2), workers=2, log=log)
    return directory, log


def rows(directory: Path, query: str) -> list[Any]:
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        return connection.execute(query).fetchall()


def test_increments_add_up_to_what_the_database_has(watched: tuple[Path, Watching]) -> None:
    directory, log = watched
    whole = CountReader(directory).read()
    assert log.found[-1] == whole
    assert len({str(each) for each in log.found}) > 3, "it was read in increments"
    assert [(name, each.rollouts) for name, each in sorted(whole.series.items())] == rows(
        directory, "SELECT problem, count(*) FROM rollouts GROUP BY problem ORDER BY problem"
    )
    assert [(name, each.tests) for name, each in sorted(whole.series.items()) if each.tests] == rows(
        directory, "SELECT problem, count(*) FROM observations GROUP BY problem ORDER BY problem"
    )
    assert sorted(whole.attempts.items()) == rows(directory, "SELECT host, count(*) FROM attempts GROUP BY host")
    assert sum(whole.outcomes.values()) == rows(directory, "SELECT 0, count(*) FROM outcomes")[0][1]
    last = "SELECT upper FROM bounds ORDER BY seq DESC"
    assert rows(directory, f"SELECT max(y), ({last}) FROM observations") == [
        (whole.series["maximum"].greatest, whole.series["maximum"].upper)
    ]


def test_no_count_falls(watched: tuple[Path, Watching]) -> None:
    _, log = watched
    for before, after in zip(log.found, log.found[1:], strict=False):
        for name, each in before.series.items():
            assert each.rollouts <= after.series[name].rollouts
            assert each.tests <= after.series[name].tests
        assert not Counter(before.attempts) - Counter(after.attempts)
        assert not Counter(before.outcomes) - Counter(after.outcomes)


def test_another_campaign_in_its_place_is_counted_anew(watched: tuple[Path, Watching], tmp_path: Path) -> None:
    directory = Path(shutil.copytree(watched[0], tmp_path / "run"))
    reader = CountReader(directory)
    first = reader.read()
    shutil.rmtree(directory)
    campaign(directory, config("test-function", resolution=5, max_tests=3))
    second = reader.read()
    assert second.header.run != first.header.run
    assert second.series["maximum"].tests == 3
    assert second == CountReader(directory).read()


def test_a_discarded_rollout_leaves_the_counts_as_they_are(watched: tuple[Path, Watching], tmp_path: Path) -> None:
    directory = Path(shutil.copytree(watched[0], tmp_path / "run"))
    reader = CountReader(directory)
    before = reader.read()
    with closing(sqlite3.connect(directory / DATABASE, isolation_level=None)) as connection:
        connection.execute("DROP TRIGGER rollouts_no_delete")
        connection.execute("DELETE FROM rollouts WHERE seq = (SELECT max(seq) FROM rollouts)")
    assert reader.read() == before


def test_no_query_reads_what_was_read_before(watched: tuple[Path, Watching]) -> None:
    """Every one of them begins at the last number, as SQLite's plan for it says."""
    with closing(sqlite3.connect(watched[0] / DATABASE)) as connection:
        for query in (counts._ROLLOUTS, counts._TESTS, counts._BOUNDS, counts._ATTEMPTS, counts._OUTCOMES):
            plan = connection.execute(f"EXPLAIN QUERY PLAN {query}", [0] * query.count("?")).fetchall()
            assert "USING INTEGER PRIMARY KEY (rowid>?)" in plan[0][3], query
            assert not [step for *_, step in plan if step.startswith("SCAN")], query


def test_no_campaign_and_a_damaged_one(watched: tuple[Path, Watching], tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="no campaign here"):
        CountReader(tmp_path).read()
    directory = Path(shutil.copytree(watched[0], tmp_path / "run"))
    reader = CountReader(directory)
    reader.read()
    (directory / DATABASE).write_bytes(b"no database" * 1000)
    with pytest.raises(JournalError):
        reader.read()


# Commits


@pytest.fixture
def journal(watched: tuple[Path, Watching], tmp_path: Path) -> Iterator[Journal]:
    directory = tmp_path / "new"
    directory.mkdir()
    with campaign_lock(directory), closing(Journal.create(directory, CountReader(watched[0]).read().header)) as found:
        yield found


def test_a_commit_is_timed_and_a_turn_that_writes_nothing_is_none(journal: Journal) -> None:
    with journal.transaction():
        pass
    assert journal.commits == CommitTimes()
    with journal.transaction():
        journal.add(ProposalFact("maximum", 0, Proposal(0, (0.5,), None, None, None, None)))
    assert sum(journal.commits.numbers) == 1
    assert journal.commits.seconds > 0
    with suppress(ZeroDivisionError), journal.transaction():
        journal.add(ProposalFact("maximum", 1, Proposal(0, (0.5,), None, None, None, None)))
        raise ZeroDivisionError
    assert sum(journal.commits.numbers) == 1, "what is rolled back is no commit"
    with journal.transaction():
        journal.add(ProposalFact("maximum", 1, Proposal(0, (0.5,), None, None, None, None)))
        journal.proposal("maximum", 1)  # a query within writes the rows before
    assert sum(journal.commits.numbers) == 2


def test_the_loop_sends_the_times_of_its_commits(watched: tuple[Path, Watching]) -> None:
    directory, log = watched
    numbers = [sum(each.numbers) for each in log.commits]
    assert numbers == sorted(numbers)
    assert 0 < numbers[-1] <= rows(directory, "SELECT 0, count(*) FROM attempts")[0][1] * 3


@given(st.lists(st.floats(0, 100)))
def test_every_commit_is_in_one_bucket(times: list[float]) -> None:
    found = CommitTimes()
    for each in times:
        found = found.with_one(each)
    for edge, number in zip(EDGES, cumulative(found.numbers), strict=False):
        assert number == sum(each <= edge for each in times)
    assert cumulative(found.numbers)[-1] == len(times)
    assert found.seconds == pytest.approx(sum(times))
