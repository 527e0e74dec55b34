"""Rollouts per second that a peer of the benchmark `batches` keeps on the disk; JSON on stdout.

    python -m tests.studies.benchmarks.peers_batches PEER BATCH SAMPLES

Optuna and Dask run in an environment of their own, `.venv-bench`. Every peer simulates batches of the function in
`cheap.py`, for `SECONDS`; results are in build/. What is most favourable to a peer is taken:

- `loop`: one process; appends the samples and the robustness to one file, one fsync a batch.
- `pool`: two processes simulate, the first one has a row with the samples for each batch and commits it, in SQLite
  with a write-ahead log and `synchronous=FULL`: one fsync a commit.
- `optuna-sqlite`, `optuna-journal`: a batch is a trial without parameters and with a random sampler. Its samples are a
  file that the objective writes and syncs; its value is the least robustness of the batch, and the robustness of each
  rollout is an attribute, where there are several. Eight threads.
- `dask`: a local cluster of two processes; the task writes and syncs a file, and returns the robustness.

No file of a peer has a digest or a rename, and no folder is synced. Rate and CPU time are those between the first
result and the last one, so neither imports nor the start of processes count. The CPU time is that of all processes.
"""

import json
import os
import sqlite3
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import closing
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import psutil

from tests.studies.benchmarks.cheap import Floats, a_batch

SECONDS = 5.0
"""Of a measurement."""
PROCESSES = 2
THREADS = 8
WAITING = 16
"""Tasks that wait in Dask at a time, so that no process is idle."""


class Watch:
    """Time and CPU time of all processes from the first result to the last one; for any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._results = 0
        self._cpu = self._first = self._last = 0.0

    def one(self) -> bool:
        """Note a result that is on the disk; return whether there should be more."""
        with self._lock:
            self._results += 1
            if self._results == 1:
                self._cpu = cpu_seconds()
                self._first = time.perf_counter()
            self._last = time.perf_counter()
            return self._last - self._first < SECONDS

    def found(self, batch: int) -> dict[str, float]:
        """Return what was measured; to be called after the last result, before processes end."""
        rollouts, wall = (self._results - 1) * batch, self._last - self._first
        spent = cpu_seconds() - self._cpu
        return {"rollouts": rollouts, "wall": wall, "per_second": rollouts / wall, "cpu_us": 1e6 * spent / rollouts}


def cpu_seconds() -> float:
    """Return the CPU seconds of this process and of its living descendants."""
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return float(sum(times.user + times.system for times in (each.cpu_times() for each in processes)))


def written(folder: str, batch: int, samples: int, number: int) -> list[float]:
    """Simulate a batch and write its samples to a file of its own; return its robustness."""
    values, content = a_batch(number, batch, samples)
    with (Path(folder) / f"{number}.samples").open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return [float(value) for value in values]


def loop(folder: str, batch: int, samples: int) -> dict[str, float]:
    """Measure one process with one file."""
    watch = Watch()
    with (Path(folder) / "samples").open("wb") as file:
        for number in count():
            values, content = a_batch(number, batch, samples)
            file.write(content)
            file.write(values.tobytes())
            file.flush()
            os.fsync(file.fileno())
            if not watch.one():
                break
        return watch.found(batch)


def pool(folder: str, batch: int, samples: int) -> dict[str, float]:
    """Measure a pool of processes, and one database."""
    watch, numbers = Watch(), count()
    with closing(sqlite3.connect(f"{folder}/results.db")) as database, ProcessPoolExecutor(PROCESSES) as executor:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = FULL")
        database.execute("CREATE TABLE results (number INTEGER PRIMARY KEY, robustness BLOB, samples BLOB)")

        def submit() -> Future[tuple[Floats, bytes]]:
            return executor.submit(a_batch, next(numbers), batch, samples)

        waiting = deque(submit() for _ in range(2 * PROCESSES))
        for number in count():
            values, content = waiting.popleft().result()
            waiting.append(submit())
            database.execute("INSERT INTO results VALUES (?, ?, ?)", (number, values.tobytes(), content))
            database.commit()
            if not watch.one():
                break
        return watch.found(batch)


def optuna(storage: str, folder: str, batch: int, samples: int) -> dict[str, float]:
    """Measure a study of Optuna with this storage."""
    import optuna  # type: ignore[import-not-found]

    from tests.studies.benchmarks.peers_storage import open_storage

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(storage=open_storage(storage, folder), sampler=optuna.samplers.RandomSampler(0))
    watch = Watch()

    def objective(trial: Any) -> float:
        values = written(folder, batch, samples, trial.number)
        if batch > 1:
            trial.set_user_attr("robustness", values)
        return min(values)

    def ended(study: Any, _trial: object) -> None:
        if not watch.one():
            study.stop()

    study.optimize(objective, n_jobs=THREADS, callbacks=[ended])
    return watch.found(batch)


def dask(folder: str, batch: int, samples: int) -> dict[str, float]:
    """Measure a local cluster of Dask."""
    from distributed import Client, LocalCluster, as_completed  # type: ignore[import-not-found]

    watch, numbers = Watch(), count()
    cluster = LocalCluster(n_workers=PROCESSES, threads_per_worker=1, processes=True, dashboard_address=None)
    with cluster, Client(cluster) as client:

        def submit() -> Any:
            return client.submit(written, folder, batch, samples, next(numbers), pure=False)

        ended = as_completed([submit() for _ in range(WAITING)], with_results=True)
        for _ in ended:
            if watch.one():
                ended.add(submit())
        return watch.found(batch)


PEERS: dict[str, Callable[[str, int, int], dict[str, float]]] = {
    "loop": loop,
    "pool": pool,
    "optuna-sqlite": partial(optuna, "sqlite"),
    "optuna-journal": partial(optuna, "journal"),
    "dask": dask,
}


def main() -> None:
    """Measure one peer."""
    peer, batch, samples = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    Path("build").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir="build", ignore_cleanup_errors=True) as folder:
        found = PEERS[peer](str(Path(folder).absolute()), batch, samples)
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
