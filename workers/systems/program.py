"""Any program as a system under test, described by the campaign file.

For every rollout it gets one line of JSON on its stdin, writes the samples into the file that the line names, and
answers with one line on its stdout: `{"done": true}` or `{"error": "TEXT"}`, best with the number of its request.
It may stay for the next line, or end.
"""

import contextlib
import json
import os
import secrets
import shlex
import shutil
import stat
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...schemas.errors import DefinitionError, SimulationError
from ...schemas.file.config import CampaignConfig
from ...schemas.file.space import ProgramLimits, SampleFormat, SystemChoice
from ...schemas.link.secret import VARIABLE
from ...schemas.number_text import number_in
from ...schemas.ranges import MAX_FILE_BYTES, SEED_BITS
from ...schemas.real_numbers import real_array
from ...schemas.system import OptionValue, SystemSpec, Variant, timed_columns
from ...schemas.trajectory.input_signal import InputSignal
from ...schemas.trajectory.trajectory import Trajectory
from .base import Progress, checked_disturbances, checked_options
from .declared import NO_FILES, DeclaredFiles, declared_files
from .described import DescribedSystem, check_horizon, name_of, option_of, space_parameters
from .place import Worker
from .running import Command, EndedError, RunningProgram

KEPT = ("PATH", "HOME", "LANG")
"""Variables that every program gets: no secret of the worker's is among them."""
GIGABYTE = 10**9
PREFIX = "perfbound-samples-"
"""Of the files of samples; the number of their worker follows."""
MAX_HORIZON = 86_400.0
SHOWN = 100
"""Characters of a wrong answer that are shown."""

ONE_LINE = 'its stdout takes one line a rollout, {"done": true} or {"error": "TEXT"}; print everything else to stderr'

Floats = NDArray[np.float64]


class ProgramSystem(DescribedSystem):
    """The program of a campaign file; it is started by the first rollout, and again after a failed one."""

    def __init__(
        self, spec: SystemSpec, choice: SystemChoice, folder: Path, declared: DeclaredFiles = NO_FILES
    ) -> None:
        assert choice.program is not None, "of a program"
        self.declared = declared
        super().__init__(spec)
        self._choice, self._folder = choice, folder
        # The script of an interpreter, else the program itself.
        self._program = next(reversed(spec.code))
        limits = choice.limits or ProgramLimits()
        self._command = Command(self._program, choice.program, int(limits.memory * GIGABYTE), limits.cpu)
        self._running: RunningProgram | None = None
        self._asked = self._number = 0
        _remove_stale()

    def rollout(
        self,
        x: Sequence[Any],
        *,
        variant: Variant,
        seed: int,
        horizon: float,
        options: Mapping[str, OptionValue],
        progress: Progress,
        disturbances: Mapping[str, float] | None = None,
    ) -> Trajectory:
        """Have the program simulate, and read its samples.

        Raises:
            SimulationError: an argument is outside the spec, or the program fails or writes what it should not.
            Cancelled: raised by `progress`.

        """
        chosen = checked_options(self._spec, x, variant=variant, horizon=horizon, options=options)
        # No folder of its own: a worker that is killed would leave it behind.
        name = f"{PREFIX}{os.getpid()}-{secrets.token_hex(8)}.{self._choice.samples or 'csv'}"
        path = Path(tempfile.gettempdir(), name)
        worker = Worker.own()
        if self._choice.empty_scratch:
            worker.emptied()
        names = (parameter.name for parameter in self._spec.parameters)
        self._number += 1
        line = {
            "request": self._number,
            "start": dict(zip(names, map(_start_value, x), strict=True)),
            "seed": seed,
            "variant": variant,
            "horizon": float(horizon),
            "options": chosen,
            "worker": {"number": worker.number, "scratch": str(worker.scratch), "port": worker.port},
            # Samples in a file: it needs no framing, every language writes one, and its size is checked first.
            "path": str(path),
        }
        if drawn := checked_disturbances(self._spec, disturbances):
            line["disturbances"] = drawn
        ticks = iter(range(1, 2**62))
        try:
            answer = self._answer(json.dumps(line).encode(), lambda: progress(next(ticks)))
            self._check(answer)
            return self._trajectory(path)
        except BaseException:  # also a cancelled one: what state it is in is not known
            self.end()
            raise
        finally:
            _remove(path)

    def end(self) -> None:
        """End the program, if it runs; the next rollout starts it anew."""
        if self._running is not None:
            self._running.kill()
            self._running = None

    def _answer(self, line: bytes, waiting: Callable[[], None]) -> bytes:
        if self._running is not None and self._asked:
            try:
                return self._ask(line, waiting)
            except EndedError as error:
                if not error.quietly:
                    raise
                self.end()  # it serves one rollout, or some, and ends
        if self._running is None:
            self._start()
        return self._ask(line, waiting)

    def _ask(self, line: bytes, waiting: Callable[[], None]) -> bytes:
        assert self._running is not None, "started by `_answer`"
        if stray := self._running.unasked:
            raise SimulationError(f"{self._program} wrote {_excerpt(stray)} after its answer; {ONE_LINE}")
        answer = self._running.ask(line, waiting)
        self._asked += 1
        return answer

    def _start(self) -> None:
        names = [*KEPT, *(self._choice.environment or ())]
        environment = {name: os.environ[name] for name in names if name in os.environ and name != VARIABLE}
        worker = Worker.own()
        environment |= {
            "PERFBOUND_WORKER": str(worker.number),
            "PERFBOUND_SCRATCH": str(worker.scratch),
            "PERFBOUND_PORT": str(worker.port),
        }
        self._running = RunningProgram(self._command, self._folder, environment)
        self._asked = 0

    def _check(self, answer: bytes) -> None:
        """Refuse every answer but `{"done": true}`, and one to another request."""
        try:
            found = json.loads(answer)
        except (ValueError, RecursionError):
            found = None
        # A program need not repeat the number; one that does answers nothing twice.
        number = found.pop("request", self._number) if isinstance(found, dict) else None
        if number is not None and number != self._number:
            raise SimulationError(
                f"{self._program} answered request {str(number)[:SHOWN]}, asked was {self._number}; answer each "
                "request once, with its own number"
            )
        if isinstance(found, dict) and list(found) == ["error"]:
            reason = str(found["error"])[:1000].strip() if found["error"] is not None else ""
            raise SimulationError(f"{self._program}: {reason or 'it failed, and gave no reason'}")
        if found != {"done": True}:
            raise SimulationError(f"{self._program} answered {_excerpt(answer)}; {ONE_LINE}")

    def _trajectory(self, path: Path) -> Trajectory:
        names, step = self._spec.own_columns, self._choice.step
        samples = read_samples(path, self._choice.samples or "csv", names if step is None else names[1:])
        if step is not None:
            # From the number of the sample, and not added up: a sum of steps drifts from the borders of windows.
            samples = np.column_stack([np.arange(len(samples)) * step, samples])
        try:
            return Trajectory(names, samples)
        except ValueError as error:
            raise SimulationError(f"{self._program}: {error}") from None


def read_samples(path: Path, form: SampleFormat, columns: Sequence[str]) -> Floats:
    """Return the samples in a file, shape (T, n) for n columns.

    `csv` is numbers with commas between them, below a header or not; `f64` are little-endian numbers of 8 bytes, sample
    after sample; `npy` is an array of numpy.

    Raises:
        SimulationError: there is no file, it is too large, or it contains something else.

    """
    try:
        found = path.stat()
    except OSError:
        raise SimulationError("the program said that it was done, and wrote no samples to its `path`") from None
    if not stat.S_ISREG(found.st_mode):
        raise SimulationError("the program made something else than a file at its `path`; write the samples there")
    if not 0 < (size := found.st_size) <= MAX_FILE_BYTES:
        raise SimulationError(f"the program wrote {size} bytes of samples; allowed are 1 to {MAX_FILE_BYTES}")
    try:
        samples = _READERS[form](path, columns)
    except (ValueError, EOFError, OSError) as error:
        raise SimulationError(f"the program's samples are not {form}: {error}") from None
    if samples.ndim != 2 or samples.shape[1] != len(columns) or not len(samples):
        listed, timeless = ", ".join(columns), samples.ndim == 2 and samples.shape[1] == len(columns) - 1
        missing = "; write the time of each sample first, or give its `step` in [system]" if timeless else ""
        raise SimulationError(f"the program wrote an array {samples.shape}, not samples of {listed}{missing}")
    return samples


def _read_csv(path: Path, columns: Sequence[str]) -> Floats:
    text = path.read_text(encoding="utf-8-sig")
    if not text.strip():
        raise ValueError("it has no numbers")
    if not text.endswith("\n"):
        raise ValueError(
            f"its last line, {text.splitlines()[-1][:SHOWN]!r}, has no end, and may be cut; end every line"
        )
    lines = text.splitlines()
    first = [cell.strip().strip('"') for cell in lines[0].split(",")]
    if not _is_number(first[0]):
        # Columns in another order would be other quantities.
        if first != list(columns):
            raise ValueError(f"the header is {','.join(first)[:SHOWN]}, the columns are {','.join(columns)}")
        lines = lines[1:]
    if not lines:
        raise ValueError("no line of numbers")
    try:
        return np.loadtxt(lines, delimiter=",", ndmin=2, dtype=np.float64, comments=None)
    except ValueError:  # in words of numpy, about arguments that nobody here can give; and Fortran's exponents
        return np.array([_numbers(line, columns) for line in lines if line.strip()], dtype=np.float64)


def _numbers(line: str, columns: Sequence[str]) -> list[float]:
    """Return the numbers of a line, one for each column."""
    cells = line.split(",")
    if len(cells) != len(columns):
        raise ValueError(f"a line is {line[:SHOWN]!r}, the columns are {','.join(columns)}; write one number for each")
    try:
        return [number_in(cell) for cell in cells]
    except ValueError as error:
        raise ValueError(f"{error}, in the line {line[:SHOWN]!r}") from None


def _read_f64(path: Path, columns: Sequence[str]) -> Floats:
    numbers, size, width = np.fromfile(path, dtype="<f8"), path.stat().st_size, len(columns)
    if size % (8 * width):
        raise ValueError(
            f"{size} bytes are no samples of {width} numbers of 8 bytes, {','.join(columns)}; write one sample "
            "after the other, or name every column under `columns`"
        )
    return numbers.reshape(-1, width)


def _read_npy(path: Path, _columns: Sequence[str]) -> Floats:
    array = np.load(path, allow_pickle=False)
    try:
        return real_array(array)
    except ValueError as error:
        raise ValueError(f"the array {error}") from None


_READERS: dict[SampleFormat, Callable[[Path, Sequence[str]], Floats]] = {
    "csv": _read_csv,
    "f64": _read_f64,
    "npy": _read_npy,
}


def _is_number(cell: str) -> bool:
    try:
        number_in(cell)
    except ValueError:
        return False
    return True


def _excerpt(text: bytes) -> str:
    return repr(text[:SHOWN].decode(errors="backslashreplace"))


def load_program(file: Path, config: CampaignConfig) -> ProgramSystem:
    """Return the program of a campaign, read from `file`.

    Raises:
        DefinitionError: the program is not there, or a name in the file is none.

    """
    choice, folder = config.system, file.absolute().parent
    assert choice.program is not None, "of a program"
    assert choice.columns is not None, "required by a program"
    named = _named_files(choice.program, folder, f"{file}: system.program")
    if config.horizon and choice.step is not None:
        check_horizon(config.horizon, choice.step, str(file))
    try:
        declared = declared_files(choice.files or (), folder)
        # The program itself is last. It is started anew after a failed rollout, or after each.
        others = {name: path for name, path in declared.items() if path not in named.values()}
        files = DeclaredFiles(others | named)
    except DefinitionError as error:
        raise DefinitionError(f"{file}: system.{error}") from None
    variants: tuple[Variant, ...] = choice.variants or ("nominal",)
    laws = tuple(law.named(name, law.unit) for name, law in config.disturbances.items())
    own = choice.reported or {}
    chance = bool(laws or own) if choice.noisy is None else choice.noisy
    noisy = (variants if chance else ()) if isinstance(chance, bool) else chance
    try:
        spec = SystemSpec(
            name=name_of(next(reversed(named)), "program"),
            doc=f"the program {shlex.join(choice.program)}",
            parameters=tuple(space_parameters(config)),
            columns=timed_columns(choice.columns, choice.after_end),
            options=tuple(option_of(name, value) for name, value in sorted(choice.options.items())),
            variants=variants,
            noisy=tuple(each for each in variants if each in noisy),
            timed=choice.step is not None,
            max_horizon=MAX_HORIZON,
            default_horizon=config.horizon,
            disturbances=laws,
            residual=choice.residual is not False,
            reported=tuple(law.named(name, law.unit or choice.columns.get(name, "")) for name, law in own.items()),
            seed_bits=choice.seed_bits or SEED_BITS,
            code=files.digests,
            stamps=choice.stamps or "exact",
            after_end=choice.after_end,
        )
    except DefinitionError as error:
        raise DefinitionError(f"{file}: system: {error}") from None
    return ProgramSystem(spec, choice, folder, files)


def _start_value(value: Any) -> Any:
    """Return the value of a parameter in the line of a rollout."""
    return value.described if isinstance(value, InputSignal) else float(value)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _remove_stale() -> None:
    """Remove the samples of workers that were killed in the middle of a rollout."""
    for file in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        number = file.name.removeprefix(PREFIX).partition("-")[0]
        if number.isdigit() and not Path("/proc", number).exists():
            with contextlib.suppress(OSError):  # of another user
                file.unlink()


def _named_files(command: Sequence[str], folder: Path, where: str) -> dict[str, Path]:
    """Return the program, and the files beside it that its arguments name.

    The last one is the file that simulates: a script behind its interpreter, or the program itself.
    """
    program = str(folder / command[0]) if "/" in command[0] else shutil.which(command[0])
    if program is None or not Path(program).is_file():
        raise DefinitionError(
            f"{where}: there is no program {command[0]!r}; build it, or give its path from the folder of this file"
        )
    if not os.access(program, os.X_OK):
        raise DefinitionError(f"{where}: {command[0]} is not executable; chmod +x {program}")
    return {command[0]: Path(program)} | {each: folder / each for each in command[1:] if (folder / each).is_file()}
