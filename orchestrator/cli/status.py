"""`perfbound status`: the progress of a campaign, from its database alone."""

import math
import shlex
import time
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ...schemas.certificate import Certificate
from ...schemas.errors import one_line
from ...schemas.facts import Header
from ...schemas.places import short_path
from ..campaign.forecast import left_in_words
from ..campaign.outlook import outlook_lines
from ..certificate import files, text
from ..fleet.child import in_file
from ..run.format import duration, replay_command, resume_command
from ..run.table import progress_table, remaining_tests
from ..store import lock
from ..store.export_tables import robustness_unit
from ..store.progress import CampaignProgress, read_progress
from ..store.read import system_reference

OUTPUT = {
    "certificate.json": "certificate",
    "certificate.dsse.json": "signed",
    "regions.csv": "regions",
    "manifest.sha256": "manifest",
    "trajectories": "evidence",
    "campaign.db": "database",
    "report.html": "report",
}
"""The files of a run directory, and what they are, in the order of the output."""


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
    for line in (*outlook_lines(config, found.problems), *_work(found, running=running)):
        console.print(Text(line), soft_wrap=True)
    if certificate is not None:
        print_result(directory, found.header, certificate, console)
    elif not running:
        console.print(Text(f"continue with: {resume_command(directory)}"), soft_wrap=True)


def print_result(directory: Path, header: Header, certificate: Certificate, console: Console) -> None:
    """Print the certificate of a finished campaign, its files, and what comes next."""
    text.print_certificate(certificate, console, robustness_unit(header.config, header.spec))
    print_files(directory, console)
    reference = system_reference(directory)
    found = certificate.predicate.counterexample
    if found and (again := replay_command(directory, header, found.rollout, reference if in_file(reference) else None)):
        console.print(Text("\nTo repeat the counterexample, with a picture:"))
        console.print(Text(f"  {again} --out counterexample.png"), soft_wrap=True)
    verify = f"perfbound verify {shlex.quote(str(directory))}"
    if header.spec.repeated == "anywhere":
        system = f" --system {shlex.quote(short_path(reference))}" if in_file(reference) else ""
        verify += f" --resimulate 5{system}"
    console.print(Text("\nThe campaign is finished. Its report shows the claim; to check it against the evidence:"))
    console.print(Text(f"  {verify}"), soft_wrap=True)


def print_files(directory: Path, console: Console) -> None:
    """Print the output files of a run."""
    console.print(Text("\nOutput files", "bold"))
    for name, content in OUTPUT.items():
        if (directory / name).exists():
            console.print(Text(f"  {content:<12} {directory / name}"), soft_wrap=True)


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
