"""The secrets of the assignments of a run, and the check of the results that they prove.

All of them follow from one key, which only orchestrators of this run read: after a restart the results of workers that
went on are still proved. Without it, as after a restore from a backup, their attempts are made again.
"""

import os
import secrets
import stat
from pathlib import Path

from ...schemas.atomic import write_new
from ...schemas.ids import Attempt
from ...schemas.link.messages import ResultHeader
from ...schemas.link.seal import assignment_secret, is_proved

KEY = "assignments.key"
"""In the run directory while the campaign runs."""
LENGTH = 32


class Assignments:
    """Secrets of the assignments of one run; `directory` is locked."""

    def __init__(self, directory: Path, run: str) -> None:
        self._path, self._run = directory / KEY, run
        self._key = _known_key(self._path) or _fresh_key(self._path)

    def secret(self, worker: str, attempt: Attempt) -> str:
        """Return the secret of an assignment."""
        return assignment_secret(self._key, self._run, str(attempt.rollout), attempt.number, worker)

    def proved(self, worker: str, header: ResultHeader) -> bool:
        """Whether a result or a failure was made by the worker of its assignment."""
        secret = assignment_secret(self._key, self._run, header.rollout, header.attempt, worker)
        return is_proved(secret, header)


def forget(directory: Path) -> None:
    """Remove the key of a run that is finished: its directory is handed on, with its evidence."""
    (directory / KEY).unlink(missing_ok=True)


def _known_key(path: Path) -> bytes | None:
    """Return the key; None where there is none that nobody else knows."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    with open(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        # Who could read it could prove results; with a fresh key the attempts under way are made again.
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o077:
            return None
        key = file.read(LENGTH + 1)
    return key if len(key) == LENGTH else None


def _fresh_key(path: Path) -> bytes:
    key = secrets.token_bytes(LENGTH)
    path.unlink(missing_ok=True)
    write_new({path: (key, 0o600)})
    return key
