"""The files that a system declares as read by its rollouts: their digests, and whether they are still the same.

A system lists them as `files`: files, folders and patterns, relative to the folder of the system. Their digests stand
beside those of the sources in its spec, so that another file is another system.
"""

import glob
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from ...schemas.errors import DefinitionError, ReplacedError
from ...schemas.system import SystemSpec
from ...schemas.system_check import Acts
from ...schemas.trajectory.trajectory import Trajectory, Visual
from .base import Floats, SystemUnderTest, Vectorised, acts_of
from .fingerprint import CACHES, file_sha256

MOST_FILES = 10_000
MOST_BYTES = 20 * 10**9
"""Of all files of a system: every worker reads them once, in less than a minute."""
DATABASE = "campaign.db"
State = tuple[int, ...]


class DeclaredFiles:
    """The files that a system declares, by their names; their digests are those of its construction."""

    def __init__(self, paths: Mapping[str, Path]) -> None:
        self._paths = paths
        self._states = {name: _state(path) for name, path in paths.items()}
        self.digests = {name: _digest(path, name) for name, path in paths.items()}
        """Name -> sha256."""

    def check(self) -> None:
        """Refuse files that were replaced since: what is simulated from now on, or has been, is another system.

        Raises:
            ReplacedError: with the name of one.

        """
        for name, path in self._paths.items():
            if (state := _state(path)) == self._states[name]:
                continue
            # A file that is only copied anew, with the same content, is the same one.
            if not state or file_sha256(path) != self.digests[name]:
                what = "was replaced" if state else "is gone"
                raise ReplacedError(
                    f"{path}: this file {what} after the worker had loaded the system, and is part of it; restore it, "
                    "and start the worker again"
                )
            self._states[name] = state


NO_FILES = DeclaredFiles({})


class WithSpec(SystemUnderTest):
    """A system under another specification, which says more of it: its code, and the files that it declares."""

    def __init__(self, system: SystemUnderTest, declared: DeclaredFiles = NO_FILES, **keys: Any) -> None:
        self._system, self._declared = system, declared
        self._spec = system.spec.model_copy(update=keys)

    @property
    def spec(self) -> SystemSpec:
        """The specification that says more."""
        return self._spec

    @property
    def step(self) -> float | None:
        """Seconds between two samples, where the system says so."""
        return getattr(self._system, "step", None)

    def rollout(self, x: Sequence[Any], **arguments: Any) -> Trajectory:
        """Simulate with the system.

        Raises:
            ReplacedError: a file that it declares is another one than at its construction.

        """
        self._declared.check()
        try:
            return self._system.rollout(x, **arguments)
        finally:
            # A file that is replaced meanwhile may make a rollout of neither system, or let it fail.
            self._declared.check()

    def rollouts(self, starts: Floats, **arguments: Any) -> object:
        """Simulate many with a vectorised system; raises as `rollout`."""
        self._declared.check()
        try:
            return cast(Vectorised, self._system).rollouts(starts, **arguments)
        finally:
            self._declared.check()

    def visual(self, trajectory: Trajectory) -> Visual | None:
        """Return the visual part that the system gives, if it gives any: a class need not derive from the port."""
        visual = getattr(self._system, "visual", None)
        return None if visual is None else visual(trajectory)

    def acted(self) -> Acts | None:
        """Return what a policy did in the last rollout of the system."""
        return acts_of(self._system)


def declared_files(patterns: object, folder: Path, base: Path | None = None) -> dict[str, Path]:
    """Return name -> path of the files that a system declares, relative to `folder`.

    A name is the path from `base`, by default the folder, and that of an absolute path is itself.

    Raises:
        DefinitionError: there is no such file, they cannot be read, or there is too much to read.

    """
    if isinstance(patterns, str) or not isinstance(patterns, Sequence):
        raise DefinitionError(f'files: {patterns!r} is no list of paths; write files=["policy.pt"]')
    found: dict[str, Path] = {}
    size = 0
    for pattern in patterns:
        if not isinstance(pattern, str | os.PathLike) or not os.fspath(pattern):
            raise DefinitionError(f'files: {pattern!r} is no path; write files=["policy.pt"]')
        for path in _matching(str(os.fspath(pattern)), folder):
            name = str(path) if os.path.isabs(pattern) else os.path.relpath(path, base or folder)
            size += 0 if name in found else path.stat().st_size
            found[name] = path
            if len(found) > MOST_FILES or size > MOST_BYTES:
                much = f"more than {MOST_FILES} files" if len(found) > MOST_FILES else f"{size / 1e9:.0f} GB"
                raise DefinitionError(
                    f"files: with {name} they are {much}, and at most {MOST_FILES} files of together "
                    f"{MOST_BYTES / 1e9:.0f} GB are hashed; declare the files alone that decide a rollout"
                )
    return dict(sorted(found.items()))


def _matching(pattern: str, folder: Path) -> Iterator[Path]:
    path = folder / pattern
    # A name with brackets is first of all a name.
    matches = (
        [path] if path.exists() else [folder / each for each in glob.glob(pattern, root_dir=folder, recursive=True)]
    )
    files = sorted({file for each in matches for file in (_below(each) if each.is_dir() else [each])})
    if not files:
        what = "there is no file below" if path.is_dir() else "there is no"
        raise DefinitionError(
            f"files: {what} {pattern!r} in {folder}; give the path of a file or a folder from there, or a pattern such "
            'as "tables/*.csv"'
        )
    for file in files:
        if not file.is_file():
            raise DefinitionError(f"files: {file} is no regular file; declare files that can be read again")
        yield file


def _below(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder and below, also behind links; of a circle of links each folder once."""
    seen = set()
    for place, folders, files in os.walk(folder, followlinks=True):
        seen.add(os.path.realpath(place))
        if DATABASE in files:  # a run directory grows while its campaign runs
            folders.clear()
            continue
        folders[:] = [
            each for each in folders if each not in CACHES and os.path.realpath(os.path.join(place, each)) not in seen
        ]
        yield from (Path(place, each) for each in files)


def _state(path: Path) -> State:
    """Return what changes with the content of a file; empty if it is gone. Of a link, that of its target."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def _digest(path: Path, name: str) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        raise DefinitionError(f"files: {name}: {error.strerror}; make it readable for every worker") from None
