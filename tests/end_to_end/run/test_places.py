"""A place for each worker: what two rollouts of a machine would share, and the check that finds what they do share."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import perfbound as pb
from tests.end_to_end.processes import Processes, wait_for

# What a rollout shares with those of other workers, and the same with the place of its worker.
SHARED = {
    "a scratch file": """
    path = HERE / "scratch.txt"
    path.write_text(repr(x))
    time.sleep(0.005)
    return float(path.read_text())
""",
    "a fixed port": """
    with socket.socket() as heard:
        heard.bind(("127.0.0.1", PORT))
        time.sleep(0.005)
    return x
""",
    "a lock file": """
    lock = HERE / "model.lock"
    os.close(os.open(lock, os.O_CREAT | os.O_EXCL))
    time.sleep(0.005)
    lock.unlink()
    return x
""",
    "a log": """
    with open(HERE / "model.log", "a") as log:
        log.write(f"{x!r}\\n")
    time.sleep(0.005)
    return float((HERE / "model.log").read_text().splitlines()[-1])
""",
    "a file of the temporary folder": """
    path = Path(tempfile.gettempdir(), "state.npy")
    np.save(path, np.array(x))
    time.sleep(0.005)
    return float(np.load(path))
""",
    "the number of a display": """
    with socket.socket(socket.AF_UNIX) as display:
        display.bind("\\0test-display-NUMBER")
        time.sleep(0.005)
    return x
""",
}
OWN = {"HERE": "worker.scratch", "tempfile.gettempdir()": "worker.scratch", "PORT": "worker.port"}
SYSTEM = """
import os, socket, tempfile, time
from pathlib import Path
import numpy as np
import perfbound as pb
HERE, PORT = Path(__file__).parent, FREE

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": ""})
def shares(x, *, worker):BODY"""
PROGRAM = """
import json, os, sys, time
for line in sys.stdin:
    asked = json.loads(line)
    path = os.path.join(PLACE, "scratch.txt")
    with open(path, "w") as file:
        file.write(repr(asked["start"]["x"]))
    time.sleep(0.005)
    x = float("0" + open(path).read())
    with open(asked["path"], "w") as file:
        file.writelines(f"{x}\\n" for _ in range(3))
    print(json.dumps({"request": asked["request"], "done": True}), flush=True)
"""
CAMPAIGN = """
horizon = 1.0
specification = "y >= 0"
max_tests = 60
claims = [{ quantity = "failure_probability" }]
recheck = 20
[system]
CHOICE
[space]
x = [0, 1]
"""


def function(body: str) -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return SYSTEM.replace("BODY", body).replace("FREE", str(free.getsockname()[1]))


def with_its_place(body: str) -> str:
    for shared, own in OWN.items():
        body = body.replace(shared, own)
    return body.replace('"\\0test-display-NUMBER"', 'f"\\0test-display-{worker.number}"')


def finding(started: Processes, reference: str) -> dict[str, str]:
    ended = started.run("perfbound", "check-system", reference, "--json")
    found = {each["check"]: each for each in json.loads(ended.out)["checks"]}
    assert ended.code == (found["together"]["status"] == "failed")
    assert {each["status"] for check, each in found.items() if check not in ("together", "leftovers", "files")} == {
        "passed"
    }, found
    return dict(found["together"])


@pytest.mark.parametrize("shared", SHARED)
def test_what_rollouts_share_is_found_and_the_place_of_the_worker_mends_it(started: Processes, shared: str) -> None:
    file = started.folder / "shares.py"
    file.write_text(function(SHARED[shared]))
    found = finding(started, f"{file}:shares")
    assert found["status"] == "failed", found
    assert "rollouts collide: they repeat alone, and not beside those of another process; at x = " in found["detail"]
    assert "an argument `worker`" in found["remedy"]
    file.write_text(function(with_its_place(SHARED[shared])))
    assert finding(started, f"{file}:shares")["status"] == "passed"


def program(started: Processes, place: str) -> Path:
    (started.folder / "sim.py").write_text(PROGRAM.replace("PLACE", place))
    choice = f'program = ["{sys.executable}", "sim.py"]\ncolumns = {{ y = "m" }}\nstep = 0.5'
    file = started.folder / "sim.toml"
    file.write_text(CAMPAIGN.replace("CHOICE", choice))
    return file


def test_two_programs_in_one_folder_are_found_and_a_run_names_the_collision(started: Processes) -> None:
    file = program(started, '""')
    found = finding(started, str(file))
    assert (found["status"], "PERFBOUND_SCRATCH" in found["remedy"]) == ("failed", True)
    ended = started.run("perfbound", "run", file, "--out", "run", "--workers", "2")
    assert "alone it gives one trajectory, twice: rollouts of workers of one machine seem to collide" in ended.err, (
        ended
    )
    file = program(started, 'os.environ["PERFBOUND_SCRATCH"]')
    assert finding(started, str(file))["status"] == "passed"
    ended = started.run("perfbound", "run", file, "--out", "good", "--workers", "2")
    assert "Recheck: 20 of 20 rollouts" in ended.out
    assert "seem to collide" not in ended.err


ALONE = """
import os, socket
import perfbound as pb
HELD = {}

@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": ""})
def shares(x, *, worker):
    name = f"@test-{os.path.dirname(__file__)}-"
    if not HELD:
        HELD[0] = socket.socket(socket.AF_UNIX)
        HELD[0].bind(f"\\0{name[1:]}{worker.number}")
    if open("/proc/net/unix").read().count(name) > 1:
        raise OSError("the licence is in use")
    return x
"""


def test_a_run_that_ends_by_a_collision_says_so(started: Processes) -> None:
    """Every rollout fails while another worker is there."""
    (started.folder / "shares.py").write_text(ALONE)
    campaign = started.folder / "port.toml"
    campaign.write_text(CAMPAIGN.replace("CHOICE", 'python = "shares.py:shares"').replace("horizon = 1.0\n", ""))
    ended = started.run("perfbound", "run", campaign, "--out", "run", "--workers", "3")
    assert ended.code == 1
    assert "the licence is in use" in ended.last_line
    assert "alone it gives one trajectory, twice: rollouts of workers of one machine seem to collide" in ended.last_line


def test_what_a_campaign_refuses_of_a_rollout_alone_is_no_collision(started: Processes) -> None:
    """It repeats, and is one sample where the horizon is 1 s."""
    (started.folder / "shares.py").write_text(ALONE.partition("    name =")[0] + "    return x\n")
    campaign = started.folder / "port.toml"
    campaign.write_text(CAMPAIGN.replace("CHOICE", 'python = "shares.py:shares"'))
    ended = started.run("perfbound", "run", campaign, "--out", "run", "--workers", "2")
    assert ended.code == 1
    assert "remove `horizon` from the file" in ended.last_line
    assert "seem to collide" not in ended.last_line


# The places themselves

TAKES = "import perfbound as pb, sys; own = pb.Worker.own(); print(own.number, own.scratch, own.port, flush=True); "


@pytest.fixture
def taken(tmp_path: Path) -> Iterator[list[subprocess.Popen[str]]]:
    """Processes with a place each, as many as there are in the list."""
    found: list[subprocess.Popen[str]] = []
    yield found
    for each in found:
        each.kill()
        each.communicate()


def takes(taken: list[subprocess.Popen[str]], folder: Path, then: str = "sys.stdin.read()") -> tuple[int, Path, int]:
    taken.append(
        subprocess.Popen(
            [sys.executable, "-c", TAKES + then],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "TMPDIR": str(folder)},
        )
    )
    assert taken[-1].stdout is not None
    number, scratch, port = taken[-1].stdout.readline().split()
    return int(number), Path(scratch), int(port)


@pytest.mark.journey
def test_no_live_process_shares_its_place_and_a_killed_one_leaves_it(
    taken: list[subprocess.Popen[str]], tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    # Also where they have other temporary folders.
    places = [takes(taken, folder) for folder in (tmp_path, tmp_path, other)]
    for values in zip(*places, strict=True):
        assert len(set(values)) == 3
    assert all(list(scratch.iterdir()) == [] for _, scratch, _ in places)
    number, scratch, _ = places[1]
    (scratch / "big").write_bytes(b"1")
    taken[1].send_signal(signal.SIGKILL)
    taken[1].wait()
    assert scratch.exists()
    again = takes(taken, tmp_path)
    assert again[0] <= number, "the smallest that is free"
    assert not scratch.exists(), "removed by the next one"
    assert places[0][1].exists()
    taken[0].communicate("")
    wait_for(lambda: not places[0][1].exists())


def test_a_forked_process_has_another_place(taken: list[subprocess.Popen[str]], tmp_path: Path) -> None:
    # One write each: two processes share the pipe, and print may write a line in pieces.
    fork = (
        "import os; pid = os.fork(); own = pb.Worker.own();"
        "os.write(1, f'{own.number} {own.scratch} {own.port}\\n'.encode()); "
    )
    first = takes(taken, tmp_path, f"{fork} pid and os.waitpid(pid, 0); os._exit(0)")
    assert taken[-1].stdout is not None
    rest = [tuple(line.split()) for line in taken[-1].stdout.read().splitlines()]
    named = (str(first[0]), str(first[1]), str(first[2]))
    assert named in rest
    (forked,) = (each for each in rest if each != named)
    assert not set(forked) & set(named)


def test_its_folder_is_emptied_when_asked() -> None:
    own = pb.Worker.own()
    (own.scratch / "a" / "b").mkdir(parents=True)
    (own.scratch / "link").symlink_to("/")
    assert own.emptied() == own.scratch
    assert list(own.scratch.iterdir()) == []
    assert Path("/").exists()


def test_a_temporary_folder_without_room_is_one_line(taken: list[subprocess.Popen[str]], tmp_path: Path) -> None:
    code = "import tempfile; tempfile.tempdir = '/proc'; import perfbound as pb; pb.Worker.own()"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "SimulationError: /proc: the worker gets no folder of its own there (" in ended.stderr.splitlines()[-1]
    assert ended.stderr.endswith("set TMPDIR to a folder with room, which you may write\n")
