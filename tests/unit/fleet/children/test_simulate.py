"""One rollout in a child process: its limit of time, what a hang and a stop leave, and the text of each end."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import IO, Any

import pytest
from pydantic import TypeAdapter

from perfbound.orchestrator.fleet.children.child import HangError, ask, installed_systems, system_spec
from perfbound.orchestrator.fleet.children.family import place_of_stack
from perfbound.orchestrator.fleet.children.simulate import LIMIT, WantedRollout, simulate_to
from perfbound.orchestrator.prepare.check_system.measure import measure_in_children
from perfbound.schemas.errors import CampaignError, PerfboundError, Stopped
from perfbound.schemas.system_check import Measured, Trial
from tests.facts import facts, says
from tests.unit.run.test_service import an_assign

HANGS = """import os, subprocess, time
from pathlib import Path
import perfbound as pb

R = {"x": pb.Parameter(0, 1, unit="m")}

@pb.system(parameters=R, columns={"y": "m"})
def hangs(x, *, seed):
    child = subprocess.Popen(["sleep", "1000"], start_new_session=True)
    Path(__file__).with_name("pid").write_text(str(child.pid))
    while True:
        time.sleep(0.01)

@pb.system(parameters=R, columns={"y": "m"})
def ends(x):
    print("last words", flush=True)
    os._exit(3)
"""
PROGRAM = """name = "waits"
seed = 1
deadline = 2.0
specification = "y >= 0"
[system]
program = ["./waits.sh"]
columns = { y = "m" }
[space]
x = { low = 0.0, high = 1.0 }
[[problems]]
name = "robustness"
method = "rigorous"
alpha = 1.0
rkhs_norm = 1.0
noise_scale = 0.0
kernel = { length_scale = 1.0 }
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "own.py").write_text(HANGS)
    (tmp_path / "waits.sh").write_text("#!/bin/sh\nsleep 1000 &\necho $! > pid\nwait\n")
    (tmp_path / "waits.sh").chmod(0o755)
    (tmp_path / "waits.toml").write_text(PROGRAM)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def hung(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException], None]:
    """Raise something, once, in the wait for a child as soon as its rollout hangs."""
    communicate = subprocess.Popen.communicate

    def arrange(fault: BaseException) -> None:
        pending = [fault]

        def waits(child: subprocess.Popen[str], timeout: float | None = None) -> object:
            if "simulate" not in str(child.args) or not pending:
                return communicate(child, timeout=timeout)
            wait_for(lambda: child.poll() is not None or ((folder / "pid").exists() and bool(pid(folder))))
            raise pending.pop()

        monkeypatch.setattr(subprocess.Popen, "communicate", waits)

    return arrange


def pid(folder: Path) -> int:
    return int((folder / "pid").read_text() or 0)


def rolled(reference: str, limit: float | None) -> None:
    spec, request, seconds = WantedRollout(reference, "0.5", "nominal", 7, None, (), limit).request()
    simulate_to(Path("out.mcap"), request, spec, reference, limit=seconds)


def gone(pid: int) -> bool:
    """Whether a process has ended; as a zombie it may wait for its parent."""
    try:
        return "\nState:\tZ" in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return True


def wait_for(condition: Callable[[], bool]) -> None:
    while not condition():
        time.sleep(0.01)


@pytest.mark.integration
def test_a_rollout_that_hangs_is_ended_with_all_that_it_started_and_one_line_says_where(
    folder: Path, hung: Callable[[BaseException], None]
) -> None:
    hung(subprocess.TimeoutExpired("", 2.0))
    with pytest.raises(PerfboundError) as refused:
        rolled("own.py:hangs", 2.0)
    assert re.fullmatch(
        r"the rollout of hangs at x = 0.5, seed 7 gave no result within 2 s, and was ended in own.py, line 1[123]; fix "
        r"what does not end there, or give it more time: perfbound simulate --timeout SECONDS, `deadline` in a "
        r"campaign file",
        str(refused.value),
    )
    wait_for(lambda: gone(pid(folder)))
    assert not (folder / "out.mcap").exists()


@pytest.mark.integration
def test_a_program_that_hangs_is_ended_with_what_it_started(
    folder: Path, hung: Callable[[BaseException], None]
) -> None:
    hung(subprocess.TimeoutExpired("", 2.0))
    with pytest.raises(PerfboundError) as refused:
        rolled("waits.toml", None)
    assert says(str(refused.value), "x = 0.5 seed 7 gave 2 s")
    wait_for(lambda: gone(pid(folder)))


@pytest.mark.integration
def test_without_a_campaign_the_limit_is_the_default_of_one(folder: Path) -> None:
    assert WantedRollout("own.py:hangs", "0.5", "nominal", 7, None, ()).request()[2] == LIMIT == 600.0
    assert WantedRollout("waits.toml", "0.5", "nominal", 7, None, ()).request()[2] == 2.0, "its deadline"


@pytest.mark.integration
def test_a_stop_says_what_was_ended(folder: Path, hung: Callable[[BaseException], None]) -> None:
    hung(Stopped(signal.SIGINT))
    with pytest.raises(Stopped) as stopped:
        rolled("own.py:hangs", None)
    assert says(stopped.value.state, "x = 0.5 seed 7")
    assert stopped.value.state.endswith(" s, nothing was written")
    wait_for(lambda: gone(pid(folder)))


def measured() -> object:
    return measure_in_children([[]], [], limit=2.0, done=lambda _: None)


class AnsweringChild:
    """A child in this process, that prints something and answers every trial that it reads; it has ended at once."""

    returncode = 0
    pid = 2**22 + 1  # more than Linux has

    def __init__(self, _line: object, *, stdin: IO[bytes], stdout: IO[bytes], pass_fds: list[int], **_: object) -> None:
        trials = TypeAdapter(tuple[Trial, ...]).validate_json(os.read(stdin.fileno(), 1 << 16))
        os.write(stdout.fileno(), b"says this\nand that\n")
        for each in (Measured(), *(Measured(seconds=trial.pause) for trial in trials)):
            os.write(pass_fds[0], each.model_dump_json().encode() + b"\n")

    def poll(self) -> int:
        return 0

    wait = kill = poll


def test_a_child_reads_all_trials_and_what_it_prints_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "Popen", AnsweringChild)
    trials = [Trial(request=an_assign(number).request, pause=number) for number in (1, 2)]
    done: list[int] = []
    (run,) = measure_in_children([trials], [], limit=2.0, done=done.append)
    assert [each.seconds for each in run.measured] == [1.0, 2.0]
    assert (run.printed, run.ended, done) == ("says this", "", [0, 0])


@pytest.mark.integration
@pytest.mark.parametrize("starts", [partial(ask, "systems"), measured])
def test_a_stop_while_a_child_starts_ends_the_child(
    starts: Callable[[], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    begin, begun = subprocess.Popen.__init__, []

    def begins(child: subprocess.Popen[str], *arguments: Any, **options: Any) -> None:
        begin(child, *arguments, **options)
        os.kill(child.pid, signal.SIGSTOP)  # it cannot end by itself
        begun.append(child.pid)
        signal.raise_signal(signal.SIGTERM)

    def stop(number: int, _frame: object) -> None:
        raise Stopped(number)

    monkeypatch.setattr(subprocess.Popen, "__init__", begins)
    before = signal.signal(signal.SIGTERM, stop)
    try:
        with pytest.raises(Stopped):
            starts()
    finally:
        signal.signal(signal.SIGTERM, before)
    left = [each for each in begun if not gone(each)]
    for each in left:
        os.kill(each, signal.SIGKILL)
    assert begun
    assert not left


@pytest.mark.integration
def test_the_end_of_a_process_is_named_with_its_code_and_what_it_printed_is_not_its_reason(folder: Path) -> None:
    spec, request, _ = WantedRollout("own.py:ends", "0.5", "nominal", 7, None, ()).request()
    printed: list[str] = []
    with pytest.raises(PerfboundError) as refused:
        simulate_to(folder / "out.mcap", request, spec, "own.py:ends", on_line=printed.append)
    assert says(str(refused.value), "^`workers simulate` 3")
    assert printed == ["last words"]


@pytest.mark.integration
def test_a_file_that_does_not_end_when_it_is_loaded(folder: Path) -> None:
    (folder / "endless.py").write_text("import time\ntime.sleep(1000)\n")
    with pytest.raises(HangError, match=facts("`workers spec` 0.1 s")):
        ask("spec", "endless.py:f", limit=0.1)


def test_of_several_threads_the_one_of_the_rollout_is_named() -> None:
    other = 'Thread 0x1 (most recent call first):\n  File "/me/logger.py", line 1 in log\n\n'
    current = 'Current thread 0x2 (most recent call first):\n  File "/me/cars.py", line 7 in cars\n\nExtension modules'
    assert place_of_stack(f"Fatal Python error: Aborted\n\n{other}{current}") == "/me/cars.py, line 7"


@pytest.mark.integration
def test_the_place_of_a_fault_in_a_campaign_file_is_named_once(folder: Path) -> None:
    (folder / "waits.toml").write_text(PROGRAM.replace("./waits.sh", "./no-such"))
    with pytest.raises(CampaignError) as refused:
        system_spec("waits.toml", "waits.toml: system.program")
    assert says(str(refused.value), "^waits.toml: system.program: './no-such'")


@pytest.mark.integration
@pytest.mark.parametrize("given", [None, 0.05])
def test_a_horizon_below_one_step_is_refused_when_the_system_is_read(folder: Path, given: float | None) -> None:
    """It was refused by the first rollout, with a directory of the run."""
    code = "import perfbound as pb\n\n@pb.system(parameters={'x': pb.Parameter(0, 1)}, columns={'y': 'm'}, step=0.1)\n"
    (folder / "steps.py").write_text(f"{code}def steps(x, *, horizon):\n    return [x]\n")
    of_system = 'python = "steps.py:steps"'
    program = 'program = ["./waits.sh"]\ncolumns = { y = "m" }'
    (folder / "steps.toml").write_text("horizon = 0.05\n" + PROGRAM.replace(program, of_system))
    with pytest.raises(CampaignError) as refused:
        system_spec("steps.toml" if given is None else "steps.py:steps", "steps.toml: system.python", given)
    assert says(str(refused.value), "^steps.toml: horizon: 0.05 s one step 0.1 s give")
    assert system_spec("steps.py:steps", "SYSTEM", 0.1).name == "steps"


@pytest.mark.integration
def test_another_build_is_named_by_what_differs(folder: Path) -> None:
    spec, request, _ = WantedRollout("waits.toml", "0.5", "nominal", 7, None, ()).request()
    (folder / "waits.sh").write_text("#!/bin/sh\n")
    with pytest.raises(PerfboundError, match=facts("another campaign: ./waits.sh another")):
        simulate_to(folder / "out.mcap", request, spec, "waits.toml")


@pytest.mark.integration
def test_text_on_the_standard_output_is_no_answer(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a library in C while it loads, and of Python's own start files: it was a traceback of the JSON reader."""
    own = (folder / "own.py").read_text()
    (folder / "loud.py").write_text(f'import os\nos.write(1, b"C library 1.2\\n")\nprint("loading")\n{own}')
    (folder / "start").mkdir()
    (folder / "start" / "sitecustomize.py").write_text("print('{\"hello\": 1}')\n")
    monkeypatch.setenv("PYTHONPATH", str(folder / "start"))
    assert system_spec("loud.py:ends", "--system").name == "ends"
    assert "test-function" in installed_systems()
    lines: list[str] = []
    ask("spec", "loud.py:ends", on_line=lines.append)
    assert sorted(lines) == ["C library 1.2", "loading", '{"hello": 1}']
