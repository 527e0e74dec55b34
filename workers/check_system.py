"""The measurements of `check-system`: rollouts one after the other in this process, each with what it leaves behind."""

import ctypes
import gc
import hashlib
import os
import pickle
import random
import stat
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from ..schemas.descendants import descendants
from ..schemas.errors import PerfboundError, SimulationError
from ..schemas.instants import stamps, uncovered
from ..schemas.link.messages import MAX_RESULT
from ..schemas.places import of_perfbound, own_place
from ..schemas.system_check import Measured, SampleTimes, Trial
from ..schemas.trajectory.trajectory import Trajectory, decode
from .check_batch import compared
from .faults import NOT_OF_SYSTEMS, reason
from .opened import Opened
from .simulate import requested_system, run_request_on
from .systems import load_system
from .systems.base import acts_of
from .systems.place import PREFIX as SCRATCH

STDOUT = 1
LIBC = ctypes.CDLL(None)
TEMPORARY = "$TMPDIR"
MARK = stat.S_IRGRP | stat.S_IWGRP
"""Rights that new files of a rollout do not give to the group. No other program has files that only others may read."""
ENDED = ("Z", "X")
"""States of a process that nobody has waited for."""
MOST, REASON = 50, 500
"""Most names in a list, and characters of an error, that are kept."""
ROUND_OFF = 1e-9
"""Of a sample time, in s."""
STATES: dict[str, Callable[[], object]] = {
    "random": random.getstate,
    "numpy.random": lambda: np.random.get_state(legacy=False),  # noqa: NPY002  (the global state is what is watched)
}


def measure_trials(
    trials: Sequence[Trial], answers: TextIO, begin: int, *, folder: str, opened: Opened, keep: str | None = None
) -> None:
    """Run `trials` in their order, and write a line of JSON after loading and after each of them.

    They begin when the other end of the pipe `begin` is closed.

    New files are looked for in `folder`, where the system writes those without a path. The folder `keep` gets the file
    of each rollout, by its number.
    """
    gc.freeze()  # what is loaded now need not be searched for garbage after every rollout
    surroundings = _Surroundings.now(folder)
    started = threading.enumerate()
    _answer(answers, Measured(printed=_printed(), memory=_memory(), peak=_peak(), tasks=_tasks()))
    os.read(begin, 1)
    for number, trial in enumerate(trials):
        time.sleep(trial.pause)
        if trial.reseed is not None:
            random.seed(trial.reseed)
            np.random.seed(trial.reseed)  # noqa: NPY002  (the one that a system may use by mistake)
        before = _Surroundings.now(folder, files=surroundings.files)
        found = _measured(trial, None if keep is None else Path(keep, str(number)))
        after = _Surroundings.now(folder)
        requested = load_system(trial.request.system)
        files = own_entries(folder, sorted(after.files - surroundings.files), opened)[:MOST]
        changes = {
            "printed": after.printed - before.printed,
            "reseeded": tuple(name for name in STATES if after.random[name] != before.random[name]),
            "files": files,
            "threads": tuple(each.name for each in threading.enumerate() if each not in started)[:MOST],
            "processes": _processes(),
            "tasks": _tasks(),
            "memory": _memory(),
            "peak": _peak(),
            # The search takes some time.
            "packages": opened.packages(requested.spec)[:MOST] if number == len(trials) - 1 else (),
            "undeclared": opened.undeclared(requested.spec)[:MOST],
        }
        surroundings = after
        _answer(answers, found.model_copy(update=changes))


@dataclass(frozen=True)
class _Surroundings:
    """What a rollout must leave alone."""

    printed: int
    random: dict[str, str]
    files: frozenset[str]

    @classmethod
    def now(cls, folder: str, files: frozenset[str] | None = None) -> "_Surroundings":
        states = {name: hashlib.sha256(pickle.dumps(state())).hexdigest() for name, state in STATES.items()}
        return cls(_printed(), states, _entries(folder) if files is None else files)


def mark_files() -> None:
    """Have the kernel mark the files of this process and of all that it starts, see `MARK`."""
    os.umask(os.umask(MARK) | MARK)


def own_entries(folder: str, names: Sequence[str], opened: Opened) -> tuple[str, ...]:
    """Return which new entries this process has made, or one that it has started; another program may make some, too.

    The temporary directory is that of the check alone. Python reports what it makes itself. What a library in C or
    another program makes has the mark, unless the user lets nobody read new files: these are not found then.
    """
    made = opened.made(folder, names)
    return tuple(name for name in names if name.startswith(TEMPORARY) or name in made or _is_marked(Path(folder, name)))


def _is_marked(path: Path) -> bool:
    with suppress(OSError):
        return path.lstat().st_mode & (MARK | stat.S_IROTH) == stat.S_IROTH
    return False


def _measured(trial: Trial, kept: Path | None) -> Measured:
    request = trial.request
    started = time.perf_counter()
    try:
        if trial.batch is not None:
            found = compared(requested_system(request), trial.batch)
            return Measured(differences=found.differences, seconds=found.seconds)
        system = requested_system(request)
        payload = run_request_on(system, request, lambda _: None)
        seconds = time.perf_counter() - started
        if len(payload) > MAX_RESULT:
            raise SimulationError(f"the trajectory's file has {len(payload)} bytes, more than the {MAX_RESULT} allowed")
        trajectory = decode(payload)
        if kept is not None:
            kept.write_bytes(payload)
    except NOT_OF_SYSTEMS:
        raise
    except BaseException as error:  # noqa: BLE001  (any: the judge is the orchestrator)
        return _failed(error, time.perf_counter() - started)
    t = trajectory.samples[:, 0]
    return Measured(
        file_sha256=hashlib.sha256(payload).hexdigest(),
        samples_sha256=_samples_sha256(trajectory.samples),
        beginning_sha256=_samples_sha256(trajectory.samples[t <= trial.beginning + ROUND_OFF]),
        file_bytes=len(payload),
        grid=_grid(trajectory, request.horizon),
        acts=acts_of(system),
        reported=tuple(
            float(trajectory.samples[0, trajectory.columns.index(each.name)]) for each in system.spec.reported
        ),
        seconds=seconds,
    )


def _failed(error: BaseException, seconds: float) -> Measured:
    known = isinstance(error, PerfboundError)
    frames = [(each.filename, each.lineno or 0) for each in traceback.extract_tb(error.__traceback__)]
    text = str(error).partition("\n")[0] if known else ""
    printable = (text or reason(error).partition("\n")[0])[:REASON].encode(errors="backslashreplace").decode()
    raised = bool(frames) and not of_perfbound(frames[-1][0])
    return Measured(error=printable, raised=raised, place=own_place(frames), seconds=seconds)


def _grid(trajectory: Trajectory, horizon: float) -> SampleTimes:
    t = trajectory.samples[:, 0]
    steps = np.diff(t) if len(t) > 1 else np.zeros(1)
    steps = steps[steps > 0.0] if steps.any() else steps  # two equal stamps are a jump, and no step
    return SampleTimes(
        samples=len(t),
        first=float(t[0]),
        last=float(t[-1]),
        least_step=float((steps[:-1] if len(steps) > 1 else steps).min()),
        greatest_step=float(steps.max()),
        stamps=stamps(t),
        uncovered=uncovered(t, horizon) or "",
    )


def _samples_sha256(samples: np.ndarray) -> str:
    return hashlib.sha256(samples.tobytes()).hexdigest()


def _printed() -> int:
    """Return the bytes on stdout so far; 0 where it is no file."""
    # A system may have closed or replaced it.
    with suppress(OSError, ValueError, AttributeError):
        sys.stdout.flush()
        LIBC.fflush(None)  # a library in C has a buffer of its own
        found = os.fstat(STDOUT)
        return found.st_size if stat.S_ISREG(found.st_mode) else 0
    return 0


def _entries(folder: str) -> frozenset[str]:
    """Return the entries of the working and of the temporary directory, without hidden ones and caches of Python."""
    here = {each for each in os.listdir(folder) if not each.startswith((".", "__pycache__"))}
    temporary = {each for each in os.listdir(tempfile.gettempdir()) if not each.startswith(SCRATCH)}
    return frozenset(here | {f"{TEMPORARY}/{each}" for each in temporary})


def _memory() -> int:
    gc.collect()  # garbage that Python has not collected yet is no growth
    return sum(_of_status(pid, "VmRSS:") for pid in _family())


def _peak() -> int:
    # Not ru_maxrss, which begins with the size of the process that started this one.
    return sum(_of_status(pid, "VmHWM:") for pid in _family())


def _of_status(pid: int, key: str) -> int:
    """Return a number of bytes from the status of a process; 0 if it has ended."""
    with suppress(OSError, IndexError):
        return int(Path(f"/proc/{pid}/status").read_text().partition(key)[2].split()[0]) * 1024
    return 0


def _family() -> list[int]:
    """Return this process and all that it started, of which a system may consist."""
    return [os.getpid(), *descendants(os.getpid())]


def _processes() -> tuple[str, ...]:
    """Return the names of the processes that a rollout has left; a program itself may wait for the next one."""
    running = sys.modules.get(f"{__package__}.systems.running")
    own = set(running.pids()) if running is not None else set()
    names = [_name_of(pid) for pid in descendants(os.getpid()) if pid not in own]
    return tuple(name for name in names if name)[:MOST]


def _name_of(pid: int) -> str:
    """Return the name of a process; empty if it has ended."""
    with suppress(OSError):
        name, _, rest = Path(f"/proc/{pid}/stat").read_text().partition("(")[2].rpartition(")")
        return "" if rest.split()[0] in ENDED else name
    return ""


def _tasks() -> int:
    return len(os.listdir("/proc/self/task"))


def _answer(answers: TextIO, measured: Measured) -> None:
    answers.write(measured.model_dump_json() + "\n")
    answers.flush()
