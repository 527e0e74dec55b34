"""A deterministic function without horizon and without a clip, from its file to its verified certificate."""

import json
import os
from pathlib import Path

import pytest

from tests.end_to_end.processes import Ended, Processes, processes, recorded, wait_for
from tests.end_to_end.report.test_report import page_data
from tests.fakes import plain_function
from tests.fakes.plain_function import CAMPAIGN, ROOT

CLAIM = "CLAIM  worst robustness over all starts >= 0.0"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the plug-in and the campaign file."""
    found = tmp_path_factory.mktemp("plain")
    plain_function.install(found / "plugins")
    (found / "c.toml").write_text(CAMPAIGN)
    return found


@pytest.fixture(scope="module")
def path(folder: Path) -> str:
    """PYTHONPATH of processes that have the plug-in."""
    return os.pathsep.join(map(str, (folder / "plugins", ROOT)))


@pytest.fixture(scope="module")
def ended(folder: Path, path: str) -> Ended:
    """A run without trouble, in the folder `run`."""
    with processes(folder / "logs") as found:
        return found.run("perfbound", "run", folder / "c.toml", "--out", folder / "run", PYTHONPATH=path)


@pytest.mark.journey
def test_the_claim_is_about_every_start_and_certain(ended: Ended) -> None:
    assert ended.code == 0, ended.err
    assert CLAIM in ended.out
    assert "certain, if its " in ended.out
    assert "VERDICT  SHOWN" in ended.out
    assert "REFUTED" not in ended.out


@pytest.mark.usefixtures("ended")
def test_killed_and_resumed_it_verifies(started: Processes, folder: Path, path: str) -> None:
    directory = folder / "killed"
    first = started.start("perfbound", "run", folder / "c.toml", "--out", directory, "--workers", "1", PYTHONPATH=path)
    wait_for(lambda: recorded(directory) >= 2)
    assert first.running, "the kill has to come in mid-run"
    first.popen.kill()
    first.wait()
    assert started.run("perfbound", "resume", directory, PYTHONPATH=path).code == 0
    calm = folder / "run" / "certificate.json"
    assert (directory / "certificate.json").read_bytes() == calm.read_bytes()
    verified = started.run("perfbound", "verify", directory, "--resimulate", "3", "--json", PYTHONPATH=path)
    assert verified.code == 0, verified.out
    found = {each["check"]: each["status"] for each in json.loads(verified.out)["checks"]}
    assert {check for check, status in found.items() if status != "passed"} == {"signature", "composition", "regions"}


@pytest.mark.usefixtures("ended")
def test_it_is_shown_exported_and_replayed(started: Processes, folder: Path, path: str) -> None:
    run = folder / "run"
    found = page_data(run)
    assert (found["clip"], found["risk_weight"], found["horizon"]) == (None, None, 0.0)
    assert found["now"].startswith("worst robustness over all starts \u2265 0.0")
    shown = started.run("perfbound", "report", run, PYTHONPATH=path)
    assert shown.code == 0, shown.err
    assert (run / "figures" / "robustness-map.png").exists()
    assert started.run("perfbound", "export", run, "--format", "csv", PYTHONPATH=path).code == 0
    assert "inf" not in (run / "export" / "observations.csv").read_text()
    replayed = started.run("perfbound", "replay", run, "robustness.0.nominal.0", "--out", "one.png", PYTHONPATH=path)
    assert replayed.code == 0, replayed.err
    assert "bitwise the same as the recorded trajectory" in replayed.out


def test_a_noisy_variant_is_refused_with_the_remedy(started: Processes, tmp_path: Path) -> None:
    campaign = tmp_path / "c.toml"
    campaign.write_text(CAMPAIGN.replace('"plain-function"\n\n[space]', '"test-function"\n\n[space]'))
    refused = started.run("perfbound", "run", campaign, "--out", "run")
    assert refused.code == 1
    assert "problems.robustness.noise_scale: 0 has no meaning for the true variant of test-function" in refused.fault
