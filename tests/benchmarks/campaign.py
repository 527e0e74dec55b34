"""A whole campaign with two local workers: CPU of the orchestrator and of the workers per rollout; time until ready."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil
import sqlalchemy as sa

from orchestrator.store import queries, tables
from orchestrator.transport import Heartbeat, Inbound, listen
from schemas.keys import fresh_id

CAMPAIGNS = ("test-function", "segway-paper")
FOLDER = Path(__file__).parents[2] / "deploy" / "campaigns"


def main() -> dict[str, float]:
    """Return seconds by name."""
    results = {"worker_ready_wall_s": worker_ready()}
    for name in CAMPAIGNS:
        with tempfile.TemporaryDirectory() as folder:
            results |= {f"{name}/{key}": value for key, value in campaign(name, Path(folder) / "run").items()}
    return results


def campaign(name: str, out: Path) -> dict[str, float]:
    """Run one of our campaigns and return what it cost."""
    perfbound = Path(sys.executable).with_name("perfbound")
    command = [str(perfbound), "run", str(FOLDER / f"{name}.toml"), "--out", str(out)]
    start = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    own = _own_cpu(process)
    if process.returncode:
        raise RuntimeError(f"{name} ended with code {process.returncode}")
    with queries.reading(out) as connection:
        outcomes = tables.outcomes.c
        count, cpu = connection.execute(
            sa.select(sa.func.count(), sa.func.sum(outcomes.cpu_seconds)).where(outcomes.outcome == "recorded")
        ).one()
    return {
        "wall_s": time.monotonic() - start,
        "rollouts": count,
        "orchestrator_cpu_s": own,
        "orchestrator_ms_per_rollout": 1000 * own / count,
        "worker_ms_per_rollout": 1000 * cpu / count,
        "rollouts_per_worker_core_second": count / cpu,
    }


def worker_ready() -> float:
    """Return the seconds from the start of a worker process to its first heartbeat."""
    times: list[float] = []

    def note(message: Inbound) -> None:
        if isinstance(message, Heartbeat):
            times.append(message.at)

    with listen("tcp/127.0.0.1:0") as transport:
        transport.start(fresh_id("bench"), note)
        start = time.monotonic()
        process = subprocess.Popen([sys.executable, "-m", "workers", "serve", "--connect", transport.endpoint])
        try:
            while not times and time.monotonic() - start < 60:
                time.sleep(0.01)
        finally:
            process.kill()
            process.wait()
    return times[0] - start


def _own_cpu(process: subprocess.Popen[bytes]) -> float:
    """Return the CPU seconds of the process itself, without its workers, sampled until it ends."""
    observed, seconds = psutil.Process(process.pid), 0.0
    while process.poll() is None:
        try:
            times = observed.cpu_times()
            seconds = max(seconds, times.user + times.system)
        except psutil.Error:
            pass
        time.sleep(0.05)
    return seconds
