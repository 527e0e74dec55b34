"""Links between the orchestrator and remote workers: a router, a cable, messages in memory."""

import time

from tests.end_to_end.fleet.hosts import ip
from tests.end_to_end.processes import Process, query
from tests.faults.scene import Scene
from tests.faults.verdict import prefix
from tests.sharing import free_port

FIRST_OF_A_GRID = 2
"""At most so many results of one worker come before another's with the same time grid."""


def restart_router(scene: Scene) -> None:
    """The router between orchestrator and workers is killed and started again."""
    router = _router(scene)
    scene.start()
    for moment in scene.moments(scene.chance.choice((1, 2, 3))):
        if scene.reach(moment):
            scene.pause()
            router.popen.kill()
            seconds = scene.pause(0.0, scene.chance.choice((0.5, 2.5, 6.0)))
            scene.did(f"router away for {seconds:.1f} s")
            router = _router(scene)
    scene.finish()
    _is_calm(scene)


def router_away(scene: Scene) -> None:
    """The router is killed for 20 s in mid-run, with 8 workers."""
    router = _router(scene)
    scene.start(workers=8)
    if scene.reach(scene.moments(1, share=0.5)[0]):
        router.popen.kill()
        time.sleep(20.0)
        scene.did("router away for 20 s")
        _router(scene)
    scene.finish()
    _is_calm(scene)


def restart_everything(scene: Scene) -> None:
    """Router, orchestrator and a worker are killed, as on a cluster, and started again one after the other."""
    router = _router(scene)
    scene.start(workers=4)
    for moment in scene.moments(2):
        if scene.reach(moment):
            router.popen.kill()
            scene.kill_worker()
            scene.kill_orchestrator()
            scene.did("router killed", fault=False)
            scene.pause(0.0, 3.0)
            scene.resume()
            scene.pause(0.0, 3.0)
            router = _router(scene)
    scene.finish()


def _router(scene: Scene) -> Process:
    """Start the router, at the same place each time."""
    scene.remote = True
    scene.router = scene.router or f"tcp/127.0.0.1:{free_port()}"
    return scene.processes.start("perfbound", "router", "--listen", scene.router, **scene.environment)


def _is_calm(scene: Scene) -> None:
    """Check that no attempt was given up, and that no rollout was simulated twice, but for the doubt about its grid."""
    assert query(scene.directory, "SELECT rollout, attempt, outcome FROM outcomes WHERE outcome <> 'recorded'") == []
    # The first of a time grid is repeated, and with it what its worker has done by then.
    repeated = query(scene.directory, "SELECT DISTINCT rollout FROM attempts WHERE attempt > 1")
    compared = query(scene.directory, "SELECT DISTINCT rollout FROM opinions WHERE kind = 'compared'")
    assert set(repeated) <= set(compared)
    assert len(repeated) <= FIRST_OF_A_GRID


def cut_cable(scene: Scene) -> None:
    """Orchestrator and workers in network namespaces; their cable is cut, for shorter or longer than the leases."""
    cable = _cable(scene)
    scene.start()
    for moment in scene.moments(scene.chance.choice((1, 2, 3))):
        if scene.reach(moment):
            scene.pause()
            ip("-n", cable, "link", "set", cable, "down")
            seconds = scene.pause(*scene.chance.choice(((0.1, 1.5), (2.0, 4.0), (5.5, 8.0))))
            ip("-n", cable, "link", "set", cable, "up")
            scene.did(f"cable cut for {seconds:.1f} s")
    scene.finish()


def cut_and_kill(scene: Scene) -> None:
    """The orchestrator is killed and resumed while the cable is cut."""
    cable = _cable(scene)
    scene.start()
    if scene.reach(scene.moments(1)[0]):
        ip("-n", cable, "link", "set", cable, "down")
        scene.did("cable cut")
        scene.pause(0.0, 4.0)
        scene.kill_orchestrator()
        scene.resume()
        scene.pause(0.0, 6.0)
        ip("-n", cable, "link", "set", cable, "up")
        scene.did("cable restored", fault=False)
    scene.finish()


def _cable(scene: Scene) -> str:
    """Put orchestrator and workers into two namespaces with a cable between; return the end of the workers."""
    ours, theirs = f"{prefix(scene)}a", f"{prefix(scene)}b"
    for name in (ours, theirs):
        ip("netns", "add", name)
        scene.undo.append(lambda name=name: ip("netns", "del", name))  # type: ignore[misc]
        ip("-n", name, "link", "set", "lo", "up")
    ip("link", "add", ours, "netns", ours, "type", "veth", "peer", "name", theirs, "netns", theirs)
    for name, address in ((ours, "10.77.0.1/24"), (theirs, "10.77.0.2/24")):
        ip("-n", name, "address", "add", address, "dev", name)
        ip("-n", name, "link", "set", name, "up")
    scene.remote, scene.host, scene.listening = True, "10.77.0.1", "tcp/10.77.0.1:7447"
    scene.prefix, scene.worker_prefix = (("ip", "netns", "exec", name) for name in (ours, theirs))
    return theirs


def disturb_messages(scene: Scene) -> None:
    """A whole campaign in one process, whose messages are lost, repeated, delayed and overtake each other."""
    chance = scene.chance
    shares = {"loss": chance.uniform(0, 0.3), "duplication": chance.uniform(0, 0.5), "delay": chance.uniform(0, 0.3)}
    options = [part for name, value in shares.items() for part in (f"--{name}", f"{value:.3f}")]
    options += ["--seed", str(chance.randrange(2**31)), "--stop-at", str(scene.moments(1)[0])]
    scene.orchestrator = scene.processes.start(
        "python", "-m", "tests.faults.messages", scene.subject.campaign, scene.directory, *options,
        **scene.environment,
    )  # fmt: skip
    scene.did(", ".join(f"{name} {value:.2f}" for name, value in shares.items()), fault=False)
    scene.finish()
    scene.injected += int((scene.orchestrator.folder / "out").read_text())
