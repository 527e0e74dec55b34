"""The processes below a process, as the kernel lists them."""

import os
from contextlib import suppress
from pathlib import Path


def descendants(pid: int) -> list[int]:
    """Return the processes that a process has started, and those that they have, while their parents live."""
    family = [pid]
    for each in family:  # grows while it is read
        with suppress(OSError):
            for task in os.listdir(f"/proc/{each}/task"):
                family += map(int, Path(f"/proc/{each}/task/{task}/children").read_text().split())
    return family[1:]
