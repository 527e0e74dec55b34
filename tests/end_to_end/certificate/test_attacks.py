"""kill -9 during spot check and recheck, with real workers: the certificate is the calm one, byte by byte."""

from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes, query, wait_for
from tests.faults.subjects import function_campaign, install

TESTS = 12
"""Of the problem, before the checks."""


def simulated(directory: Path, series: str) -> int:
    """Return the number of recorded rollouts of a problem or a check, but for those that were withdrawn meanwhile."""
    observed = "JOIN observations USING (problem, test)"
    return len(query(directory, f"SELECT rollouts.seq FROM rollouts {observed} WHERE problem = '{series}'"))


@pytest.mark.smoke
def test_a_kill_in_each_check_changes_nothing(started: Processes) -> None:
    path = f"{install(started.folder / 'plugins')}:{Path(__file__).parents[3]}"
    campaign, calm, killed = (started.folder / name for name in ("campaign.toml", "calm", "killed"))
    # A deadline that nothing reaches: the limit of a repeated rollout has the start of its process in it.
    campaign.write_text(function_campaign("function", "function", tests=TESTS, deadline=120.0))
    ended = started.run("perfbound", "run", campaign, "--workers", "2", "--out", calm, PYTHONPATH=path)
    assert ended.code == 0, ended.err

    command: tuple[str | Path, ...] = ("run", campaign, "--out", killed)
    for check in ("spot_check", "recheck"):
        process = started.start("perfbound", *command, "--workers", "2", PYTHONPATH=path)
        wait_for(lambda check=check: simulated(killed, check))  # type: ignore[misc]
        process.popen.kill()
        process.wait()
        assert not (killed / "certificate.json").exists()
        command = ("resume", killed)
    before = {check: simulated(killed, check) for check in ("spot_check", "recheck")}
    ended = started.run("perfbound", *command, "--workers", "1", PYTHONPATH=path)
    assert ended.code == 0, ended.err
    assert simulated(killed, "spot_check") == before["spot_check"] == simulated(calm, "spot_check")
    assert 0 < before["recheck"] < simulated(killed, "recheck")
    for name in ("certificate.json", "manifest.sha256"):
        assert (killed / name).read_bytes() == (calm / name).read_bytes()
    assert started.run("perfbound", "verify", killed, "--resimulate", "2", PYTHONPATH=path).code == 0
