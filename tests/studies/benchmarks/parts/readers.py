"""Cost of database readers for the writer: CPU time, which few cores share among all processes, apart from locks.

The writer works alone, beside readers, and beside processes that burn as much CPU time and read nothing, in turns.

python -m tests.studies.benchmarks.parts.readers DIRECTORY     is the process beside the writer
"""

import json
import multiprocessing
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from perfbound.orchestrator.store.changes import ChangeReader
from perfbound.schemas.file.config import CampaignConfig
from tests.fakes.puppets import Stage, scratch
from tests.studies.benchmarks.report import Row

READERS = 20
PUPPETS = 64
PAUSE = 0.2
"""Seconds between two refreshes of a reader."""
PHASE = 2.0
"""Seconds of a turn."""
CYCLES = 6
"""The first one is to warm up."""
KINDS = ("alone", "reading", "burning")
OVER = "over"
WARM = 6


def main(config: CampaignConfig) -> list[Row]:
    """Measure with a campaign that does not end by itself."""
    with scratch() as folder:
        directory = Path(folder)
        stage = Stage(directory, config, PUPPETS)
        turns, looks = Turns(directory, stage), list[float]()
        with _processes(directory, looks):
            stage.play(turns.over)
        stage.journal.close()
    return turns.rows(statistics.median(looks))


class Turns:
    """Decides who is beside the writer, by a file of that name, and notes how the writer does meanwhile."""

    def __init__(self, directory: Path, stage: Stage) -> None:
        self._directory, self._stage = directory, stage
        self._done: list[tuple[float, float]] = []
        self._log = 0
        self._since = self._now()

    def over(self) -> bool:
        """Read the clock; return whether every kind has had its turns."""
        spent = [now - then for now, then in zip(self._now(), self._since, strict=True)]
        if spent[0] < PHASE:
            return False
        wall, cpu, count = spent
        self._done.append((count / wall, 1000 * cpu / max(count, 1)))
        self._log = max(self._log, (self._directory / "campaign.db-wal").stat().st_size)
        (self._directory / self._kind(-1)).unlink(missing_ok=True)
        (self._directory / self._kind(0)).touch()
        self._since = self._now()
        return len(self._done) == len(KINDS) * CYCLES

    def _kind(self, offset: int) -> str:
        return KINDS[(len(self._done) + offset) % len(KINDS)]

    def _now(self) -> tuple[float, float, float]:
        own = self._stage.puppets.own
        return time.perf_counter() - own.wall, time.process_time() - own.cpu, float(self._stage.puppets.delivered)

    def rows(self, look: float) -> list[Row]:
        """Return medians over the cycles; `look` is the CPU time of one refresh, in s."""
        found = {kind: self._done[number :: len(KINDS)][1:] for number, kind in enumerate(KINDS)}
        rate, cpu = ({kind: statistics.median(e[k] for e in each) for kind, each in found.items()} for k in (0, 1))
        reading, burning = (100 * (1 - rate[kind] / rate["alone"]) for kind in KINDS[1:])
        name = f"writer beside {READERS} readers"
        return [
            Row(f"{name}: rate", rate["reading"], "rollouts/s", "alone", rate["alone"]),
            Row(f"{name}: rate lost", reading, "%", "to CPU time alone", burning, at_most=10.0),
            Row(f"{name}: CPU per rollout", cpu["reading"], "ms", "alone", cpu["alone"]),
            Row(f"{name}: CPU per refresh of a reader", 1000 * look, "ms"),
            Row(f"{name}: largest write-ahead log", self._log / 1e6, "MB"),
        ]


@contextmanager
def _processes(directory: Path, looks: list[float]) -> Iterator[None]:
    command = [sys.executable, "-m", "tests.studies.benchmarks.parts.readers", str(directory)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        try:
            yield
        finally:
            (directory / OVER).touch()
            looks += json.loads(process.stdout.read())


def beside(kind: str, directory: Path) -> float:
    """Refresh, or burn as much CPU time, whenever the file named `kind` is there; return the time of a refresh."""
    watch = ChangeReader(directory)
    looks = [_look(watch) for _ in range(WARM)]
    while not (directory / OVER).exists():
        if (directory / kind).exists():
            if kind == "reading":
                looks.append(_look(watch))
            else:
                _burn(statistics.median(looks))
        time.sleep(PAUSE)
    return statistics.median(looks)


def _forked(directory: Path) -> None:
    """Be all processes; forked, because forty imports would keep two cores busy for a minute."""
    each = [(kind, directory) for kind in KINDS[1:] for _ in range(READERS)]
    with multiprocessing.get_context("fork").Pool(len(each)) as pool:
        found = pool.starmap_async(beside, each, chunksize=1)
        print(flush=True)  # noqa: T201
        print(json.dumps(found.get()))  # noqa: T201


def _look(watch: ChangeReader) -> float:
    start = time.process_time()
    watch.read()
    return time.process_time() - start


def _burn(seconds: float) -> None:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


if __name__ == "__main__":
    _forked(Path(sys.argv[1]))
