"""CPU of the orchestrator in whole campaigns with two workers, and where it goes."""

import subprocess
import sys
import time

from perfbound.orchestrator.fleet.link.transport import Heartbeat, Inbound, listen
from perfbound.schemas.link.key_expressions import fresh_id
from perfbound.schemas.link.secret import shared_secret
from tests.studies.benchmarks.report import Row
from tests.studies.benchmarks.runs import Cost, conduct

CAMPAIGNS: dict[str, tuple[str, dict[str, str], float | None]] = {
    "test function, 2000 tests": (
        "test-function",
        {"sigma": '"std"', "max_tests": "2000", "alpha": "1e-9"},
        15.0,
    ),
    "segway-paper": ("segway-paper", {}, None),
}
"""By label: the shipped file, what is changed in it, and the most CPU seconds that the orchestrator should take."""


def main() -> list[Row]:
    """Run each campaign twice: as it is, and with the timer that finds the shares."""
    rows = [Row("worker process, from start to first heartbeat", worker_ready(), "s wall")]
    for label, (name, changes, most) in CAMPAIGNS.items():
        plain, looked = conduct(name, changes), conduct(name, changes, shares=True)
        rows += _costs(label, plain, most) + _shares(label, looked)
        with_timer = f"{label}: orchestrator in all, with the sampling timer"
        rows.append(Row(with_timer, looked.orchestrator, "s", "without it", plain.orchestrator))
    return rows


def _costs(label: str, cost: Cost, most: float | None) -> list[Row]:
    account, per = cost.account, 1000 / cost.rollouts
    threads = cost.orchestrator - account["main_thread"]
    return [
        Row(f"{label}: rollouts", cost.rollouts, "rollouts"),
        Row(f"{label}: orchestrator in all", cost.orchestrator, "s", at_most=most),
        Row(f"{label}: start-up", account["loop_begins"], "s"),
        Row(f"{label}: loop, per rollout", cost.loop * per, "ms"),
        Row(f"{label}: certificate and summary", cost.orchestrator - account["loop_ends"], "s"),
        Row(f"{label}: other threads (Zenoh), per rollout", threads * per, "ms"),
        Row(f"{label}: in the rollouts of the workers, per rollout", cost.simulating * per, "ms"),
        Row(f"{label}: worker processes in all, per rollout", account["children"] * per, "ms"),
        Row(f"{label}: peak memory of the orchestrator", account["peak_memory_mb"], "MB"),
    ]


def _shares(label: str, cost: Cost) -> list[Row]:
    """Shares of the process: samples divide the main thread's CPU time, the rest is the other threads'."""
    main = cost.account["main_thread"] / cost.orchestrator
    looks = cost.account["looks"]
    shares = {room: 100 * main * count / sum(looks.values()) for room, count in looks.items()}
    shares["other threads (Zenoh)"] = 100 * (1 - main)
    ordered = sorted(shares.items(), key=lambda pair: -pair[1])
    return [Row(f"{label}: share of {room}", share, "%") for room, share in ordered]


def worker_ready() -> float:
    """Return the seconds from the start of a worker process to its first heartbeat."""
    times: list[float] = []

    def note(message: Inbound) -> None:
        if isinstance(message, Heartbeat):
            times.append(message.at)

    with listen("tcp/127.0.0.1:0", secret=shared_secret(loopback=True)) as transport:
        transport.start(fresh_id("bench"), note)
        start = time.monotonic()
        process = subprocess.Popen(
            [sys.executable, "-m", "perfbound.workers", "serve", "--connect", transport.endpoint]
        )
        try:
            while not times and time.monotonic() - start < 60:
                time.sleep(0.01)
        finally:
            process.kill()
            process.wait()
    return times[0] - start
