"""Files of a run directory for clients of the live page; a path from a request is never opened.

A request is looked up in the database. Its file must be in the run directory, reached without a symbolic link, and
have the recorded digest, so that neither a forged database nor a link in a forged directory opens another file.
"""

import re
import stat
from pathlib import Path

from ...certificate.files import MAX_CERTIFICATE
from ...store import files
from ...store.changes import rollouts_of

_PATH = re.compile(
    rf"{files.FOLDER}/[a-z_]{{1,40}}/[0-9]{{1,9}}/([a-z_]{{1,40}})\.([0-9]{{1,9}})\.[a-z]+\.[0-9]+\.mcap"
)


def recorded_file(directory: Path, path: str) -> bytes | None:
    """Return a recorded trajectory file by its path in the run directory; None if `path` is not that of one.

    Raises:
        EvidenceError: the file is not the recorded one.
        JournalError: the database cannot be read.

    """
    found = _PATH.fullmatch(path)
    facts = rollouts_of(directory, found[1], int(found[2])) if found else []
    fact = next((fact for fact in facts if fact.path == path), None)
    if fact is None or not _is_plain(directory, fact.path, fact.size):
        return None
    return files.read_evidence(directory, fact.path, fact.sha256)


def certificate(directory: Path, name: str) -> bytes | None:
    """Return the certificate; None if there is none."""
    return (directory / name).read_bytes() if _is_plain(directory, name, MAX_CERTIFICATE) else None


def _is_plain(directory: Path, relative: str, most: int) -> bool:
    """Return whether this is a regular file of at most `most` bytes, reached without a link in the directory."""
    path = directory.resolve() / relative
    try:
        state = path.lstat()
        # A FIFO would block its reader; a path that resolves elsewhere has a link on the way.
        return stat.S_ISREG(state.st_mode) and state.st_size <= most and path.resolve() == path
    except OSError:
        return False
