"""Links between the orchestrator and remote workers: a router, a cable, messages in memory."""

from pathlib import Path

from tests.end_to_end.hosts import ip
from tests.faults.scene import Scene
from tests.faults.verdict import prefix
from tests.sharing import free_port

ROUTER = Path(__file__).with_name("router.py")


def restart_router(scene: Scene) -> None:
    """A Zenoh router between orchestrator and workers is killed and started again."""
    scene.remote = True
    scene.workers_at = f"tcp/127.0.0.1:{free_port()}"
    ends = (scene.listening, scene.workers_at)
    router = scene.processes.start("python", ROUTER, *ends, **scene.environment)
    scene.start()
    for moment in scene.moments(scene.chance.choice((1, 2, 3))):
        if scene.reach(moment):
            scene.pause()
            router.popen.kill()
            seconds = scene.pause(0.0, scene.chance.choice((0.5, 2.5, 6.0)))
            scene.did(f"router away for {seconds:.1f} s")
            router = scene.processes.start("python", ROUTER, *ends, **scene.environment)
    scene.finish()


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
