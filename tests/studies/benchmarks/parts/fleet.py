"""Growth with rollouts, heartbeats and workers: time, memory, database, files.

python -m tests.studies.benchmarks.parts.fleet ROLLOUTS FOLDER

runs one long campaign with ten times as many heartbeats in FOLDER.
"""

import resource
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.progress import read_progress
from perfbound.orchestrator.store.rows import DATABASE
from tests.campaigns import REPLICATES, cheap
from tests.fakes.puppets import Stage, scratch
from tests.studies.benchmarks.parts import sessions
from tests.studies.benchmarks.report import Row

ROLLOUTS = 5000
BEATS = 10
"""Heartbeats per rollout."""
PUPPETS = 64
WORKERS = (10, 100, 1000, 10_000)
HEARTBEATS = 20_000
PAGE = resource.getpagesize()


def main() -> list[Row]:
    """Return the rows of a short run; the long one is asked for by hand."""
    with scratch() as folder:
        rows = long(ROLLOUTS, Path(folder))
    return [*rows, *(row for workers in WORKERS for row in crowd(workers)), *sessions.main()]


# One long campaign


@dataclass(frozen=True)
class Mark:
    """Measurements at one moment."""

    rollouts: int
    cpu: float
    """Seconds so far, without the puppets'."""
    memory: int
    """Resident bytes."""


def long(rollouts: int, folder: Path) -> list[Row]:
    """Run a campaign of so many rollouts, then replay it."""
    directory = folder / "run"
    stage, marks = Stage(directory, cheap(rollouts), PUPPETS, beats=BEATS), list[Mark]()
    stage.play(lambda: _mark(stage, marks))
    stage.journal.close()
    early, late = _between(marks, 0.1, 0.4), _between(marks, 0.7, 1.0)
    name = f"{rollouts} rollouts, {rollouts * BEATS} heartbeats"
    files = [path.stat() for path in directory.rglob("*.mcap")]
    return [
        Row(f"{name}: CPU per rollout, last third", late[0] * 1000, "ms", "first third", early[0] * 1000),
        Row(f"{name}: memory per rollout, last third", late[1], "bytes"),
        Row(f"{name}: memory at the end", marks[-1].memory / 1e6, "MB", "after a tenth", _at(marks, 0.1).memory / 1e6),
        Row(f"{name}: database per rollout", (directory / DATABASE).stat().st_size / rollouts, "bytes"),
        Row(f"{name}: file per rollout", sum(file.st_size for file in files) / len(files), "bytes"),
        Row(f"{name}: blocks of that file", sum(file.st_blocks * 512 for file in files) / len(files), "bytes"),
        Row(f"{name}: replay", replay(directory), "s", at_most=10.0),
        Row(f"{name}: a refresh of the progress", refresh_seconds(directory) * 1000, "ms"),
    ]


def _mark(stage: Stage, marks: list[Mark]) -> bool:
    cpu = time.process_time() - stage.puppets.own.cpu
    memory = int(Path("/proc/self/statm").read_text().split()[1]) * PAGE
    marks.append(Mark(stage.puppets.delivered, cpu, memory))
    return False


def _at(marks: list[Mark], share: float) -> Mark:
    return next(mark for mark in marks if mark.rollouts >= share * marks[-1].rollouts)


def _between(marks: list[Mark], start: float, end: float) -> tuple[float, float]:
    """Return CPU seconds and bytes per rollout between two shares of the campaign."""
    first, last = _at(marks, start), _at(marks, end)
    count = last.rollouts - first.rollouts
    return (last.cpu - first.cpu) / count, (last.memory - first.memory) / count


def replay(directory: Path) -> float:
    """Return the CPU seconds from opening the database to the state at its end."""
    start = time.process_time()
    journal = Journal.open(directory)
    Ledger(directory, journal).replay()
    journal.close()
    return time.process_time() - start


def refresh_seconds(directory: Path) -> float:
    """Return the CPU seconds of one refresh of a reader."""
    read_progress(directory)
    start = time.process_time()
    read_progress(directory)
    return time.process_time() - start


# Many workers


def crowd(workers: int) -> list[Row]:
    """Measure heartbeats of idle and of busy workers, and rollouts, with so many workers."""
    with scratch() as folder:
        idle = _beating(Path(folder) / "idle", workers, busy=False)
        busy = _beating(Path(folder) / "busy", workers, busy=True)
        rollouts = _rolling(Path(folder) / "rolling", workers)
    name = f"{workers} workers"
    return [
        Row(f"{name}: a heartbeat, all idle", idle * 1e6, "us"),
        Row(f"{name}: a heartbeat, all busy", busy * 1e6, "us"),
        Row(f"{name}: a rollout, without heartbeats", rollouts * 1000, "ms"),
        Row(f"{name}: share of a core for two heartbeats a second", 200 * workers * busy, "%"),
    ]


def _beating(directory: Path, workers: int, *, busy: bool) -> float:
    """Return CPU seconds a heartbeat."""
    window = max(1, 2 * workers // REPLICATES) if busy else 1
    stage = Stage(directory, cheap(10**6, window), workers)
    puppets = stage.puppets
    puppets.holding = True
    spent: list[tuple[float, int]] = []

    def beat() -> bool:
        spent.append((time.process_time() - puppets.own.cpu, puppets.beaten))
        puppets.beat_all(max(1, 2000 // workers))
        return puppets.beaten >= 4 * max(HEARTBEATS, workers)

    stage.play(beat)
    stage.journal.close()
    first, last = spent[len(spent) // 2], spent[-1]  # by then all that can be busy are
    return (last[0] - first[0]) / (last[1] - first[1])


def _rolling(directory: Path, workers: int) -> float:
    rollouts = max(2000, workers)
    stage = Stage(directory, cheap(rollouts, max(1, 2 * workers // REPLICATES)), workers)
    stage.play()
    stage.journal.close()
    return stage.per_rollout()[1]


if __name__ == "__main__":
    from tests.studies.benchmarks import report

    sys.stdout.write(report.table(long(int(sys.argv[1]), Path(sys.argv[2]))))
