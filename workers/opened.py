"""The files that rollouts read, for `check-system` and `init`: what is opened while a system loads and simulates.

Two views that complete each other. The audit hook reports what Python opens, wherever it is. The operating system
(inotify) reports what libraries in C and other programs open, in the folder of the system and below; it names no
process, so that a file which some other program opens at that time is among them.
"""

import ctypes
import os
import struct
import sys
import tempfile
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from ..schemas.errors import PerfboundError
from ..schemas.file.reader import load_description
from ..schemas.places import PACKAGES, of_perfbound
from ..schemas.system import SystemSpec
from .systems.elsewhere import file_of, is_code, loaded_elsewhere
from .systems.fingerprint import required_by, versions_of

IN_MODIFY, IN_OPEN, IN_MOVED_TO, IN_CREATE, IN_ISDIR = 0x2, 0x20, 0x80, 0x100, 0x4000_0000
WRITTEN = IN_MODIFY | IN_MOVED_TO | IN_CREATE
EVENT = struct.Struct("iIII")
BUFFER = 1 << 20
MOST_FOLDERS = 2_000
"""Folders that are watched, those near the system first: kernels allow 8192 or more."""
MADE = os.O_CREAT | os.O_TRUNC
"""Flags that open a file to write it."""
PLACES = {"open": 0, "sqlite3.connect": 0, "ctypes.dlopen": 0, "subprocess.Popen": 0}
"""Audit events with a file, and the number of the argument that names it."""
MAKING = {"os.mkdir": 0, "os.rename": 1, "os.link": 1, "os.symlink": 1}
"""Audit events that make an entry of a folder, and the number of the argument that names it."""
OF_THE_MACHINE = ("/proc", "/sys", "/dev", "/etc", "/usr", "/lib", "/lib64", "/bin", "/sbin", "/run")
OF_TOOLS = frozenset({"__pycache__", "node_modules", ".git", ".config", "matplotlib", "fontconfig"}) | PACKAGES
"""Folders of installed software, of its settings and its caches."""
METADATA = (".dist-info", ".egg-info")


class Opened:
    """The files that were opened since the construction: by this process, and below `folder` by every one."""

    def __init__(self, folder: Path | None, base: Path | None = None) -> None:
        folder, base = (each and Path(os.path.abspath(each)) for each in (folder, base or folder))
        self._folder, self._base = folder, base
        self._names: dict[str, str] = {}
        """Real path -> path by which it was opened."""
        self._ignored: set[str] = set()
        self._made: set[str] = set()
        """Paths that this process has made itself."""
        self._no_data: set[str] = set()
        """Real paths that every rollout may open again, and that were looked at once."""
        self._modules = self._looked_at = frozenset(sys.modules)
        self._notices = _Notices(folder) if folder is not None else None
        self._listens = True
        sys.addaudithook(self._heard)

    @classmethod
    def of(cls, references: Sequence[str], name: str = "") -> "Opened":
        """Begin before a system is loaded: `FILE.py:NAME`, a campaign file, or the installed one `name`."""
        if not references:
            return cls(*_folders_of_installed(name))
        reference = references[0]
        file = Path(reference if reference.endswith(".toml") else reference.rpartition(":")[0]).absolute()
        description = None
        if reference.endswith(".toml"):
            with suppress(PerfboundError):  # the loader says so
                description = load_description(file).system
        if description is not None and description.python is not None:
            watched = cls((file.parent / description.python.rpartition(":")[0]).parent)
        else:
            watched = cls(file.parent)
        if reference.endswith(".toml"):
            with suppress(PerfboundError):
                load_description(file)
            watched.ignore()
        return watched

    def ignore(self) -> None:
        """Ignore the files that were opened until now: perfbound has read them."""
        self._collect()
        self._ignored.update(self._names)

    def undeclared(self, spec: SystemSpec) -> tuple[str, ...]:
        """Return the files so far that are read and no part of the system, as it can declare them, sorted."""
        self._collect()
        self._listens = False
        base = self._base or Path()
        own = {os.path.realpath(file_of(name) or base / name) for name in spec.code} | self._ignored
        # Python has read some from its cache alone.
        for module in loaded_elsewhere(self._looked_at).values():
            self._add(str(module.file), written=False)
        self._looked_at = frozenset(sys.modules)
        others = {real for real, path in self._names.items() if real in own or not self._is_data(Path(path))}
        # Those that are gone are forgotten: every rollout may have others.
        self._ignored = set(filter(os.path.exists, self._ignored))
        self._no_data |= {real for real in others if os.path.exists(real)}
        self._names = {real: path for real, path in self._names.items() if real not in others}
        found = list(self._names.values())
        self._listens = True
        return tuple(sorted(map(self._name, found)))

    def made(self, folder: str, names: Iterable[str]) -> tuple[str, ...]:
        """Return which new entries of a folder this process has made; the others may be of any program."""
        return tuple(name for name in names if os.path.realpath(os.path.join(folder, name)) in self._made)

    def packages(self, spec: SystemSpec) -> tuple[str, ...]:
        """Return the distributions, with versions, that were imported since and are no part of the system."""
        tops = {name.partition(".")[0] for name in sys.modules.keys() - self._modules}
        found = versions_of((), {name for name in tops if name in sys.modules})
        known = spec.versions.keys() | required_by("perfbound").keys()
        return tuple(f"{name} {number}" for name, number in found.items() if name not in known)

    def _name(self, path: str) -> str:
        # Near ones by a relative path, which another machine has as well.
        near = self._folder is not None and Path(path).is_relative_to(self._folder.parent)
        return os.path.relpath(path, self._folder) if near else path

    def _heard(self, event: str, arguments: tuple[object, ...]) -> None:
        number = PLACES.get(event, MAKING.get(event))
        if number is None or not self._listens or len(arguments) <= number:
            return
        place = arguments[number]
        if event == "sqlite3.connect" and isinstance(place, str):
            place = place.removeprefix("file:").partition("?")[0]
        if not isinstance(place, str | bytes | os.PathLike):
            return
        with suppress(OSError, ValueError, TypeError):
            path = os.path.abspath(os.fsdecode(place))
            flags = arguments[2] if event == "open" and len(arguments) > 2 else 0
            written = event in MAKING or (isinstance(flags, int) and bool(flags & MADE))
            if written:
                self._made.add(os.path.realpath(path))
            self._add(path, written=written)

    def _add(self, path: str, *, written: bool) -> None:
        real = os.path.realpath(path)
        if written:
            self._ignored.add(real)
        elif real not in self._no_data:
            self._names.setdefault(real, path)

    def _collect(self) -> None:
        for path, mask in self._notices.read() if self._notices is not None else ():
            self._add(path, written=bool(mask & WRITTEN))

    def _is_data(self, path: Path) -> bool:
        """Whether a file is none of the machine, of Python, of installed software, of perfbound, or temporary."""
        if of_perfbound(str(path)) or not path.is_file():
            return False
        below = self._folder is not None and path.is_relative_to(self._folder)
        parts = path.relative_to(self._folder).parts if below and self._folder is not None else path.parts
        if OF_TOOLS.intersection(parts) or any(each.endswith(METADATA) for each in parts):
            return False
        # A system may lie in such a folder itself, and an environment in that of a system.
        prefixes = {Path(sys.prefix), Path(sys.base_prefix), Path(tempfile.gettempdir())}
        others = [each for each in prefixes if not below or each.is_relative_to(self._folder or "/")]
        others += [] if below else [Path(each) for each in OF_THE_MACHINE]
        return is_code(path) and not any(path.is_relative_to(each) for each in others)


class _Notices:
    """What the operating system reports of the files of a folder and below, those behind links included."""

    def __init__(self, folder: Path) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._descriptor: int = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        self._places: dict[int, str] = {}
        if self._descriptor >= 0:
            for place in _watched(folder):
                number = self._libc.inotify_add_watch(self._descriptor, os.fsencode(place), IN_OPEN | WRITTEN)
                # A folder and a link to it have one number, and the first name is the shorter one.
                self._places.setdefault(number, str(place))

    def read(self) -> Iterator[tuple[str, int]]:
        """Yield path and kind of what happened since the last call."""
        while self._descriptor >= 0:
            try:
                data = os.read(self._descriptor, BUFFER)
            except BlockingIOError:
                return
            at = 0
            while at < len(data):
                number, mask, _, length = EVENT.unpack_from(data, at)
                name = data[at + EVENT.size : at + EVENT.size + length].rstrip(b"\0")
                at += EVENT.size + length
                if number in self._places and not mask & IN_ISDIR:
                    yield os.path.join(self._places[number], os.fsdecode(name)).rstrip("/"), mask


def _watched(folder: Path) -> Iterator[Path]:
    """Yield a folder and those below it, the near ones first, and the links to files in them."""
    waiting, seen = deque([folder]), set[str]()
    while waiting and len(seen) < MOST_FOLDERS:
        place = waiting.popleft()
        if (real := os.path.realpath(place)) in seen:
            continue
        seen.add(real)
        with suppress(OSError):
            entries = sorted(os.scandir(place), key=lambda each: each.name)
            # Environments and run directories have many files, and none of a system.
            if place != folder and {"campaign.db", "pyvenv.cfg"} & {each.name for each in entries}:
                continue
            yield place
            waiting += (Path(each.path) for each in entries if each.is_dir() and each.name not in OF_TOOLS)
            # A link is opened where it leads to.
            yield from (Path(each.path) for each in entries if each.is_symlink() and each.is_file())


def _folders_of_installed(name: str) -> tuple[Path | None, Path | None]:
    from .systems import module_of  # noqa: PLC0415

    found = find_spec(module) if (module := module_of(name)) else None
    if found is None or found.origin is None or of_perfbound(found.origin):
        return None, None
    folder = Path(found.origin).parent
    return folder, folder if found.submodule_search_locations is None else folder.parent
