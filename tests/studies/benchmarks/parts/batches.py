"""Rollouts of microseconds that a campaign makes durable, in batches of 1 to 1,024, beside peers on the same function.

The campaign is a process, `perfbound run` with two local workers over Zenoh and files on the disk of this checkout. It
has no spot check, no recheck and no visual part. Its rate is that between the first recorded result and the last one,
so start-up and certificate do not count. The CPU times of the orchestrator and of the workers are read from /proc every
`INTERVAL` seconds, and interpolated at these two results.

Campaign and peers take turns, and the best of the rounds counts, because others use the disk too. `peers_batches.py`
describes the peers. The loop and the pool run with our Python, the others in the environment of the peers.
"""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from tests.fakes.puppets import scratch
from tests.studies.benchmarks import cheap
from tests.studies.benchmarks.report import Row

WORKERS = 2
ROUNDS = 2
INTERVAL = 0.05
US = "perfbound"
OURS = ("loop", "pool")
THEIRS = ("optuna-sqlite", "optuna-journal", "dask")
WORDS = {
    "loop": "a bare loop",
    "pool": "a pool, SQLite",
    "optuna-sqlite": "Optuna on SQLite",
    "optuna-journal": "Optuna on its journal",
    "dask": "Dask and files",
}

SYSTEM = f"""
import perfbound as pb

import cheap


@pb.system(
    parameters={{"a": pb.Parameter(0, 1), "b": pb.Parameter(0, 1)}},
    columns={{name: "1" for name in cheap.COLUMNS}},
    step={cheap.STEP},
    vectorised=True,
)
def simulated(a, b, *, seeds, horizon):
    return cheap.simulated(a, b, seeds, round(horizon / {cheap.STEP}) + 1)
"""
CAMPAIGN = """
name = "batches"
seed = 1
horizon = {horizon}
specification = "always (x < {limit})"
clip = [-1, 10]
batch = {batch}
visual = "none"
spot_check = 0
recheck = 0
claims = [{{ quantity = "failure_probability", delta = 0.05 }}]

[system]
python = "system.py:simulated"

[space]
a = [0, 1]
b = [0, 1]

[[problems]]
name = "robustness"
method = "sample"
max_tests = {tests}
"""
RECORDED = """
SELECT outcomes.ended, rollouts FROM rollouts JOIN outcomes ON outcome = 'recorded'
AND rollout = problem || '.' || test || '.' || variant || '.' || replicate || iif(places > 1, '.' || places, '')
ORDER BY outcomes.ended
"""


@dataclass(frozen=True)
class Setting:
    """Size of the batches and of the rollouts, and the number of tests of a campaign, which takes 5 to 20 s."""

    batch: int
    samples: int
    tests: int

    @property
    def name(self) -> str:
        """Size of the batches, and of the samples of a rollout."""
        return f"batch {self.batch}, {self.samples * len(cheap.COLUMNS) * 8 / 1000:.1f} kB"


SETTINGS = (
    Setting(1, 100, 1_500),
    Setting(16, 100, 15_000),
    Setting(256, 100, 100_000),
    Setting(1024, 100, 120_000),
    Setting(256, 320, 50_000),
)


@dataclass(frozen=True)
class Rates:
    """What was measured; CPU times in us per rollout."""

    per_second: float
    orchestrator: float
    workers: float

    @property
    def cpu(self) -> float:
        """CPU time of all processes."""
        return self.orchestrator + self.workers


def main(peers: Path | None) -> list[Row]:
    """Return the rows; `peers` is the Python in whose environment Optuna and Dask are."""
    rates: dict[tuple[Setting, str], list[Rates]] = defaultdict(list)
    with_python = dict.fromkeys(OURS, Path(sys.executable)) | (dict.fromkeys(THEIRS, peers) if peers else {})
    for _ in range(ROUNDS):
        for setting in SETTINGS:
            rates[setting, US].append(_noted(setting, US, conduct(setting)))
            for name, python in with_python.items():
                rates[setting, name].append(_noted(setting, name, _asked(python, name, setting)))
    best = {key: max(found, key=lambda each: each.per_second) for key, found in rates.items()}
    return [*_beside(best, list(with_python)), *_alone(best)]


def _beside(best: Mapping[tuple[Setting, str], Rates], peers: Sequence[str]) -> Iterator[Row]:
    for setting in SETTINGS:
        ours = best[setting, US]
        for theirs, words in ((best[setting, peer], WORDS[peer]) for peer in peers):
            yield Row(f"{setting.name}: rate", ours.per_second, "rollouts/s", words, theirs.per_second)
            yield Row(f"{setting.name}: CPU per rollout", ours.cpu, "us", words, theirs.cpu)


def _alone(best: Mapping[tuple[Setting, str], Rates]) -> Iterator[Row]:
    for setting in SETTINGS:
        yield Row(f"{setting.name}: orchestrator, per rollout", best[setting, US].orchestrator, "us")
        yield Row(f"{setting.name}: workers, per rollout", best[setting, US].workers, "us")


def _noted(setting: Setting, name: str, found: Rates) -> Rates:
    text = f"{found.per_second:.0f}/s, {found.orchestrator:.1f} + {found.workers:.1f} us, load {os.getloadavg()[0]:.1f}"
    sys.stderr.write(f"  {setting.name}: {name}: {text}\n")
    return found


def _asked(python: Path, peer: str, setting: Setting) -> Rates:
    module = "tests.studies.benchmarks.peers_batches"
    command = [str(python), "-m", module, peer, str(setting.batch), str(setting.samples)]
    found = json.loads(subprocess.check_output(command))
    return Rates(found["per_second"], found["cpu_us"], 0.0)


def conduct(setting: Setting) -> Rates:
    """Run one campaign.

    Raises:
        RuntimeError: it failed; with the end of its output.

    """
    with scratch() as base:
        folder = Path(base).absolute()
        shutil.copy(str(cheap.__file__), folder / "cheap.py")
        (folder / "system.py").write_text(SYSTEM)
        horizon = round((setting.samples - 1) * cheap.STEP, 6)
        text = CAMPAIGN.format(horizon=horizon, limit=cheap.LIMIT, batch=setting.batch, tests=setting.tests)
        (folder / "campaign.toml").write_text(text)
        command = [sys.executable, "-m", "perfbound.orchestrator", "run", "campaign.toml"]
        command += ["--workers", str(WORKERS), "--out", "run"]
        with (folder / "output").open("wb") as output:
            process = subprocess.Popen(
                command,
                cwd=folder,
                env={**os.environ, "PYTHONPATH": str(Path.cwd())},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
            looks = _watched(process)
        if not (folder / "run/certificate.json").exists():
            raise RuntimeError(f"{setting.name}: no certificate: {(folder / 'output').read_text()[-500:]}")
        with closing(sqlite3.connect(f"file:{folder / 'run/campaign.db'}?mode=ro", uri=True)) as connection:
            recorded = connection.execute(RECORDED).fetchall()
            pids = {pid for (pid,) in connection.execute("SELECT DISTINCT pid FROM attempts")}
        return rates_of(recorded, looks, process.pid, pids)


Look = tuple[float, Mapping[int, float]]
"""Unix time, and the CPU seconds of each process until then."""


def _watched(process: subprocess.Popen[bytes]) -> list[Look]:
    """Wait for the end of the process; return its CPU seconds and those of its descendants, by process number."""
    looks, known = list[Look](), {process.pid: psutil.Process(process.pid)}
    while process.poll() is None:
        if not looks or len(known) <= WORKERS or len(looks) % 20 == 0:
            known = {each.pid: each for each in known[process.pid].children(recursive=True)} | {
                process.pid: known[process.pid]
            }
        looks.append((time.time(), {pid: _cpu(each) for pid, each in known.items()}))
        time.sleep(INTERVAL)
    return looks


def _cpu(process: psutil.Process) -> float:
    try:
        times = process.cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return float(times.user + times.system)


def rates_of(recorded: Sequence[tuple[float, int]], looks: Sequence[Look], main: int, workers: set[int]) -> Rates:
    """Return the rates between the first and the last of (Unix time, rollouts); the first only starts the clock."""
    (begin, _), (end, _) = recorded[0], recorded[-1]
    rollouts = sum(number for _, number in recorded[1:])

    def spent(pids: set[int]) -> float:
        times = [at for at, _ in looks]
        first, last = (
            sum(float(np.interp(at, times, [cpu.get(pid, 0.0) for _, cpu in looks])) for pid in pids)
            for at in (begin, end)
        )
        return 1e6 * (last - first) / rollouts

    return Rates(rollouts / (end - begin), spent({main}), spent(workers))
