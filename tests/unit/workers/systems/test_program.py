"""Programs as systems: what they get, what they may answer, and every way in which they can fail."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

import perfbound as pb
from perfbound.schemas.errors import DefinitionError, SimulationError
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.link.secret import VARIABLE
from perfbound.workers.systems.base import Cancelled
from perfbound.workers.systems.files import load_reference
from perfbound.workers.systems.program import PREFIX, ProgramSystem, load_program, read_samples
from tests.end_to_end.processes import wait_for
from tests.facts import facts, says

pytestmark = pytest.mark.integration

CAMPAIGN = """
name = "p"
seed = 1
composition = "single"
specification = "always (x <= 1)"
[system]
program = PROGRAM
columns = { x = "m", v = "m/s" }
KEYS
[space]
x0 = { low = 0.0, high = 2.0, unit = "m" }
[[problems]]
name = "robustness"
method = "rigorous"
delta = 0.05
alpha = 0.1
rkhs_norm = 1.0
noise_scale = 0.0
kernel = { nu = 2.5, length_scale = 1.0 }
"""
STAYS = """
import json, os, sys, time
rollouts = 0
for line in sys.stdin:
    rollouts += 1
    request = json.loads(line)
    path, x0 = request["path"], request["start"]["x0"]
    BODY
    print('{"done": true}', flush=True)
"""
PLACE = ("PERFBOUND_WORKER", "PERFBOUND_SCRATCH", "PERFBOUND_PORT")
WRITES = 'open(path, "w").write(f"0,{x0},1\\n0.5,{x0 + 1},2\\n")'


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Callable[..., ProgramSystem]]:
    """Make a system of the body of a loop over lines, in Python; its process ends with the test."""
    made: list[ProgramSystem] = []

    def make(
        body: str, keys: str = "", *, source: str = STAYS, command: list[str] | None = None, horizon: str = ""
    ) -> ProgramSystem:
        (tmp_path / "sim.py").write_text(source.replace("BODY", body))
        text = CAMPAIGN.replace("PROGRAM", json.dumps(command or [sys.executable, "sim.py"])).replace("KEYS", keys)
        text = horizon + text
        made.append(load_program(tmp_path / "p.toml", parse_campaign(text.encode(), "p.toml")))
        return made[-1]

    yield make
    for system in made:
        system.end()


def rolled(system: ProgramSystem, x0: float | pb.InputSignal = 0.5, **changes: Any) -> Any:
    arguments: dict[str, Any] = {"variant": "nominal", "seed": 7, "horizon": 0.5, "options": {}}
    return system.rollout((x0,), **{**arguments, "progress": lambda _: None, **changes})


# What it gets


def test_the_spec_follows_from_the_campaign_file(program: Callable[..., ProgramSystem]) -> None:
    spec = program(WRITES, 'noisy = true\nstep = 0.5\ndamping = 0.25\nmode = "fast"').spec
    assert [(each.name, each.low, each.high, each.unit) for each in spec.parameters] == [("x0", 0, 2, "m")]
    assert [(each.name, each.unit) for each in spec.columns] == [("t", "s"), ("x", "m"), ("v", "m/s")]
    assert {each.name: each.default for each in spec.options} == {"damping": 0.25, "mode": "fast"}
    assert (spec.name, spec.variants, spec.noisy) == ("sim", ("nominal",), ("nominal",))
    assert spec.timed, "with a step it has a duration, and a campaign needs a horizon"
    assert set(spec.code) == {sys.executable, "sim.py"}, "the interpreter and its script"


def test_the_disturbances_of_the_file_are_in_the_line(program: Callable[..., ProgramSystem], tmp_path: Path) -> None:
    laws = '[disturbances]\ngust = { distribution = "normal", mean = 0.0, sd = 2.0, unit = "m/s" }'
    system = program(f'open("got", "w").write(line); {WRITES}', f"residual = false\n{laws}")
    assert [each.words for each in system.spec.disturbances] == ["normal, mean 0 m/s, sd 2 m/s"]
    assert (system.spec.residual, system.spec.noisy) == (False, ("nominal",))
    rolled(system, disturbances={"gust": 1.25})
    assert json.loads((tmp_path / "got").read_text())["disturbances"] == {"gust": 1.25}
    with pytest.raises(SimulationError, match="sim takes the disturbances gust, not none"):
        rolled(system)


def test_what_a_program_reports_has_the_unit_of_its_column(program: Callable[..., ProgramSystem]) -> None:
    law = 'reported = { v = { distribution = "normal", mean = 0.0, sd = 2.0 } }'
    spec = program(WRITES, law).spec
    assert [each.words for each in spec.reported] == ["normal, mean 0 m/s, sd 2 m/s"]
    assert (spec.disturbances, spec.noisy, spec.residual) == ((), ("nominal",), True)
    with pytest.raises(DefinitionError, match="'gust' is no column"):
        program(WRITES, law.replace(" v ", " gust "))


def test_one_line_has_everything_in_a_fixed_order(program: Callable[..., ProgramSystem], tmp_path: Path) -> None:
    system = program(f'open("got", "w").write(line); {WRITES}', "damping = 0.25")
    rolled(system)
    line = (tmp_path / "got").read_text()
    path, own = json.loads(line)["path"], pb.Worker.own()
    place = f'{{"number": {own.number}, "scratch": "{own.scratch}", "port": {own.port}}}'
    assert line == (
        '{"request": 1, "start": {"x0": 0.5}, "seed": 7, "variant": "nominal", "horizon": 0.5, '
        f'"options": {{"damping": 0.25}}, "worker": {place}, "path": "{path}"}}\n'
    )
    assert not Path(path).exists(), "removed when it is read"


def test_an_input_over_time_has_its_kind_its_knots_and_their_times(
    program: Callable[..., ProgramSystem], tmp_path: Path
) -> None:
    system = program(f'open("got", "w").write(line); {WRITES.replace("x0", "0")}')
    spec = system.spec.model_copy(update={"parameters": (pb.Parameter(0, 2, name="x0", signal=True),)})
    found = ProgramSystem(spec, system._choice, tmp_path)
    rolled(found, pb.InputSignal("constant", (0.5, 2.0), 0.5))
    found.end()
    line = json.loads((tmp_path / "got").read_text())
    assert line["start"] == {"x0": {"signal": "constant", "knots": [0.5, 2.0], "times": [0.0, 0.25]}}


def test_the_environment_is_clean(program: Callable[..., ProgramSystem], monkeypatch: Any, tmp_path: Path) -> None:
    monkeypatch.setenv("SECRET", "s")
    monkeypatch.setenv(VARIABLE, "not even if it is asked for")
    monkeypatch.setenv("WANTED", "w")
    monkeypatch.setenv("LANG", "C.UTF-8")
    wanted = f'environment = ["WANTED", "{VARIABLE}"]'
    rolled(program(f'open("env", "w").write("\\n".join(os.environ)); {WRITES}', wanted))
    assert set((tmp_path / "env").read_text().split()) - {"LC_CTYPE"} == {"PATH", "HOME", "LANG", "WANTED", *PLACE}


# What it may write


@pytest.mark.parametrize(
    ("keys", "body"),
    [
        ("", WRITES),
        ("", 'open(path, "w").write(f"t,x,v\\n0,{x0},1\\n0.5,{x0 + 1},2\\n")'),
        ("step = 0.5", 'open(path, "w").write(f"{x0},1\\n{x0 + 1},2\\n")'),
        ('samples = "f64"', 'import struct; open(path, "wb").write(struct.pack("<6d", 0, x0, 1, 0.5, x0 + 1, 2))'),
        ('samples = "f64"\nstep = 0.5', 'import struct; open(path, "wb").write(struct.pack("<4d", x0, 1, x0 + 1, 2))'),
        ('samples = "npy"', "import numpy; numpy.save(path, [[0, x0, 1], [0.5, x0 + 1, 2]])"),
    ],
)
def test_samples_in_every_form(program: Callable[..., ProgramSystem], keys: str, body: str) -> None:
    trajectory = rolled(program(body, keys))
    assert trajectory.columns == ("t", "x", "v")
    np.testing.assert_array_equal(trajectory.samples, [[0, 0.5, 1], [0.5, 1.5, 2]])


def test_it_may_stay_or_end_after_each_rollout(program: Callable[..., ProgramSystem]) -> None:
    stays = program('open(path, "w").write(f"0,{rollouts},{os.getpid()}\\n")')
    once = [rolled(stays, horizon=0.0).samples[0] for _ in range(3)]
    assert [each[1] for each in once] == [1, 2, 3]
    assert len({each[2] for each in once}) == 1
    ends = program(
        f"{WRITES.replace('{x0},1', '{x0},{os.getpid()}')}; print('{{\"done\": true}}', flush=True); sys.exit()"
    )
    assert len({rolled(ends).samples[0, 2] for _ in range(3)}) == 3


# How it can fail


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("sys.exit(3)", "exit code 3"),
        ('print("no steps\\nsee the log", file=sys.stderr); sys.exit(1)', "words: no steps | see the log"),
        ("sys.exit()", "exit code 0"),
        ("os.abort()", "SIGABRT"),
        ('print(\'{"error": "unstable"}\', flush=True); continue', ": unstable"),
        ('print("step 1 of 9", flush=True)', "answered 'step 1 of 9'"),
        ('print(\'{"done": false}\', flush=True); continue', '\'{"done": false}\''),
        ('print("x" * 10**6, end="", flush=True); time.sleep(99)', "more 65536 bytes"),
        ("os.close(1); time.sleep(99)", "closed stdout"),
        ("pass", "done no samples"),
        ('open(path, "w")', "0 bytes 1 to 67108864"),
        ('open(path, "wb").truncate(65 * 2**20)', "68157440 bytes samples"),
        ('open(path, "w").write("0,1\\n")', "(1, 2) t, x, v"),
        ('open(path, "w").write("t,v,x\\n0,1,2\\n")', "t,v,x t,x,v"),
        ('open(path, "w").write("t,x,v\\n")', "csv: numbers"),
        ('open(path, "w").write("0,1,oops\\n")', "csv: 'oops'"),
        ('open(path, "w").write("0,1,nan\\n")', "not finite"),
        ('open(path, "w").write("1,1,1\\n0,1,1\\n")', "t = 0 s row 1 t = 1 s row 0"),
        ('os.mkfifo(path)', "file `path` samples"),
        ('os.makedirs(path + "/more")', "file `path`"),
        ('open(path, "w").write("\ufeff")', "csv: numbers"),
        ('open(path, "w").write("0,1,2\\n0.5,1.25,1.2")', "'0.5,1.25,1.2' cut"),
        ('open(path, "w").write("0,1,2#9\\n")', "csv: '2#9'"),
        ('print("[" * 50000, flush=True); continue', "answered '[[[["),
        ('print(\'{"error": ""}\', flush=True); continue', "failed reason"),
        ('print(\'{"error": null}\', flush=True); continue', "failed reason"),
        ('print(\'{"request": 0, "done": true}\', flush=True); continue', "request 0 asked 1"),
        ('print(\'{"request": [], "done": true}\', flush=True); continue', "request [] asked 1"),
        ('bytearray(10**9)', "MemoryError"),
    ],
)  # fmt: skip
def test_every_failure_is_one_reason_and_the_next_rollout_starts_anew(
    program: Callable[..., ProgramSystem], body: str, words: str
) -> None:
    system = program(f"\n    if x0 < 1:\n        {body}\n    else:\n        {WRITES}", "limits = { memory = 0.5 }")
    with pytest.raises(SimulationError) as failure:
        rolled(system)
    assert says(str(failure.value), words)
    assert "\n" not in str(failure.value)
    assert rolled(system, 1.5).samples[0, 1] == 1.5


def test_a_line_after_the_answer_is_refused(program: Callable[..., ProgramSystem]) -> None:
    system = program(f"{WRITES}; print('{{\"done\": true}}\\nand more', flush=True); time.sleep(99)")
    rolled(system)
    with pytest.raises(SimulationError, match=r"wrote 'and more.*' after its answer"):
        rolled(system)


def test_a_second_answer_that_comes_late_is_not_that_of_the_next_rollout(
    program: Callable[..., ProgramSystem], tmp_path: Path
) -> None:
    twice = STAYS.replace(
        "print('{\"done\": true}', flush=True)",
        "print(json.dumps({'request': request['request'], 'done': True}), flush=True); last = request['request']",
    )
    late = "\n    if rollouts > 1: print(json.dumps({'request': last, 'done': True}), flush=True)\n    "
    system = program(late + WRITES, source=twice)
    rolled(system)
    with pytest.raises(SimulationError, match=facts("request 1 asked 2 answer request")):
        rolled(system)


def test_its_folder_is_emptied_before_a_rollout_where_the_file_says_so(
    program: Callable[..., ProgramSystem],
) -> None:
    body = (
        '\n    here = os.environ["PERFBOUND_SCRATCH"]; count = len(os.listdir(here))'
        '\n    os.makedirs(f"{here}/d{rollouts}/e"); open(path, "w").write(f"0,{count},0\\n")'
    )
    kept, emptied = program(body), program(body, "empty_scratch = true")
    assert [rolled(emptied, horizon=0.0).samples[0, 1] for _ in range(3)] == [0, 0, 0]
    emptied.end()
    assert [rolled(kept, horizon=0.0).samples[0, 1] for _ in range(2)] == [1, 2], "and by nobody else"


def test_more_cpu_time_than_its_limit_ends_it(program: Callable[..., ProgramSystem]) -> None:
    system = program("\n    while True: pass", "limits = { cpu = 1 }")
    with pytest.raises(SimulationError, match=facts("SIGXCPU more CPU limits.cpu")):
        rolled(system)


def test_the_limit_of_cpu_time_is_one_of_a_rollout(program: Callable[..., ProgramSystem]) -> None:
    burn = "\n    end = time.process_time() + 0.7\n    while time.process_time() < end: pass\n    "
    system = program(burn + 'open(path, "w").write(f"0,{rollouts},0\\n")', "limits = { cpu = 1 }")
    assert [rolled(system, horizon=0.0).samples[0, 1] for _ in range(4)] == [1, 2, 3, 4]


def test_a_cancelled_rollout_ends_the_whole_group(program: Callable[..., ProgramSystem], tmp_path: Path) -> None:
    system = program('os.fork(); open(f"pid-{os.getpid()}", "w"); time.sleep(99)')

    def cancel(_step: int) -> None:
        if len(list(tmp_path.glob("pid-*"))) == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        rolled(system, progress=cancel)
    for file in tmp_path.glob("pid-*"):
        wait_for(partial(ended, int(file.name[4:])))


def ended(pid: int) -> bool:
    return not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def test_a_child_that_keeps_the_stdout_open_is_no_hang(program: Callable[..., ProgramSystem]) -> None:
    system = program("\n    if os.fork() == 0: time.sleep(99)\n    sys.exit(4)")
    with pytest.raises(SimulationError, match="exit code 4"):
        rolled(system)


def test_a_killed_worker_takes_its_program_along(tmp_path: Path, program: Callable[..., ProgramSystem]) -> None:
    program("")
    text = CAMPAIGN.replace("PROGRAM", json.dumps(["./hangs.sh"])).replace("KEYS", "")
    (tmp_path / "p.toml").write_text(text)
    script = tmp_path / "hangs.sh"
    script.write_text("#!/bin/sh\nread -r line\necho $$ > pid\nexec sleep 99\n")
    script.chmod(0o755)
    code = (
        "from perfbound.workers.systems.files import load_reference as load\n"
        "load('p.toml').rollout((0.5,), variant='nominal', seed=0, horizon=1.0, options={}, progress=lambda _: None)"
    )
    worker = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path)
    wait_for(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text().strip() != "")
    worker.kill()
    worker.wait()
    wait_for(lambda: ended(int((tmp_path / "pid").read_text())))


# What is refused when it is loaded


def test_a_program_that_is_not_there(program: Callable[..., ProgramSystem], tmp_path: Path) -> None:
    with pytest.raises(DefinitionError, match=facts("p.toml: system.program: './nothing'")):
        program("", command=["./nothing"])
    with pytest.raises(DefinitionError, match="there is no program 'no-such-program'"):
        program("", command=["no-such-program"])
    (tmp_path / "plain").write_text("")
    with pytest.raises(DefinitionError, match=r"./plain is not executable; chmod"):
        program("", command=["./plain"])


def test_a_program_that_cannot_be_executed_is_a_failure(program: Callable[..., ProgramSystem], tmp_path: Path) -> None:
    script = tmp_path / "broken"
    script.write_text("#!/no/interpreter\n")
    script.chmod(0o755)
    with pytest.raises(SimulationError, match=facts("127 words: ./broken:")):
        rolled(program("", command=["./broken"]))


def test_a_list_of_starts_names_its_parameters(tmp_path: Path) -> None:
    text = CAMPAIGN.partition("[space]")[0] + "[space]\nscenarios = [[1, 5], [2, 3]]\n" + SCENARIO
    text = (
        text.replace("PROGRAM", '["sh"]')
        .replace("KEYS", "")
        .replace("seed = 1", "seed = 1\nhorizon = 1.0\nclip = [-1.0, 1.0]")
    )
    (tmp_path / "p.toml").write_text(text)
    parameters = load_reference(str(tmp_path / "p.toml")).spec.parameters
    assert [(each.name, each.low, each.high) for each in parameters] == [("x1", 1, 2), ("x2", 3, 5)]


SCENARIO = """
[[problems]]
name = "true_risk"
method = "scenario"
delta = 0.05
alpha = 0.1
"""


def test_another_program_is_another_system(program: Callable[..., ProgramSystem], tmp_path: Path) -> None:
    one = program(WRITES).spec
    assert program(WRITES).spec.digest == one.digest
    assert program(WRITES + " ").spec.digest != one.digest


def test_a_campaign_file_stands_for_its_system(tmp_path: Path) -> None:
    folder = Path(__file__).parents[4] / "deploy" / "examples" / "cars"
    shutil.copytree(folder, tmp_path / "cars")
    assert load_reference(str(tmp_path / "cars" / "cars.toml")).spec.name == "cars"


def test_samples_of_a_killed_worker_are_removed(program: Callable[..., ProgramSystem]) -> None:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    stale, ours = (Path(tempfile.gettempdir(), f"{PREFIX}{pid}-x") for pid in (child.pid, os.getpid()))
    stale.touch()
    ours.touch()
    program(WRITES)
    assert not stale.exists()
    assert ours.exists()
    ours.unlink()


FORKS = """
    if os.fork() == 0:
        open("new", "w").write(str(os.getpid()))
        os.rename("new", "pid")  # whole: its worker ends as soon as it is there
        time.sleep(99)
    WRITES"""


@pytest.mark.parametrize("how", ["sys.exit()", "os.kill(os.getpid(), 15)"])
def test_what_a_program_started_ends_with_its_worker(
    tmp_path: Path, program: Callable[..., ProgramSystem], how: str
) -> None:
    program(FORKS.replace("WRITES", WRITES))
    text = CAMPAIGN.replace("PROGRAM", json.dumps([sys.executable, "sim.py"])).replace("KEYS", "")
    (tmp_path / "p.toml").write_text(text)
    code = (
        "import os, sys, time\n"
        "from perfbound.workers.systems.files import load_reference as load\n"
        "load('p.toml').rollout((0.5,), variant='nominal', seed=0, horizon=0.5, options={}, progress=lambda _: None)\n"
        f"while not os.path.exists('pid'): time.sleep(.01)\n{how}"
    )
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False)
    wait_for(lambda: ended(int((tmp_path / "pid").read_text())))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,y\n0,1\n1\n", "a line is '1'"),
        ("0,1\n1,2#9\n", "'2#9' is no number"),
        ("0,1\n1,1_000\n", "'1_000' is no number"),
        ("0,1\n1,\n", "'' is no number"),
    ],
)
def test_lines_that_are_no_samples_are_named_in_words_of_perfbound(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(SimulationError) as error:
        read_samples(tmp_path / "a.csv", "csv", ("t", "y"))
    assert words in str(error.value)
    assert "usecols" not in str(error.value)


def test_samples_without_a_time_need_a_step(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("0.5\n0.6\n")
    with pytest.raises(SimulationError, match=r"time of each sample first, or give its `step` in \[system\]"):
        read_samples(tmp_path / "a.csv", "csv", ("t", "y"))


def test_a_horizon_below_the_step_is_refused(program: Callable[..., ProgramSystem]) -> None:
    keys = "step = 0.5\n"
    with pytest.raises(DefinitionError, match=facts("horizon: 0.2 s one step 0.5 s")):
        program(WRITES, keys, horizon="horizon = 0.2\n")
    assert program(WRITES, keys, horizon="horizon = 0.5\n").spec.timed


def test_exponents_of_fortran_are_numbers(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("0.0D+00,1.5d-01\n1.0D+00,2\n")
    assert read_samples(tmp_path / "a.csv", "csv", ("t", "y")).tolist() == [[0.0, 0.15], [1.0, 2.0]]
