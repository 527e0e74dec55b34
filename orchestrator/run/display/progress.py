"""Progress of a run as a live table, as lines, as JSON and for systemd; a listener for each form."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from ....schemas.file.config import CampaignConfig
from ....schemas.file.parts import alpha_of
from ....schemas.file.problem_models import Problem
from ....schemas.result.certificate import Assumption
from ....schemas.result.known import SoFar
from ....schemas.values import ProblemProgress
from ...certificate.words.format import ENDS, duration, figure
from ...certificate.words.known_text import refutation_line, so_far_line, so_far_view
from ...forecast.outlook import outlook_lines, remaining_tests
from ..routers import is_down
from ..service import RunStatus
from .json_lines import JsonLines
from .progress_table import LEGEND, bound_in_sense, bound_text, legend_lines, progress_table, remaining_distance
from .systemd import Systemd

PLAIN_PERIOD = 10.0
"""Seconds between two progress lines where there is no terminal."""
RATE_SPAN = 15.0
"""Seconds over which the rate is taken."""


class Terminal:
    """A live table on a terminal."""

    def __init__(self, console: Console, live: Live) -> None:
        self._console, self._live = console, live
        self._rate = Rate()
        self._so_far: SoFar | None = None

    def print_line(self, line: str) -> None:
        """Print a line above the table."""
        self._console.print(Text(line, "yellow"), soft_wrap=True)

    def refuted(self, found: Assumption, then: str) -> None:
        """Print a refutation above the table."""
        self._console.print(Text(refutation_line(found, then), "bold red"), soft_wrap=True)

    def so_far(self, found: SoFar) -> None:
        """Keep what the run has shown so far for the next drawing."""
        self._so_far = found

    def show(self, status: RunStatus) -> None:
        """Redraw the table."""
        rate, config = self._rate.of(status), status.config
        running = sum(each.stopped_by is None for each in status.problems.values())
        rows = [
            (each, "-" if is_down(status.link) else _time_left(config, problem, each, rate / max(1, running)))
            for problem, each in zip(config.problems, status.problems.values(), strict=True)
        ]
        outlooks = outlook_lines(config, list(status.problems.values()))
        lines = [*legend_lines(config), *outlooks, worker_line(status, rate)]
        above: list[RenderableType] = [so_far_view(self._so_far), Text()] if self._so_far else []
        below = (Text(line, style="dim") for line in lines)
        self._live.update(Group(*above, progress_table(config, rows, status.closing), *below))


class Plain:
    """Log lines, or JSON lines with the numbers as fields: one for each problem that ends, and all periodically."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._json = console.file if isinstance(console.file, JsonLines) else None
        self._rate = Rate()
        self._last = time.monotonic()
        self._ended: set[str] = set()
        self._has_legend = False
        self._so_far: SoFar | None = None

    def print_line(self, line: str) -> None:
        """Print a line."""
        self._console.print(Text(line), soft_wrap=True)

    def refuted(self, found: Assumption, then: str) -> None:
        """Print a refutation."""
        if self._json is None:
            self.print_line(refutation_line(found, then))
        else:
            self._json.line("refuted", level="warning", assumption=found.id, reason=found.detail, then=then)

    def so_far(self, found: SoFar) -> None:
        """Keep what the run has shown so far for the next lines."""
        self._so_far = found

    def show(self, status: RunStatus) -> None:
        """Print the lines that are due."""
        rate, now = self._rate.of(status), time.monotonic()
        due = now - self._last >= PLAIN_PERIOD
        for problem, progress in zip(status.config.problems, status.problems.values(), strict=True):
            if self._has_news(problem.name, progress, due=due):
                self._problem(status.config, problem, progress)
        for name, progress in status.closing.items():
            if self._has_news(name, progress, due=due):
                self._check(name, progress)
        if due:
            self._last = now
            if self._json is None:
                for line in outlook_lines(status.config, list(status.problems.values())):
                    self.print_line(line)
            self._workers(status, rate)
            if self._so_far is not None:
                self._holding(self._so_far)

    def _holding(self, found: SoFar) -> None:
        if self._json is None:
            self.print_line(so_far_line(found))
        else:
            self._json.line("so far", **found.model_dump(mode="json", exclude={"assumptions", "run", "at"}))

    def _has_news(self, name: str, progress: ProblemProgress, *, due: bool) -> bool:
        """Whether a series continues and a line is due, or has ended since the last call."""
        if progress.stopped_by is None:
            return due
        news = name not in self._ended
        self._ended.add(name)
        return news

    def _problem(self, config: CampaignConfig, problem: Problem, progress: ProblemProgress) -> None:
        away, bound = remaining_distance(config, problem, progress), bound_in_sense(config, problem, progress)
        alpha = alpha_of(config, problem)
        if self._json is None:
            name = "F" if problem.method == "paper" else "upper - lower"
            end = f"; {ENDS[progress.stopped_by]}" if progress.stopped_by else ""
            distance = "" if alpha is None else f"{name} {figure(away)} (alpha {alpha:g}), "
            early = problem.bound_at_end and not end
            words = "with this budget the bound would be" if early and bound is not None else "bound so far"
            shown = bound_text(config, problem, bound)
            self.print_line(f"{problem.name}: test {progress.tests:,}, {distance}{words} {shown}{end}")
            if problem.method == "paper" and not self._has_legend:
                self._has_legend = True
                self.print_line(LEGEND)
            return
        self._json.line(
            "problem ended" if progress.stopped_by else "progress",
            problem=problem.name,
            tests=progress.tests,
            rollouts=progress.rollouts,
            distance=away,
            alpha=alpha,
            bound=bound,
            stopped_by=progress.stopped_by,
        )

    def _check(self, name: str, progress: ProblemProgress) -> None:
        if self._json is None:
            self.print_line(f"{name}: test {progress.tests:,}{'; ended' if progress.stopped_by else ''}")
        else:
            event = "check ended" if progress.stopped_by else "progress of a check"
            self._json.line(event, check=name, tests=progress.tests, rollouts=progress.rollouts)

    def _workers(self, status: RunStatus, rate: float) -> None:
        if self._json is None:
            self.print_line(worker_line(status, rate))
        else:
            phases = dict(sorted(status.workers.items()))
            numbers: dict[str, Any] = {"rollouts": status.recorded, "rollouts_per_second": round(rate, 2)}
            if status.link is not None:
                numbers["router_link"] = asdict(status.link)
            self._json.line("workers", workers=phases, **numbers)


class SystemdStatus:
    """Progress for the service manager."""

    def __init__(self, systemd: Systemd) -> None:
        self._systemd = systemd

    def print_line(self, line: str) -> None:
        """Drop the line: systemd's journal has it from stderr."""

    def show(self, status: RunStatus) -> None:
        """Notify the watchdog, and send the counts if they have changed."""
        tests = ", ".join(f"{name} {each.tests:,} tests" for name, each in status.problems.items())
        self._systemd.alive(f"{tests}; {len(status.workers):,} workers")
        if status.loop.done:
            self._systemd.outside_loop()


class Rate:
    """Rollouts per second over the last `RATE_SPAN` seconds."""

    def __init__(self) -> None:
        self._points: list[tuple[float, int]] = []

    def of(self, status: RunStatus) -> float:
        """Return the rate now."""
        self._points.append((status.seconds, status.recorded))
        self._points = [point for point in self._points if status.seconds - point[0] <= RATE_SPAN]
        (first, count), (last, total) = self._points[0], self._points[-1]
        return (total - count) / (last - first) if last > first else 0.0


def _time_left(config: CampaignConfig, problem: Problem, progress: ProblemProgress, rate: float) -> str:
    left = remaining_tests(config, problem, progress) if progress.tests else None
    if left is None or rate <= 0:
        return "-"
    return f"about {duration(left.middle * progress.rollouts / progress.tests / rate)}"


def worker_line(status: RunStatus, rate: float) -> str:
    """Return the workers and the throughput."""
    busy = sum(1 for phase in status.workers.values() if phase in ("sent", "busy"))
    trouble = [name for name, phase in status.workers.items() if phase in ("shunned", "gone", "set aside")]
    text = f"workers {len(status.workers):,} ({busy:,} busy), {rate:,.1f} rollouts/s, {duration(status.seconds)} so far"
    if status.link is not None and status.link.down_for is not None:
        away = sum(1 for phase in status.workers.values() if phase == "out of reach")
        text += f", the link to the router has been down for {duration(status.link.down_for)}, {away} out of reach"
    return text + (f", in trouble: {', '.join(trouble)}" if trouble else "")


@contextmanager
def listener(console: Console) -> Iterator[Terminal | Plain]:
    """Yield the form that fits: a live table on a terminal, lines elsewhere."""
    if not console.is_terminal:
        yield Plain(console)
        return
    with Live(console=console, refresh_per_second=4, transient=True) as live:
        yield Terminal(console, live)
