"""The class of machines of a campaign: where it comes from, and who is refused."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from perfbound.orchestrator.run.options import check_platform
from perfbound.orchestrator.store import journal as module
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import JournalError
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.platforms import ANY, platform_class
from tests.campaigns import config
from tests.facts import facts
from tests.fakes.inmemory import begin

OTHER = "other-7-glibc-2.5"


def test_a_campaign_keeps_the_platform_of_the_orchestrator_that_began_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin(tmp_path / "run", config("test-function"))
    monkeypatch.setattr(module, "platform_class", lambda: OTHER)
    with closing(Journal.open(tmp_path / "run")) as journal:
        assert journal.platform == platform_class() != OTHER
    with closing(sqlite3.connect(tmp_path / "run" / DATABASE)) as connection:
        rows = connection.execute("SELECT platform FROM sessions ORDER BY session").fetchall()
    assert rows == [(platform_class(),), (OTHER,)]


def test_a_campaign_file_may_name_the_platform_and_stays_the_same_campaign(tmp_path: Path) -> None:
    base = config("test-function")
    named = base.model_copy(update={"platform": OTHER})
    assert named.digest == base.digest
    begin(tmp_path / "run", named)
    with closing(Journal.open(tmp_path / "run")) as journal:
        assert journal.platform == OTHER


def test_a_machine_of_another_class_runs_no_workers_of_the_campaign() -> None:
    check_platform(ANY, Path("runs/x"))
    check_platform(platform_class(), Path("runs/x"))
    with pytest.raises(JournalError, match=facts(f"runs/x: {OTHER} --workers 0")):
        check_platform(OTHER, Path("runs/x"))


def test_a_platform_that_no_machine_has_is_refused() -> None:
    text = (Path(__file__).parents[3] / "deploy" / "campaigns" / "test-function.toml").read_text()
    assert parse_campaign(f'platform = "any"\n{text}'.encode(), "x").platform == "any"
    with pytest.raises(Exception, match="platform"):
        parse_campaign(f'platform = "Genuine Intel"\n{text}'.encode(), "x")
