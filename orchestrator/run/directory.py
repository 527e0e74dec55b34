"""The run directory of a new campaign: empty, or with the leftovers of an attempt to start one; locked."""

import os
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...schemas.errors import JournalError, PerfboundError
from ...schemas.file.config import CampaignConfig
from ...schemas.file.reader import differences
from ...schemas.result.certificate import Certificate
from ..certificate import files
from ..store import read
from ..store.lock import LOCK_FILE, RunLock, campaign_lock, forget_lock
from ..store.read import read_header
from ..store.rows import DATABASE
from .continuation import continue_command


def check_vacant(directory: Path, config: CampaignConfig) -> None:
    """Refuse a directory that is not empty; the text says what the campaign in it differs in, or how to continue it.

    Raises:
        PerfboundError: something is there.

    """
    if (directory / DATABASE).exists():
        found = stored_differently(directory, config)
        if found:
            raise PerfboundError(
                f"{directory}: the campaign stored here differs from the file: {found}. A campaign never "
                "changes after its start; choose another --out"
            )
        if (directory / files.CERTIFICATE).exists():
            raise PerfboundError(
                f"{directory}: a finished campaign is here; `perfbound show {shlex.quote(str(directory))}` prints it. "
                "Choose another --out for a new one"
            )
        raise PerfboundError(
            f"{directory}: a campaign is here already; continue it with `{continue_command(directory)}`, "
            "or choose another --out"
        )
    leftovers = {directory / LOCK_FILE, *_unfinished(directory)}
    if directory.exists() and (not directory.is_dir() or set(directory.iterdir()) - leftovers):
        raise PerfboundError(f"{directory}: exists and is not empty; choose another --out")


def stored_differently(directory: Path, config: CampaignConfig) -> str:
    """Return where the campaign in `directory` differs from `config`; nothing if it does not, or cannot be read."""
    try:
        with read.reading(directory) as connection:
            stored = read_header(connection, directory).config
    except JournalError:
        return ""
    found = differences(stored, config)
    more = f"; and {len(found) - 3} more" if len(found) > 3 else ""
    return f"{'; '.join(found[:3])}{more}, respectively" if found else ""


def _unfinished(directory: Path) -> list[Path]:
    """Return the files of a database that was never finished: its orchestrator failed, or was killed."""
    return list(directory.glob(f"{DATABASE}.partial*"))


@contextmanager
def claimed(directory: Path, config: CampaignConfig) -> Iterator[RunLock]:
    """Make the run directory and lock it; remove it if no campaign was started in it."""
    try:
        there = directory.is_dir()
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PerfboundError(f"{directory}: cannot be created ({error.strerror}); choose another --out") from None
    with campaign_lock(directory) as held:
        try:
            check_vacant(directory, config)  # again, under the lock: another orchestrator may have started here
            _remove(_unfinished(directory))
            try:
                yield held
            finally:
                _remove(_unfinished(directory))
        finally:
            if not (directory / DATABASE).exists():
                forget_lock(held)
            if not there and not any(directory.iterdir()):
                directory.rmdir()


def _remove(files: list[Path]) -> None:
    for each in files:
        each.unlink()


def finished_certificate(directory: Path) -> Certificate:
    """Return the certificate of a finished campaign.

    Raises:
        PerfboundError: there is none, or it is damaged.

    """
    found = files.read(directory)
    if found is None:
        raise PerfboundError(f"{directory}: no certificate yet; `{continue_command(directory)}` continues the campaign")
    return found


TIMEOUT = 5.0
"""Seconds for one command of git."""


def revision(folder: Path) -> str | None:
    """Return the commit of a folder, and whether its files differ from it; None where git knows none."""
    commit = _git(folder, "rev-parse", "--short=12", "HEAD")
    if commit is None:
        return None
    changed = _git(folder, "status", "--porcelain", "--untracked-files=no", "--", ".")
    return f"commit {commit}" if changed == "" else f"commit {commit}, with changes"


def _git(folder: Path, *arguments: str) -> str | None:
    # Read alone: no index is refreshed on disk, and no question is asked.
    environment = {**os.environ, "GIT_OPTIONAL_LOCKS": "0", "GIT_TERMINAL_PROMPT": "0"}
    try:
        found = subprocess.run(
            ["git", "-C", str(folder), *arguments],  # noqa: S607  (the git of the user)
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIMEOUT,
            env=environment,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return found.stdout.strip() if found.returncode == 0 else None
