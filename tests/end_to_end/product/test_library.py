"""perfbound from Python in real processes: its page, its notebook, kills and interrupts, functions without a file."""

import shutil
import signal
from pathlib import Path

import psutil
import pytest

import perfbound as pb
from tests.end_to_end.processes import Ended, Process, Processes, recorded, wait_for

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "deploy" / "examples"
KEYS = """
import time, signal, threading
import numpy as np
import perfbound as pb

KEYS = dict(
    space={"gap": (20, 50), "speed": (10, 30)}, specification="always (distance >= 2)", horizon=8.0, clip=(-20, 60),
    replicates=4, max_tests=8, delta=0.05, alpha=3.0, rkhs_norm=40, prior_mean=-25, noise_scale=2.1,
    kernel={"nu": 2.5, "length_scale": {"gap": 30, "speed": 20}}, spot_check=6, spot_check_followups=4, recheck=3,
)
"""
TOLD = """
from cars import cars

with pb.Campaign(cars, **KEYS).ask_tell("told") as study:
    while (request := study.ask()) is not None:
        time.sleep(0.02)
        study.tell(request, cars(*request.x, seed=request.seed, horizon=request.horizon))
"""
TYPED = """
@pb.system(
    parameters={"gap": pb.Parameter(5, 60, unit="m"), "speed": pb.Parameter(5, 35, unit="m/s")},
    columns={"distance": "m"}, step=0.05,
)
def typed(gap, speed, *, seed, horizon):
    time.sleep(0.02)
    t = np.arange(0.0, horizon + 0.025, 0.05)
    return (gap - 0.02 * speed * t + 0.1 * np.random.default_rng(seed).uniform(),)

campaign = pb.Campaign(typed, **KEYS)
"""


def certificate(directory: Path) -> bytes:
    return (directory / "certificate.json").read_bytes()


def script(started: Processes, *parts: str) -> Process:
    """Start Python with a text that is in no file."""
    return started.start("python", "-c", "".join((KEYS, *parts)), PYTHONUNBUFFERED="1")


def of_cells(started: Processes, path: Path) -> Ended:
    return started.start("python", "-m", "tests.end_to_end.methods.cells", path, PYTHONPATH=f"{ROOT}").wait()


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The certificate of the typed function, without trouble."""
    folder = tmp_path_factory.mktemp("typed")
    found = Processes(folder)
    try:
        ended = script(found, TYPED, "campaign.run('run')").wait()
    finally:
        found.end()
    assert ended.code == 0, ended.err
    assert "typed: one worker, forked from this process: no file defines it" in ended.err
    return certificate(folder / "run")


def test_the_examples_of_the_page_run_and_are_those_of_the_command(started: Processes, tmp_path: Path) -> None:
    shutil.copy(EXAMPLES / "cars" / "cars.py", tmp_path)
    ended = of_cells(started, ROOT / "docs" / "library.md")
    assert ended.code == 0, ended.err
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    runs = {each.name: pb.open(each).certificate for each in (tmp_path / "runs").iterdir()}
    assert set(runs) == {"cars", "brake-rig", "bump"}
    interactive = {name: "defined_in_session" in {each.id for each in run.assumptions} for name, run in runs.items()}
    assert interactive == {"cars": False, "brake-rig": False, "bump": True}
    assert "bump (its own text)" in runs["bump"].software


def test_the_notebook_runs(started: Processes, tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "notebook", tmp_path, dirs_exist_ok=True)
    (notebook,) = tmp_path.glob("*.ipynb")
    ended = of_cells(started, notebook)
    assert ended.code == 0, ended.err
    assert "Traceback" not in ended.err


@pytest.mark.journey
def test_a_script_a_saved_file_and_a_killed_study_give_one_certificate(started: Processes, tmp_path: Path) -> None:
    shutil.copy(EXAMPLES / "cars" / "cars.py", tmp_path)
    saved = script(started, "c = pb.Campaign('cars.py:cars', **KEYS); c.save('c.toml'); c.run('run', workers=1)").wait()
    assert saved.code == 0, saved.err
    assert started.run("perfbound", "run", tmp_path / "c.toml", "--out", tmp_path / "command").code == 0
    killed = script(started, TOLD)
    wait_for(lambda: recorded(tmp_path / "told") >= 10)
    assert killed.running, "the kill has to come in mid-run"
    killed.popen.kill()
    killed.wait()
    again = script(started, TOLD).wait()
    assert again.code == 0, again.err
    assert certificate(tmp_path / "run") == certificate(tmp_path / "command")
    assert certificate(tmp_path / "told") == certificate(tmp_path / "command")


def test_an_interrupted_run_continues_in_the_same_session(started: Processes, tmp_path: Path, calm: bytes) -> None:
    process = script(
        started,
        TYPED,
        "try:\n    campaign.run('run')\n"
        "except KeyboardInterrupt as stopped:\n"
        "    print(stopped, signal.getsignal(signal.SIGINT) is signal.default_int_handler)\n"
        "try:\n    campaign.run('run')\n"
        "except Exception as error:\n    print(error)\n"
        "print(pb.resume('run', system=typed))\n"
        "try:\n    campaign.run('run')\n"
        "except Exception as error:\n    print(error)\n",
    )
    wait_for(lambda: recorded(tmp_path / "run") >= 10)
    process.signal_group(signal.SIGINT)
    ended = process.wait()
    assert ended.code == 0, ended.err
    stopped, refused, *claim, finished = ended.out.splitlines()
    assert stopped == f"stopped; perfbound.resume('{tmp_path / 'run'}') continues True"
    run = tmp_path / "run"
    assert refused == f"{run}: this campaign is here already; continue it with perfbound.resume('{run}')"
    assert claim[0].startswith("VERDICT")
    assert claim[1].startswith("CLAIM")
    assert f"read it with perfbound.open('{run}')" in finished, "there is nothing to continue"
    assert certificate(tmp_path / "run") == calm


def test_a_killed_worker_is_forked_again(started: Processes, tmp_path: Path, calm: bytes) -> None:
    process = script(started, TYPED, "campaign.run('run')")
    wait_for(lambda: recorded(tmp_path / "run") >= 5)
    _, worker = process.children()
    worker.kill()
    ended = process.wait()
    assert ended.code == 0, ended.err
    assert "ended (signal 9); started" in ended.err
    assert certificate(tmp_path / "run") == calm


def test_killed_itself_it_leaves_no_worker_and_another_session_resumes(
    started: Processes, tmp_path: Path, calm: bytes
) -> None:
    process = script(started, TYPED, "campaign.run('run')")
    wait_for(lambda: recorded(tmp_path / "run") >= 5)
    _, worker = process.children()
    process.popen.kill()
    process.wait()
    wait_for(lambda: not psutil.pid_exists(worker.pid) or worker.status() == psutil.STATUS_ZOMBIE)
    refused = started.run("perfbound", "resume", tmp_path / "run")
    assert "typed was defined in an interactive session, so no worker can import it" in refused.fault
    other = script(started, TYPED.replace("0.02 * speed", "0.03 * speed"), "pb.resume('run', system=typed)").wait()
    assert other.code == 1
    assert "typed: not the function with which this campaign was started" in other.err.splitlines()[-1]
    same = script(started, TYPED, "pb.resume('run', system=typed)").wait()
    assert same.code == 0, same.err
    assert certificate(tmp_path / "run") == calm


def test_in_a_thread_and_after_a_network_was_opened(started: Processes, tmp_path: Path, calm: bytes) -> None:
    shutil.copy(EXAMPLES / "cars" / "cars.py", tmp_path)
    ended = script(
        started,
        TYPED,
        "pb.Campaign('cars.py:cars', **KEYS).run('first')\n"
        "thread = threading.Thread(target=campaign.run, args=('run',))\n"
        "thread.start()\n"
        "thread.join()\n",
    ).wait()
    assert ended.code == 0, ended.err
    assert certificate(tmp_path / "run") == calm


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("raise ValueError('too close')", "ValueError: too close"),
        ("import os; os._exit(3)", "exit code 3"),
        ("return 1.0, 2.0", "its columns are distance"),
    ],
)
def test_a_function_that_fails_is_one_line(started: Processes, tmp_path: Path, body: str, words: str) -> None:
    failing = TYPED.replace("    time.sleep(0.02)\n", f"    {body}\n")
    ended = script(started, failing, "campaign.run('run')").wait()
    assert ended.code == 1
    last = ended.err.splitlines()[-1]
    assert words in last
    assert "Repeat it: perfbound" not in last, "no command has the function"
