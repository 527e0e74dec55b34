"""`perfbound check-system` on systems with one fault each, and on those that are shipped."""

import json
import shutil
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest

from perfbound.orchestrator.prepare.check_system.findings import SYSTEM_CHECKS
from tests.end_to_end.processes import Ended, Processes

PLANTED = Path(__file__).parent / "planted.py"
CARS = Path(__file__).parents[3] / "deploy" / "examples" / "cars" / "cars.py"
DRAW = "np.random.default_rng(seed)"


@dataclass(frozen=True)
class Fault:
    """What must be found: a row that is not passed, words of its detail and of its remedy."""

    check: str
    detail: str
    remedy: str
    status: str = "failed"
    others: tuple[str, ...] = ()
    """Further rows that are not passed."""


COMPARING = ("together", "seed", "horizon")
UNENDED = ("together", "seed")
NO_TRAJECTORY = ("columns", "finite", "times", "repeatable", "batches", *COMPARING, "random state", "memory", "speed")
TEN = {
    "unseeded": Fault("repeatable", "differ when they are repeated, in a new process too", DRAW, others=COMPARING),
    "state": Fault(
        "repeatable", "keeps state from one rollout to the next", "set every variable anew", others=COMPARING
    ),
    "columns": Fault(
        "columns", "returned altitude, its columns are height", "an array for each of", others=NO_TRAJECTORY
    ),
    "corner": Fault("finite", "row 0; fix the arithmetic there", "narrow the ranges of `parameters`"),
    "short": Fault("times", "is at t = 8 s, and the horizon is 10 s", "declare after_end"),
    "grid": Fault("times", "the first row is at t = 0.1 s, and 0 s is requested", "the first sample be at 0"),
    "global_rng": Fault("random state", "gives another rollout", DRAW, others=("repeatable", *COMPARING)),
    "prints": Fault("output", "rollouts print, 7 bytes each: 'step 0'", "remove the print", "warning"),
    "hangs": Fault("ends", "gave no answer within 2 s in ", "fix what does not end there", others=UNENDED),
    "grows": Fault("memory", "it grows by about ", "clear lists and caches", "warning"),
}
MORE = {
    "crashes": Fault("ends", "ended by signal SIGSEGV in ", "raise an exception instead", others=UNENDED),
    "raises": Fault("errors", "AssertionError: too far; at x = 1, y = 0, seed", "fix it"),
    "short_seeds": Fault("errors", "Seed must be between 0 and 2**32 - 1", "below 2**53", others=NO_TRAJECTORY),
    "false_noisy": Fault("seed", "declared as noisy, but at ", "use `seed`"),
    "secretly_noisy": Fault("seed", "not declared as noisy, but at ", "declare it, noisy=['nominal']"),
    "of_process": Fault("repeatable", "between two processes, but not within one", "no hash()", others=COMPARING),
    "seeds_global": Fault("random state", "change the global state of numpy.random", DRAW, "warning"),
    "threads": Fault("leftovers", "more with every rollout: viewer", "join every thread", "warning", ("memory",)),
    "files": Fault("leftovers", "new files: log-", "write no files", "warning"),
    "touches": Fault("leftovers", "new files: log-", "write no files", "warning"),
    "unrolled": Fault("batches", "differ from the same ones alone; most at x = ", "batch_is_the_unit=True"),
    "mixes": Fault("batches", "not independent and no bound holds", "no step, sum or maximum"),
    "uneven": Fault("times", "the steps of one trajectory are 0.001 to 0.199 s", "equal steps", "warning"),
}

LEAK = """#include <stdlib.h>
#include <string.h>
static char *volatile kept;
static int leak(void) { return (kept = memset(malloc(100000), 1, 100000)) != 0; }
"""
LINES = {"hangs": "pass", "crashes": "string_at", "raises": '"too far"', "short_seeds": "RandomState"}
"""Text of the line that is named; a loop may be in the line before it."""


def checked(started: Processes, reference: str, *options: str) -> tuple[Ended, dict[str, Any]]:
    ended = started.run("perfbound", "check-system", reference, "--json", *options)
    return ended, {each["check"]: each for each in json.loads(ended.out)["checks"]}


@pytest.mark.parametrize("name", [*TEN, *MORE])
def test_a_planted_fault_is_found_with_its_remedy(started: Processes, name: str) -> None:
    fault = (TEN | MORE)[name]
    options = ("--timeout", "2") if name == "hangs" else ()
    ended, found = checked(started, f"{PLANTED}:{name}", *options)
    row = found[fault.check]
    assert row["status"] == fault.status, row
    assert fault.detail in row["detail"]
    assert fault.remedy in row["remedy"]
    if name in LINES:
        lines = [n for n, text in enumerate(PLANTED.read_text().splitlines(), 1) if LINES[name] in text]
        assert any(f"{PLANTED}, line {line}: " in row["detail"] for line in (lines[0] - 1, *lines)), row
    assert ended.code == (fault.status == "failed")
    assert {check for check, each in found.items() if each["status"] != "passed"} <= {fault.check, *fault.others}


@pytest.mark.parametrize(
    ("reference", "options"),
    [
        pytest.param(str(CARS.with_name("cars.toml")), (), marks=pytest.mark.journey),
        ("segway", ("--horizon", "3")),
        ("test-function", ("--variant", "true")),
        (f"{PLANTED}:sound", ()),
        (f"{PLANTED}:lasts_three_seconds", ()),
        (f"{PLANTED}:one_sample", ()),
        (f"{PLANTED}:loads_slowly_once", ()),
    ],
)
def test_a_sound_system_passes(started: Processes, reference: str, options: tuple[str, ...]) -> None:
    ended, found = checked(started, reference, *options)
    assert ended.code == 0, ended.err
    assert [each for each in found.values() if each["status"] != "passed"] == []
    assert ended.err == "", "progress is for terminals"


def test_files_of_another_program_are_no_leftovers(started: Processes) -> None:
    """They appear in the folder of the system, while its rollouts run."""
    check = started.start("perfbound", "check-system", f"{PLANTED}:sound", "--json")
    number = 0
    while check.running:
        (started.folder / f"backup-{number}.csv").touch()
        number += 1
        time.sleep(0.02)
    found = {each["check"]: each for each in json.loads(check.wait().out)["checks"]}
    assert (found["leftovers"]["status"], found["leftovers"]["detail"]) == ("passed", "none")


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler: apt install gcc")
def test_a_program_is_checked_and_its_memory_is_counted(started: Processes, tmp_path: Path) -> None:
    folder = tmp_path / "pendulum"
    shutil.copytree(CARS.parents[1] / "pendulum", folder)
    source = folder / "pendulum.c"
    build = ("cc", "-O2", "-o", "pendulum", "pendulum.c", "-lm")
    subprocess.run(build, cwd=folder, check=True)
    ended, found = checked(started, str(folder / "pendulum.toml"))
    assert ended.code == 0, ended.err
    assert [each for each in found.values() if each["status"] != "passed"] == []
    source.write_text(LEAK + source.read_text().replace("while (scanf(", "while (leak() && scanf("))
    assert "leak() &&" in source.read_text()
    subprocess.run(build, cwd=folder, check=True)
    ended, found = checked(started, str(folder / "pendulum.toml"))
    assert found["memory"]["status"] == "warning", found["memory"]


def test_a_process_that_ends_is_a_finding_and_the_other_checks_are_skipped(started: Processes) -> None:
    ended, found = checked(started, f"{PLANTED}:exits")
    assert ended.code == 1
    assert "ended with exit code 3" in found["ends"]["detail"]
    assert {each["status"] for check, each in found.items() if check != "ends"} == {"skipped"}


def test_a_system_that_hangs_while_it_is_measured_leaves_no_process(started: Processes, tmp_path: Path) -> None:
    file = tmp_path / "hanging.py"
    pids = tmp_path / "pids"
    file.write_text(
        "import os, subprocess, time\nimport perfbound as pb\n"
        '@pb.system(parameters={"x": pb.Parameter(0, 1)}, columns={"y": ""})\n'
        "def hanging(x):\n"
        '    child = subprocess.Popen(["sleep", "1000"])\n'
        f'    open({str(pids)!r}, "a").write(f"{{os.getpid()}} {{child.pid}} ")\n'
        "    time.sleep(1000)\n"
    )
    ended, found = checked(started, f"{file}:hanging", "--timeout", "1")
    assert ended.code == 1
    assert "gave no answer within 1 s" in found["ends"]["detail"]
    numbers = [int(pid) for pid in pids.read_text().split()]
    assert len(numbers) == 4, "at two starts"
    assert not [pid for pid in numbers if psutil.pid_exists(pid) and psutil.Process(pid).status() != "zombie"]


def test_the_table_names_every_check_and_the_verdict(started: Processes) -> None:
    ended = started.run("perfbound", "check-system", f"{PLANTED}:short")
    assert ended.code == 1
    rows = [line for line in ended.out.splitlines() if not line.startswith(" ")]
    shown = {check for check in SYSTEM_CHECKS if any(row.startswith(check) for row in rows)}
    assert shown == SYSTEM_CHECKS.keys() - {"disturbances", "reported", "actions"}, "the system has none"
    assert "Let the first sample be at 0 and the last one at the horizon" in ended.out
    assert rows[-1] == "short, rollouts of 10 s: 15 passed, 1 failed; fix what failed before you run a campaign"


def test_a_formula_that_is_none_is_one_line(started: Processes) -> None:
    (started.folder / "cars.py").write_bytes(CARS.read_bytes())
    keys = 'specification = "always (distanse >= 2)"\nhorizon = 8\nfalsify = {}\n[system]\npython = "cars.py:cars"\n'
    (started.folder / "cars.toml").write_text(f"{keys}[space]\ngap = [5, 50]\nspeed = [10, 30]\n")
    refused = started.run("perfbound", "check-system", "cars.toml").fault
    assert "cars.toml: specification: character 9: unknown column 'distanse'; did you mean 'distance'?" in refused


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("nothing",),
            "SYSTEM: 'nothing' is not an installed system; allowed are segway, segway-mujoco, test-function",
        ),
        ((f"{PLANTED}:nothing",), "there is no 'nothing' in it"),
        ((f"{PLANTED}:sound", "--variant", "true"), "--variant true: sound has nominal"),
        (("segway", "--horizon", "500"), "--horizon 500: segway takes 0 to 120 s"),
        (
            ("segway", "--option", "gain=2"),
            "--option gain=2: did you mean 'gains'? segway has the options gains",
        ),
    ],
)
def test_a_wrong_argument_is_one_line(started: Processes, arguments: tuple[str, ...], words: str) -> None:
    refused = started.run("perfbound", "check-system", *arguments)
    assert refused.code == 1
    assert words in refused.fault
