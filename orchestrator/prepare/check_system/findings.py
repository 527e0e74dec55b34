"""The checks of a system, and their findings."""

from dataclasses import dataclass
from typing import Literal

FindingStatus = Literal["passed", "warning", "failed", "skipped"]

SYSTEM_CHECKS = {
    "ends": "every rollout ends within its time limit, and no rollout ends the process",
    "errors": "no rollout raises an exception",
    "columns": "every trajectory has the columns of the system",
    "finite": "every number is finite, at the corners of the box and at random starts",
    "times": "the first sample is at 0, the times increase in equal steps, the last sample is at the horizon",
    "repeatable": "equal requests give equal bytes: again, after other rollouts, in another process",
    "together": "rollouts of two processes at the same time give the same as each alone",
    "batches": "a rollout is the same in a batch and alone, whatever the others are and in which order",
    "seed": "the rollouts of a noisy variant differ between seeds, those of another one do not",
    "actions": "a policy acts within the limits of its environment, and a controller sets the actuators",
    "disturbances": "every declared disturbance has an effect, and nothing else is random unless the system says so",
    "reported": "the numbers that rollouts draw themselves and report have their laws",
    "random state": "no rollout depends on the global random state, or changes it",
    "horizon": "a longer horizon gives a longer trajectory with the same beginning",
    "memory": "the memory of the process does not grow with its rollouts",
    "output": "no rollout prints to stdout",
    "leftovers": "no rollout leaves threads, processes or files behind",
    "files": "every file that a rollout reads is part of the system",
    "speed": "time of a rollout, size of its file",
}
"""Every check in the order of the table, and what it tests."""


OF_PROGRAM = {
    "ends": 'let every rollout end, with {"error": "TEXT"} where it cannot be simulated; if it takes longer, choose '
    "--timeout, or a `deadline` in the campaign file",
    "errors": "fix the program: its answer, or its last lines on stderr, are in the reason, and stdout is for answers "
    "alone; if it is not defined there, narrow the ranges of [space]",
    "columns": "write the numbers of `columns` alone, in their order, and in the form that `samples` names",
    "finite": "fix the arithmetic at this start (a division by 0, an overflow, an unstable step), or narrow the ranges "
    "of [space] to where the system is defined",
    "times": "let the first sample be at 0 and the last one at `horizon`, in the steps that `step` names; what an "
    "early end means is said by after_end",
    "repeatable": "set every variable anew at the beginning of a rollout, and draw random numbers from `seed` alone: "
    "no clock, no pid, no order of threads. A program that ends after each rollout keeps nothing",
    "together": "write files into the folder PERFBOUND_SCRATCH, listen at the port PERFBOUND_PORT, and name locks, "
    "devices and displays by PERFBOUND_WORKER, in place of fixed names; or run one worker on each machine",
    "seed": "draw all random numbers from the whole `seed` (seed_bits = 32 in [system] makes it fit), and let noisy in "
    "[system] say which variants depend on it",
    "disturbances": "use the values under `disturbances` in each line; with residual = false in [system] use no seed",
    "memory": "free what a rollout allocates, or let the program end after each rollout",
    "leftovers": "write no files but the one at `path`, or remove them, and end every process before the answer",
}
"""Remedies for a program, whose file is no place for those of Python."""


@dataclass(frozen=True)
class SystemFinding:
    """One line of the table: what was found, and what to do about it."""

    check: str
    status: FindingStatus
    detail: str
    remedy: str = ""

    @property
    def meaning(self) -> str:
        """What this check tests."""
        return SYSTEM_CHECKS[self.check]


def passed(check: str, detail: str) -> SystemFinding:
    """Return the finding of a check that passed."""
    return SystemFinding(check, "passed", detail)


def warning(check: str, detail: str, remedy: str) -> SystemFinding:
    """Return a finding on which no certificate rests."""
    return SystemFinding(check, "warning", detail, remedy)


def failed(check: str, detail: str, remedy: str) -> SystemFinding:
    """Return a finding that makes certificates worthless."""
    return SystemFinding(check, "failed", detail, remedy)
