"""Processes that die, stop, and come back."""

import threading
import time
from contextlib import suppress

import psutil

from tests.end_to_end.processes import recorded, wait_for
from tests.faults.scene import Scene

LEASE, LOST = 2.0, 3.0
"""Seconds after which the token of a silent worker is gone, and after which a worker without a token is lost."""
ALL_BACK = ((0.1, 1.0), (LOST + 0.5, LOST + 2.0), (10.0, 10.0))
"""Seconds without any worker: before the attempts of the dead ones are lost, or afterwards."""


def kill_workers(scene: Scene) -> None:
    """kill -9 of workers, once or again and again, local or remote."""
    scene.remote = scene.chance.random() < 0.5
    scene.start()
    for moment in scene.moments(scene.chance.choice((1, 2, 3, 4))):
        if scene.reach(moment):
            scene.pause()
            scene.kill_worker()
    scene.finish()


def mass_death(scene: Scene) -> None:
    """kill -9 of all workers at once; after up to ten seconds as many are back. Local ones are replaced at once."""
    scene.remote = scene.chance.random() < 0.7
    scene.start(workers=scene.chance.choice((2, 3, 6)))
    for moment in scene.moments(scene.chance.choice((1, 2))):
        if scene.reach(moment):
            scene.pause()
            victims = scene.workers()
            for worker in victims:
                with suppress(psutil.NoSuchProcess):
                    worker.kill()
            scene.did(f"kill all {len(victims)} workers")
            if scene.remote:
                scene.pause(*scene.chance.choice(ALL_BACK))
                for _ in victims:
                    scene.join()
    scene.finish()


def stop_workers(scene: Scene) -> None:
    """SIGSTOP of workers, for shorter or longer than the orchestrator's patience, then SIGCONT."""
    scene.remote = scene.chance.random() < 0.7
    scene.start(workers=3)
    for moment in scene.moments(scene.chance.choice((1, 2)), share=0.4):
        if scene.reach(moment):
            stop_worker(scene, scene.chance.choice((0.3, 1.5, scene.subject.hung_after + 1, LEASE + LOST + 1.0)))
    scene.finish()


def stop_worker(scene: Scene, seconds: float) -> None:
    """SIGSTOP of a random worker; a timer sends SIGCONT."""
    found = scene.workers()
    if not found:
        return
    worker = scene.chance.choice(found)
    with suppress(psutil.NoSuchProcess):
        worker.suspend()
        scene.did(f"stop worker {worker.pid} for {seconds:.1f} s")
    timer = threading.Timer(seconds, _go_on, [worker])
    timer.start()
    scene.undo.append(timer.join)


def _go_on(process: psutil.Process) -> None:
    with suppress(psutil.NoSuchProcess):
        process.resume()


def kill_orchestrator(scene: Scene) -> None:
    """kill -9 of the orchestrator in mid-run, once or more, and `resume`; remote workers stay alive."""
    scene.remote = scene.chance.random() < 0.5
    scene.start()
    for moment in scene.moments(scene.chance.choice((1, 2, 3))):
        if scene.reach(moment):
            scene.pause()
            scene.kill_orchestrator()
            scene.resume()
    scene.finish()


def kill_resume(scene: Scene) -> None:
    """kill -9 of the orchestrator, then of `resume` while it starts, at a random moment of its first seconds."""
    scene.remote = scene.chance.random() < 0.5
    scene.start()
    if scene.reach(scene.moments(1, share=0.5)[0]):
        scene.kill_orchestrator()
        for _ in range(scene.chance.choice((1, 2, 3))):
            scene.resume()
            scene.pause(0.0, 3.0)
            if scene.orchestrator.running:
                scene.kill_orchestrator()
        scene.resume()
    scene.finish()


def kill_start(scene: Scene) -> None:
    """kill -9 of `run` in its first seconds; the same command, or `resume` where a campaign was begun, continues."""
    for _ in range(scene.chance.choice((1, 2, 3))):
        begin_or_resume(scene)
        if scene.chance.random() < 0.5:  # while the database is being made
            wait_for(scene.directory.exists)
            seconds = scene.pause(0.0, 0.05)
        else:
            seconds = scene.pause(0.0, 2.0)
        scene.orchestrator.popen.kill()
        scene.orchestrator.wait()
        scene.did(f"kill orchestrator after {seconds:.2f} s, at {recorded(scene.directory)} rollouts")
    begin_or_resume(scene)
    scene.finish()


def two_resumes(scene: Scene) -> None:
    """Two `resume` at once after kill -9, again and again: one continues, the other one names who has the lock."""
    scene.remote = scene.chance.random() < 0.5
    scene.start()
    for moment in scene.moments(scene.chance.choice((1, 2)), share=0.5):
        if scene.reach(moment):
            scene.pause()
            scene.kill_orchestrator()
            _race(scene)
            scene.did("two resumes at once")
            scene.pause(0.0, 1.0)
    scene.finish()


def _race(scene: Scene) -> None:
    scene.resume()
    one = scene.orchestrator
    scene.resume()
    both = (one, scene.orchestrator)
    wait_for(lambda: not all(each.running for each in both))
    scene.orchestrator, loser = sorted(both, key=lambda each: each.running, reverse=True)
    ended = loser.wait()
    assert ended.code == 1, f"exit {ended.code} of the second resume: {ended.err[-1500:]}"
    assert "another orchestrator is running this campaign" in ended.fault


def begin_or_resume(scene: Scene) -> None:
    """Do what a person does who finds a run directory, or none."""
    if (scene.directory / "campaign.db").exists():
        scene.resume()
    else:
        scene.start()


def stop_orchestrator(scene: Scene) -> None:
    """SIGSTOP of the orchestrator, for shorter or longer than the leases, then SIGCONT."""
    scene.remote = scene.chance.random() < 0.5
    scene.start()
    for moment in scene.moments(scene.chance.choice((1, 2))):
        if scene.reach(moment):
            stand_still(scene, scene.chance.choice((0.2, 1.0, 2.5, 6.0)))
    scene.finish()


def stand_still(scene: Scene, seconds: float) -> None:
    """SIGSTOP of the orchestrator; SIGCONT."""
    process = psutil.Process(scene.orchestrator.pid)
    process.suspend()
    scene.did(f"stop orchestrator for {seconds:.1f} s")
    time.sleep(seconds)
    process.resume()


def hang_then_kill(scene: Scene) -> None:
    """Workers are stopped, and the orchestrator is killed: no worker may remain."""
    scene.start()
    if scene.reach(scene.moments(1)[0]):
        workers = scene.workers()
        for worker in workers:
            worker.suspend()
        scene.did(f"stop workers {', '.join(str(worker.pid) for worker in workers)}")
        scene.kill_orchestrator()
        wait_for(lambda: not any(_lives(worker) for worker in workers))
        scene.resume()
    scene.finish()


def _lives(process: psutil.Process) -> bool:
    return process.is_running() and process.status() != psutil.STATUS_ZOMBIE


def mixed(scene: Scene) -> None:
    """Kills and stops of workers and orchestrator, one upon another."""
    scene.remote = scene.chance.random() < 0.5
    scene.start(workers=3)
    for moment in scene.moments(scene.chance.randint(3, 6)):
        if not scene.reach(moment):
            break
        scene.pause()
        scene.chance.choice((Scene.kill_worker, _stop_one, _stand_still, _kill_and_resume))(scene)
    scene.finish()


def _stop_one(scene: Scene) -> None:
    stop_worker(scene, scene.chance.choice((0.5, 2.5, 6.0)))


def _stand_still(scene: Scene) -> None:
    if scene.orchestrator.running:
        stand_still(scene, scene.chance.choice((0.5, 3.0)))


def _kill_and_resume(scene: Scene) -> None:
    scene.kill_orchestrator()
    scene.resume(workers=3)
