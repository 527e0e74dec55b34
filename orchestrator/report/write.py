"""`perfbound report`: one page that needs no server, the counterexamples, and the figures, beside the evidence."""

import shlex
from dataclasses import replace
from pathlib import Path

from ...schemas import atomic
from ..run.format import resume_command
from ..store import export
from . import html
from .collect import Collector
from .data import ReportData, Rollout, to_json

REPORT, COUNTEREXAMPLES, FIGURES = "report.html", "counterexamples.csv", "figures"


def tell(directory: Path) -> ReportData:
    """Return the story of the campaign in `directory` now, whether it runs, has stopped or is finished.

    Raises:
        PerfboundError: there is no campaign, or it cannot be read.

    """
    return Collector(directory).look()


def here(story: ReportData) -> ReportData:
    """Return the story with commands for somebody who stands in the run directory: a report may have been moved."""

    def moved(rollout: Rollout) -> Rollout:
        return replace(rollout, command=shlex.join(["perfbound", "replay", ".", rollout.id]))

    scenes = tuple(replace(scene, rollouts=tuple(map(moved, scene.rollouts))) for scene in story.scenes)
    return replace(
        story,
        scenes=scenes,
        counterexamples=tuple(map(moved, story.counterexamples)),
        resume=resume_command(Path()),
    )


def write(directory: Path, story: ReportData) -> tuple[Path, ...]:
    """Write the page and the counterexamples, each file whole or not at all, and return the files, the page first.

    Raises:
        PerfboundError: the database cannot be read.
        OSError: the directory cannot be written.

    """
    export.counterexamples(directory, directory / COUNTEREXAMPLES)
    page = html.report(f"{story.name}: perfbound report", to_json(here(story)))
    atomic.write(directory / REPORT, page.html.encode())
    return (directory / REPORT, directory / COUNTEREXAMPLES)


def write_figures(directory: Path, story: ReportData) -> tuple[Path, ...]:
    """Write the figures as SVG and PNG, and return the files; it takes seconds.

    Raises:
        OSError: the directory cannot be written.

    """
    from .figures import figures  # noqa: PLC0415  (late: matplotlib takes a second to load)

    pictures = dict(figures(story))
    for name, picture in pictures.items():
        atomic.write(directory / FIGURES / name, picture)
    return tuple(directory / FIGURES / name for name in pictures)
