"""The output of `perfbound report`: a page that needs no server, the counterexamples, and the figures."""

import os
import shlex
from dataclasses import replace
from pathlib import Path

from ...schemas import atomic
from ...schemas.errors import one_line
from ..certificate.verify.stages import Report
from ..certificate.words.format import resume_command
from ..store import export
from ..store.files import inside
from . import html
from .collect.campaign import Collector
from .data.claims import VerdictCard
from .data.page import ReportData, to_json
from .data.rollouts import Rollout
from .stages import unreported

REPORT, COUNTEREXAMPLES, FIGURES = "report.html", "counterexamples.csv", "figures"


def collected(directory: Path) -> ReportData:
    """Return the report data of the campaign in `directory`, running, stopped or finished.

    Raises:
        PerfboundError: there is no campaign, or it cannot be read.

    """
    return Collector(directory).refresh()


def relocatable(data: ReportData) -> ReportData:
    """Return the data with commands for a shell in the run directory, since a report may be moved with it."""

    def moved(rollout: Rollout) -> Rollout:
        return replace(rollout, command=_in_its_directory(rollout.command))

    found, verdict = data.counterexample, data.verdict
    return replace(
        data,
        scenes=tuple(replace(scene, rollouts=tuple(map(moved, scene.rollouts))) for scene in data.scenes),
        counterexamples=tuple(map(moved, data.counterexamples)),
        verdict=verdict and _in_place(verdict, data.resume),
        counterexample=found and replace(found, command=_in_its_directory(found.command)),
        resume=resume_command(Path()),
    )


def _in_place(verdict: VerdictCard, resume: str) -> VerdictCard:
    advice = (each.replace(resume, resume_command(Path())) for each in verdict.advice)
    return replace(verdict, command=_in_its_directory(verdict.command), advice=tuple(advice))


def _in_its_directory(command: str) -> str:
    words = shlex.split(command)
    if not words:
        return ""
    for number in range(3, len(words)):
        # From the folder in which this report is made, where it is not absolute.
        if words[number - 1] == "--system" and not os.path.isabs(words[number]):
            words[number] = os.path.relpath(words[number], words[2])
    return shlex.join([*words[:2], ".", *words[3:]])


def write_page(directory: Path, data: ReportData) -> tuple[Path, ...]:
    """Write the page and the counterexamples, each file whole or not at all, and return the files, the page first.

    Raises:
        PerfboundError: the database cannot be read.
        OSError: the directory cannot be written.

    """
    export.counterexamples(directory, directory / COUNTEREXAMPLES)
    page = html.standalone_page(f"{data.name}: perfbound report", to_json(relocatable(data)))
    atomic.write_whole(directory / REPORT, page.html.encode())
    return (directory / REPORT, directory / COUNTEREXAMPLES)


def finish_page(directory: Path) -> str:
    """Write the page of a finished campaign, and return why there is none in one line; empty where it is written."""
    try:
        write_page(directory, collected(directory))
    except Exception as error:  # noqa: BLE001  (any: the certificate is already there, and the report only shows it)
        command = shlex.join(["perfbound", "report", str(directory)])
        return one_line(f"{directory}: finished, but there is no report: {error}; run `{command}`")
    return ""


def write_figures(directory: Path, data: ReportData, report: Report = unreported) -> tuple[Path, ...]:
    """Write the figures as SVG and PNG, and return the files; this takes seconds.

    Raises:
        OSError: the directory cannot be written.

    """
    report("figures", 0, len(data.problems))
    from .figures import figures  # noqa: PLC0415  (late: matplotlib takes a second to load)

    written = []
    for done, problem in enumerate(data.problems, 1):
        for name, picture in figures(replace(data, problems=(problem,))):
            written.append(inside(directory, f"{FIGURES}/{name}"))
            atomic.write_whole(written[-1], picture)
        report("figures", done, len(data.problems))
    return tuple(written)
