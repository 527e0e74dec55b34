"""Tables for people: their values are those of the database, in the unit and with the sign of the objective."""

import csv
import io
import math
import os
import resource
import sqlite3
import sys
import tracemalloc
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from click.testing import CliRunner, Result

from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store import export
from perfbound.orchestrator.store.export_tables import ExportColumn, export_table, robustness_unit, unit
from perfbound.orchestrator.store.journal import Journal
from perfbound.schemas.errors import JournalError, PerfboundError
from perfbound.schemas.failure import Failure
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.objectives import OBJECTIVES
from perfbound.schemas.ids import Attempt, RolloutId
from perfbound.schemas.result.facts import (
    RECORDED,
    RESTORED,
    BoundFact,
    Fact,
    Header,
    ObservationFact,
    ProposalFact,
    RolloutFact,
)
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.values import Bound, Observation, Proposal
from perfbound.workers.systems import load_system
from tests.campaigns import cheap, config, table
from tests.facts import facts
from tests.fakes.puppets import Stage

ROLLOUTS = 64
HOSTILE = ("=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", 'a","b', "a\r\nb", "ü", "'=1", "")


@pytest.fixture(autouse=True)
def _no_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have nothing wait for the disk; what is durable is not the question here."""
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """Return a finished campaign on the real service."""
    stage = played(tmp_path / "run")
    stage.play()
    stage.journal.close()
    return tmp_path / "run"


def played(directory: Path, names: Sequence[str] = ("one", "two")) -> Stage:
    stage = Stage(directory, cheap(ROLLOUTS), 0)
    stage.puppets.names = list(names)
    return stage


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file, strict=True))


def exported(directory: Path, **options: Any) -> dict[str, list[dict[str, str]]]:
    folder = directory / "export"
    return {path.stem: rows(path) for path, _ in export.export(directory, folder, **options)}


def query(directory: Path, text: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(directory / "campaign.db")) as connection:
        return connection.execute(text).fetchall()


def number(cell: str) -> float | None:
    return float(cell) if cell else None


def plain(cell: object) -> str:
    return "" if cell is None else str(cell)


# Values of the tables


def test_rollouts_are_those_of_the_database(campaign: Path) -> None:
    found = exported(campaign)["rollouts"]
    columns = "seq, problem, test, variant, replicate, seed, sha256, size, path, robustness, by_tolerance, ended"
    facts = query(campaign, f"SELECT {columns} FROM rollouts ORDER BY seq")
    outcomes = {
        rollout: values
        for rollout, *values in query(campaign, "SELECT rollout, worker, wall_seconds, cpu_seconds FROM outcomes")
    }
    attempts = dict(query(campaign, "SELECT rollout, count(*) FROM attempts GROUP BY rollout"))
    assert len(found) == len(facts) == ROLLOUTS
    for row, (_, problem, test, variant, replicate, seed, sha256, size, path, robustness, border, ended) in zip(
        found, facts, strict=True
    ):
        name = f"{problem}.{test}.{variant}.{replicate}"
        worker, wall, cpu = outcomes[name]
        values = (
            name,
            problem,
            test,
            variant,
            replicate,
            seed,
            robustness,
            border,
            ended,
            path,
            size,
            sha256,
            worker,
            attempts[name],
            wall,
            cpu,
        )
        titles = ("rollout", "problem", "test", "variant", "replicate", "seed", "robustness (1)", "by_tolerance")
        after = ("ended (s)", "path", "size (B)", "sha256", "worker", "attempts", "wall (s)", "cpu (s)")
        assert [row[title] for title in (*titles, *after)] == [plain(value) for value in values]


def test_tests_are_those_of_the_database_as_risks(campaign: Path) -> None:
    found = exported(campaign)["tests"]
    facts = query(
        campaign,
        "SELECT t.problem, t.test, t.node, t.x, t.mu, t.sigma, t.beta, t.F, o.y, b.upper, b.lower, b.stopped_by "
        "FROM tests t LEFT JOIN observations o USING (problem, test) LEFT JOIN bounds b USING (problem, test) "
        "ORDER BY t.seq",
    )
    assert len(found) == len(facts)
    for row, (problem, test, node, x, mu, sigma, beta, f, y, upper, lower, stopped_by) in zip(
        found, facts, strict=True
    ):
        assert (row["problem"], row["test"], row["node"]) == (problem, str(test), str(node))
        assert f"[{row['z1 (1)']},{row['z2 (1)']}]" == x
        assert (row["sense"], row["unit"], row["stopped_by"]) == ("min", "1", plain(stopped_by))
        assert [number(row[name]) for name in ("sigma", "beta", "F")] == [sigma, beta, f]
        turned = [number(row[name]) for name in ("observation", "mu", "lower", "upper")]
        assert turned == [None if value is None else -value for value in (y, mu, upper, lower)]
    assert query(campaign, "SELECT count(*) FROM bounds WHERE stopped_by IS NOT NULL") == [(1,)]


def test_every_replicate_has_its_row_and_their_mean_is_the_observation(campaign: Path) -> None:
    found = exported(campaign)
    assert len(found["observations"]) == ROLLOUTS
    assert [row["replicate"] for row in found["observations"][:9]] == list("012345670")
    by_rollout = {(row["test"], row["replicate"]): row["robustness (1)"] for row in found["rollouts"]}
    by_test: dict[str, list[float]] = {}
    for row in found["observations"]:
        assert row["contribution"] == by_rollout[row["test"], row["replicate"]]
        by_test.setdefault(row["test"], []).append(float(row["contribution"]))
    for row in found["observations"]:
        values = by_test[row["test"]]
        assert float(row["observation"]) == math.fsum(values) / len(values)
    chains = query(campaign, "SELECT test, chain FROM observations")
    assert {(int(row["test"]), row["chain"]) for row in found["observations"]} == set(chains)


def test_counterexamples_are_the_rollouts_below_zero(tmp_path: Path) -> None:
    journal = journal_of(tmp_path, config("segway-paper"))
    values = (0.1, -1e-300, 0.0, -0.05, None)
    add(journal, ProposalFact("sim_gap", 0, Proposal(7, (1.0, 2.0), None, None, None, None)))
    add(journal, *(rollout("sim_gap", 0, number, value) for number, value in enumerate(values)))
    journal.close()
    found = exported(tmp_path)
    assert [row["replicate"] for row in found["counterexamples"]] == ["1", "3"]
    assert [row for row in found["rollouts"] if row["replicate"] in "13"] == found["counterexamples"]
    assert export.counterexamples(tmp_path, tmp_path / "c.csv") == 2
    assert rows(tmp_path / "c.csv") == found["counterexamples"]
    assert [number(row["robustness (rad)"]) for row in found["rollouts"]] == list(values)


def segway() -> SystemSpec:
    return load_system("segway").spec


def journal_of(directory: Path, settings: CampaignConfig, spec: SystemSpec | None = None) -> Journal:
    return Journal.create(directory, Header.new(settings, spec or segway(), {}, run="0" * 16))


def add(journal: Journal, *facts: Fact) -> None:
    with journal.transaction():
        for fact in facts:
            journal.add(fact)


def rollout(problem: str, test: int, replicate: int, robustness: float | None = 0.5) -> RolloutFact:
    which = RolloutId(problem, test, "true", replicate)
    return RolloutFact(which, 2**53 - 1, "a" * 64, 1234, f"trajectories/{problem}/0/{which}.mcap", robustness)


J = {"y": -0.7, "mu": -0.6, "upper": -0.5, "lower": -0.9}
"""Of the maximised objective, as the database has it."""
ROBUSTNESS = {"observation": 0.7, "mu": 0.6, "lower": 0.5, "upper": 0.9}
ITSELF = {"observation": -0.7, "mu": -0.6, "lower": -0.9, "upper": -0.5}


@pytest.mark.parametrize(
    ("preset", "problem", "expected", "each"),
    [
        ("segway-paper", "nominal_robustness", ROBUSTNESS, [0.8, 0.6]),
        ("segway-paper", "sim_gap", ITSELF, [-0.8, -0.6]),
        ("segway-pair", "nominal_robustness", ROBUSTNESS, [0.8, 0.6]),
        ("segway-pair", "sim_gap", ITSELF, [-0.8, -0.6]),
        ("segway-scenario", "true_risk", ROBUSTNESS, [-0.8, -0.6]),
        ("segway-direct", "true_risk", ROBUSTNESS, [-0.8, -0.6]),
        ("test-function", "maximum", ITSELF, [-0.8, -0.6]),
    ],
)
def test_signs(tmp_path: Path, preset: str, problem: str, expected: dict[str, float], each: list[float]) -> None:
    """`each` holds J, which is turned; but for a risk it holds robustness, which stays."""
    settings = config(preset)
    journal = journal_of(tmp_path, settings, load_system(settings.system.name).spec)
    add(
        journal,
        ProposalFact(problem, 0, Proposal(7, (1.0, 2.0), J["mu"], 0.1, 2.0, 0.2)),
        ObservationFact(problem, 0, Observation(J["y"], (-0.8, -0.6)), "b" * 64),
        BoundFact(problem, 0, Bound(J["upper"], J["lower"], None)),
    )
    journal.close()
    found = exported(tmp_path)
    (row,) = found["tests"]
    assert {name: float(row[name]) for name in expected} == expected
    assert (row["sigma"], row["beta"], row["F"]) == ("0.1", "2.0", "0.2")
    assert (row["sense"], row["unit"]) == (OBJECTIVES[problem].sense, "1" if preset == "test-function" else "rad")  # type: ignore[index]
    assert [float(row["contribution"]) for row in found["observations"]] == each
    assert {float(row["observation"]) for row in found["observations"]} == {expected["observation"]}


def test_a_linearised_risk_contributes_what_its_mean_is_made_of(tmp_path: Path) -> None:
    problem = table("segway-pair")["problems"][0]
    risk = {**problem, "name": "true_risk", "linearised": {"centre": 0.7, "spread": 0.1}}
    journal = journal_of(tmp_path, config("segway-pair", problems=[risk], composition="single"))
    add(
        journal,
        ProposalFact("true_risk", 0, Proposal(7, (1.0, 2.0), None, None, None, None)),
        ObservationFact("true_risk", 0, Observation(-0.7, (-0.8, -0.6)), "b" * 64),
    )
    journal.close()
    assert [row["contribution"] for row in exported(tmp_path)["observations"]] == ["0.8", "0.6"]


@pytest.mark.parametrize(("preset", "each"), [("segway-pair", ["0.8", "0.6"]), ("segway-scenario", ["-0.8", "-0.6"])])
def test_a_robustness_keeps_its_sign_in_method_scenario_alone(tmp_path: Path, preset: str, each: list[str]) -> None:
    problem = {**table(preset)["problems"][0], "name": "robustness"}
    problem.pop("linearised", None)
    journal = journal_of(tmp_path, config(preset, problems=[problem], composition="single"))
    add(
        journal,
        ProposalFact("robustness", 0, Proposal(7, (1.0, 2.0), None, None, None, None)),
        ObservationFact("robustness", 0, Observation(-0.7, (-0.8, -0.6)), "b" * 64),
    )
    journal.close()
    assert [row["contribution"] for row in exported(tmp_path)["observations"]] == each


def test_zero_has_no_sign(tmp_path: Path) -> None:
    journal = journal_of(tmp_path, config("segway-paper"))
    add(journal, ProposalFact("nominal_robustness", 0, Proposal(7, (0.0, 2.0), 0.0, 1.0, None, None)))
    journal.close()
    (row,) = exported(tmp_path)["tests"]
    assert (row["mu"], row["x (m)"], row["beta"], row["observation"], row["lower"]) == ("0.0", "0.0", "", "", "")


def test_the_attempt_is_the_one_that_brought_the_result(tmp_path: Path) -> None:
    journal, which = journal_of(tmp_path, config("segway-paper")), RolloutId("sim_gap", 0, "true", 0)
    add(journal, ProposalFact("sim_gap", 0, Proposal(7, (1.0, 2.0), None, None, None, None)), rollout("sim_gap", 0, 0))
    add(journal, rollout("sim_gap", 0, 1))
    with journal.transaction():
        for try_ in (1, 2, 3):
            journal.attempts.started(Attempt(which, try_), f"w{try_}", "host", 1)
        journal.attempts.ended(Attempt(which, 1), "w1", Failure("infrastructure", "lost"), 9.0, 9.0)
        journal.attempts.ended(Attempt(which, 2), "w2", RECORDED, 0.25, 0.5)
        journal.attempts.ended(Attempt(which, 3), "w3", RESTORED, 8.0, 8.0)
    journal.close()
    first, second = exported(tmp_path)["rollouts"]
    attempt = ("worker", "attempts", "wall (s)", "cpu (s)")
    assert [first[name] for name in attempt] == ["w2", "3", "0.5", "0.25"]
    assert [second[name] for name in attempt] == ["", "0", "", ""]


def test_after_a_discard_the_attempt_is_that_of_the_present_row(tmp_path: Path) -> None:
    journal, which = journal_of(tmp_path, config("segway-paper")), RolloutId("sim_gap", 0, "true", 0)
    add(journal, ProposalFact("sim_gap", 0, Proposal(7, (1.0, 2.0), None, None, None, None)), rollout("sim_gap", 0, 0))
    with journal.transaction():
        for try_ in (1, 2):
            journal.attempts.ended(Attempt(which, try_), f"w{try_}", RECORDED)
    journal.close()
    assert [row["worker"] for row in exported(tmp_path)["rollouts"]] == ["w2"]


def test_failures_are_the_attempts_without_a_result(tmp_path: Path) -> None:
    journal, which = journal_of(tmp_path, config("segway-paper")), RolloutId("sim_gap", 0, "true", 0)
    with journal.transaction():
        journal.attempts.ended(Attempt(which, 2), "w2", Failure("system", "=1+1"))
        journal.attempts.ended(Attempt(which, 1), "w1", Failure("infrastructure", "worker lost for 3 s"))
        journal.attempts.ended(Attempt(which, 3), "w3", RECORDED)
        journal.attempts.ended(Attempt(which, 4), "w3", RESTORED)
    journal.close()
    found = exported(tmp_path)["failures"]
    titles = ("rollout", "attempt", "worker", "kind", "reason")
    assert [[row[name] for name in titles] for row in found] == [
        ["sim_gap.0.true.0", "2", "w2", "system", "'=1+1"],
        ["sim_gap.0.true.0", "1", "w1", "infrastructure", "worker lost for 3 s"],
    ]
    assert all(float(row["ended (s)"]) > 1.7e9 for row in found)


def test_what_was_compared_and_who_was_set_aside(tmp_path: Path) -> None:
    journal, which = journal_of(tmp_path, config("segway-paper")), RolloutId("sim_gap", 0, "true", 0)
    with journal.transaction():
        for number, (kind, worker) in enumerate([("compared", "w1"), ("outvoted", "w2"), ("reviewed", "w3")]):
            journal.attempts.opinion(kind, Attempt(which, number + 1), worker, worker * 32)
        journal.attempts.set_aside("worker", "w2", math.inf, "=1+1")
    journal.close()
    found = exported(tmp_path)
    assert [(row["kind"], row["rollout"], row["attempt"], row["worker"]) for row in found["opinions"]] == [
        ("compared", "sim_gap.0.true.0", "1", "w1"),
        ("outvoted", "sim_gap.0.true.0", "2", "w2"),
        ("reviewed", "sim_gap.0.true.0", "3", "w3"),
    ]
    assert found["opinions"][1]["sha256"] == "w2" * 32
    (pause,) = found["set_aside"]
    assert [pause[name] for name in ("kind", "name", "seconds (s)", "reason")] == ["worker", "w2", "inf", "'=1+1"]


# Names and units


@pytest.mark.rest
def test_a_parameter_that_is_called_like_a_column_gets_another_name(tmp_path: Path) -> None:
    names = ("seed", "observation", "x")
    spec = SystemSpec(
        name="segway",
        doc="",
        parameters=tuple(Parameter(name=name, unit="µm", low=0, high=5) for name in names),
        columns=(Column(name="t", unit="s"), Column(name="phi", unit="rad")),
        max_horizon=60,
    )
    journal = journal_of(tmp_path, config("segway-paper"), spec)
    add(
        journal,
        ProposalFact("sim_gap", 0, Proposal(7, (1.0, 2.0, 3.0), None, None, None, None)),
        rollout("sim_gap", 0, 0),
    )
    journal.close()
    found = exported(tmp_path)
    for (row,) in (found["tests"], found["rollouts"]):
        assert [row[title] for title in ("start_seed (µm)", "start_observation (µm)", "x (µm)")] == [
            "1.0",
            "2.0",
            "3.0",
        ]
    assert found["rollouts"][0]["seed"] == str(2**53 - 1)
    export.export(tmp_path, tmp_path / "p", form="parquet")
    for name in export.TABLES:
        columns = pyarrow.parquet.read_schema(tmp_path / "p" / f"{name}.parquet").names
        assert len(set(columns)) == len(columns)


COLUMNS = (("t", "s"), ("phi", "rad"), ("x", "m"), ("y", "m"), ("e", ""))


@pytest.mark.parametrize(
    ("specification", "expected"),
    [
        ("always (abs(phi) <= 0.95)", "rad"),
        ("always[0,1e3] x - y <= 1 until y > 2e-1", "m"),
        ("always x <= 1 and phi <= 1", ""),
        ("always (x - 2.5)^2 <= 1", ""),
        ("always x * y <= 1", ""),
        ("always x / y <= 1", ""),
        ("always 1 <= 2", ""),
        (None, ""),
    ],
)
def test_the_unit_of_a_robustness_is_that_of_what_is_compared(specification: str | None, expected: str) -> None:
    spec = segway().model_copy(update={"columns": tuple(Column(name=name, unit=unit) for name, unit in COLUMNS)})
    settings = config("segway-paper").model_copy(update={"specification": specification})
    assert robustness_unit(settings, spec) == expected


def test_a_gap_has_the_unit_of_its_column() -> None:
    settings = config("segway-paper", specification="always x <= 1")
    assert [unit(problem, settings, segway()) for problem in settings.problems] == ["m", "rad"]


# Files


@pytest.mark.rest
def test_both_formats_say_the_same(campaign: Path) -> None:
    texts = exported(campaign)
    for path, number_of_rows in export.export(campaign, campaign / "p", form="parquet"):
        table = pyarrow.parquet.read_table(path)
        assert table.num_rows == number_of_rows == len(texts[path.stem])
        titles = [
            f"{field.name} ({field.metadata[b'unit'].decode()})" if field.metadata else field.name
            for field in table.schema
        ]
        found = [dict(zip(titles, map(plain, row.values()), strict=True)) for row in table.to_pylist()]
        assert found == texts[path.stem]
        assert table.schema.metadata[b"run"].decode() in query(campaign, "SELECT run FROM campaign")[0]


def test_an_array_has_the_rows_and_titles_of_a_file(campaign: Path) -> None:
    for name, expected in exported(campaign).items():
        found = export.table_array(campaign, name)
        assert len(found) == len(expected)
        for title in expected[0] if expected else ():
            values = found[title].tolist()
            assert [plain(value).replace("nan", "") for value in values] == [row[title] for row in expected]
    found = export.table_array(campaign, "rollouts")
    assert [found.dtype[name].str for name in ("worker", "seed", "z1")] == ["|O", "<i8", "<f8"]
    assert (found["size"] == found["size (B)"]).all()


def test_a_number_that_an_array_lacks_is_nan(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    columns = (ExportColumn("id", "text"), ExportColumn("test", "integer"), ExportColumn("class"))
    monkeypatch.setattr(export, "table_rows", lambda _directory, _name: (columns, [("a", 1, 0.5), (None, None, None)]))
    found = export.table_array(campaign, "tests")
    assert found[0].item() == ("a", 1.0, 0.5)
    assert found["id"][1] is None
    assert np.isnan([found["test"][1], found["class"][1]]).all()


def test_types_are_those_of_the_values(campaign: Path) -> None:
    export.export(campaign, campaign / "p", ["rollouts"], form="parquet")
    schema = pyarrow.parquet.read_schema(campaign / "p" / "rollouts.parquet")
    kinds = {name: str(schema.field(name).type) for name in ("seed", "robustness", "worker", "z1", "size")}
    assert kinds == {"seed": "int64", "robustness": "double", "worker": "string", "z1": "double", "size": "int64"}
    assert schema.field("size").metadata == {b"unit": b"B"}


def test_a_strangers_name_is_text(tmp_path: Path) -> None:
    stage = played(tmp_path, HOSTILE)
    stage.play()
    stage.journal.close()
    found = {row["worker"] for row in exported(tmp_path)["rollouts"]}
    assert found == {f"'{name}" if name[:1] in tuple("=+-@\t\r\n") else name for name in HOSTILE}
    export.export(tmp_path, tmp_path / "p", ["rollouts"], form="parquet")
    assert set(pyarrow.parquet.read_table(tmp_path / "p" / "rollouts.parquet")["worker"].to_pylist()) == set(HOSTILE)


def test_numbers_are_not_text(tmp_path: Path) -> None:
    """A negative number stays a number, and every digit of it."""
    journal = journal_of(tmp_path, config("segway-paper"))
    values = (-1 / 3, -5e-324, 1e22, -1.7976931348623157e308)
    add(journal, ProposalFact("sim_gap", 0, Proposal(7, (values[0], values[1]), values[2], values[3], None, None)))
    journal.close()
    (row,) = exported(tmp_path)["tests"]
    assert tuple(float(row[title]) for title in ("x (m)", "y (m)", "mu", "sigma")) == values


def test_lines_end_as_rfc_4180_says(campaign: Path) -> None:
    ((path, _),) = export.export(campaign, campaign / "export", ["tests"])
    text = path.read_bytes()
    assert text.count(b"\r\n") == text.count(b"\n") == len(rows(path)) + 1
    assert text.endswith(b"\r\n")


def names(directory: Path) -> set[str]:
    return {str(path.relative_to(directory)) for path in directory.rglob("*")}


def test_nothing_but_the_tables_is_written(campaign: Path) -> None:
    before = names(campaign)
    exported(campaign)
    assert names(campaign) - before == {"export", *(f"export/{name}.csv" for name in export.TABLES)}


@contextmanager
def room(size: int) -> Iterator[None]:
    """Have no file grow beyond `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_full_disk_leaves_what_was_there(campaign: Path, form: export.Format) -> None:
    """`tests` fits, `rollouts` does not: neither is replaced."""
    folder = campaign / "export"
    export.export(campaign, folder, form=form)
    before = {path: path.write_bytes(b"before") for path in folder.iterdir()}
    with room(7000), pytest.raises(PerfboundError, match=facts(f"{folder} : written File")):
        export.export(campaign, folder, form=form)
    assert set(folder.iterdir()) == set(before)
    assert {path.read_bytes() for path in before} == {b"before"}


def test_a_campaign_that_is_not_there_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="no campaign here"):
        export.export(tmp_path, tmp_path / "export")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("out", ["trajectories", "trajectories/x", "link/x", "x/../trajectories"])
def test_nothing_is_written_among_the_evidence(campaign: Path, out: str) -> None:
    (campaign / "link").symlink_to(campaign / "trajectories")
    before = names(campaign)
    with pytest.raises(PerfboundError, match="trajectories is for evidence alone"):
        export.export(campaign, campaign / out)
    with pytest.raises(PerfboundError, match="trajectories is for evidence alone"):
        export.counterexamples(campaign, campaign / out / "c.csv")
    assert names(campaign) == before


@pytest.mark.parametrize("name", ["campaign.db", "campaign.db-wal", "x/../campaign.db"])
def test_nothing_is_written_over_the_database(campaign: Path, name: str) -> None:
    before = (campaign / "campaign.db").read_bytes()
    with pytest.raises(PerfboundError, match="this is the campaign's database"):
        export.counterexamples(campaign, campaign / name)
    assert (campaign / "campaign.db").read_bytes() == before


def test_a_file_is_no_folder(campaign: Path) -> None:
    with pytest.raises(PerfboundError, match=r"campaign\.db.*: cannot be written"):
        export.export(campaign, campaign / "campaign.db")
    with pytest.raises(PerfboundError, match=r"campaign\.db.*: cannot be written"):
        export.export(campaign, campaign / "campaign.db" / "x")


def test_without_pyarrow_the_remedy_is_named(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = names(campaign)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(PerfboundError, match=r"pip install 'perfbound\[parquet\]'"):
        export.export(campaign, campaign / "export", form="parquet")
    assert names(campaign) == before
    export.export(campaign, campaign / "export", form="csv")


# While the campaign runs


def test_a_running_campaign_is_exported_whole_turn_by_whole_turn(tmp_path: Path) -> None:
    stage, seen = played(tmp_path, [f"w{number}" for number in range(8)]), list[int]()

    def look() -> bool:
        found = exported(tmp_path)
        known = {(row["test"], row["replicate"]) for row in found["rollouts"]}
        assert {(row["test"], row["replicate"]) for row in found["observations"]} <= known
        observed = {row["test"] for row in found["tests"] if row["observation"]}
        assert observed == {row["test"] for row in found["observations"]}
        seen.append(len(found["rollouts"]))
        return False

    stage.play(look)
    stage.journal.close()
    assert stage.ledger.done
    assert seen == sorted(seen)
    assert len({0, *seen}) > 2, "in the middle, too"


def test_all_tables_show_one_moment(tmp_path: Path) -> None:
    """Facts written between two tables are in neither of them."""
    journal = journal_of(tmp_path, config("segway-paper"))
    add(journal, ProposalFact("sim_gap", 0, Proposal(7, (1.0, 2.0), None, None, None, None)), rollout("sim_gap", 0, 0))

    def progress(name: str, _rows: int) -> None:
        if name == "tests":
            add(journal, rollout("sim_gap", 0, 1), rollout("sim_gap", 0, 2, -0.01))

    found = exported(tmp_path, progress=progress)
    assert [len(found[name]) for name in export.TABLES] == [1, 1, 0, 0, 0, 0, 0]
    again = exported(tmp_path)
    journal.close()
    assert [len(again[name]) for name in export.TABLES] == [1, 3, 0, 1, 0, 0, 0]


@pytest.mark.rest
@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_long_table_takes_little_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: export.Format) -> None:
    monkeypatch.setattr(export, "GROUP", 1000)
    journal = journal_of(tmp_path, config("segway-paper"))
    add(journal, ProposalFact("sim_gap", 0, Proposal(7, (1.0, 2.0), None, None, None, None)))
    add(journal, *(rollout("sim_gap", 0, number) for number in range(8000)))
    journal.close()
    export.export(tmp_path, tmp_path / "warm", form=form)
    ticks = list[int]()
    tracemalloc.start()
    try:
        export.export(tmp_path, tmp_path, ["rollouts"], form=form, progress=lambda _name, rows: ticks.append(rows))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert ticks == list(range(0, 8000, 1000))
    assert peak < 4e6, "8,000 rows at once would take 10 MB"


# The command


def command(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, ["export", *(str(each) for each in arguments)])


EMPTY = ("counterexamples", "failures", "set_aside")


def test_the_command_says_what_it_wrote(campaign: Path) -> None:
    result = command(campaign)
    assert result.exit_code == 0
    assert result.stdout.splitlines() == [
        f"{campaign / 'export' / 'tests.csv'}  {ROLLOUTS // 8} rows",
        *(f"{campaign / 'export' / name}.csv  {ROLLOUTS:,} rows" for name in ("rollouts", "observations")),
        *(f"{campaign / 'export' / name}.csv  0 rows" for name in EMPTY[:2]),
        f"{campaign / 'export' / 'opinions'}.csv  1 row",
        *(f"{campaign / 'export' / name}.csv  0 rows" for name in EMPTY[2:]),
    ]


def test_one_table_on_stdout_is_the_file(campaign: Path) -> None:
    ((path, _),) = export.export(campaign, campaign / "export", ["rollouts"])
    result = command(campaign, "rollouts", "--out", "-")
    assert (result.exit_code, result.stdout_bytes, result.stderr) == (0, path.read_bytes(), "")
    assert len(list(csv.reader(io.StringIO(result.stdout, newline="")))) == ROLLOUTS + 1


@pytest.mark.parametrize(
    "arguments",
    [("trials",), ("tests", "trials"), ("--out", "-"), ("tests", "rollouts", "--out", "-"), ("--format", "xlsx")],
)
def test_a_wrong_call_is_a_usage_error(campaign: Path, arguments: tuple[str, ...]) -> None:
    before = names(campaign)
    assert command(campaign, *arguments).exit_code == 2
    assert command(campaign, "tests", "--out", "-", "--format", "parquet").exit_code == 2
    assert names(campaign) == before


def test_an_unknown_table_is_named(campaign: Path) -> None:
    with pytest.raises(PerfboundError, match=facts("'trials' tests rollouts")):
        export.stream(campaign, "trials", io.BytesIO())


def test_the_spot_check_has_the_sign_of_the_problem_that_it_tests() -> None:
    """The database has J = -robustness for both; the export turned that of the problem alone."""
    found = config("segway-scenario")
    header = Header.new(found, load_system("test-function").spec, {})
    (problem,) = found.problems
    columns = [column.name for column in export_table("tests", header).columns]
    row = SimpleNamespace(
        test=0,
        node=0,
        x="[0.5, 0.5]",
        y=-0.3,
        mu=None,
        sigma=None,
        beta=None,
        F=None,
        lower=None,
        upper=None,
        stopped_by=None,
    )
    for name in (problem.name, "spot_check"):
        row.problem = name
        (exported,) = export_table("tests", header).expand(row)
        assert exported[columns.index("observation")] == 0.3
        assert exported[columns.index("sense")] == "min"
    row.problem = "recheck"
    (exported,) = export_table("tests", header).expand(row)
    assert exported[columns.index("observation")] == -0.3, "no objective"
