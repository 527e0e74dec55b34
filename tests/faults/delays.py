"""Time from a fault to its detection, and to the next result: `python -m tests.faults.delays` measures it."""

import shutil
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import click

from tests.end_to_end.processes import query, under_way, wait_for
from tests.faults.catalogue import randomness
from tests.faults.scene import Scene
from tests.faults.subjects import prepare
from tests.faults.systems import a_plan

BUILD = Path(__file__).parents[2] / "build"


def dead_worker(scene: Scene) -> float:
    """Return the seconds from kill -9 of a busy local worker until its rollout is given to another."""
    scene.start()
    scene.reach(2)
    victim = _busy(scene)
    killed = time.time()
    scene.chance.choice([each for each in scene.workers() if each.pid == victim]).kill()
    return _ended(scene, "worker lost") - killed


def hung_worker(scene: Scene) -> float:
    """Return the seconds from the last progress of a rollout until it is given to another."""
    plan = a_plan(scene)
    token = f"{scene.subject.seeds[5]}-0-gil"
    (plan / token).touch()
    scene.start()
    noticed = _ended(scene, "no progress")
    return noticed - (plan / "taken" / token).stat().st_mtime


def resume_local(scene: Scene) -> float:
    """Return the seconds from the start of `resume` to the first new attempt, with workers of its own."""
    scene.start()
    scene.reach(4)
    scene.kill_orchestrator()
    began = time.time()
    scene.resume()
    wait_for(lambda: query(scene.directory, NEW))
    return float(str(query(scene.directory, NEW)[0][0])) - began


def resume_remote(scene: Scene) -> float:
    """Return the seconds from the start of `resume` to the first new attempt, with remote workers that stayed alive."""
    scene.remote = True
    return resume_local(scene)


NEW = "SELECT started FROM attempts WHERE session = 2 ORDER BY started LIMIT 1"
DELAYS: dict[str, Callable[[Scene], float]] = {
    each.__name__.replace("_", "-"): each for each in (dead_worker, hung_worker, resume_local, resume_remote)
}


def _busy(scene: Scene) -> int:
    """Return the process id of a worker that has just been given a rollout."""
    before = {row[:2] for row in under_way(scene.directory)}
    found: list[int] = []

    def fresh() -> bool:
        found[:] = [
            int(str(pid)) for rollout, attempt, _, pid in under_way(scene.directory) if (rollout, attempt) not in before
        ]
        return bool(found)

    wait_for(fresh)
    return found[0]


def _ended(scene: Scene, reason: str) -> float:
    """Wait until an attempt ends for `reason`; return when, as Unix time."""
    text = f"SELECT ended FROM outcomes WHERE outcome LIKE '{reason}%' LIMIT 1"
    wait_for(lambda: query(scene.directory, text))
    return float(str(query(scene.directory, text)[0][0]))


@click.command()
@click.option("--times", type=click.IntRange(1), default=5, show_default=True, help="Measurements of each delay.")
def main(*, times: int) -> None:
    """Print the median and the largest of each delay, in seconds."""
    base = BUILD / "delays"
    shutil.rmtree(base, ignore_errors=True)
    subject = prepare("slow", base / "calm")
    for name, measure in DELAYS.items():
        found = []
        for number in range(times):
            scene = Scene(subject, base / f"{name}-{number}", randomness(1, number))
            try:
                found.append(measure(scene))
                scene.finish()
            finally:
                scene.close()
        click.echo(f"{name:<14} median {statistics.median(found):.2f} s, largest {max(found):.2f} s of {times}")
    shutil.rmtree(base)


if __name__ == "__main__":
    main()
