"""One campaign to which faults are done: its processes, what was done when, and what is true of it afterwards."""

import os
import random
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from perfbound.orchestrator.store import lock
from tests.end_to_end.processes import Ended, Process, Processes, arguments, recorded, wait_for
from tests.faults.subjects import Subject
from tests.patience import PATIENCE
from tests.sharing import free_port

MARK = "PERFBOUND_FAULTS"
"""Every process of a scene inherits this variable, whose value is the scene's folder."""


class EndedEarly(AssertionError):
    """A campaign ended without a certificate where it had to continue."""


@dataclass
class Scene:
    """A campaign in `folder`, with local workers or (`endpoint`) remote ones."""

    subject: Subject
    folder: Path
    chance: random.Random
    remote: bool = False
    done: list[str] = field(default_factory=list)
    """Actions, each with its time."""
    injected: int = 0
    environment: dict[str, str] = field(default_factory=dict)
    prefix: Sequence[str] = ()
    """Command before that of the orchestrator."""
    worker_prefix: Sequence[str] = ()
    host: str = "127.0.0.1"
    router: str = ""
    """Endpoint of the router that orchestrator and workers connect to, if there is one."""
    resumes: int = 0
    patience: float = PATIENCE
    """Seconds in which what shall end by itself does so."""
    irreproducible: bool = False
    """Whether a rollout fails in the system and is recorded afterwards."""
    misled: bool = False
    """Whether false results were recorded, so that the campaign proposes other starts than the calm one."""
    undo: list[Callable[[], None]] = field(default_factory=list)
    """Actions that remove changes of the machine: mounts, network namespaces."""

    def __post_init__(self) -> None:
        self.began = time.monotonic()
        self.folder.mkdir(parents=True)
        self.directory = self.folder / "run"
        self.processes = Processes(self.folder)
        self.listening = f"tcp/{self.host}:{free_port()}"
        self.fleet: list[Process] = []
        self.environment |= {MARK: str(self.folder), "PYTHONPATH": self.subject.path}

    # Faults and actions

    def did(self, what: str, *, fault: bool = True) -> None:
        """Write down what was done; a fault is counted."""
        self.done.append(f"{time.monotonic() - self.began:.1f} {what}")
        self.injected += fault

    def start(self, *, workers: int = 2) -> None:
        """Start the campaign with its workers."""
        if self.remote:
            self._orchestrate("orchestrate", self.subject.campaign, "--out", self.directory)
            for _ in range(workers):
                self.join()
        else:
            options = ("--out", self.directory, "--workers", str(workers))
            self._orchestrator("run", self.subject.campaign, *options)

    def resume(self, *, workers: int = 2) -> None:
        """Start an orchestrator that resumes the campaign."""
        self.resumes += 1
        if self.remote:
            self._orchestrate("resume", self.directory, "--workers", "0")
        else:
            self._orchestrator("resume", self.directory, "--workers", str(workers))

    def _orchestrate(self, *arguments: str | Path) -> None:
        guard = () if self.host == "127.0.0.1" else ("--insecure",)
        way = ("--connect", self.router) if self.router else ("--listen", self.listening)
        self._orchestrator(*arguments, *way, *guard)

    def _orchestrator(self, *arguments: str | Path) -> None:
        self.orchestrator = self.processes.start("perfbound", *arguments, prefix=self.prefix, **self.environment)

    def join(self, name: str = "", **environment: str) -> None:
        """Start one more remote worker."""
        endpoint = self.router or self.listening
        options = ("--connect", endpoint, "--name", name or f"remote-{len(self.fleet)}")
        worker = self.processes.start(
            "perfbound-worker", *options, prefix=self.worker_prefix, **self.environment, **environment
        )
        self.fleet.append(worker)

    def workers(self) -> list[psutil.Process]:
        """Return the workers that live."""
        if self.remote:
            return [psutil.Process(each.pid) for each in self.fleet if each.running]
        if not self.orchestrator.running:
            return []
        with suppress(psutil.NoSuchProcess):
            return self.orchestrator.children_with("serve")
        return []

    def reach(self, count: int) -> bool:
        """Wait until `count` rollouts are recorded; False if the campaign has ended before."""
        wait_for(lambda: recorded(self.directory) >= count or not self.orchestrator.running)
        return self.orchestrator.running

    def moments(self, number: int, share: float = 0.7) -> list[int]:
        """Draw numbers of recorded rollouts, in the first `share` of the campaign, at which to act."""
        return sorted(self.chance.sample(range(1, int(self.subject.rollouts * share)), number))

    def pause(self, low: float = 0.0, high: float = 0.1) -> float:
        """Wait for a random time; return it."""
        seconds = self.chance.uniform(low, high)
        time.sleep(seconds)
        return seconds

    def kill_worker(self) -> None:
        """kill -9 of a random worker; a remote one is followed by another, as under a supervisor."""
        found = self.workers()
        if not found:
            return
        worker = self.chance.choice(found)
        with suppress(psutil.NoSuchProcess):
            worker.kill()
            self.did(f"kill worker {worker.pid}")
        if self.remote:
            self.join()

    def kill_orchestrator(self) -> None:
        """kill -9 of the orchestrator; counted if it was in mid-run."""
        self.orchestrator.popen.kill()
        self.orchestrator.wait()
        count = recorded(self.directory)
        middle = 0 < count < self.subject.rollouts and not (self.directory / "certificate.json").exists()
        self.did(f"kill orchestrator at {count} of {self.subject.rollouts}", fault=middle)

    def finish(self) -> Ended:
        """Wait for the certificate; return the end of the orchestrator.

        Raises:
            EndedEarly: the campaign ended before.

        """
        ended = self.end()
        if ended.code != 0:
            raise EndedEarly(f"exit {ended.code}: {''.join(ended.err.splitlines()[-1:])}")
        assert "Traceback" not in ended.err, ended.err[-2000:]
        return ended

    def end(self) -> Ended:
        """Wait for the end of the orchestrator, however it ends."""
        return self.orchestrator.wait()

    def refused(self) -> str:
        """Wait for an orchestrator that cannot continue; return its last line on stderr.

        Raises:
            AssertionError: it ends in another way than with exit 1 and one clear line, or keeps the lock.

        """
        ended = self.end()
        assert ended.code == 1, f"exit {ended.code}: {ended.err[-1500:]}"
        assert "Traceback" not in ended.err, ended.err[-1500:]
        last = ended.err.splitlines()[-1] if ended.err else ""
        assert last.startswith("perfbound: "), ended.err[-1500:]
        assert not lock.is_held(self.directory)
        return last

    # Afterwards

    def close(self) -> list[str]:
        """Let remote workers go, and return the processes that do not end by themselves."""
        for each in self.processes.started:
            if each.running:
                each.popen.send_signal(signal.SIGCONT)
                each.popen.send_signal(signal.SIGTERM)
        with suppress(TimeoutError):
            wait_for(lambda: not self.alive(), self.patience)
        left = self.alive()
        self.processes.end()
        for pid in left:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        for back in reversed(self.undo):
            back()
        return [f"process {pid} ({line})" for pid, line in left.items()]

    def alive(self) -> dict[int, str]:
        """Return process id and command line of every process of this scene."""
        for each in self.processes.started:
            each.popen.poll()
        mark = f"{MARK}={self.folder}".encode()
        found = {}
        for process in psutil.process_iter():
            with suppress(OSError, psutil.Error):
                if mark in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0"):
                    found[process.pid] = " ".join(arguments(process))
        return found
