"""The main job on the real parts: processes, PyBullet, Zenoh, MCAP, SQLite; and what kills them."""

import os
import random
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import trustme
from mcap.reader import make_reader

from perfbound.orchestrator.store import lock, read
from perfbound.schemas.trajectory.trajectory import decode
from tests.end_to_end.processes import (
    ROLLOUTS,
    Process,
    Processes,
    attempts,
    catch,
    of_run,
    query,
    recorded,
    under_way,
    wait_for,
    write_campaign,
)
from tests.faults.subjects import function_campaign, install
from tests.faults.verdict import REPRODUCIBLE, without
from tests.sharing import free_port

RESUME = "perfbound: stopped; continue with: perfbound resume run\n"


@pytest.fixture
def directory(tmp_path: Path) -> Iterator[Path]:
    """Return the run directory; afterwards nothing but it is left."""
    shared = set(os.listdir("/dev/shm"))
    yield tmp_path / "run"
    assert not list(tmp_path.rglob("*.partial"))
    assert not lock.is_held(tmp_path / "run")
    assert {name for name in os.listdir("/dev/shm") if "zenoh" in name} <= shared


def start(started: Processes, *arguments: str | Path) -> Process:
    campaign = write_campaign(started.folder / "c.toml")
    return started.start("perfbound", "run", campaign, "--out", started.folder / "run", *arguments)


def finished(directory: Path, calm: Path) -> bool:
    """Whether the campaign ended with the bytes of the calm one."""
    return (directory / "certificate.json").read_bytes() == (calm / "certificate.json").read_bytes()


def gone(directory: Path) -> bool:
    return not of_run(directory)


# The calm run


@pytest.mark.journey
@pytest.mark.smoke
def test_every_rollout_has_its_file_and_two_workers_served_them(calm: Path) -> None:
    rows = query(calm, "SELECT path, sha256 FROM rollouts")
    assert len(rows) == ROLLOUTS
    for path, _ in rows:
        file = calm / str(path)
        trajectory = decode(file.read_bytes())
        assert (trajectory.columns[0], len(trajectory.samples)) == ("t", 2401)
        with file.open("rb") as stream:
            for _ in make_reader(stream, validate_crcs=True).iter_messages():
                pass
    assert {str(path) for path, _ in rows} == {
        str(path.relative_to(calm)) for path in (calm / "trajectories").rglob("*") if path.is_file()
    }
    workers = query(calm, "SELECT DISTINCT pid FROM attempts JOIN outcomes USING (rollout, attempt)")
    assert len(workers) == 2
    assert gone(calm)


@pytest.mark.smoke
def test_the_manifest_is_checked_by_sha256sum(calm: Path) -> None:
    command = ["sha256sum", "--check", "--strict", "manifest.sha256"]
    checked = subprocess.run(command, cwd=calm, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr
    assert checked.stdout.count(": OK\n") == ROLLOUTS


@pytest.mark.parametrize("workers", [pytest.param("1", marks=pytest.mark.journey), "3"])
def test_the_number_of_workers_changes_no_byte(started: Processes, directory: Path, calm: Path, workers: str) -> None:
    ended = start(started, "--workers", workers).wait()
    assert ended.code == 0, ended.err
    assert finished(directory, calm)
    assert (directory / "manifest.sha256").read_bytes() == (calm / "manifest.sha256").read_bytes()
    assert "pybullet" not in ended.err, "the simulator's greeting stays in the worker"
    assert str(directory / "certificate.json") in ended.out
    assert gone(directory)


# Deaths


def sessions(directory: Path) -> int:
    return int(str(query(directory, "SELECT count(*) FROM sessions")[0][0]))


@pytest.mark.smoke
def test_an_orchestrator_killed_again_and_again(started: Processes, directory: Path, calm: Path) -> None:
    chance = random.Random(7)
    kills = sorted(chance.sample(range(1, ROLLOUTS // 2), 3))
    process = start(started)
    for session, kill in enumerate(kills, start=1):
        # On a busy machine one session may reach the rollouts of two kills: each kill is of a session of its own.
        wait_for(lambda kill=kill: recorded(directory) >= kill)  # type: ignore[misc]
        wait_for(lambda session=session: sessions(directory) == session)  # type: ignore[misc]
        time.sleep(chance.uniform(0, 0.05))
        process.popen.kill()
        assert process.wait().code == -signal.SIGKILL
        assert kill <= recorded(directory) < ROLLOUTS, "killed in mid-run"
        assert not (directory / "certificate.json").exists()
        process = started.start("perfbound", "resume", directory)
    ended = process.wait()
    assert ended.code == 0, ended.err
    assert finished(directory, calm)
    assert sessions(directory) == 4
    wait_for(lambda: gone(directory))


def test_a_killed_run_leaves_no_worker(started: Processes, directory: Path) -> None:
    process = start(started)
    wait_for(lambda: under_way(directory))
    workers = process.children()
    assert len(workers) == 2 * 2, "each with its guardian"
    process.popen.kill()
    wait_for(lambda: not any(worker.is_running() for worker in workers))
    assert gone(directory)


@pytest.mark.smoke
def test_a_killed_worker_shows_as_a_second_attempt(started: Processes, directory: Path, calm: Path) -> None:
    process = start(started)
    rollout, worker = catch(directory, lambda: recorded(directory) >= 2)
    worker.kill()
    ended = process.wait()
    assert ended.code == 0, ended.err
    assert attempts(directory, rollout) == [(1, "worker lost for 3 s"), (2, "recorded")]
    assert finished(directory, calm)
    assert " ended (signal 9); started local-" in ended.err
    assert gone(directory)


def test_a_stopped_worker_is_lost_and_harmless_when_it_comes_back(
    started: Processes, directory: Path, calm: Path
) -> None:
    process = start(started)
    rollout, worker = catch(directory, lambda: recorded(directory) >= 2)
    wait_for(lambda: (2, "recorded") in attempts(directory, rollout))
    worker.resume()
    assert process.running, "it comes back to a campaign that continues"
    ended = process.wait()
    assert ended.code == 0, ended.err
    assert attempts(directory, rollout) == [(1, "worker lost for 3 s"), (2, "recorded")]
    assert finished(directory, calm)
    assert gone(directory)


# A system that fails


def test_a_system_that_raises_once_keeps_every_number_and_is_shown_as_irreproducible(
    started: Processes, directory: Path
) -> None:
    campaign, plugins = started.folder / "c.toml", install(started.folder / "plugins")
    campaign.write_text(function_campaign("once", "function", tests=8, pace=0.04))
    calm, plan = started.folder / "calm", started.folder / "plan"
    path = {"PYTHONPATH": str(plugins), "FAULTY_PLAN": str(plan)}
    assert started.run("perfbound", "run", campaign, "--out", calm, **path).code == 0
    ((seed,),) = query(calm, "SELECT seed FROM rollouts WHERE problem = 'maximum' AND test = 3")
    (plan / "taken").mkdir(parents=True)
    (plan / f"{seed}-0-raise").touch()
    ended = started.run("perfbound", "run", campaign, "--out", directory, **path)
    assert ended.code == 0, ended.err
    failure = "system failure: RuntimeError: the solver did not converge\\nat all"
    assert len([line for line in ended.err.splitlines() if line.startswith("maximum.3.") and failure in line]) == 1
    assert (directory / "manifest.sha256").read_bytes() == (calm / "manifest.sha256").read_bytes()
    certificates = [(each / "certificate.json").read_bytes() for each in (calm, directory)]
    assert without(certificates[0], REPRODUCIBLE) == without(certificates[1], REPRODUCIBLE)
    assert [read.irreproducible(each) for each in (calm, directory)] == [0, 1]
    assert "1 attempt without a result (1 failed in the system)" in started.run("perfbound", "status", directory).out
    failures = started.run("perfbound", "export", directory, "failures", "--out", "-").out
    assert len(failures.splitlines()) > 1
    assert "maximum.3.nominal.0,1,local-" in failures or "maximum.3.true.0,1,local-" in failures
    assert ",system," in failures


# Signals, and output for people


@pytest.mark.smoke
def test_ctrl_c_waits_for_no_rollout(started: Processes, directory: Path) -> None:
    """Every rollout lasts an hour: a wait for one would reach the limit of the test."""
    campaign, plugins = started.folder / "c.toml", install(started.folder / "plugins")
    campaign.write_text(function_campaign("endless", "slow", pace=3600.0, deadline=36000.0))
    process = started.start("perfbound", "run", campaign, "--out", "run", PYTHONPATH=str(plugins))
    wait_for(lambda: len(under_way(directory)) == 2)
    process.signal_group(signal.SIGINT)
    ended = process.wait()
    assert (ended.code, ended.out) == (130, "")
    assert ended.err.endswith(RESUME)
    assert (recorded(directory), len(under_way(directory))) == (0, 2)
    assert gone(directory)
    assert not lock.is_held(directory)


def test_an_impatient_person_presses_ctrl_c_again_and_again(started: Processes, directory: Path) -> None:
    campaign = write_campaign(started.folder / "c.toml")
    process = started.start("perfbound", "run", campaign, "--out", "run")
    wait_for(lambda: recorded(directory) >= 3)
    while process.running:
        process.signal_group(signal.SIGINT)
        time.sleep(0.005)
    ended = process.wait()
    assert (ended.code, ended.last_line) == (130, RESUME.strip())
    assert gone(directory)


@pytest.mark.parametrize("busy", [0.0, 0.3], ids=["idle", "busy"])
def test_a_signal_that_meets_a_destructor_is_not_lost(started: Processes, busy: float) -> None:
    """Nor when its repetition arrives before the process is back from where it was noticed, as on a busy machine."""
    (started.folder / "dying.py").write_text(
        "import os, signal, threading, time\n"
        "from perfbound.orchestrator.cli import entry\n"
        "start = threading.Thread.start\n"
        f"threading.Thread.start = lambda thread: (start(thread), time.sleep({busy}))\n"
        "class Dying:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "        time.sleep(0)\n"
        "def run():\n"
        "    Dying()\n"
        "    time.sleep(30)\n"
        "entry._main = run\n"
        "entry.main()\n"
    )
    ended = started.run("python", "dying.py")
    assert (ended.code, ended.err) == (143, "perfbound: stopped; nothing was changed\n")


def test_the_exit_code_is_that_of_the_campaign_though_its_link_has_not_ended(started: Processes) -> None:
    """As where a peer does not read: threads that wait for its messages are in compiled code then."""
    write_campaign(started.folder / "c.toml")
    (started.folder / "linked.py").write_text(
        "from perfbound.orchestrator.cli import main\n"
        "from perfbound.orchestrator.fleet.link.transport import ZenohTransport\n"
        "ZenohTransport.close = lambda transport: None\n"
        "main()\n"
    )
    ended = started.run("python", "linked.py", "run", "c.toml", "--out", "run", "--workers", "1")
    assert ended.code == 0, ended.err
    assert (started.folder / "run" / "certificate.json").exists()
    assert not (started.folder / "run" / "campaign.db-wal").exists(), "the database is closed"


EVERY_LINE = """
import atexit, os, signal, sys
from perfbound.orchestrator.cli import entry, exits, pipes

HERE = {each.__file__ for each in (entry, exits, pipes)}


def end_with_a_signal(lines):
    ended = False

    def trace(frame, event, _):
        nonlocal lines
        if ended and event == "line":
            lines -= 1
            if lines == 0:
                os.write(2, b"sent\\n")
                os.kill(os.getpid(), signal.SIGTERM)
        return trace if frame.f_code.co_filename in HERE else None

    def command(**_):
        nonlocal ended
        ended = True
        print("result")

    entry.cli = command
    sys.settrace(trace)
    entry.main()


for lines in range(1, 60):
    if not os.fork():
        atexit.register(os._exit, 134)  # called last: the interpreter continues to its end
        sys.exit(end_with_a_signal(lines))
    print(os.waitstatus_to_exitcode(os.wait()[1]), flush=True)
"""


def test_a_signal_while_a_command_ends_does_not_spoil_its_end(started: Processes) -> None:
    """At every line between the end of the command and that of its process."""
    ended = started.run("python", "-c", EVERY_LINE)
    assert ended.code == 0, ended.err
    codes = [line for line in ended.out.splitlines() if line != "result"]
    assert (len(codes), set(codes), ended.out.count("result")) == (59, {"0", "143"}, 59), ended.err
    assert set(ended.err.splitlines()) == {"sent", "perfbound: stopped; nothing was changed"}, ended.err
    assert ended.err.count("sent") > 20, "the lines at which the signal came"


def test_a_signal_before_anything_is_made(started: Processes) -> None:
    process = start(started)
    wait_for(process.children)  # the child that is asked for the systems
    process.signal_group(signal.SIGINT)
    ended = process.wait()
    assert (ended.code, ended.err) == (130, "perfbound: stopped; nothing was started\n")
    assert not (started.folder / "run").exists()


@pytest.mark.journey
def test_status_while_it_runs_when_stopped_and_at_the_end(started: Processes, directory: Path, calm: Path) -> None:
    campaign = write_campaign(started.folder / "c.toml")
    process = started.start("perfbound", "run", campaign, "--out", "run")
    wait_for(lambda: recorded(directory) >= 2)
    process.popen.send_signal(signal.SIGSTOP)  # or the campaign is over before it is asked
    process_state = started.run("perfbound", "status", "run")
    process.popen.terminate()
    process.popen.send_signal(signal.SIGCONT)
    stopped = process.wait()
    assert (stopped.code, stopped.out, stopped.last_line) == (143, "", RESUME.strip())
    assert "segway-paper  running, seed 1, run " in process_state.out
    assert " of 8" in process_state.out
    assert "worker local-" in process_state.out
    after = started.run("perfbound", "status", "run").out
    assert "segway-paper  stopped, seed 1, run " in after
    assert after.endswith("\ncontinue with: perfbound resume run\n")
    resumed = started.run("perfbound", "resume", "run", "--workers", "1")
    assert resumed.code == 0, resumed.err
    assert finished(directory, calm)
    final = started.run("perfbound", "status", "run").out
    assert "segway-paper  finished, seed 1, run " in final
    assert "2 starts of the orchestrator" in final
    assert resumed.out in final, "the summary is the same"
    shown = started.run("perfbound", "show", "run").out
    assert "min over d of E[robustness of the nominal system], of values clipped to [-0.05, 0.75] >= -" in shown


# Workers of their own


def test_workers_that_outlive_the_orchestrator(started: Processes, directory: Path, calm: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    early = started.start("perfbound-worker", "--connect", endpoint, "--name", "early")
    campaign = write_campaign(started.folder / "c.toml")
    process = started.start("perfbound", "orchestrate", campaign, "--out", directory, "--listen", endpoint)
    late = started.start("perfbound-worker", "--connect", endpoint, "--name", "late")
    names = "SELECT DISTINCT pid FROM attempts"
    wait_for(lambda: len(query(directory, names)) == 2 and recorded(directory) >= 4)
    process.popen.kill()
    assert process.wait().code == -signal.SIGKILL
    assert recorded(directory) < ROLLOUTS, "in mid-run"
    resumed = started.start("perfbound", "resume", directory, "--workers", "0", "--listen", endpoint)
    ended = resumed.wait()
    assert ended.code == 0, ended.err
    assert f"waiting for workers: perfbound-worker --connect {endpoint}\n" in ended.err
    assert finished(directory, calm)
    assert set(query(directory, names)) == {(early.pid,), (late.pid,)}
    assert early.running
    assert late.running
    late.popen.send_signal(signal.SIGINT)
    assert late.wait().code == 130
    early.popen.terminate()
    assert early.wait().code == 128 + signal.SIGTERM


@pytest.fixture
def certificates(tmp_path: Path) -> Callable[[str], list[str]]:
    """Return a maker of TLS options; each name has an authority of its own."""
    authorities: dict[str, trustme.CA] = {}

    def make(authority: str, name: str | None = None) -> list[str]:
        ca = authorities.setdefault(authority, trustme.CA())
        issued = ca.issue_cert("127.0.0.1", common_name=name)
        folder = tmp_path / f"tls-{authority}-{name}"
        folder.mkdir(exist_ok=True)
        ca.cert_pem.write_to_path(folder / "ca.pem")
        issued.private_key_pem.write_to_path(folder / "key.pem")
        (folder / "key.pem").chmod(0o600)
        issued.cert_chain_pems[0].write_to_path(folder / "certificate.pem")
        options = (("--tls-ca", "ca"), ("--tls-key", "key"), ("--tls-certificate", "certificate"))
        return [part for option, name in options for part in (option, str(folder / f"{name}.pem"))]

    return make


def test_mutual_tls_keeps_strangers_out(
    started: Processes, directory: Path, calm: Path, certificates: Callable[[str], list[str]]
) -> None:
    port = free_port()
    ours, theirs = certificates("ours"), certificates("theirs")
    campaign = write_campaign(started.folder / "c.toml")
    listen = ["--listen", f"tls/127.0.0.1:{port}", *ours]
    process = started.start("perfbound", "orchestrate", campaign, "--out", directory, *listen)
    wait_for(lambda: "waiting for workers" in process.err)
    strangers = [
        started.start("perfbound-worker", "--connect", f"tls/127.0.0.1:{port}", *theirs),
        started.start("perfbound-worker", "--connect", f"tcp/127.0.0.1:{port}"),
    ]
    wait_for(lambda: all(stranger.err for stranger in strangers))
    assert not query(directory, "SELECT * FROM attempts")
    assert f"the certificate of 127.0.0.1:{port} is not signed by {theirs[1]}; " in strangers[0].err
    assert f"tcp/127.0.0.1:{port} is encrypted; write tls/HOST:PORT, with --tls-ca, " in strangers[1].err
    ours_worker = started.start("perfbound-worker", "--connect", f"tls/127.0.0.1:{port}", *ours)
    ended = process.wait()
    assert ended.code == 0, ended.err
    assert query(directory, "SELECT DISTINCT pid FROM attempts") == [(ours_worker.pid,)]
    assert finished(directory, calm)


@pytest.mark.journey
def test_local_workers_over_mutual_tls(
    started: Processes, directory: Path, calm: Path, certificates: Callable[..., list[str]]
) -> None:
    """Also where only the workers of a list are taken besides."""
    ended = start(started, "--listen", "tls/127.0.0.1:0", *certificates("ours", "server"), "--allow", "w1").wait()
    assert ended.code == 0, ended.err
    assert finished(directory, calm)


def orchestrate(started: Processes, endpoint: str, *arguments: str, **environment: str) -> Process:
    """Start an orchestrator without workers of its own, and wait until it listens."""
    campaign = write_campaign(started.folder / "c.toml")
    line = ("perfbound", "orchestrate", campaign, "--out", started.folder / "run", "--listen", endpoint)
    process = started.start(*line, *arguments, **environment)
    wait_for(lambda: "waiting for workers" in process.err)
    return process


def test_an_allowed_worker_has_the_name_of_its_certificate(
    started: Processes, directory: Path, calm: Path, certificates: Callable[..., list[str]]
) -> None:
    endpoint, own = f"tls/127.0.0.1:{free_port()}", certificates("ours", "w1")
    process = orchestrate(started, endpoint, *certificates("ours", "server"), "--allow", "w1")
    named = started.run("perfbound-worker", "--connect", endpoint, *own, "--name", "w2")
    assert named.code == 1
    assert named.fault == (
        f"perfbound-worker: --name w2: {endpoint} was started with --allow, so a worker has the common name of its "
        "certificate, here 'w1'; leave --name out"
    )
    started.start("perfbound-worker", "--connect", endpoint, *own)
    ended = process.wait()
    assert ended.code == 0, ended.err
    assert finished(directory, calm)
    ((name,),) = query(directory, "SELECT DISTINCT worker FROM attempts")
    assert str(name).rpartition("-")[0] == "w1"


def test_processes_of_one_user_meet_and_others_are_refused(started: Processes, directory: Path, calm: Path) -> None:
    """Without a flag; each stranger gets one sentence with both remedies."""
    ours, theirs = ({"XDG_STATE_HOME": str(started.folder / name)} for name in ("ours", "theirs"))
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    process = orchestrate(started, endpoint, **ours)
    worker = ("perfbound-worker", "--connect", endpoint)
    strangers = [
        started.start(*worker, **theirs),
        started.start(*worker, **ours, PERFBOUND_SECRET="a secret of another user"),
        started.start(*worker, "--insecure", **ours),
        started.start("perfbound-worker", "--connect", f"tcp/127.0.0.1:{free_port()}", **ours),
    ]
    wait_for(lambda: all(each.err for each in strangers))
    place = started.folder / "theirs" / "perfbound" / "secret"
    assert strangers[0].err.splitlines()[0] == (
        f"perfbound-worker: something listens at {endpoint}, but refuses this worker: start both as the same user "
        f"(their secret is in {place}), or set PERFBOUND_SECRET to the same text for both"
    )
    assert ["refuses this worker" in each.err for each in strangers] == [True, True, True, False]
    assert "no answer from" in strangers[3].err
    secret = (started.folder / "ours" / "perfbound" / "secret").read_text().strip()
    friends = [started.start(*worker, **ours), started.start(*worker, **theirs, PERFBOUND_SECRET=secret)]
    ended = process.wait()
    assert ended.code == 0, ended.err
    assert finished(directory, calm)
    found = {pid for (pid,) in query(directory, "SELECT DISTINCT pid FROM attempts")}
    assert found <= {friend.pid for friend in friends}


# Without a campaign


@pytest.mark.journey
def test_one_rollout_has_equal_bytes_for_equal_seeds(started: Processes) -> None:
    options = ["--x", "5,0", "--variant", "true", "--horizon", "2"]
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        ended = started.run("perfbound", "simulate", "segway", *options, "--seed", seed, "--out", name)
        assert (ended.code, ended.err) == (0, "")
        assert f"241 samples in {name}\n" in ended.out
    a, b, c = ((started.folder / name).read_bytes() for name in "abc")
    assert a == b
    assert a != c
    assert decode(a).samples[-1, 0] == 2.0


def test_the_systems_are_listed(started: Processes) -> None:
    ended = started.run("perfbound", "systems")
    assert (ended.code, ended.err) == (0, "")
    assert "segway: " in ended.out
    assert "  option    gains = paper (allowed: paper | aggressive) tuning of the controller\n" in ended.out
    assert "test-function: J(z) = sin(z1) cos(z2) / 2\n" in ended.out


def test_a_folder_called_workers_is_not_ours(started: Processes) -> None:
    (started.folder / "workers").mkdir()
    (started.folder / "workers" / "__init__.py").write_text("raise RuntimeError('imported from the present directory')")
    ended = started.run("perfbound", "systems")
    assert (ended.code, ended.err) == (0, "")
