"""Faults of the machine: a full disk, a slow disk, a disk with errors, a clock that jumps."""

import os
import shutil
import subprocess
from pathlib import Path

from tests.end_to_end.processes import query, recorded, wait_for
from tests.faults.scene import Scene

SHIM = Path(__file__).with_name("shim.c")
MEGABYTE = 2**20


def fill_disk(scene: Scene) -> None:
    """The run directory is on a small disk that fills up; it is enlarged, and the campaign resumed."""
    disk = scene.folder / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", disk], check=True)
    scene.undo.append(lambda: subprocess.run(["umount", "--lazy", disk], check=True))  # type: ignore[arg-type]
    scene.directory = disk / "run"
    scene.start()
    for size, moment in zip((24, 48, 72), scene.moments(scene.chance.choice((1, 2, 3))), strict=False):
        if not scene.reach(moment):
            break
        left = scene.chance.randrange(0, 48 * 1024)
        _fill(disk, left)
        scene.did(f"disk full but for {left} bytes, at {recorded(scene.directory)} rollouts")
        _ended_by(scene)
        if scene.chance.random() < 0.5:  # a person who resumes before making room
            _fill(disk, 0)  # the end has freed the write-ahead log
            scene.resume()
            _ended_by(scene)
        subprocess.run(["mount", "-o", f"remount,size={size}m", disk], check=True)
        scene.did(f"disk enlarged to {size} MB", fault=False)
        scene.resume()
    scene.finish()
    for ballast in disk.glob("ballast*"):
        ballast.unlink()


def _fill(disk: Path, left: int) -> None:
    free = os.statvfs(disk)
    size = free.f_bavail * free.f_frsize - left
    try:
        with open(disk / f"ballast-{len(list(disk.iterdir()))}", "wb") as file:
            file.write(bytes(max(0, size)))
            file.flush()
    except OSError:
        return  # the campaign was quicker: it is full already, perhaps without room for an empty file


def _ended_by(scene: Scene) -> None:
    """Assert that the orchestrator ends with one clear line that names the disk."""
    last = scene.refused()
    assert any(word in last for word in ("full", "No space left", "disk I/O")), last
    assert "continue with: perfbound resume" in last, last


def slow_disk(scene: Scene) -> None:
    """Every fsync lasts 50 ms to half a second longer."""
    ms = scene.chance.choice((50, 200, 500))
    scene.environment |= {"LD_PRELOAD": str(shim(scene.folder)), "SHIM_FSYNC_MS": str(ms)}
    scene.start()
    scene.did(f"fsync lasts {ms} ms longer")
    if scene.chance.random() < 0.5 and scene.reach(scene.moments(1)[0]):
        scene.pause()
        scene.kill_orchestrator()
        scene.resume()
    scene.finish()


def io_error(scene: Scene) -> None:
    """Single calls on the run directory fail with EIO: a campaign that ends says why, and resumes."""
    plan = scene.folder / "errors"
    (plan / "taken").mkdir(parents=True)
    scene.environment |= {
        "LD_PRELOAD": str(shim(scene.folder)),
        "SHIM_EIO": str(plan),
        "SHIM_BELOW": str(scene.directory),
    }
    scene.start()
    for moment in scene.moments(scene.chance.choice((1, 2)), share=1.0):
        if _reach(scene, moment):
            _fail_once(scene, plan / scene.chance.choice(("read", "write", "fsync", "rename")))
    while _ended_by_error(scene):
        scene.resume()
    scene.finish()


def _reach(scene: Scene, moment: int) -> bool:
    """Wait as `Scene.reach` does; resume what an error ends before."""
    while not scene.reach(moment):
        if not _ended_by_error(scene):
            return False
        scene.resume()
    return True


def _fail_once(scene: Scene, call: Path) -> None:
    """Plan one error, of the campaign that runs or of its resume; wait until it has come."""
    if call.name == "read" or scene.chance.random() < 0.2:  # a campaign that runs reads little
        scene.kill_orchestrator()
        call.touch()
        scene.resume()
    else:
        call.touch()
    wait_for(lambda: not call.exists() or not scene.orchestrator.running)
    if not call.exists():
        scene.did(f"{call.name} fails at {recorded(scene.directory)} rollouts")
    call.unlink(missing_ok=True)


def _ended_by_error(scene: Scene) -> bool:
    """Wait for the end; whether an error of the disk was the cause, told in one clear line."""
    if scene.end().code == 0:
        return False
    last = scene.refused()
    assert any(word in last for word in ("Input/output error", "disk I/O error")), last
    return True


HOUR, DAY = 3600, 86400


def jump_clock(scene: Scene) -> None:
    """The wall clock is wrong by an hour and more, in both directions: of all processes, or of one side alone.

    No time limit sees it, and all of them hold afterwards: a worker that is killed is noticed.
    """
    clock = scene.folder / "clock"
    clock.write_text("0")
    calm = dict(scene.environment)
    wrong = calm | {"LD_PRELOAD": str(shim(scene.folder)), "SHIM_CLOCK": str(clock)}
    scene.remote = scene.chance.random() < 0.7
    whose = scene.chance.choice(("all", "orchestrator", "workers") if scene.remote else ("all",))
    scene.did(f"the clock of: {whose}", fault=False)
    of_orchestrator, of_workers = (calm if whose == other else wrong for other in ("workers", "orchestrator"))
    scene.environment = of_orchestrator
    scene.start(workers=0 if scene.remote else 2)
    scene.environment = of_workers
    for _ in range(2 if scene.remote else 0):
        scene.join()
    jumps = scene.chance.sample((HOUR, -HOUR, scene.chance.choice((-1, 1)) * scene.chance.choice((5, 600, DAY))), 3)
    killed = scene.chance.randrange(2 * len(jumps))  # before one of the jumps, or never
    for number, (moment, seconds) in enumerate(zip(scene.moments(len(jumps)), jumps, strict=True)):
        if number == killed and scene.reach(moment):
            scene.kill_orchestrator()
            scene.environment = of_orchestrator
            scene.resume()
            scene.environment = of_workers
        if scene.reach(moment):
            _write(clock, str(seconds))
            scene.did(f"clock wrong by {seconds} s")
    scene.kill_worker()
    scene.finish()
    if scene.subject.hung_after > HOUR / 100:
        late = query(scene.directory, "SELECT outcome FROM outcomes WHERE outcome GLOB 'no[t ]*'")
        assert not late, f"taken for late: {late}"


def _write(path: Path, text: str) -> None:
    beside = path.with_name("next")
    beside.write_text(text)
    beside.replace(path)


def shim(folder: Path) -> Path:
    """Compile the shim into `folder`; return it, for LD_PRELOAD."""
    library = folder / "shim.so"
    compiler = shutil.which("cc")
    assert compiler is not None
    subprocess.run([compiler, "-O1", "-shared", "-fPIC", "-o", library, SHIM], check=True)
    return library
