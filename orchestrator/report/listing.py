"""The campaigns below a folder, each with its state and its verdict."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.text import Text

from ...schemas.errors import OtherVersionError, PerfboundError, one_line
from ...schemas.result.known import CampaignState, CampaignVerdict, VerdictWord, Violations
from ..certificate import files
from ..certificate.words.console_lines import aligned
from ..certificate.words.format import duration
from ..certificate.words.known_text import COLOURS, first_bound
from ..run.known import state_of, verdict_of
from ..store import lock
from ..store.progress import header_alone
from ..store.robustness import read_number_of_rollouts, read_violations
from ..store.rows import DATABASE

DEPTH = 3
"""Folders below the given one in which campaigns are looked for."""
HEAD = ("campaign", "verdict", "first claim", "state", "rollouts", "violations", "changed")
NUMBERS = ("rollouts", "violations")

ListedState = CampaignState | Literal["damaged", "other version"]


@dataclass(frozen=True, slots=True)
class ListedCampaign:
    """One campaign of a list."""

    directory: Path
    name: str
    state: ListedState
    verdict: VerdictWord | None
    """None while there is no certificate."""
    bound: str
    """Of the first claim with its sense and unit, rounded to the safe side; empty while there is no certificate."""
    rollouts: int
    """All that are recorded."""
    violations: int | None
    """Rollouts of the tested variant that violate the specification; None where none of it has a robustness."""
    changed: float
    """Unix time of the last change of the database."""
    fault: str = ""
    """Why it cannot be read."""
    refuted: bool = False
    """Whether the first claim rests on a refuted assumption."""

    def has(self, text: str) -> bool:
        """Whether a text is part of what is shown of it, whatever the case."""
        shown = f"{self.directory} {self.name} {self.state} {self.verdict or ''} {self.fault}"
        return text.casefold() in shown.casefold()


def campaigns_below(folder: Path) -> Iterator[ListedCampaign]:
    """Yield the campaigns in a folder and below it, the one that changed last first; an unreadable one has its fault.

    Raises:
        PerfboundError: there is no such folder.

    """
    check_folder(folder)
    found = [(last_change(directory), directory) for directory in run_directories(folder)]
    for changed, directory in sorted(found, key=lambda pair: (-pair[0], str(pair[1]))):
        yield read_campaign(directory, changed)[0]


def check_folder(folder: Path) -> None:
    """Refuse a folder of campaigns that is not there; raises PerfboundError."""
    if not folder.is_dir():
        raise PerfboundError(f"{folder}: no such folder; name the one with the run directories, such as runs")


def run_directories(folder: Path) -> Iterator[Path]:
    """Yield the run directories in a folder and at most `DEPTH` folders below it, and none inside another one."""
    for root, folders, names in os.walk(folder):
        if DATABASE in names:
            folders.clear()  # its trajectories: thousands of files, and no campaign
            yield Path(root)
        elif len(Path(root).relative_to(folder).parts) >= DEPTH:
            folders.clear()


def last_change(directory: Path) -> float:
    """Return the Unix time of the last change of the database in a run directory; 0 without one."""
    try:
        return (directory / DATABASE).stat().st_mtime
    except OSError:  # removed meanwhile
        return 0.0


def read_campaign(directory: Path, changed: float) -> tuple[ListedCampaign, CampaignVerdict | None]:
    """Return the campaign in a run directory, and its verdict where it has one; an unreadable one has its fault."""
    try:
        header, certificate, running = header_alone(directory), files.read(directory), lock.is_held(directory)
        state = state_of(certificate, running=running)
        if certificate is None or running:
            seen, recorded = read_violations(directory, header.claimed_variant), read_number_of_rollouts(directory)
            return ListedCampaign(
                directory, header.config.name, state, None, "", recorded, _count_of(seen), changed
            ), None
        found, recorded = (
            verdict_of(directory, header, certificate, repeatable=False),
            read_number_of_rollouts(directory),
        )
    except (PerfboundError, OSError) as error:
        return ListedCampaign(
            directory, directory.name, unreadable(error), None, "", 0, None, changed, one_line(str(error))
        ), None
    bound, violations = first_bound(found), _count_of(found.violations)
    refuted = bool(certificate.predicate.claims[0].refuted)
    return ListedCampaign(
        directory, found.campaign, state, found.verdict, bound, recorded, violations, changed, refuted=refuted
    ), found


def unreadable(error: Exception) -> ListedState:
    """Return the state of a campaign that cannot be read."""
    return "other version" if isinstance(error, OtherVersionError) else "damaged"


def _count_of(seen: Violations) -> int | None:
    return seen.violations if seen.rollouts else None


def listing(campaigns: Sequence[ListedCampaign], now: float) -> Iterator[Text]:
    """Yield a heading and a line for each campaign, in columns; `now` is the Unix time that ages are measured from."""
    rows = [HEAD, *(_cells_of(each, now) for each in campaigns)]
    verdict = 2 + max(len(row[0]) for row in rows)
    styles = ["", *(COLOURS[each.verdict] if each.verdict else "" for each in campaigns)]
    right = [HEAD.index(name) for name in NUMBERS]
    for number, (row, text, style) in enumerate(zip(rows, aligned(rows, right), styles, strict=True)):
        line = Text(text, "bold" if number == 0 else "")
        line.stylize(style, verdict, verdict + len(row[1]))
        yield line


def _cells_of(each: ListedCampaign, now: float) -> tuple[str, ...]:
    age = f"{duration(max(0.0, now - each.changed))} ago"
    bound = f"refuted ({each.bound})" if each.refuted else each.bound
    shown = bound or each.fault or "-"
    folder = one_line(str(each.directory))
    violations = "-" if each.violations is None else f"{each.violations:,}"
    rollouts = "-" if each.fault else f"{each.rollouts:,}"
    return (folder, each.verdict or "-", shown, each.state, rollouts, violations, age)
