"""Files of a run directory for those who ask over the network: no path of theirs is ever opened.

What they ask for is looked up in the database, stands below the run directory without a link on the way, and has the
digest that was recorded; so not even a foreign database, or a link in a foreign directory, opens another file.
"""

import re
import stat
from pathlib import Path

from ...store import files
from ...store.changes import rollouts_of

MOST = 64 * 1024 * 1024
"""Bytes of a certificate."""
_ASKED = re.compile(
    rf"{files.FOLDER}/[a-z_]{{1,40}}/[0-9]{{1,9}}/([a-z_]{{1,40}})\.([0-9]{{1,9}})\.[a-z]+\.[0-9]+\.mcap"
)


def trajectory(directory: Path, asked: str) -> bytes | None:
    """Return a recorded trajectory file by its path in the run directory; None where `asked` is no such path.

    Raises:
        EvidenceError: the file is not the one that was recorded.
        JournalError: the database cannot be read.

    """
    found = _ASKED.fullmatch(asked)
    facts = rollouts_of(directory, found[1], int(found[2])) if found else []
    fact = next((fact for fact in facts if fact.path == asked), None)
    if fact is None or not _is_plain(directory, fact.path, fact.size):
        return None
    return files.read(directory, fact.path, fact.sha256)


def certificate(directory: Path, name: str) -> bytes | None:
    """Return the certificate; None where there is none."""
    return (directory / name).read_bytes() if _is_plain(directory, name, MOST) else None


def _is_plain(directory: Path, relative: str, most: int) -> bool:
    """Whether it is a file of at most `most` bytes, reached without a symbolic link below the directory."""
    path = directory.resolve() / relative
    try:
        state = path.lstat()
        return stat.S_ISREG(state.st_mode) and state.st_size <= most and path.resolve() == path
    except OSError:
        return False
