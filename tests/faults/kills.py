"""The orchestrator of test-function.toml killed at random moments, and resumed: `python -m tests.faults.kills`.

Every kill is confirmed to have come in mid-run: something was recorded, not everything, and no certificate was there.
"""

import argparse
import random
import signal
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.campaigns import with_few_checks
from tests.end_to_end.processes import Processes, processes, recorded, wait_for

CAMPAIGN = "test-function"


def _campaign(started: Processes) -> Path:
    return with_few_checks(started.folder / "c.toml", CAMPAIGN)


def calm(started: Processes) -> tuple[bytes, int]:
    """Return the certificate of a run without trouble, and its number of rollouts."""
    directory = started.folder / "calm"
    ended = started.run("perfbound", "run", _campaign(started), "--out", directory)
    if ended.code:
        raise RuntimeError(ended.err)
    return (directory / "certificate.json").read_bytes(), recorded(directory)


def kill_and_resume(folder: Path, moment: int, wanted: bytes, rollouts: int) -> bool | None:
    """Kill once `moment` rollouts are recorded, resume, and compare; None if the campaign was quicker than the kill."""
    with processes(folder) as started:
        directory = folder / "run"
        process = started.start("perfbound", "run", _campaign(started), "--out", directory)
        wait_for(lambda: recorded(directory) >= moment)
        process.popen.kill()
        if process.wait().code != -signal.SIGKILL or (directory / "certificate.json").exists():
            return None
        if not 0 < recorded(directory) < rollouts:
            return None
        ended = started.run("perfbound", "resume", directory)
        return ended.code == 0 and (directory / "certificate.json").read_bytes() == wanted


def main() -> int:
    """Run and count; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults.kills", description=__doc__.partition("\n")[0])
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--parallel", type=int, default=2)
    arguments = parser.parse_args()
    chance = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as folder, processes(Path(folder) / "first") as first:
        wanted, rollouts = calm(first)
        moments = iter([chance.randint(1, rollouts - 1) for _ in range(10 * arguments.times)])
        results: list[bool | None] = []
        with ThreadPoolExecutor(arguments.parallel) as pool:
            while sum(result is not None for result in results) < arguments.times:
                left = arguments.times - sum(result is not None for result in results)
                jobs = [(Path(folder) / f"run-{len(results) + n}", next(moments)) for n in range(left)]
                results += pool.map(lambda job: kill_and_resume(job[0], job[1], wanted, rollouts), jobs)
    same = sum(result is True for result in results)
    sys.stdout.write(
        f"{arguments.times} kills in mid-run (of {rollouts} rollouts), {same} certificates as without trouble; "
        f"{len(results) - arguments.times} campaigns were quicker than the kill and do not count\n"
    )
    return 0 if same == arguments.times else 1


if __name__ == "__main__":
    sys.exit(main())
