"""`perfbound status`: the progress of a campaign, from its database alone."""

import math
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from ...schemas.amounts import counted
from ...schemas.errors import one_line
from ...schemas.file.problem_models import KrigingProblem
from ...schemas.result.known import SoFar
from ..certificate.words.format import duration
from ..certificate.words.known_text import so_far_view
from ..forecast.outlook import left_in_words, outlook_lines, remaining_tests
from ..run.display.progress_table import legend_lines, progress_table
from ..run.known import known
from ..store.progress import CampaignProgress
from .result import print_end


def print_status(directory: Path, console: Console) -> None:
    """Print problems, workers, rate and state.

    Raises:
        PerfboundError: there is no campaign here, or its database cannot be read.

    """
    found = known(directory)
    header, progress, config = found.progress.header, found.progress, found.progress.header.config
    title = Text(config.name, "bold").append(f"  {found.state}, seed {config.seed}, run {header.run}", "not bold")
    console.print(title, soft_wrap=True)
    rows = []
    for problem, each in zip(config.problems, progress.problems, strict=True):
        left = remaining_tests(config, problem, each) if each.tests else None
        rows.append((each, "-" if left is None else left_in_words(config, problem, left)))
    if found.so_far is not None:
        _print_so_far(found.so_far, console, running=found.running)
    console.print(progress_table(config, rows))
    if (down := found.link_down_for) is not None:
        text = f"the link to the router has been down for {duration(down)}: no rollout can arrive"
        console.print(Text(text, "yellow"), soft_wrap=True)
    outlooks = outlook_lines(config, progress.problems)
    if found.certificate is None and any(isinstance(each, KrigingProblem) for each in config.problems):
        outlooks = _planned_outlooks(directory)
    for line in (*legend_lines(config), *outlooks, *_work(progress, running=found.running)):
        console.print(Text(line), soft_wrap=True)
    if found.certificate is not None:
        print_end(directory, header, found.certificate, console)
    elif found.resume:
        console.print(Text(f"continue with: {found.resume}"), soft_wrap=True)


def status_object(directory: Path) -> dict[str, Any]:
    """Return the same for programs, as an object for JSON.

    Raises:
        PerfboundError: as `print_status`.

    """
    return known(directory).model().model_dump(mode="json")


def _print_so_far(found: SoFar, console: Console, *, running: bool) -> None:
    console.print(so_far_view(found, running=running))
    for each in found.assumptions:
        if each.status == "refuted" and each.id not in found.others:
            console.print(Text(f"REFUTED: {each.id}: {each.detail}", "bold red"), soft_wrap=True)
    if not running:
        tests, ago = counted(found.tests, "test"), duration(max(0.0, time.time() - found.at))
        console.print(Text(f"as of {tests}, {ago} ago: no process runs this campaign now"), soft_wrap=True)
    console.print()


def _planned_outlooks(directory: Path) -> list[str]:
    """Return the forecasts of a campaign with planned tests: they take its weights, which are planned again."""
    from ..report.collect.campaign import Collector  # noqa: PLC0415  (loads numpy, and takes seconds)

    return [f"{each.name}, {each.outlook}" for each in Collector(directory).refresh().problems if each.outlook]


def _work(progress: CampaignProgress, *, running: bool) -> list[str]:
    now = time.time()
    lines = []
    for name, rollouts, last in progress.workers:
        ago = f", the last {duration(max(0.0, now - last))} ago" if running else ""
        lines.append(f"worker {name}: {counted(rollouts, 'rollout')}{ago}")
    for each in progress.pauses:
        left = duration(each.until - now) if each.until < math.inf else "all the rest"
        still = f", {left} to go" if running and each.until > now else ""
        lines.append(
            f"{each.kind} {each.name}: set aside {counted(each.count, 'time')}{still}; {one_line(each.reason)}"
        )
    if progress.opinions:
        counts = ", ".join(f"{count:,} {kind}" for kind, count in progress.opinions.items())
        lines.append(f"results: {counts} (`perfbound export DIR opinions` lists them)")
    of_system = f" ({progress.system_failures:,} failed in the system)" if progress.system_failures else ""
    handed_back = f"; {counted(progress.handed_back, 'attempt')} handed back" if progress.handed_back else ""
    lines.append(
        f"{progress.rate:,.1f} rollouts/s in the last minute of work; {counted(progress.failures, 'attempt')} without "
        f"a result{of_system}{handed_back}; {counted(progress.sessions, 'start')} of the orchestrator"
    )
    return lines
