"""The revision of a folder under git."""

import os
import subprocess
from pathlib import Path

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
