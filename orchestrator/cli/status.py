"""`perfbound status`: the progress of a campaign, from its database alone."""

import math
import time
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ...schemas.errors import one_line
from ...schemas.problem_models import KrigingProblem
from ..campaign.forecast import left_in_words
from ..campaign.outlook import outlook_lines
from ..certificate import files
from ..run.format import duration, resume_command
from ..run.table import progress_table, remaining_tests
from ..store import lock
from ..store.progress import CampaignProgress, read_progress
from .result import print_end


def print_status(directory: Path, console: Console) -> None:
    """Print problems, workers, rate and state.

    Raises:
        PerfboundError: there is no campaign here, or its database cannot be read.

    """
    found = read_progress(directory)
    certificate = files.read(directory)
    running = lock.is_held(directory)
    config = found.header.config
    state = "running" if running else "finished" if certificate else "stopped"
    title = Text(config.name, "bold").append(f"  {state}, seed {config.seed}, run {found.header.run}", "not bold")
    console.print(title, soft_wrap=True)
    rows = []
    for problem, each in zip(config.problems, found.problems, strict=True):
        left = remaining_tests(config, problem, each)
        rows.append((each, "-" if left is None else left_in_words(config, problem, left)))
    console.print(progress_table(config, rows))
    outlooks = outlook_lines(config, found.problems)
    if certificate is None and any(isinstance(each, KrigingProblem) for each in config.problems):
        outlooks = _planned_outlooks(directory)
    for line in (*outlooks, *_work(found, running=running)):
        console.print(Text(line), soft_wrap=True)
    if certificate is not None:
        print_end(directory, found.header, certificate, console)
    elif not running:
        console.print(Text(f"continue with: {resume_command(directory)}"), soft_wrap=True)


def _planned_outlooks(directory: Path) -> list[str]:
    """Return the forecasts of a campaign with planned tests: they take its weights, which are planned again."""
    from ..report.collect import Collector  # noqa: PLC0415  (loads numpy, and takes seconds)

    return [f"{each.name}, {each.outlook}" for each in Collector(directory).refresh().problems if each.outlook]


def _work(progress: CampaignProgress, *, running: bool) -> list[str]:
    now = time.time()
    lines = []
    for name, rollouts, last in progress.workers:
        ago = f", the last {duration(max(0.0, now - last))} ago" if running else ""
        lines.append(f"worker {name}: {_number(rollouts, 'rollout')}{ago}")
    for each in progress.pauses:
        left = duration(each.until - now) if each.until < math.inf else "all the rest"
        still = f", {left} to go" if running and each.until > now else ""
        lines.append(
            f"{each.kind} {each.name}: set aside {_number(each.count, 'time')}{still}; {one_line(each.reason)}"
        )
    if progress.opinions:
        counts = ", ".join(f"{count} {kind}" for kind, count in progress.opinions.items())
        lines.append(f"results: {counts} (`perfbound export DIR opinions` lists them)")
    of_system = f" ({progress.system_failures} failed in the system)" if progress.system_failures else ""
    lines.append(
        f"{progress.rate:.1f} rollouts/s in the last minute of work; {_number(progress.failures, 'attempt')} without a "
        f"result{of_system}; {_number(progress.sessions, 'start')} of the orchestrator"
    )
    return lines


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
