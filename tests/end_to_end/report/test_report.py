"""The report of real campaigns, written at their end and asked for afterwards."""

import json
import os
import re
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.run import service
from tests.end_to_end.processes import BIN, Processes
from tests.fakes.finished import a_list, finish, play


def page_data(directory: Path) -> Any:
    """Return the data in the page of a report."""
    found = re.search(r'id="story">(.*?)</script>', (directory / "report.html").read_text(), re.DOTALL)
    assert found
    return json.loads(found[1])


@pytest.mark.journey
def test_a_run_ends_with_its_report(calm: Path, started: Processes) -> None:
    certificate = json.loads((calm / "certificate.json").read_text())["predicate"]
    found = page_data(calm)
    assert found["state"] == "finished"
    assert [claim["assumptions"] for claim in found["claims"]] == [
        each["assumptions"] for each in certificate["claims"]
    ]
    printed = started.run("perfbound", "report", calm, "--json")
    assert (printed.code, printed.err) == (0, "")
    scenes = [scene["test"] for scene in found["scenes"]]
    assert [scene["test"] for scene in json.loads(printed.out)["scenes"]] == scenes
    assert {trace["column"] for scene in found["scenes"] for trace in scene["traces"]} == {"phi"}


def test_a_report_that_cannot_be_written_spoils_no_campaign(calm: Path, started: Processes) -> None:
    run = started.folder / "run"
    shutil.copytree(calm, run)
    (run / "certificate.json").unlink()  # as if it had been stopped there
    (run / "report.html").unlink()
    (run / "report.html" / "in the way").mkdir(parents=True)
    ended = started.run("perfbound", "resume", run)
    assert ended.code == 0
    assert "there is no report" in ended.err
    assert "Traceback" not in ended.err
    assert "certificate.json" in ended.out


def test_true_rollouts_are_shown_beside_a_nominal_one(
    tmp_path: Path, started: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "TICK", 0.01)
    finish(play(tmp_path / "run", a_list()), tmp_path / "run")
    ended = started.run("perfbound", "report", tmp_path / "run")
    assert ended.code == 0, ended.err
    for scene in page_data(tmp_path / "run")["scenes"]:
        first, *others = scene["traces"]
        assert first["label"] == "nominal, simulated for this report"
        assert {trace["variant"] for trace in others} == {"true"}


def test_a_report_shows_its_stages_on_a_terminal(calm: Path, tmp_path: Path) -> None:
    directory = tmp_path / "run"
    shutil.copytree(calm, directory)
    ours, theirs = os.openpty()
    with subprocess.Popen(
        [BIN / "perfbound", "report", directory],
        stdout=subprocess.PIPE,
        stderr=theirs,
        env=os.environ | {"TERM": "xterm"},
    ) as process:
        os.close(theirs)
        shown = bytearray()
        with suppress(OSError):  # the end of a terminal
            while part := os.read(ours, 65536):
                shown += part
        os.close(ours)
        assert process.stdout is not None
        files = process.stdout.read().decode().split()
    assert process.returncode == 0
    assert files[0] == str(directory / "report.html")
    for stage in (b"campaign", b"figures", b"100%"):
        assert stage in shown, shown
    assert b"Traceback" not in shown
