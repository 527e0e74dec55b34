"""Trials per second that Optuna stores durably; JSON on stdout.

Run in an environment of its own: `.venv-bench/bin/python -m tests.studies.benchmarks.peers_storage`. Storages
are in build/.

What is most favourable to Optuna is taken: trials without parameters, a random sampler, and 100 kB as a file beside
the storage that is written and synced by the objective itself, without a rename, a digest or a sync of its folder (in
an attribute the storage would carry the bytes); one thread or eight, whichever is faster.
"""

import json
import os
import sys
import tempfile
import time
from pathlib import Path

import optuna  # type: ignore[import-not-found]
from optuna.storages import BaseStorage, JournalStorage, RDBStorage  # type: ignore[import-not-found]
from optuna.storages.journal import JournalFileBackend  # type: ignore[import-not-found]

RESULT = os.urandom(108_000)
SECONDS = 3.0
"""Of each measurement."""
THREADS = (1, 8)


def main() -> None:
    """Measure both storages, without and with a result."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    found = {}
    for storage in ("sqlite", "journal"):
        for kind in ("null", "100 kB"):
            rates = [_measure(storage, kind == "100 kB", threads) for threads in THREADS]
            found[f"{storage}, {kind}"] = max(rates, key=lambda rate: rate["per_second"])
    sys.stdout.write(json.dumps({"optuna": optuna.__version__, "rates": found}))


def _measure(storage: str, with_result: bool, threads: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory(dir="build") as folder:
        study = optuna.create_study(storage=open_storage(storage, folder), sampler=optuna.samplers.RandomSampler(0))

        def objective(trial: optuna.Trial) -> float:
            if with_result:
                _write(Path(folder) / f"{trial.number}.result")
            return 0.0

        wall, cpu = time.perf_counter(), time.process_time()
        study.optimize(objective, timeout=SECONDS, n_jobs=threads)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        count = len(study.trials)
        return {"per_second": count / wall, "cpu_ms": 1000 * cpu / count, "threads": threads}


def open_storage(storage: str, folder: str) -> BaseStorage:
    """Open a storage in a folder."""
    if storage == "sqlite":
        return RDBStorage(f"sqlite:///{folder}/study.db", engine_kwargs={"connect_args": {"timeout": 60}})
    return JournalStorage(JournalFileBackend(f"{folder}/journal.log"))


def _write(path: Path) -> None:
    with path.open("wb") as file:
        file.write(RESULT)
        file.flush()
        os.fsync(file.fileno())


if __name__ == "__main__":
    main()
