"""The memory that an orchestrator took at most."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.faults.scene import Scene

LIBRARIES = 200 * 2**20
"""Bytes of an orchestrator that has loaded everything; 173 MB were measured."""
PERIOD = 0.02


@contextmanager
def memory(scene: Scene) -> Iterator[Callable[[], int]]:
    """Watch the orchestrator that runs now; inside and after the block, return the bytes that it took at most."""
    status, peak, over = Path(f"/proc/{scene.orchestrator.pid}/status"), [0], threading.Event()

    def look() -> None:
        while not over.wait(PERIOD):
            with suppress(FileNotFoundError, ProcessLookupError):
                lines = status.read_text().splitlines()
                # A process that has ended, and that nobody has waited for, has no memory.
                peak[0] = max([peak[0], *(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))])

    watching = threading.Thread(target=look)
    watching.start()
    try:
        yield lambda: peak[0]
    finally:
        over.set()
        watching.join()
