"""`perfbound status`: how far a campaign is, from its database alone."""

import time
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from orchestrator import forecast, summary
from orchestrator.certificate import files
from orchestrator.session import resume_command
from orchestrator.store import lock, queries
from orchestrator.words import MINIMA, duration, figure


def show(directory: Path, console: Console) -> None:
    """Print problems, workers, rate and state.

    Raises:
        PerfboundError: there is no campaign here, or its database cannot be read.

    """
    progress = queries.progress(directory)
    certificate = files.read(directory)
    running = lock.is_held(directory)
    config = progress.header.config
    state = "running" if running else "finished" if certificate else "stopped"
    title = Text(config.name, "bold").append(f"  {state}, seed {config.seed}, run {progress.header.run}", "not bold")
    console.print(title, soft_wrap=True)
    console.print(_problems(progress))
    for line in _work(progress, running=running):
        console.print(Text(line), soft_wrap=True)
    if certificate is not None:
        summary.show(certificate, console)
        summary.written(directory, console)
    elif not running:
        console.print(Text(f"go on with: {resume_command(directory)}"), soft_wrap=True)


def _problems(progress: queries.CampaignProgress) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("problem", "tests", "F or U-L", "alpha", "bound so far", "rollouts", "tests left"):
        table.add_column(name, justify="left" if name == "problem" else "right")
    config = progress.header.config
    for problem, found in zip(config.problems, progress.problems, strict=True):
        distance = forecast.distance(problem, found.last_F, found.upper, found.lower)
        left = forecast.tests_left(config, problem, distance, found.tests)
        bound = -found.upper if found.upper is not None and problem.name in MINIMA else found.upper
        table.add_row(
            problem.name,
            f"{found.tests} of {config.max_tests_of(problem)}",
            figure(distance),
            f"{problem.alpha:g}",
            figure(bound),
            str(found.rollouts),
            f"ended: {found.stopped_by}" if found.stopped_by else "-" if left is None else f"about {left}",
        )
    return table


def _work(progress: queries.CampaignProgress, *, running: bool) -> list[str]:
    now = time.time()
    lines = []
    for name, rollouts, last in progress.workers:
        ago = f", the last {duration(max(0.0, now - last))} ago" if running else ""
        lines.append(f"worker {name}: {_number(rollouts, 'rollout')}{ago}")
    lines.append(
        f"{progress.rate:.1f} rollouts/s in the last minute of work; {_number(progress.failures, 'attempt')} without a "
        f"result; {_number(progress.sessions, 'start')} of the orchestrator"
    )
    return lines


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
