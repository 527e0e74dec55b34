"""What is printed and written before a campaign: check-system, init, calibrate, plan."""

import io
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from perfbound.orchestrator.prepare.calibrate.answer import Requirement, answer, compared
from perfbound.orchestrator.prepare.calibrate.calibrate import check_effort
from perfbound.orchestrator.prepare.calibrate.file import kernel_file, sample_file
from perfbound.orchestrator.prepare.check_system.findings import OF_PROGRAM, SYSTEM_CHECKS, SystemFinding
from perfbound.orchestrator.prepare.check_system.judge import judge
from perfbound.orchestrator.prepare.check_system.trials import GROWTH, SEED
from perfbound.orchestrator.prepare.init.file import campaign_text
from perfbound.orchestrator.prepare.init.questions import QUESTIONS
from perfbound.orchestrator.prepare.plan.fleet_need import PilotFigures, fleet_plan
from perfbound.orchestrator.prepare.plan.plan import long_mathematics
from perfbound.orchestrator.prepare.plan.text import print_plan
from perfbound.orchestrator.prepare.size import FirstSize
from perfbound.schemas.system_check import SampleTimes, Trial
from tests.texts import Cases, refusal, rows
from tests.unit.prepare.calibrate import test_answer, test_constants
from tests.unit.prepare.check_system import test_batches, test_judge
from tests.unit.prepare.init import test_file
from tests.unit.prepare.plan import test_plan, test_sizes, test_text
from tests.unit.prepare.plan.test_fleet_need import BATCHED, IN_BATCHES

MB = test_judge.MB


def check_system(_folder: Path) -> Cases:
    """Yield the findings on a sound system, and what is found wrong with others."""
    yield "every check", "\n".join(f"{name}: {tests}" for name, tests in SYSTEM_CHECKS.items())
    sound = test_judge.findings()
    yield "a sound system", "\n".join(map(_line, sound.values()))
    for make, check in rows(test_judge.test_what_perfbound_refuses_is_a_finding_of_the_check_that_it_is_about):
        yield check, refusal(make)
    for number, (rule, _) in enumerate(rows(test_judge.test_the_cause_of_unequal_repeats)):
        yield f"unequal repeats {number}", _wrong(test_judge.findings(rule))
    for name, changes in _CHANGES.items():
        yield name, _wrong(test_judge.findings(_place_alone(changes)))
    yield "a seed that is cut", _wrong(test_judge.findings(_cut_seed))
    other = SampleTimes(samples=51, first=0.0, last=10.0, least_step=0.2, greatest_step=0.2)
    yield (
        "different times",
        _wrong(
            test_judge.findings(
                lambda _process, _place, trial: {"grid": other} if trial.request.problem == GROWTH else {}
            )
        ),
    )
    yield (
        "a noisy variant that ignores its seed",
        _wrong(test_judge.findings(lambda _process, _place, trial: {"samples_sha256": f"{trial.request.x}"})),
    )
    yield (
        "noise that is not declared",
        _wrong(test_judge.findings(lambda _process, _place, trial: {"samples_sha256": f"{trial.request.seed}"})),
    )
    yield (
        "a crash",
        _wrong(test_judge.broken("ended by signal SIGSEGV", reached=1, place="a.py, line 1", stderr="bad")),
    )
    yield "a hang", _wrong(test_judge.broken("gave no answer within 60 s", reached=0, hung=True))
    yield (
        "an end while loading",
        _wrong(test_judge.broken("ended with exit code 1", reached=0, loaded=None, stderr="another build")),
    )
    program = replace(test_judge.evidence(), runs=(test_judge.TRIALS_HUNG,), program="./pendulum --fast")
    yield "a program that hangs", _wrong({each.check: each for each in judge(program)})
    for against in ("alone", "order", "again", "others"):
        yield f"batches: {against}", _line(test_batches.judged(against))
    yield "batches: the unit", _line(test_batches.judged("alone", unit=True))
    yield "batches: equal", "\n".join(_line(test_batches.judged(unit=unit)) for unit in (False, True))
    yield "remedies for programs", "\n".join(f"{name}: {remedy}" for name, remedy in OF_PROGRAM.items())


_CHANGES: dict[str, Callable[[int], dict[str, Any]]] = {
    "memory that grows a little": lambda place: {"memory": 100 * MB + place * 10_000},
    "memory that grows": lambda place: {"memory": 100 * MB + place * 2 * MB},
    "text at every rollout": lambda _place: {"printed": 9},
    "a file": lambda place: {"files": ("out.csv",)} if place == 0 else {},
    "many files": lambda place: {"files": (f"$TMPDIR/{place % 5}",)},
    "threads": lambda _place: {"threads": ("pool",), "tasks": 5},
    "more threads with every rollout": lambda place: {"tasks": place},
    "processes": lambda _place: {"processes": ("sleep",)},
    "a changed global random state": lambda _place: {"reseeded": ("random", "numpy.random")},
    "an exception": lambda _place: {
        "error": "ValueError: not finite, a column\nand more",
        "raised": True,
        "place": "a.py, line 3",
        "grid": None,
    },
}


def _place_alone(changes: Callable[[int], dict[str, Any]]) -> test_judge.Rule:
    return lambda _process, place, _trial: changes(place)


def _cut_seed(_process: int, _place: int, trial: Trial) -> dict[str, Any]:
    return test_judge.changed(f"{trial.request.seed % 7}") if trial.request.problem == SEED else {}


def _wrong(found: dict[str, SystemFinding]) -> str:
    return "\n".join(_line(each) for each in found.values() if each.status not in {"passed", "skipped"})


def _line(found: SystemFinding) -> str:
    remedy = f"\n    remedy: {found.remedy}" if found.remedy else ""
    return f"{found.status:<8} {found.check}: {found.detail}{remedy}"


def init(_folder: Path) -> Cases:
    """Yield campaign files that `init` writes."""
    one = test_file.campaign(robustness=test_file.proposal(-2.0, 17.0, 0.34, 0.1))
    yield "one problem with noise", campaign_text(one)
    exact = test_file.campaign(robustness=test_file.proposal(-2.0, 17.0, 0.0, 0.1))
    yield "one problem without noise", campaign_text(replace(exact, size=FirstSize(110, 1, spot_check=110)))
    nominal, gap = test_file.proposal(-2.0, 17.0, 0.0, 0.1), test_file.proposal(0.1, 3.0, "derived", 0.1)
    two = test_file.campaign(nominal=nominal, gap=gap)
    yield "two problems", campaign_text(two)
    yield "samples in batches", campaign_text(test_file.sampled(batch=256))
    search = test_file.asking("fails")
    scaled = replace(search, basis=replace(search.basis, scale={"x": 0.5, "t": 10.0}))
    yield "a search with a scale", campaign_text(scaled)
    yield "questions", "\n".join(f"{name}: {each.words}" for name, each in QUESTIONS.items())


def calibrate(folder: Path) -> Cases:
    """Yield files of constants, answers, and the refusals of drafts."""
    draft: dict[str, Any] = {
        "clip": [-1, 2],
        "specification": "x >= 0",
        "system": {"name": "s"},
        "space": {"x": [0, 1]},
    }
    yield "a file of drawn starts", sample_file(draft, (-1, 2), 0.001, ["It jumps."])
    pair: dict[str, Any] = {
        "name": "two",
        "system": {"name": "s"},
        "space": {"x": [0, 5]},
        "problems": [{"name": "nominal_robustness"}],
    }
    yield "a file of constants", kernel_file(pair, [test_constants.constants("rkhs_norm")], None, "Head.")
    for number, (margin, guess, _) in enumerate(test_answer.CASES):
        required = Requirement("robustness", -margin, -1, "m")
        yield f"answer {number}, required_margin = {margin}", compared(required, guess, test_answer.EFFORT)
    exact = test_answer.found(folder, "required_margin = 0.5\n")
    yield "answer: a rollout misses what is required", answer(exact)
    yield "answer: no kernel", answer(replace(test_answer.found(folder), forecasts=()))
    yield "answer: nothing else fits", answer(replace(test_answer.found(folder), forecasts=(), text=None))
    yield "pace", exact.problems[0].measured.pace.words
    yield "more rollouts than memory allows", refusal(partial(check_effort, 100_000, test_sizes.spec(6)))
    for text, _ in rows(test_constants.test_the_error_of_a_file_that_is_no_draft_names_key_and_remedy):
        yield f"no draft: {text}", refusal(partial(test_constants.read, folder, text))


def plan(_folder: Path) -> Cases:
    """Yield plans of fleets."""
    fast = PilotFigures(10, 0.01, 0.01, 2.0, 100_000.0, 97_000_000)
    for name, found in {
        "as many workers as rollouts": fleet_plan(8, test_text.PILOT, [test_text.problem()], [], 10.0),
        "workers without work": fleet_plan(64, test_text.PILOT, [test_text.problem()], [], 10.0),
        "the orchestrator limits": fleet_plan(64, fast, [test_text.problem(64)], [], 10.0),
        "batches": fleet_plan(128, BATCHED, [IN_BATCHES], [], 10.0),
        "second opinions": fleet_plan(8, test_text.PILOT, [test_text.problem()], [], 10.0, second_opinion=0.1),
    }.items():
        console = Console(file=io.StringIO(), width=120)
        print_plan(found, "segway", console)
        assert isinstance(console.file, io.StringIO)
        yield name, console.file.getvalue()
    yield "long mathematics", "\n".join(long_mathematics(test_plan.LONG))
