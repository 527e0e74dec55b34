"""A campaign on a Slurm cluster: its jobs end by themselves, and kills and requeues change no byte."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.end_to_end.fleet.cluster import Cluster, cluster, missing
from tests.end_to_end.processes import Processes, processes, query, recorded, wait_for, write_campaign

pytestmark = pytest.mark.skipif(bool(missing()), reason=missing())
WORKERS = 4


@pytest.fixture
def slurm(started: Processes) -> Iterator[Cluster]:
    with cluster(started) as found:
        yield found


def submitted(started: Processes, slurm: Cluster, campaign: Path, out: str = "run") -> dict[str, str]:
    """Submit a campaign; return the number of each job."""
    options = ("--workers", str(WORKERS), "--out", out, "--folder", "jobs", "--memory", "1G")
    ended = started.start("perfbound", "slurm", campaign, *options, prefix=slurm.inside).wait()
    assert ended.code == 0, ended.err
    return dict(line.split() for line in ended.out.splitlines()[:3])


def check_end(started: Processes, slurm: Cluster, jobs: dict[str, str]) -> None:
    """Wait for the end of all jobs, each of which has ended well."""
    wait_for(slurm.is_empty)
    logs = "\n".join(path.read_text() for path in (started.folder / "jobs").glob("*.log"))
    for job in jobs.values():
        for shown in slurm.shown(job).split("\n\n"):
            assert not shown.strip() or "JobState=COMPLETED" in shown, shown + logs
            assert not shown.strip() or "ExitCode=0:0" in shown, shown + logs


def test_an_array_of_workers_behind_a_router_gives_the_same_certificate(
    started: Processes, slurm: Cluster, calm: Path
) -> None:
    jobs = submitted(started, slurm, write_campaign(started.folder / "c.toml"))
    check_end(started, slurm, jobs)
    assert (started.folder / "run" / "certificate.json").read_bytes() == (calm / "certificate.json").read_bytes()
    names = {row[0] for row in query(started.folder / "run", "SELECT DISTINCT worker FROM attempts")}
    assert len(names) > 1
    # The same command again: there is nothing left to do, and every job finds that.
    check_end(started, slurm, submitted(started, slurm, started.folder / "c.toml"))


@pytest.fixture(scope="module")
def longer(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    """A campaign with time to disturb it, and its certificate without trouble."""
    folder = tmp_path_factory.mktemp("longer")
    campaign = write_campaign(folder / "c.toml", max_tests="60")
    with processes(folder) as found:
        ended = found.run("perfbound", "run", campaign, "--out", "run")
    assert ended.code == 0, ended.err
    return campaign, (folder / "run" / "certificate.json").read_bytes()


def test_killed_and_queued_again_they_give_the_same_certificate(
    started: Processes, slurm: Cluster, longer: tuple[Path, bytes]
) -> None:
    campaign, certificate = longer
    directory = started.folder / "run"
    jobs = submitted(started, slurm, campaign)
    wait_for(lambda: recorded(directory) >= 8)
    hit = [jobs["router"], jobs["orchestrator"], f"{jobs['workers']}_2"]
    for job in hit:
        slurm.ask("scancel", "--signal=KILL", "--full", job)
    for job in hit:
        slurm.ask("scontrol", "requeue", job)
    assert not (directory / "certificate.json").exists()
    check_end(started, slurm, jobs)
    for job in hit:
        assert "Restarts=1" in slurm.shown(job)
    assert (directory / "certificate.json").read_bytes() == certificate
    assert query(directory, "SELECT count(*) FROM sessions") == [(2,)]


def test_warned_of_its_time_limit_a_job_is_queued_again_by_itself(
    started: Processes, slurm: Cluster, longer: tuple[Path, bytes]
) -> None:
    campaign, certificate = longer
    directory = started.folder / "run"
    jobs = submitted(started, slurm, campaign)
    wait_for(lambda: recorded(directory) >= 8)
    # The orchestrator while it has much to do; the router last, since what is under way is delivered through it.
    for warned in ([f"{jobs['workers']}_1", jobs["orchestrator"]], [jobs["router"]]):
        for job in warned:
            # What `--signal=B:USR1@120` sends: to the job's shell, and to nothing else.
            slurm.ask("scancel", "--signal=USR1", "--batch", job)
        for job in warned:
            wait_for(lambda job=job: "Restarts=1" in slurm.shown(job))  # type: ignore[misc]
    check_end(started, slurm, jobs)
    assert (directory / "certificate.json").read_bytes() == certificate
    failed = query(directory, "SELECT outcome FROM outcomes WHERE outcome NOT IN ('recorded', 'handed back')")
    assert not failed, "nobody was lost"
