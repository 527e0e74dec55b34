"""`perfbound stop`, from another process: what it stops, how, and what it refuses."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from perfbound.orchestrator.cli import stop
from perfbound.orchestrator.store import lock, stop_request
from tests.campaigns import FOLDER
from tests.end_to_end.processes import Process, Processes, query, recorded, under_way, wait_for
from tests.patience import PATIENCE

FUNCTION = """import time

import perfbound as pb


@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": "m"})
def slow(x):
    time.sleep(0.1)
    return 1 + (x - 0.3) ** 2
"""
FILE = """system.python = "slow.py:slow"
name = "slow"
specification = "y >= 0.5"
space = { x = { low = 0, high = 1 } }
resolution = 201
alpha = 0.001
rkhs_norm = 4
noise_scale = 0
prior_mean = -1
max_tests = 60
recheck = 0
spot_check = 0
kernel = { length_scale = 0.1 }
"""
LIBRARY = """import sys
import threading

import perfbound as pb

failures = []


def run():
    try:
        pb.Campaign.load("slow.toml").run("run", progress=False)
    except KeyboardInterrupt as stopped:
        failures.append(str(stopped))


if sys.argv[1] == "thread":
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
else:
    run()
print(*failures)
"""


@pytest.fixture
def slow(started: Processes) -> Processes:
    (started.folder / "slow.py").write_text(FUNCTION)
    (started.folder / "slow.toml").write_text(FILE)
    return started


def begun(process: Process, directory: Path) -> None:
    wait_for(lambda: recorded(directory) >= 3 or not process.running)
    assert process.running, process.err


def whole(started: Processes) -> bytes:
    """The certificate of the campaign that nobody stops."""
    assert started.run("perfbound", "run", "slow.toml", "--out", "calm").code == 0
    return (started.folder / "calm" / "certificate.json").read_bytes()


@pytest.mark.journey
def test_a_run_is_stopped_and_resumed_and_another_one_stays(slow: Processes) -> None:
    directory = slow.folder / "run"
    other = slow.start("perfbound", "run", "slow.toml", "--out", "other")
    process = slow.start("perfbound", "run", "slow.toml", "--out", directory)
    begun(process, directory)
    begun(other, slow.folder / "other")
    ended = slow.run("perfbound", "stop", directory)
    assert (ended.code, ended.err) == (0, "")
    assert ended.out == f"stopped; continue with: perfbound resume {directory}\n"
    stopped = process.wait()
    assert stopped.code == 128 + signal.SIGINT
    assert "`perfbound stop` has asked for the end of this run" in stopped.err
    assert stopped.err.endswith(f"perfbound: stopped; continue with: perfbound resume {directory}\n")
    assert other.running
    assert not stop_request.is_waiting(directory)
    assert recorded(directory) < 60
    resumed = slow.start("perfbound", "resume", directory)
    wait_for(lambda: len(query(directory, "SELECT * FROM sessions")) == 2)
    assert resumed.wait().code == 0, "no request of before stops it"
    assert (directory / "certificate.json").read_bytes() == whole(slow)
    assert other.wait().code == 0


def test_draining_records_what_is_under_way(slow: Processes) -> None:
    directory = slow.folder / "run"
    process = slow.start("perfbound", "run", "slow.toml", "--out", directory, "--log", "json")
    begun(process, directory)
    assert slow.run("perfbound", "stop", directory, "--drain").code == 0
    stopped = process.wait()
    assert stopped.code == 128 + signal.SIGINT
    assert "draining: " in stopped.err
    assert not under_way(directory)
    assert not query(directory, "SELECT * FROM outcomes WHERE outcome <> 'recorded'")


def test_a_resumed_and_an_orchestrated_campaign_are_stopped(slow: Processes) -> None:
    directory = slow.folder / "run"
    process = slow.start("perfbound", "orchestrate", "slow.toml", "--out", directory)
    wait_for(lambda: query(directory, "SELECT * FROM sessions") and lock.is_held(directory))
    assert slow.run("perfbound", "stop", directory).code == 0
    assert process.wait().code == 128 + signal.SIGINT
    resumed = slow.start("perfbound", "resume", directory)
    begun(resumed, directory)
    assert slow.run("perfbound", "stop", directory).code == 0
    assert resumed.wait().code == 128 + signal.SIGINT


@pytest.mark.parametrize("where", ["main", "thread"])
def test_a_campaign_of_the_library_is_stopped_in_any_thread(slow: Processes, where: str) -> None:
    directory = slow.folder / "run"
    (slow.folder / "program.py").write_text(LIBRARY)
    process = slow.start("python", "program.py", where)
    begun(process, directory)
    assert slow.run("perfbound", "stop", directory).code == 0
    ended = process.wait()
    assert ended.code == 0, "the program itself continues"
    assert f"perfbound.resume('{directory}') continues" in ended.out


def test_what_cannot_be_stopped_is_refused(slow: Processes) -> None:
    (slow.folder / "empty").mkdir()
    assert slow.run("perfbound", "stop", "empty").fault.startswith("perfbound: empty: no campaign here")
    assert slow.run("perfbound", "stop", "nowhere").fault.startswith("perfbound: nowhere: no campaign here")
    process = slow.start("perfbound", "run", "slow.toml", "--out", "run")
    begun(process, slow.folder / "run")
    process.popen.send_signal(signal.SIGKILL)
    process.wait()
    killed = slow.run("perfbound", "stop", "run")
    assert killed.code == 1
    assert killed.fault == (
        "perfbound: run: no process runs the campaign, nothing is left to stop; continue it with `perfbound resume run`"
    )
    assert slow.run("perfbound", "resume", "run").code == 0
    finished = slow.run("perfbound", "stop", "run")
    assert finished.fault == "perfbound: run: the campaign has finished, nothing is left to stop"
    assert not stop_request.is_waiting(slow.folder / "run")


HOLDER = """import sys, time
from pathlib import Path
from perfbound.orchestrator.store.lock import campaign_lock
with campaign_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_process_that_takes_no_request_is_named_and_lives(slow: Processes) -> None:
    assert slow.run("perfbound", "run", FOLDER / "test-function.toml", "--out", "run").code == 0
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(slow.folder / "run")], stdout=subprocess.PIPE, text=True
    ) as holder:
        try:
            assert holder.stdout is not None
            assert holder.stdout.readline() == "held\n"
            ended = slow.run("perfbound", "stop", "run", "--wait", "0.3")
            assert ended.code == 1
            assert "has not taken the request within 0.3 s" in ended.fault
            assert holder.poll() is None
            assert not stop_request.is_waiting(slow.folder / "run")
        finally:
            holder.kill()
            holder.wait(PATIENCE)


def test_another_host_is_named(slow: Processes, monkeypatch: pytest.MonkeyPatch) -> None:
    (slow.folder / "slow.toml").write_text(FILE.replace("max_tests = 60", "max_tests = 20"))
    process = slow.start("perfbound", "run", "slow.toml", "--out", "run")
    begun(process, slow.folder / "run")
    assert slow.run("perfbound", "stop", "run").code == 0
    uname = os.uname()
    monkeypatch.setattr(os, "uname", lambda: os.uname_result(("Linux", "elsewhere", *uname[2:])))
    words = stop._why_not_running(slow.folder / "run")
    assert f"the last one that did was on {uname.nodename}: stop it there" in words


def test_a_run_says_what_holds_and_what_is_refuted_in_lines_for_programs(slow: Processes) -> None:
    """The noise scale is far too small: it is refuted while the campaign runs, and with "stop" that ends it."""
    noisy = FUNCTION.replace("def slow(x):", "def slow(x, *, seed):").replace(
        "return 1 + (x - 0.3) ** 2", "return 1 + (x - 0.3) ** 2 + 0.5 * (seed % 997) / 997"
    )
    (slow.folder / "slow.py").write_text(noisy)
    file = FILE.replace(
        "noise_scale = 0\n", 'noise_scale = 0.02\nclip = [-5, 5]\nreplicates = 4\non_refuted = "stop"\n'
    )
    (slow.folder / "slow.toml").write_text(file.replace("max_tests = 60", "max_tests = 1000"))
    process = slow.start("perfbound", "run", "slow.toml", "--out", "run", "--log", "json")
    wait_for(lambda: (slow.folder / "run" / "so-far.json").exists() or not process.running)
    state = slow.run("perfbound", "status", "run", "--json")
    found = json.loads(state.out)
    assert found["state"] in ("running", "finished")
    ended = process.wait()
    assert ended.code == 0, ended.err
    lines = [json.loads(line) for line in ended.err.splitlines()]
    (line,) = [each for each in lines if each["message"] == "refuted" and each["assumption"].startswith("replicate")]
    assert line["level"] == "warning"
    assert line["assumption"] == "replicate_spread/robustness"
    assert line["then"] == "robustness ends here"
    assert not (slow.folder / "run" / "so-far.json").exists(), "the certificate has everything"
    last = json.loads(slow.run("perfbound", "status", "run", "--json").out)
    assert last["state"] == "finished"
    assert last["verdict"]["verdict"] == "NOT SHOWN"
    assert last["so_far"] is None
    assert last["problems"][0]["stopped_by"] == "refuted"
    assert slow.run("perfbound", "verify", "run").code == 0


def test_a_run_writes_its_verdict_so_far_periodically(slow: Processes) -> None:
    (slow.folder / "slow.toml").write_text(FILE.replace("max_tests = 60", "max_tests = 1000"))
    process = slow.start("perfbound", "run", "slow.toml", "--out", "run", "--log", "json")
    wait_for(lambda: '"so far"' in process.err or not process.running)
    assert slow.run("perfbound", "stop", "run").code == 0
    (line, *_) = [each for each in map(json.loads, process.wait().err.splitlines()) if each["message"] == "so far"]
    assert line["verdict"] in ("SHOWN", "NOT SHOWN")
    assert 0 < line["expected"]["share"] < 1
    stopped = json.loads(slow.run("perfbound", "status", "run", "--json").out)
    assert stopped["state"] == "stopped"
    assert stopped["so_far"]["verdict"] in ("SHOWN", "NOT SHOWN")
    assert stopped["resume"] == "perfbound resume run"
