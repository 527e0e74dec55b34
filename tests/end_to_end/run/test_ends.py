"""The ends of workers: when the campaign is finished, when there is none, when their time is over, and by SIGTERM."""

import json
import os
import signal
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from perfbound.workers.stopping import STOPPED
from tests.end_to_end.processes import Process, Processes, query, recorded, under_way, wait_for
from tests.sharing import free_port

SYSTEM = """
import os, subprocess, time
import numpy as np
import perfbound as pb

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": "1"}, step=0.5)
def slow(x, *, seed, horizon, progress):
    seconds, kind = open(os.environ["PACE"]).read().split()
    child = subprocess.Popen(["sleep", "100"])
    child.terminate()  # which a signal mask of its parent would block
    child.wait(50)
    open(os.environ["PACE"] + ".begun", "w").close()
    if kind == "native":  # one long call, without progress
        time.sleep(float(seconds))
    for step in range(int(float(seconds) * 100) if kind == "steps" else 0):
        progress(step)
        time.sleep(0.01)
    return np.full(round(horizon / 0.5) + 1, 1.0 + x)
"""
CAMPAIGN = """
name = "slow"
seed = 1
horizon = 1.0
max_tests = {tests}
recheck = 0
spot_check = 0
window = 2
specification = "always (y >= 0)"
clip = [-1, 2]
alpha = 0.001
rkhs_norm = 4
noise_scale = 0.5
kernel = {{ length_scale = {{ x = 0.3 }} }}
hung_after = 90.0

[system]
python = "slow.py:slow"

[space]
x = {{ low = 0.0, high = 1.0 }}
"""


@pytest.fixture
def slow(started: Processes) -> Callable[..., tuple[Process, str]]:
    """Start the orchestrator of a campaign whose rollouts take as long as `pace` says; return it and its endpoint."""
    (started.folder / "slow.py").write_text(SYSTEM)

    def start(pace: str, tests: int = 4) -> tuple[Process, str]:
        (started.folder / "pace").write_text(pace)
        (started.folder / "c.toml").write_text(CAMPAIGN.format(tests=tests))
        process = started.start("perfbound", "orchestrate", "c.toml", "--out", "run", PACE=pace_file(started))
        wait_for(lambda: "waiting for workers" in process.err or not process.running)
        assert process.running, process.err
        return process, process.err.split("--connect ")[1].split()[0]

    return start


def pace_file(started: Processes) -> str:
    return str(started.folder / "pace")


def worker(started: Processes, endpoint: str, *options: str) -> Process:
    arguments = ("--connect", endpoint, "--system", "slow.py:slow", *options)
    return started.start("perfbound-worker", *arguments, PACE=pace_file(started))


Slow = Callable[..., tuple[Process, str]]


def outcomes(started: Processes) -> set[str]:
    return {str(row[0]) for row in query(started.folder / "run", "SELECT outcome FROM outcomes")}


def is_busy(started: Processes) -> bool:
    """Whether a worker has begun a rollout: its first progress may be long ago in coming, its first heartbeat not."""
    return bool(under_way(started.folder / "run"))


def finish(started: Processes, orchestrator: Process, endpoint: str, tests: int = 4) -> None:
    """Let a worker that is quick do the rest, and end by itself."""
    (started.folder / "pace").write_text("0.01 steps")
    last = worker(started, endpoint, "--until-done")
    assert orchestrator.wait().code == 0, orchestrator.err
    assert last.wait().code == 0, last.err
    assert recorded(started.folder / "run") == tests


@pytest.mark.journey
def test_workers_end_with_the_campaign(started: Processes, slow: Slow) -> None:
    orchestrator, endpoint = slow("0.1 steps", tests=30)  # until both are there, also on a busy machine
    workers = [worker(started, endpoint, "--until-done") for _ in range(2)]
    assert orchestrator.wait().code == 0, orchestrator.err
    # By what the orchestrator says: it takes --idle-exit until then, which is 600 s.
    assert [each.wait().code for each in workers] == [0, 0]
    assert outcomes(started) == {"recorded"}


KILLED = """
import os, signal
from perfbound.orchestrator.cli import main
from perfbound.orchestrator.run.service import Service

Service.report_end = lambda self: os.kill(os.getpid(), signal.SIGKILL)  # with the certificate, before the report of it
main()
"""


@pytest.mark.parametrize("way", ["--listen", "--connect"])
def test_workers_end_though_the_orchestrator_was_killed_before_its_report(started: Processes, way: str) -> None:
    (started.folder / "slow.py").write_text(SYSTEM)
    (started.folder / "c.toml").write_text(CAMPAIGN.format(tests=4))
    (started.folder / "pace").write_text("0.01 steps")
    endpoint, directory = f"tcp/127.0.0.1:{free_port()}", started.folder / "run"
    if way == "--connect":
        started.start("perfbound", "router", "--listen", endpoint)
    arguments = ("orchestrate", "c.toml", "--out", "run", way, endpoint)
    killed = started.start("python", "-c", KILLED, *arguments, PACE=pace_file(started))
    workers = [worker(started, endpoint, "--until-done") for _ in range(2)]
    assert killed.wait().code == -signal.SIGKILL, killed.err
    certificate = (directory / "certificate.json").read_bytes()
    assert all(each.running for each in workers)
    resumed = started.run("perfbound", "resume", directory, way, endpoint)
    assert resumed.code == 0, resumed.err
    assert f"{directory}: finished already\nreporting that to its workers for 10 s\n" in resumed.err
    assert [each.wait().code for each in workers] == [0, 0]
    assert (directory / "certificate.json").read_bytes() == certificate


def test_a_finished_campaign_waits_for_no_router_and_needs_no_endpoint(started: Processes, calm: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        ended = started.run("perfbound", "resume", calm, "--listen", endpoint)
    assert ended.code == 0
    assert f"its workers get no report of that: --listen {endpoint}: this endpoint is in use" in ended.err


def test_without_a_campaign_a_worker_ends_with_an_error(started: Processes) -> None:
    ended = started.run("perfbound-worker", "--connect", "tcp/127.0.0.1:9", "--until-done", "--idle-exit", "0.5")
    assert ended.code == 1
    assert ended.last_line.startswith("perfbound-worker: no campaign within 0.5 s; check that its orchestrator runs")


def test_a_worker_whose_orchestrator_does_not_come_back_ends(started: Processes, slow: Slow) -> None:
    orchestrator, endpoint = slow("0.01 steps", tests=400)
    one = worker(started, endpoint, "--idle-exit", "10")
    wait_for(lambda: recorded(started.folder / "run") > 1)
    orchestrator.popen.kill()
    assert one.wait().code == 0, one.err


def test_after_its_hours_a_worker_finishes_what_is_under_way(started: Processes, slow: Slow) -> None:
    orchestrator, endpoint = slow("3 steps", tests=20)  # more than it can do in its time
    one = worker(started, endpoint, "--max-hours", "0.003")  # 11 s, in which a busy machine starts it and a rollout
    assert one.wait().code == 0, one.err
    assert "recorded" in outcomes(started)
    assert outcomes(started) <= {"recorded", "handed back"}
    assert not under_way(started.folder / "run")
    finish(started, orchestrator, endpoint, tests=20)


@pytest.mark.parametrize(("kind", "number"), [("steps", signal.SIGTERM), ("native", signal.SIGHUP)])
def test_a_signal_lets_a_short_rollout_end(started: Processes, slow: Slow, kind: str, number: int) -> None:
    orchestrator, endpoint = slow(f"3 {kind}")
    one = worker(started, endpoint)
    # The first result counts once its repetition has confirmed its time grid.
    wait_for(lambda: recorded(started.folder / "run") == 1)
    begun = started.folder / "pace.begun"
    begun.unlink()
    # Not only assigned: what has not begun is handed back at once.
    wait_for(begun.exists)
    one.popen.send_signal(number)
    assert one.wait().code == STOPPED, one.err
    assert recorded(started.folder / "run") > 1
    assert outcomes(started) <= {"recorded", "handed back"}
    assert not under_way(started.folder / "run")
    finish(started, orchestrator, endpoint)


def test_a_terminal_that_closes_ends_an_orchestrator_as_a_signal_of_a_manager(started: Processes, slow: Slow) -> None:
    orchestrator, _ = slow("0.01 steps")
    orchestrator.popen.send_signal(signal.SIGHUP)
    ended = orchestrator.wait()
    assert ended.code == 128 + signal.SIGHUP, ended.err
    assert ended.last_line.startswith("perfbound: stopped; continue with: perfbound resume run")


def test_under_nohup_a_terminal_may_close(started: Processes, slow: Slow) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # which processes that are started now inherit
    try:
        orchestrator, endpoint = slow("0.01 steps")
        one = worker(started, endpoint, "--until-done")
    finally:
        signal.signal(signal.SIGHUP, before)
    orchestrator.popen.send_signal(signal.SIGHUP)
    wait_for(lambda: recorded(started.folder / "run") > 0)
    one.popen.send_signal(signal.SIGHUP)
    assert orchestrator.wait().code == 0, orchestrator.err
    assert one.wait().code == 0, one.err


@pytest.mark.parametrize("kind", ["steps", "native"])
def test_a_long_rollout_is_handed_back_and_counts_against_nobody(started: Processes, slow: Slow, kind: str) -> None:
    orchestrator, endpoint = slow(f"200 {kind}")
    directory = started.folder / "run"
    for number in range(1, 8):  # more often than a rollout may fail
        one = worker(started, endpoint, "--stop-within", "0.2")
        wait_for(lambda: is_busy(started))
        one.popen.terminate()
        assert one.wait().code == STOPPED, one.err
        assert len(query(directory, "SELECT * FROM outcomes WHERE outcome = 'handed back'")) >= number
    assert outcomes(started) == {"handed back"}
    assert not query(directory, "SELECT * FROM set_aside")
    handed_back = len(query(directory, "SELECT * FROM outcomes"))
    status = started.run("perfbound", "status", directory).out
    assert f"; 0 attempts without a result; {handed_back} attempts handed back; " in status
    counts = json.loads(started.run("perfbound", "status", directory, "--json").out)["attempts"]
    assert counts == {"without_result": 0, "failed_in_system": 0, "handed_back": handed_back}
    finish(started, orchestrator, endpoint)


def test_a_second_signal_ends_a_worker_at_once(started: Processes, slow: Slow) -> None:
    orchestrator, endpoint = slow("200 native")
    one = worker(started, endpoint, "--stop-within", "250")  # of the second signal, not of this time, is the test
    # Not only assigned: what has not begun is handed back at once.
    wait_for((started.folder / "pace.begun").exists)
    one.popen.terminate()
    wait_for(lambda: "a second SIGTERM" in one.err)
    one.popen.terminate()
    assert one.wait().code in (STOPPED, -signal.SIGTERM)
    wait_for(lambda: any("worker lost" in each for each in outcomes(started)))
    finish(started, orchestrator, endpoint)


def test_a_folder_whose_name_is_no_utf_8_is_one_line(started: Processes) -> None:
    folder = started.folder / os.fsdecode(b"bad\xff")
    folder.mkdir()
    (folder / "slow.py").write_text(SYSTEM)
    (folder / "c.toml").write_text(CAMPAIGN.format(tests=4))
    (started.folder / "pace").write_text("0 none")
    pace = {"PACE": str(started.folder / "pace")}  # else its first rollout is at fault
    ended = started.run("perfbound", "run", folder / "c.toml", "--out", started.folder / "run", **pace)
    assert ended.code == 1
    assert "\\udcff" in ended.last_line
    assert "this name is no UTF-8 text, which messages and the database need; rename it" in ended.last_line
