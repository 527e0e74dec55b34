"""The continuation of a campaign with the workers of its last session, by the options in its database.

Nothing connects by itself: the options are printed as part of a command. A database may come from elsewhere, so only
the options of a link are taken from it.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from ...schemas.errors import PerfboundError
from ...schemas.places import short_path
from ..certificate import files
from ..certificate.words.format import resume_command
from ..store.progress import session_options

LOCAL_WORKERS = 2
"""Local workers of a command without `--workers`."""
_WORKERS, _INSECURE = "--workers", "--insecure"
_FILES = frozenset({"--tls-ca", "--tls-certificate", "--tls-key"})
_VALUED = frozenset({_WORKERS, "--connect", "--listen", "--allow", "--grace"}) | _FILES


def continue_command(directory: Path) -> str:
    """Return the command that continues a campaign with the workers of its last session, quoted for a shell."""
    return command_with(directory, _options_text(directory))


def command_with(directory: Path, text: str | None) -> str:
    """Return the command that continues a campaign with options as its database has them."""
    words: list[str] = []
    for name, *value in _link_pairs(text):
        # Whole paths are stored; in the folder where the session was started they are those that were typed.
        words += [name, *(map(short_path, value) if name in _FILES else value)]
    return resume_command(directory, words)


def local_workers(directory: Path, workers: int | None, link: Sequence[str], *, extends: bool) -> int:
    """Return the number of local workers of a resume; `workers` and the options `link` are those of its command line.

    Without `workers`: those of the last session if that had a link as well, else two.

    Raises:
        PerfboundError: the last session had a link, and the command line says neither that nor the number of workers.

    """
    if workers is not None:
        return workers
    last = _link_pairs(_options_text(directory))
    if link:
        return next((int(value[0]) for name, *value in last if name == _WORKERS), LOCAL_WORKERS)
    # A finished campaign simulates nothing.
    if last and (extends or files.read(directory) is None):
        local = resume_command(directory, [_WORKERS, str(LOCAL_WORKERS)])
        raise PerfboundError(
            f"{directory}: was run last with workers that connect from elsewhere; continue so with "
            f"`{continue_command(directory)}`, or with local workers alone with `{local}`"
        )
    return LOCAL_WORKERS


def _options_text(directory: Path) -> str | None:
    try:
        return session_options(directory)
    except (PerfboundError, OSError):  # the resume itself says what is wrong
        return None


def _link_pairs(text: str | None) -> list[list[str]]:
    """Return each option with its value; none at all where one of them is not of a link."""
    try:
        words = json.loads(text or "[]")
    except (ValueError, RecursionError):
        return []
    if not isinstance(words, list) or not all(isinstance(each, str) and each.isprintable() for each in words):
        return []
    found, rest = list[list[str]](), iter(words)
    for word in rest:
        pair = [word] if word == _INSECURE else [word, next(rest, "-")]
        # A value that looks like an option would be one for the shell's reader.
        if word != _INSECURE and (word not in _VALUED or pair[1].startswith("-")):
            return []
        found.append(pair)
    return found if all(value[0].isdecimal() for name, *value in found if name == _WORKERS) else []
