"""The lock of a run directory for one orchestrator: an flock, which the kernel releases on kill -9."""

import fcntl
import os
import shlex
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...schemas.errors import PerfboundError
from . import stop_request

ATTEMPTS = 10


@contextmanager
def campaign_lock(directory: Path) -> Iterator[None]:
    """Lock the campaign in `directory`; no file is made, so kill -9 leaves none behind.

    Raises:
        PerfboundError: another orchestrator has locked it.

    """
    # CLOEXEC: a child that outlives a killed orchestrator must not keep its lock.
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        if not _take(descriptor):
            place = shlex.quote(str(directory))
            raise PerfboundError(
                f"{directory}: another orchestrator is running this campaign; "
                f"watch it with `perfbound status {place}`, or stop it with `perfbound stop {place}`"
            )
        stop_request.withdraw_request(directory)  # of before: it was meant for an orchestrator that has ended
        try:
            yield
        finally:
            stop_request.withdraw_request(directory)
    finally:
        os.close(descriptor)


def _take(descriptor: int) -> bool:
    # A reader in `is_held` has a shared lock for microseconds: it must not keep an orchestrator from starting.
    for _ in range(ATTEMPTS):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(0.05)
        else:
            return True
    return False


def is_held(directory: Path) -> bool:
    """Whether an orchestrator has locked the campaign now."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    else:
        return False
    finally:
        os.close(descriptor)
