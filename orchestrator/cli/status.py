"""`perfbound status`: the progress of a campaign, from its database alone."""

import math
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from ...schemas.errors import one_line
from ...schemas.file.parts import alpha_of
from ...schemas.file.problem_models import KrigingProblem
from ...schemas.result.so_far import SoFar
from ..certificate import files
from ..forecast.outlook import left_in_words, outlook_lines, remaining_tests
from ..forecast.remaining import budget
from ..run.continuation import continue_command
from ..run.display.progress_table import bound_in_sense, legend_lines, progress_table, remaining_distance
from ..run.display.so_far_text import so_far_view
from ..run.format import duration
from ..run.verdict import verdict_of
from ..store import lock
from ..store.progress import CampaignProgress, read_progress
from ..store.so_far import read_so_far
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
    state = _state_word(finished=certificate is not None, running=running)
    title = Text(config.name, "bold").append(f"  {state}, seed {config.seed}, run {found.header.run}", "not bold")
    console.print(title, soft_wrap=True)
    rows = []
    for problem, each in zip(config.problems, found.problems, strict=True):
        left = remaining_tests(config, problem, each) if each.tests else None
        rows.append((each, "-" if left is None else left_in_words(config, problem, left)))
    so_far = None if certificate is not None else _so_far_of(directory, found.header.run)
    if so_far is not None:
        _print_so_far(so_far, console, running=running)
    console.print(progress_table(config, rows))
    if (down := _link_down_for(found, so_far, running=running)) is not None:
        text = f"the link to the router has been down for {duration(down)}: no rollout can arrive"
        console.print(Text(text, "yellow"), soft_wrap=True)
    outlooks = outlook_lines(config, found.problems)
    if certificate is None and any(isinstance(each, KrigingProblem) for each in config.problems):
        outlooks = _planned_outlooks(directory)
    for line in (*legend_lines(config), *outlooks, *_work(found, running=running)):
        console.print(Text(line), soft_wrap=True)
    if certificate is not None:
        print_end(directory, found.header, certificate, console)
    elif not running:
        console.print(Text(f"continue with: {continue_command(directory)}"), soft_wrap=True)


def status_object(directory: Path) -> dict[str, Any]:
    """Return the progress of a campaign as an object for JSON: verdict and forecast of one that runs, or the verdict.

    Raises:
        PerfboundError: there is no campaign here, or its database cannot be read.

    """
    found, certificate, running = read_progress(directory), files.read(directory), lock.is_held(directory)
    config = found.header.config
    so_far = None if certificate is not None else _so_far_of(directory, found.header.run)
    verdict = None if certificate is None else verdict_of(directory, found.header, certificate)
    return {
        "campaign": config.name,
        "seed": config.seed,
        "run": found.header.run,
        "state": _state_word(finished=certificate is not None, running=running),
        "verdict": verdict.model_dump(mode="json") if verdict else None,
        "so_far": so_far.model_dump(mode="json") if so_far else None,
        "problems": [
            {
                "name": problem.name,
                "tests": each.tests,
                "most_tests": budget(config, problem, each.extended),
                "rollouts": each.rollouts,
                "bound": bound_in_sense(config, problem, each),
                "distance": remaining_distance(config, problem, each),
                "alpha": alpha_of(config, problem),
                "stopped_by": each.stopped_by,
            }
            for problem, each in zip(config.problems, found.problems, strict=True)
        ],
        "rollouts_per_second": found.rate,
        "router_link_down_for": _link_down_for(found, so_far, running=running),
        "attempts": {
            "without_result": found.failures,
            "failed_in_system": found.system_failures,
            "handed_back": found.handed_back,
        },
        "resume": None if certificate is not None or running else continue_command(directory),
    }


def _so_far_of(directory: Path, run: str) -> SoFar | None:
    found = read_so_far(directory)
    return found if found is not None and found.run == run else None


def _link_down_for(progress: CampaignProgress, so_far: SoFar | None, *, running: bool) -> float | None:
    """Return the seconds without a link to the router, by the last file of the session that runs; None with one."""
    if not running or so_far is None or so_far.link_down_since is None or so_far.at < progress.began:
        return None
    return max(0.0, time.time() - so_far.link_down_since)


def _state_word(*, finished: bool, running: bool) -> str:
    return "running" if running else "finished" if finished else "stopped"


def _print_so_far(found: SoFar, console: Console, *, running: bool) -> None:
    console.print(so_far_view(found, running=running))
    for each in found.assumptions:
        if each.status == "refuted" and each.id not in found.others:
            console.print(Text(f"REFUTED: {each.id}: {each.detail}", "bold red"), soft_wrap=True)
    if not running:
        ago = duration(max(0.0, time.time() - found.at))
        console.print(Text(f"as of {found.tests} tests, {ago} ago: no process runs this campaign now"), soft_wrap=True)
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
    handed_back = f"; {_number(progress.handed_back, 'attempt')} handed back" if progress.handed_back else ""
    lines.append(
        f"{progress.rate:.1f} rollouts/s in the last minute of work; {_number(progress.failures, 'attempt')} without a "
        f"result{of_system}{handed_back}; {_number(progress.sessions, 'start')} of the orchestrator"
    )
    return lines


def _number(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
