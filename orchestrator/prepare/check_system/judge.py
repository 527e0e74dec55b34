"""The findings about a system: a pure function of what its child processes measured."""

from collections.abc import Callable
from dataclasses import replace

from ....schemas.errors import one_line
from ....schemas.system_check import ChildRun
from . import batches, costs, disturbances, files, repeats, trajectories
from .findings import OF_PROGRAM, SystemFinding, failed, passed
from .measurements import Measurements

_REMEDY = (
    "give the function an argument `worker`, and use its folder `worker.scratch`, its port `worker.port` and its "
    "number `worker.number` in place of fixed names of files, ports, locks and devices; or run one worker on each "
    "machine"
)


def judge_together(measurements: Measurements) -> SystemFinding | None:
    """Judge whether rollouts give the same beside those of another process as they give alone."""
    if not measurements.together:
        return None
    alone = {trial.request.model_dump_json(): found for trial, found in measurements.rolled if trial.reseed is None}
    pairs = [
        (trial, found, alone[trial.request.model_dump_json()])
        for run in measurements.together
        for trial, found in zip(run.trials, run.measured, strict=False)
        if trial.request.model_dump_json() in alone
    ]
    differing = [
        (trial, found)
        for trial, found, other in pairs
        if bool(found.error) != bool(other.error) or found.file_sha256 != other.file_sha256
    ]
    ended = [run for run in measurements.together if run.ended]
    if not pairs and not ended:
        return None
    if not differing and not ended:
        return passed("together", f"{len(pairs)} rollouts of two processes at a time are as alone")
    if not differing:
        text = f"a process that repeats its rollouts alone {_end(ended[0])} beside another one"
        return failed("together", text, _REMEDY)
    trial, found = next((each for each in differing if each[1].error), differing[0])
    said = f": {found.error}" if found.error else ""
    return failed(
        "together",
        f"{len(differing)} of {len(pairs)} rollouts collide: they repeat alone, and not beside those of another process"
        f"; at {trial.request.words(measurements.spec)}{said}",
        _REMEDY,
    )


def _end(run: ChildRun) -> str:
    return run.ended + (f" in {run.place}" if run.place else "")


_CHECKS: dict[str, Callable[[Measurements], SystemFinding | None]] = {
    "ends": trajectories.judge_ends,
    "errors": trajectories.judge_errors,
    "columns": trajectories.judge_columns,
    "finite": trajectories.judge_finite,
    "times": trajectories.judge_times,
    "repeatable": repeats.judge_repeatable,
    "together": judge_together,
    "batches": batches.judge_batches,
    "seed": repeats.judge_seed,
    "actions": trajectories.judge_actions,
    "disturbances": disturbances.judge_disturbances,
    "reported": disturbances.judge_reported,
    "random state": repeats.judge_random_state,
    "horizon": trajectories.judge_horizon,
    "memory": costs.judge_memory,
    "output": costs.judge_output,
    "leftovers": costs.judge_leftovers,
    "files": files.judge_files,
    "speed": costs.judge_speed,
}
_OF_SOME: dict[str, Callable[[Measurements], bool]] = {
    "actions": lambda found: any(each.acts for _, each in found.rolled),
    "disturbances": lambda found: bool(found.spec.disturbances),
    "reported": lambda found: bool(found.spec.reported),
}
"""Checks of what some systems alone have."""
_COMPARING = {"together", "seed", "disturbances", "reported", "horizon"}
"""Checks that compare rollouts, and so need repeatable ones."""


def judge(measurements: Measurements) -> tuple[SystemFinding, ...]:
    """Return one finding for each check; a check that nothing was measured for is skipped."""
    found: dict[str, SystemFinding] = {}
    for name, check in _CHECKS.items():
        if name in _OF_SOME and not _OF_SOME[name](measurements):
            continue
        finding = check(measurements) or SystemFinding(name, "skipped", "no rollout was measured for it")
        if name in _COMPARING and found["repeatable"].status == "failed":
            finding = SystemFinding(name, "skipped", "equal rollouts differ already")
        if measurements.program and finding.remedy:
            finding = replace(finding, remedy=OF_PROGRAM.get(name, finding.remedy))
        # One line: what a system raises or prints is untrusted text.
        found[name] = replace(finding, detail=one_line(finding.detail))
    return tuple(found.values())
