"""The lines of a run for its listeners: those that messages of peers cause are limited."""

import shlex
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from ...schemas.errors import one_line
from ...schemas.failure import Failure
from ...schemas.ids import WorkId, rollouts_of
from ...schemas.places import short_path
from ...schemas.rollout import RolloutRequest
from ..campaign.ledger import Ledger
from ..fleet.children.simulate import LIMIT
from ..fleet.dispatch import events
from ..fleet.dispatch.retries import missed


class Lines:
    """The log of one run; `print_line` passes a line to every listener."""

    def __init__(self, print_line: Callable[[str], None]) -> None:
        self.print_line = print_line
        self._throttle = Throttle()
        self._was_full = False
        self._failed: set[tuple[WorkId, Failure]] = set()

    def refused(self, worker: str, reason: str) -> None:
        """Print that a worker is refused."""
        self._about(worker, "refused workers", f"refused worker {worker}: {reason}")

    def simulates(self, worker: str, variants: Iterable[str]) -> None:
        """Print that a worker has only one of two simulators."""
        found = " and ".join(sorted(variants))
        self._about(
            worker,
            "workers with one simulator",
            f"worker {worker} has the simulator of {found} alone, and gets its "
            "rollouts; the others wait for a worker with theirs",
        )

    def ignored(self, worker: str, reason: str) -> None:
        """Print that a message is not acceptable."""
        self._about(worker, "ignored messages", f"ignored a message of {worker}: {reason}")

    def too_many(self, worker: str, most: int) -> None:
        """Print that a worker gets no work because there are `most`; a line for all of them together."""
        if self._was_full:
            return
        self._was_full = True
        self.print_line(
            f"worker {worker}, and those that come after it, get no work: {most:,} workers are there, the most of one "
            "campaign; end them, or start them with --run ID for another campaign"
        )

    def failed(self, found: events.Fail) -> None:
        """Print a failed attempt, once: attempts that fail alike are counted in the database."""
        attempt, failure = found.attempt, found.failure
        if (attempt.rollout, failure) in self._failed:
            return
        self._failed.add((attempt.rollout, failure))
        # The reason is text of a system under test.
        reason = one_line(failure.reason)
        which = f"{attempt.rollout}, attempt {attempt.number} on {found.worker}"
        self._about(found.worker, "failed attempts", f"{which}, {failure.kind} failure: {reason}")

    def summarise(self) -> None:
        """Print how many lines were left out; called every tick."""
        for line in self._throttle.summaries(time.monotonic()):
            self.print_line(line)

    def _about(self, worker: str, kind: str, line: str) -> None:
        if self._throttle.admits(time.monotonic(), kind, worker):
            self.print_line(line)


# The limit of lines about messages of peers, so that none of them fills the terminal or a log

EACH = 10
"""Lines of one kind about one worker in a period."""
ALL = 100
"""Lines of one kind about all workers in a period: a peer that chooses names has as many as it likes."""
PERIOD = 60.0
"""Seconds."""


@dataclass(slots=True)
class _Period:
    began: float
    shown: Counter[str] = field(default_factory=Counter)
    hidden: int = 0


class Throttle:
    """The lines of the present period, by kind; a kind is its name in the plural, such as `ignored messages`.

    Time is in seconds of any one clock. Memory is bounded: `ALL` names a kind.
    """

    def __init__(self) -> None:
        self._periods: dict[str, _Period] = {}

    def admits(self, now: float, kind: str, worker: str) -> bool:
        """Count a line; return whether it may be shown."""
        period = self._periods.setdefault(kind, _Period(now))
        if period.shown.get(worker, 0) < EACH and period.shown.total() < ALL:
            period.shown[worker] += 1
            return True
        period.hidden += 1
        return False

    def summaries(self, now: float) -> list[str]:
        """End the periods that are over; return a line for each that left lines out."""
        over = [(kind, period) for kind, period in self._periods.items() if now - period.began >= PERIOD]
        for kind, _ in over:
            del self._periods[kind]
        return [f"{period.hidden} more {kind} in {PERIOD:g} s, not shown" for kind, period in over if period.hidden]


# The last words of a run whose rollout fails again and again


def poison_text(
    found: events.Poison, request: RolloutRequest, ledger: Ledger, reference: str | None, ends: Mapping[str, str]
) -> str:
    """Return the history of a rollout that fails again and again, the command that repeats it, and the remedy.

    `reference` is that of a system that is not installed; `ends` say how workers have ended.
    """
    config = ledger.config
    by_reason: dict[str, list[str]] = {}
    for each in found.failures:
        end = f" ({how})" if (how := ends.get(each.worker)) else ""
        attempt = f"attempt {each.attempt.number} on {each.worker}{end}"
        by_reason.setdefault(each.failure.reason, []).append(attempt)
    # What is wrong comes first: the names of the workers help nobody who reads one line.
    history = "; ".join(f"{reason} ({', '.join(attempts)})" for reason, attempts in by_reason.items())
    options = [f"--option={name}={value}" for name, value in config.system.options.items()]
    start = ",".join(map(repr, request.x))
    spec = ledger.header.spec
    given = zip(spec.disturbances, request.disturbances, strict=True) if request.disturbances else ()
    bounded = [f"--disturbance={law.name}={value!r}" for law, value in given if law.name in spec.as_parameters]
    rollout = [f"--x={start}", "--variant", request.variant, "--seed", str(request.seed), *bounded]
    system = config.system.name if reference is None else short_path(reference)
    limits = ["--horizon", f"{request.horizon:g}"]
    if config.deadline != LIMIT:  # a rollout that hangs is to hang no longer than here
        limits += ["--timeout", f"{config.deadline:g}"]
    command = shlex.join(["perfbound", "simulate", system, *rollout, *limits, *options, "--out", "failed.mcap"])
    repeat = f"Repeat it: {command}"
    if ledger.header.spec.repeated == "session":  # which no command has
        repeat = f"Repeat it: call {request.system.replace('-', '_')} at {start}, with seed {request.seed}"
    if rollouts_of(found.rollout) > 1:
        repeat = f"Of its {rollouts_of(found.rollout)} rollouts repeat the first one alone: {command}"
    elif found.failures[-1].failure == missed(config.deadline):
        missing = f"It exceeds deadline = {config.deadline:g} s at the start ({start})"
        named = (
            "it names the place in the file" if config.system.program is None else "see whether it flushes its answers"
        )
        repeat = f"{missing}; simulated alone, {named}. {repeat}"
    # Another code is another system, with which the recorded rollouts cannot be mixed.
    remedy = "If the code of the system is wrong, fix it and start a new campaign (--out); else"
    which = "batch" if rollouts_of(found.rollout) > 1 else "rollout"
    return (
        f"{which} {found.rollout} failed {len(found.failures)} times, so the campaign cannot continue: {history}. "
        f"{repeat}. {remedy} fix the worker or the machine, then resume"
    )
