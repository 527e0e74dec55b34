"""Campaigns of an earlier perfbound: the finished ones verify, the stopped one resumes to the same certificate."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.end_to_end.processes import Processes, query

pytestmark = pytest.mark.smoke
RULES_1 = Path(__file__).parents[1] / "fixtures" / "rules-1"
RECORDED = sys.version_info[:2] == (3, 11)
"""Whether this is the Python of these campaigns: another one verifies them, and resumes none."""
resumed = pytest.mark.skipif(not RECORDED, reason="needs Python 3.11, with which these campaigns were started")
FINISHED = ("paper-pair", "rigorous-pair", "scenario-list")
DECIDED = ("claims", "problems", "composition", "evidence")
"""Parts of a certificate that follow from the campaign alone, not from the perfbound that wrote it."""


def copied(name: str, folder: Path) -> Path:
    """Return a run directory that may be written to."""
    return Path(shutil.copytree(RULES_1 / name, folder / name))


def decided(certificate: Path) -> dict[str, Any]:
    predicate = json.loads(certificate.read_bytes())["predicate"]
    # The chain covers the last digits of every proposal, which depend on the CPU: `verify` recomputes it instead.
    predicate["evidence"].pop("chain_head")
    return {part: predicate[part] for part in DECIDED}


@pytest.mark.parametrize("name", FINISHED)
def test_a_finished_campaign_verifies(started: Processes, name: str) -> None:
    directory = copied(name, started.folder)
    ended = started.run("perfbound", "verify", directory, "--resimulate", "2", "--json")
    found = {each["check"]: each["status"] for each in json.loads(ended.out)["checks"]}
    absent = {"spot check", "recheck", "regions"} | ({"composition"} if name == "scenario-list" else set())
    skipped = absent | ({"signature"} if RECORDED else {"signature", "software"}) | {"attempts"}
    assert {check: status for check, status in found.items() if status != "passed"} == dict.fromkeys(skipped, "skipped")
    assert ended.code == 0
    assert len(found) >= 20


@pytest.mark.parametrize("name", ["steep", "rare"])
def test_certificates_of_rules_3_verify_and_what_they_miss_is_said(started: Processes, name: str) -> None:
    """By their rules: a gap that does not dominate at fresh starts (steep), and results that repeat (rare)."""
    directory = Path(shutil.copytree(RULES_1.parent / "rules-3" / name, started.folder / name))
    ended = started.run("perfbound", "verify", directory, "--json")
    found = {each["check"]: each["status"] for each in json.loads(ended.out)["checks"]}
    assert "failed" not in found.values()
    assert ended.code == 0
    shown = started.run("perfbound", "show", directory).out
    assert "VERDICT  NOT SHOWN" in shown
    expected = "less than the bound 0.2470: the claim is false." if name == "steep" else "(independent_rollouts of"
    assert expected in " ".join(shown.split())


@resumed
def test_the_stopped_campaign_resumes_to_the_certificate_of_the_finished_one(started: Processes) -> None:
    directory, calm = copied("rigorous-pair-stopped", started.folder), RULES_1 / "rigorous-pair"
    recorded = "SELECT count(*) FROM rollouts"
    before = query(directory, recorded)
    ended = started.run("perfbound", "resume", directory, "--workers", "2")
    assert ended.code == 0, ended.err
    assert query(directory, recorded) > before
    assert decided(directory / "certificate.json") == decided(calm / "certificate.json")
    assert (directory / "manifest.sha256").read_bytes() == (calm / "manifest.sha256").read_bytes()
    assert started.run("perfbound", "verify", directory).code == 0


@resumed
@pytest.mark.parametrize(
    ("name", "version", "manifest"),
    [
        ("rules-1/rigorous-pair-stopped", 1, "rules-1/rigorous-pair/manifest.sha256"),
        ("schema-2", 2, "rules-1/rigorous-pair/manifest.sha256"),
        ("schema-3", 3, "schema-3.manifest.sha256"),
    ],
)
def test_an_older_database_is_resumed_as_it_is(started: Processes, name: str, version: int, manifest: str) -> None:
    """Stopped runs, and the manifests of undisturbed ones; the database is written without newer columns."""
    directory = Path(shutil.copytree(RULES_1.parent / name, started.folder / "run"))
    before = query(directory, "SELECT sql FROM sqlite_master")
    ended = started.run("perfbound", "resume", directory, "--workers", "2")
    assert ended.code == 0, ended.err
    assert query(directory, "SELECT version FROM schema") == [(version,)]
    assert query(directory, "SELECT sql FROM sqlite_master") == before
    assert "does not name the sources of test-function: whether they are the same is not known" in ended.err
    assert (directory / "manifest.sha256").read_bytes() == (RULES_1.parent / manifest).read_bytes()
    for command in ("verify", "status", "export", "report"):
        ended = started.run("perfbound", command, directory)
        assert ended.code == 0, ended.err


@resumed
def test_a_function_of_an_older_database_is_resumed(started: Processes) -> None:
    """Its campaign knows the code of the function, but not the version of the package that it imports."""
    directory = Path(shutil.copytree(RULES_1.parent / "function-schema-3", started.folder / "run"))
    ended = started.run("perfbound", "resume", directory, "--system", f"{directory / 'hill.py'}:hill")
    assert ended.code == 0, ended.err
    assert "does not name the packages of hill: whether they are the same is not known" in ended.err
    # Its trajectory files have channels to plot since then, so their digests are others.
    found = decided(directory / "certificate.json")
    calm = decided(RULES_1.parent / "function-schema-3.certificate.json")
    assert [found[part] for part in ("claims", "problems")] == [calm[part] for part in ("claims", "problems")]
    assert started.run("perfbound", "verify", directory).code == 0
