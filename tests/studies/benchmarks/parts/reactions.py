"""Time in which the orchestrator detects a dead or hung worker, resumes and stops, in starts of one program.

The start of `perfbound systems` in the same run is the reference: a load makes both longer.
"""

import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from tests.end_to_end.processes import processes, wait_for
from tests.faults.catalogue import randomness
from tests.faults.delays import DELAYS
from tests.faults.scene import Scene
from tests.faults.subjects import Subject, prepare
from tests.studies.benchmarks.report import Row

LIMITS = {"dead-worker": 6, "hung-worker": 6, "resume-local": 4, "resume-remote": 8, "ctrl-c": 3}
"""Limit of each, in starts. On a quiet machine a start takes 1 s, a lease 3 s, and `hung_after` 2 s."""


def main() -> list[Row]:
    """Return a row for each reaction."""
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        subject = prepare("slow", base / "calm")
        reference = _start(base / "reference")
        return [
            Row(
                name,
                _reaction(measure, subject, base / name),
                "s wall",
                "starts of a program",
                reference,
                ratio_at_least=1 / LIMITS[name],
            )
            for name, measure in {**DELAYS, "ctrl-c": _ctrl_c}.items()
        ]


def _start(folder: Path) -> float:
    with processes(folder) as started:
        began = time.monotonic()
        started.run("perfbound", "systems")
        return time.monotonic() - began


def _reaction(measure: Callable[[Scene], float], subject: Subject, folder: Path) -> float:
    scene = Scene(subject, folder, randomness(1, 0))
    try:
        return measure(scene)
    finally:
        scene.close()


def _ctrl_c(scene: Scene) -> float:
    """Return the seconds from Ctrl-C in mid-run until the orchestrator and its workers have ended."""
    scene.start()
    scene.reach(3)
    began = time.monotonic()
    scene.orchestrator.signal_group(signal.SIGINT)
    wait_for(lambda: not scene.alive())
    return time.monotonic() - began
