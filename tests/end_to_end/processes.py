"""Real `perfbound` processes for tests: started here, and ended here by their pid."""

import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from perfbound.workers.systems.segway import bullet
from tests.campaigns import FOLDER
from tests.patience import PATIENCE

BIN = Path(sys.executable).parent


@dataclass
class Ended:
    """A process that has ended."""

    code: int
    out: str
    err: str

    @property
    def last_line(self) -> str:
        """The last line on stderr."""
        assert "Traceback" not in self.err, self.err
        return self.err.splitlines()[-1]

    @property
    def fault(self) -> str:
        """The one line on stderr of a run that could not start."""
        assert "Traceback" not in self.err, self.err
        assert self.err.count("\n") == 1, self.err
        assert self.err.endswith("\n")
        return self.err.strip()


@dataclass
class Process:
    """A process in a session of its own, whose output goes to files."""

    popen: subprocess.Popen[bytes]
    folder: Path

    @property
    def pid(self) -> int:
        return self.popen.pid

    @property
    def running(self) -> bool:
        return self.popen.poll() is None

    @property
    def err(self) -> str:
        return (self.folder / "err").read_text()

    def signal_group(self, number: int) -> None:
        """Send what a terminal sends to everything in the foreground."""
        os.killpg(self.pid, number)

    def wait(self) -> Ended:
        code = self.popen.wait(PATIENCE)
        return Ended(code, (self.folder / "out").read_text(), self.err)

    def children(self) -> list[psutil.Process]:
        return psutil.Process(self.pid).children(recursive=True)

    def children_with(self, word: str) -> list[psutil.Process]:
        """Return the children with the argument `word`, without the guardians of others."""
        found = [each for each in self.children() if word in arguments(each)]
        parents = {each.ppid() for each in found}
        return [each for each in found if each.pid not in parents]

    def end(self) -> None:
        """Kill the process and what it started."""
        try:
            family = [*self.children(), psutil.Process(self.pid)]
        except psutil.NoSuchProcess:
            family = []
        for each in family:
            try:
                each.kill()
            except psutil.NoSuchProcess:
                continue
        self.popen.wait()


@dataclass
class Processes:
    """Starts processes in `folder`, and ends all of them."""

    folder: Path
    started: list[Process] = field(default_factory=list)

    def start(self, program: str, *arguments: str | Path, prefix: Sequence[str] = (), **environment: str) -> Process:
        """Start a program of the virtual environment; `prefix` is a command that turns into it (`ip netns exec`)."""
        logs = self.folder / f"log-{len(self.started)}"
        logs.mkdir()
        with (logs / "out").open("wb") as out, (logs / "err").open("wb") as err:
            popen = subprocess.Popen(
                [*prefix, BIN / program, *arguments],
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                env={**os.environ, **environment},
                start_new_session=True,
            )
        process = Process(popen, logs)
        self.started.append(process)
        return process

    def run(self, program: str, *arguments: str | Path, **environment: str) -> Ended:
        return self.start(program, *arguments, **environment).wait()

    def end(self) -> None:
        for process in self.started:
            process.end()


@contextmanager
def processes(folder: Path) -> Iterator[Processes]:
    """Start processes that do not outlive this block."""
    folder.mkdir(exist_ok=True)
    started = Processes(folder)
    try:
        yield started
    finally:
        started.end()


def write_campaign(path: Path, **changes: str) -> Path:
    """Write the paper's Segway campaign, small and without recheck; `changes` are lines of its first table in TOML.

    Raises:
        UnknownSystemError: PyBullet is not installed; nobody then waits for a campaign that cannot start.

    """
    bullet.providers()
    text = (FOLDER / "segway-paper.toml").read_text()
    for key, value in {"resolution": "7", "max_tests": "8", "horizon": "20.0", "recheck": "0", **changes}.items():
        lines = [line for line in text.splitlines() if line.startswith(f"{key} = ")]
        text = text.replace(lines[0], f"{key} = {value}", 1) if lines else f"{key} = {value}\n{text}"
    path.write_text(text)
    return path


ROLLOUTS = 24
"""Of the small campaign: 8 nominal ones, and 8 pairs for the gap."""


def arguments(process: psutil.Process) -> list[str]:
    """Return the command line of a process; none, if it ended between its listing and this look at it."""
    with suppress(psutil.Error):
        return process.cmdline()
    return []


def wait_for(condition: Callable[[], object], patience: float = PATIENCE) -> None:
    """Wait until `condition()` is true.

    Raises:
        TimeoutError: it never was.

    """
    deadline = time.monotonic() + patience
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError("the condition did not come true")
        time.sleep(0.005)


def query(directory: Path, text: str) -> list[tuple[object, ...]]:
    """Ask the database of a run; nothing, where there is none yet."""
    path = directory / "campaign.db"
    if not path.exists():
        return []
    with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=PATIENCE)) as connection:
        return connection.execute(text).fetchall()


def recorded(directory: Path) -> int:
    """Return the number of rollouts in the database."""
    return len(query(directory, "SELECT seq FROM rollouts"))


def under_way(directory: Path) -> list[tuple[object, ...]]:
    """Return (rollout, attempt, worker, pid) of the attempts that have not ended, by an outcome or a comparison."""
    ended = "SELECT rollout, attempt FROM outcomes"
    if query(directory, "SELECT name FROM sqlite_master WHERE name = 'opinions'"):
        ended += " UNION SELECT rollout, attempt FROM opinions"
    return query(
        directory, f"SELECT rollout, attempt, worker, pid FROM attempts WHERE (rollout, attempt) NOT IN ({ended})"
    )


def catch(directory: Path, when: Callable[[], bool]) -> tuple[str, psutil.Process]:
    """Stop a worker in the middle of a rollout, on its first attempt; return the rollout and the stopped process."""
    while True:
        wait_for(lambda: when() and under_way(directory))
        # Not the first of a campaign or of a gap pair: without a known time grid it is simulated again in any case.
        if not (busy := [each for each in under_way(directory) if each[1] == 1 and "gap.0." not in str(each[0])]):
            continue
        rollout, _, _, pid = busy[0]
        assert isinstance(pid, int)
        worker, count = psutil.Process(pid), recorded(directory)
        worker.suspend()
        # Its result may be on its way already: two later ones of the other worker would come behind it.
        wait_for(lambda name=str(rollout), least=count + 2: attempts(directory, name) or recorded(directory) >= least)  # type: ignore[misc]
        if not attempts(directory, str(rollout)):
            return str(rollout), worker
        worker.resume()


def attempts(directory: Path, rollout: str) -> list[tuple[object, ...]]:
    return query(directory, f"SELECT attempt, outcome FROM outcomes WHERE rollout = '{rollout}' ORDER BY attempt")


def of_run(directory: Path) -> list[psutil.Process]:
    """Return the processes that belong to a run: their command line contains its id or its directory."""
    marks = [str(directory), *(str(row[0]) for row in query(directory, "SELECT run FROM campaign"))]
    found = []
    for process in psutil.process_iter(["cmdline", "status"]):
        line = " ".join(process.info["cmdline"] or ())
        if any(mark in line for mark in marks) and process.info["status"] != psutil.STATUS_ZOMBIE:
            found.append(process)
    return found


def contents(directory: Path) -> dict[str, tuple[bytes, int]]:
    """Return bytes and time of modification of every file."""
    files = (path for path in sorted(directory.rglob("*")) if path.is_file())
    return {str(path.relative_to(directory)): (path.read_bytes(), path.stat().st_mtime_ns) for path in files}
