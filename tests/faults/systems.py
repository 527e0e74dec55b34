"""Systems under test that misbehave."""

from collections.abc import Sequence
from pathlib import Path

from perfbound.orchestrator.fleet.link.inbox import RESULTS
from perfbound.orchestrator.store.facts import observed_rollouts
from perfbound.schemas.ids import closing_check
from perfbound.schemas.result.facts import RolloutFact
from tests.end_to_end.processes import query, wait_for
from tests.faults.faulty_function import BEFORE, BIG
from tests.faults.memory import LIBRARIES, memory
from tests.faults.scene import Scene

OF_SYSTEM = ("raise", "refuse", "leave", "nan", "shape", "columns", "none")
"""Failures of the system: it raises, or its trajectory is not usable."""
ODD = {
    "gap": ("nan", "short", "late", "columns", "raise", "grid"),
    "brief": ("nan", "huge", "late", "columns", "raise"),
    # Other times fail a batch as a whole, with one reason, and two in a row are poison; a clip hides huge numbers.
    "batches": ("nan", "late", "columns", "raise", "refuse"),
}
"""Trajectories, by campaign, on which its objectives cannot be computed; and a failure of the ordinary kind."""
OF_INFRASTRUCTURE = tuple(kind for kind in BEFORE if kind not in (*OF_SYSTEM, "lack"))
"""Failures of the infrastructure: the process hangs or ends; or it only prints and leaks. A node lacks a module."""


def misbehave(scene: Scene) -> None:
    """Some rollouts hang, crash, exit, print or leak, each a few times; then they behave."""
    _misbehave(scene, OF_INFRASTRUCTURE)


def fail_once(scene: Scene) -> None:
    """In some rollouts the system raises or returns nonsense, once or in two ways; then it succeeds with that seed."""
    scene.irreproducible = True
    _misbehave(scene, OF_SYSTEM, alike=False)


def odd_result(scene: Scene) -> None:
    """In some rollouts the system returns huge numbers, a part, or other times, once; later it succeeds."""
    scene.irreproducible = True
    _misbehave(scene, ODD["batches" if scene.subject.batch > 1 else scene.subject.name], alike=False)


def big_result(scene: Scene) -> None:
    """Some results have 48 MB, once: refused, and nothing else waits for them or is pushed out of memory."""
    scene.irreproducible = True
    plan = a_plan(scene)
    for seed in scene.chance.sample(scene.subject.seeds, scene.chance.choice((1, 2, 6))):
        (plan / f"{seed}-0-big").touch()
    scene.start()
    with memory(scene) as used:
        scene.finish()
    for file in sorted((plan / "taken").iterdir()):
        scene.did(f"48 MB of the rollout of seed {file.name.split('-')[0]}")
    scene.did(f"the orchestrator took {used() >> 20} MB", fault=False)
    # What waits, one message that Zenoh puts together for each worker, and two copies of the one that is decoded.
    assert used() < LIBRARIES + RESULTS + 4 * 16 * BIG


def _misbehave(scene: Scene, among: Sequence[str], *, alike: bool = True) -> None:
    scene.remote = False  # else no process replaces workers that die
    plan = a_plan(scene)
    seeds = scene.chance.sample(scene.subject.seeds, 5)
    kinds = scene.chance.sample(among, 5)
    for place, seed in enumerate(seeds):
        for number in range(scene.chance.choice((1, 1, 2))):
            # Two failures of the system with one reason would end the campaign.
            kind = kinds[place if alike else (place + number) % len(kinds)]
            if not (kind == "dawdle" and number):  # two missed deadlines of one rollout end the campaign as well
                (plan / f"{seed}-{number}-{kind}").touch()
    scene.start()
    scene.finish()
    for file in sorted((plan / "taken").iterdir()):
        scene.did(f"{file.name.split('-')[2]} in the rollout of seed {file.name.split('-')[0]}")
    assert scene.injected >= len(seeds), "every rollout of the plan was tried"


def poison(scene: Scene) -> None:
    """One rollout kills every worker, hangs or fails: the campaign fails with its history; after the fix it resumes."""
    plan = a_plan(scene)
    kind = scene.chance.choice(("exit", "crash", "raise", "nan", "sleep", "leave"))
    seed = scene.chance.choice(scene.subject.seeds)
    always = plan / f"{seed}-always-{kind}"
    always.touch()
    scene.irreproducible = kind in OF_SYSTEM  # the same build with the same seed has failed, and then succeeds
    scene.start(workers=scene.chance.choice((1, 2, 3)))
    ended = scene.end()
    scene.did(f"{kind} in every attempt of the rollout of seed {seed}", fault=False)
    rollout = _rollout(scene, seed, alone=kind in OF_SYSTEM)
    last = ended.err.splitlines()[-1]
    assert ended.code == 1, f"exit {ended.code}: {ended.err[-1500:]}"
    attempts = 2 if kind in OF_SYSTEM else 5
    what = "rollout" if kind in OF_SYSTEM or scene.subject.batch == 1 else "batch"
    assert f"{what} {rollout} failed {attempts} times" in last, last
    assert all(f"attempt {number} on local-" in last for number in range(1, attempts + 1)), last
    scene.injected += len(query(scene.directory, f"SELECT * FROM outcomes WHERE rollout = '{rollout}'"))
    always.unlink()
    scene.resume()
    scene.finish()


def hang_and_kill(scene: Scene) -> None:
    """A rollout never releases the lock of Python, and the orchestrator is killed: the worker must not stay."""
    plan = a_plan(scene)
    seed = scene.chance.choice(scene.subject.seeds[: scene.subject.rollouts // 2])
    (plan / f"{seed}-0-gil").touch()
    scene.start()
    wait_for((plan / "taken" / f"{seed}-0-gil").exists)
    scene.did(f"gil in the rollout of seed {seed}")
    scene.pause(0.3, 1.0)
    scene.kill_orchestrator()
    wait_for(lambda: not scene.alive())
    scene.resume()
    scene.finish()


def a_plan(scene: Scene) -> Path:
    """Make an empty plan for the plug-in; `taken/` in it collects what was carried out."""
    plan = scene.folder / "plan"
    (plan / "taken").mkdir(parents=True)
    scene.environment["FAULTY_PLAN"] = str(plan)
    return plan


def _rollout(scene: Scene, seed: int, *, alone: bool) -> str:
    """Return what attempts call the rollout of a seed, or its batch, which it fails in before it is made again."""
    if scene.subject.batch > 1:
        (found,) = (each for each in observed_rollouts(scene.subject.calm) if each.seed == seed and _is_new(each))
        return f"{found.rollout}.1" if alone else Path(found.path).stem
    text = f"SELECT path FROM rollouts WHERE seed = {seed}"
    return Path(str(query(scene.subject.calm, text)[0][0])).stem


def _is_new(fact: RolloutFact) -> bool:
    return closing_check(fact.rollout.problem) is None
