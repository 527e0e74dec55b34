"""One of three workers that is of no use, or of little."""

import json
from pathlib import Path
from typing import Any

from perfbound.schemas.batch import BatchRequest
from perfbound.schemas.ids import FileId
from perfbound.schemas.trajectory.batch import read_batch
from perfbound.schemas.trajectory.trajectory import File, read_mcap
from tests.end_to_end.processes import Ended, Process, query, wait_for
from tests.faults.faulty_function import honest
from tests.faults.scene import Scene

NODE = "FAULTY_NODE"
"""Variable of a worker that misbehaves in every rollout, with the kind of `faulty_function`."""
SINCE = "FAULTY_SINCE"
"""Variable with the file from whose creation on it does."""


def broken_node(scene: Scene) -> None:
    """A worker lacks its simulator, is refused a licence, or dies in every rollout and comes back three times."""
    kind = scene.chance.choice(("lack", "raise", "exit"))
    scene.irreproducible = kind == "raise"  # an exception is a failure of the system, wherever it comes from
    _with_two_good(scene, "broken", kind)
    for _ in range(3 if kind == "exit" else 0):
        last = scene.fleet[-1]
        wait_for(lambda last=last: not last.running or not scene.orchestrator.running)  # type: ignore[misc]
        if scene.orchestrator.running:
            scene.join("broken", **{NODE: kind})
    _finish(scene, "broken", "attempt" if kind == "exit" else "set aside")


def silent_node(scene: Scene) -> None:
    """A worker accepts its rollouts and never answers."""
    silent = _with_two_good(scene, "silent", "sleep")
    _finish(scene, "silent", "attempt")
    silent.popen.kill()  # it does not listen to a signal either


def slow_node(scene: Scene) -> None:
    """A worker takes ten times as long as the others; it is slow, not bad."""
    _with_two_good(scene, "slow", "slow")
    scene.finish()
    outcomes = query(scene.directory, "SELECT outcome FROM outcomes WHERE worker = 'slow'")
    assert set(outcomes) <= {("recorded",)}, outcomes


def lying_node(scene: Scene) -> None:
    """A worker sends plausible trajectories that are false; every rollout has a second opinion.

    Nothing of it is recorded, unless it is alone at first: then it agrees with itself.
    """
    _with_two_good(scene, "lying", "lie")
    ended = _finish(scene, "lying", "set aside for good")
    for rollout in _judge(scene, ended, "lying"):
        opinions = query(scene.directory, f"SELECT DISTINCT worker FROM opinions WHERE rollout = '{rollout}'")
        others = [worker for (worker,) in opinions if worker != "lying"]
        assert len(others) == 1, f"{rollout} is false, and simulated by {others}, not by the review alone"


def turning_node(scene: Scene) -> None:
    """A worker begins to lie in mid-run; one rollout in twenty has a second opinion.

    The certificate is the calm one, or refutes that workers are honest, or the share of false rollouts behind it is
    at most the one which it states.
    """
    since = scene.folder / "since"
    _with_two_good(scene, "turning", "lie", **{SINCE: str(since)})
    scene.reach(scene.chance.randrange(scene.subject.rollouts // 4, 3 * scene.subject.rollouts // 4))
    since.touch()
    scene.did("the worker begins to lie")
    _judge(scene, scene.finish(), "turning")


def _judge(scene: Scene, ended: Ended, name: str) -> list[str]:
    """Return the false rollouts behind the certificate, which says enough about them."""
    rows = query(scene.directory, "SELECT path FROM rollouts")
    wrong = [Path(str(path)).stem for (path,) in rows if _is_false(scene.directory / str(path))]
    scene.misled = wrong != []
    document = json.loads((scene.directory / "certificate.json").read_bytes())["predicate"]
    honesty: dict[str, Any] = next(each for each in document["assumptions"] if each["id"] == "workers_honest")
    aside = any(name in line and "set aside for good" in line for line in ended.err.splitlines())
    caught = "caught, " if aside else ""
    scene.did(f"{len(wrong)} of {len(rows)} rollouts are false; {caught}{honesty['status']}", fault=False)
    if honesty["status"] == "refuted":
        assert wrong, "refuted without a false rollout"
    else:
        assert not (aside and wrong), f"{wrong} are false rollouts of an outvoted worker, and nothing is refuted"
        assert 100 * len(wrong) / len(rows) <= honesty["values"]["percent"], f"silent about {wrong} of {len(rows)}"
    return wrong


def _is_false(file: Path) -> bool:
    name, data = FileId.parse(file.stem), file.read_bytes()
    if not name.places:
        return _is_false_rollout(read_mcap(data))
    found = read_batch(data)
    request = BatchRequest.model_validate_json(found.request)
    return any(_is_false_rollout(found.alone(request.rollouts[place])) for place in found.batch.succeeded)


def _is_false_rollout(found: File) -> bool:
    x, variant, seed = (found.request[key] for key in ("x", "variant", "seed"))
    return bool(found.trajectory.samples[0, 1] != honest(x, variant, seed))


def _with_two_good(scene: Scene, name: str, kind: str, **environment: str) -> Process:
    scene.remote = True
    scene.start(workers=0)
    scene.join(name, **{NODE: kind}, **environment)
    bad = scene.fleet[-1]
    scene.join()
    scene.join()
    scene.did(f"{kind} in every rollout of worker {name}{', later' if environment else ''}", fault=not environment)
    return bad


def _finish(scene: Scene, name: str, how: str) -> Ended:
    ended = scene.finish()
    named = [line for line in ended.err.splitlines() if name in line and how in line]
    assert named, f"no line names {name}: {ended.err[-2000:]}"
    return ended
