"""Faults of the machine: a full disk, a slow disk, a clock that jumps."""

import os
import shutil
import subprocess
import threading
from pathlib import Path

from perfbound.orchestrator.store import lock
from tests.end_to_end.processes import recorded
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
    """Assert that the orchestrator ends with one clear line and frees the campaign."""
    ended = scene.end()
    last = ended.err.splitlines()[-1] if ended.err else ""
    assert ended.code == 1, f"exit {ended.code} on a full disk: {ended.err[-1500:]}"
    assert "Traceback" not in ended.err, ended.err[-1500:]
    assert any(word in last for word in ("full", "No space left", "disk I/O")), last
    assert "continue with: perfbound resume" in last, last
    assert not lock.is_held(scene.directory)


def slow_disk(scene: Scene) -> None:
    """Every fsync lasts 50 ms to half a second longer."""
    ms = scene.chance.choice((50, 200, 500))
    scene.environment |= {"LD_PRELOAD": str(_shim(scene)), "SHIM_FSYNC_MS": str(ms)}
    scene.start()
    scene.did(f"fsync lasts {ms} ms longer")
    if scene.chance.random() < 0.5 and scene.reach(scene.moments(1)[0]):
        scene.pause()
        scene.kill_orchestrator()
        scene.resume()
    scene.finish()


def jump_clock(scene: Scene) -> None:
    """The wall clock jumps by seconds to hours, forwards and backwards; perhaps another than that of the workers."""
    clock = scene.folder / "clock"
    clock.write_text("0")
    calm = dict(scene.environment)
    scene.environment |= {"LD_PRELOAD": str(_shim(scene)), "SHIM_CLOCK": str(clock)}
    scene.remote = scene.chance.random() < 0.5
    ticking = _jumps(scene, clock)
    if scene.remote and scene.chance.random() < 0.5:
        scene.start(workers=0)
        scene.environment = calm
        scene.join()
        scene.join()
    else:
        scene.start()
    ticking.start()
    if scene.chance.random() < 0.3 and scene.reach(scene.moments(1)[0]):
        scene.kill_orchestrator()
        scene.resume()
    scene.end()
    ticking.join()
    scene.finish()


def _jumps(scene: Scene, clock: Path) -> threading.Thread:
    jumps = [scene.chance.choice((-1, 1)) * scene.chance.choice((5, 600, 3 * 3600, 86400)) for _ in range(3)]
    moments = scene.moments(3)

    def jump() -> None:
        for moment, seconds in zip(moments, jumps, strict=True):
            if scene.reach(moment):
                beside = clock.with_name("clock-next")
                beside.write_text(str(seconds))
                beside.replace(clock)
                scene.did(f"clock wrong by {seconds} s")

    return threading.Thread(target=jump)


def _shim(scene: Scene) -> Path:
    library = scene.folder / "shim.so"
    compiler = shutil.which("cc")
    assert compiler is not None
    subprocess.run([compiler, "-O1", "-shared", "-fPIC", "-o", library, SHIM], check=True)
    return library
