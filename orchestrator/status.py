"""`perfbound status`: how far a campaign is, from its database alone."""

import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from orchestrator import terminal
from orchestrator.certificate import files
from orchestrator.store import lock, queries


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
    console.print(f"[bold]{config.name}[/]  seed {config.seed}, {state}, run {progress.header.run}", highlight=False)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("problem", "tests", "F_i", "alpha", "bound so far", "rollouts", "stopped by"):
        table.add_column(name, justify="left" if name == "problem" else "right")
    for problem, found in zip(config.problems, progress.problems, strict=True):
        bound = found.epsilon
        if bound is not None and problem.name in terminal.MINIMA:
            bound = -bound
        table.add_row(
            problem.name,
            str(found.tests),
            terminal.figure(found.last_F),
            f"{problem.alpha:g}",
            terminal.figure(bound),
            str(found.rollouts),
            found.stopped_by or "-",
        )
    console.print(table)
    now = time.time()
    for name, rollouts, last in progress.workers:
        ago = f", last {terminal.duration(now - last)} ago" if running else ""
        console.print(f"worker {name}: {rollouts} rollouts{ago}", highlight=False)
    console.print(
        f"{progress.rate:.1f} rollouts/s over the last minute of work; {progress.failures} attempts without a result; "
        f"{progress.sessions} orchestrator session(s)",
        highlight=False,
    )
    if certificate is not None:
        terminal.summary(certificate, console)
        terminal.written(directory, console)
    elif not running:
        console.print(f"go on with: perfbound resume {directory}", highlight=False)
