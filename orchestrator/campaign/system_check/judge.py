"""The findings about a system: a pure function of what its child processes measured."""

from collections.abc import Callable
from dataclasses import replace

from ....schemas.errors import one_line
from . import costs, files, repeats, together, trajectories
from .findings import OF_PROGRAM, SystemFinding
from .measurements import Measurements

_CHECKS: dict[str, Callable[[Measurements], SystemFinding | None]] = {
    "ends": trajectories.judge_ends,
    "errors": trajectories.judge_errors,
    "columns": trajectories.judge_columns,
    "finite": trajectories.judge_finite,
    "times": trajectories.judge_times,
    "repeatable": repeats.judge_repeatable,
    "together": together.judge_together,
    "seed": repeats.judge_seed,
    "random state": repeats.judge_random_state,
    "horizon": trajectories.judge_horizon,
    "memory": costs.judge_memory,
    "output": costs.judge_output,
    "leftovers": costs.judge_leftovers,
    "files": files.judge_files,
    "speed": costs.judge_speed,
}
_COMPARING = {"together", "seed", "horizon"}
"""Checks that compare rollouts, and so need repeatable ones."""


def judge(measurements: Measurements) -> tuple[SystemFinding, ...]:
    """Return one finding for each check; a check that nothing was measured for is skipped."""
    found: dict[str, SystemFinding] = {}
    for name, check in _CHECKS.items():
        finding = check(measurements) or SystemFinding(name, "skipped", "no rollout was measured for it")
        if name in _COMPARING and found["repeatable"].status == "failed":
            finding = SystemFinding(name, "skipped", "equal rollouts differ already")
        if measurements.program and finding.remedy:
            finding = replace(finding, remedy=OF_PROGRAM.get(name, finding.remedy))
        # One line: what a system raises or prints is untrusted text.
        found[name] = replace(finding, detail=one_line(finding.detail))
    return tuple(found.values())
