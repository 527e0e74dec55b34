"""Searches that are asked for one start at a time: ours in this process, the others in one of their own environment.

A start is a point of the unit box. The peers (`peers`) run in `.venv-bench`, which has no perfbound; one process of
them answers one search after the other.
"""

import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol

import numpy as np

from perfbound.orchestrator.mathematics.search.goal import ALONE, Goal
from tests.studies.falsification.benchmark import Floats

Margins = tuple[float, tuple[float, ...]]
"""The robustness of a rollout, and that of each part of a requirement with several."""
Objective = Callable[[Floats], Margins]
"""A point (p,) of the unit box -> its robustness."""

ENVIRONMENT = Path(".venv-bench/bin/python")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Search(Protocol):
    """A search that has begun; `tell` follows each `ask`, but for the last one."""

    cpu: float
    """Seconds of CPU time that the search itself has used, without simulations."""

    def ask(self) -> Floats:
        """Return the next point (p,)."""
        ...

    def tell(self, margins: Margins) -> None:
        """Give it the robustness of the point."""
        ...

    def stop(self) -> None:
        """End the search; the last point keeps its value for itself."""
        ...


Begin = Callable[[int, int], Search]
"""(number of parameters, seed) -> a search."""


class Ours:
    """Our search, which knows as in a campaign what is a part of the requirement, and which knots are of one input."""

    def __init__(self, dimension: int, seed: int, goal: Goal = ALONE, signals: Sequence[Sequence[int]] = ()) -> None:
        from perfbound.orchestrator.mathematics.search import Falsifier

        self._search = Falsifier((0.0,) * dimension, (1.0,) * dimension, seed=seed, signals=signals, goal=goal)
        self._asked: tuple[float, ...] = ()
        self.cpu = 0.0

    def ask(self) -> Floats:
        begin = time.process_time()
        self._asked = self._search.propose()
        self.cpu += time.process_time() - begin
        return np.array(self._asked)

    def tell(self, margins: Margins) -> None:
        begin, (value, parts) = time.process_time(), margins
        self._search.observe(self._asked, value, parts)
        self.cpu += time.process_time() - begin

    def stop(self) -> None:
        """Nothing is left to end."""


class Peer:
    """A search in the process of the peers."""

    def __init__(self, process: "PeerProcess", asked: dict[str, object]) -> None:
        self._process = process
        process.write(json.dumps(asked))
        self.cpu = 0.0

    def ask(self) -> Floats:
        self.cpu, point = json.loads(self._process.read())
        return np.array(point)

    def tell(self, margins: Margins) -> None:
        self._process.write(repr(margins[0]))

    def stop(self) -> None:
        self._process.write("")


class PeerProcess:
    """The process of the peers: it reads and writes lines."""

    def __init__(self, stdin: IO[str], stdout: IO[str]) -> None:
        self._in, self._out = stdin, stdout
        self.versions: dict[str, str] = json.loads(self.read())

    def begin(self, peer: str) -> Begin:
        """Return how a search of this peer begins."""
        return lambda dimension, seed: Peer(self, {"peer": peer, "dimension": dimension, "seed": seed})

    def read(self) -> str:
        """Return a line.

        Raises:
            RuntimeError: the process has ended.

        """
        line = self._out.readline()
        if not line:
            raise RuntimeError("the process of the peers has ended; its messages are above")
        return line

    def write(self, line: str) -> None:
        """Write a line."""
        self._in.write(line + "\n")
        self._in.flush()


@contextmanager
def peer_process() -> Iterator[PeerProcess]:
    """Start the process of the peers, and end it."""
    command = [str(ENVIRONMENT), "-m", "tests.studies.falsification.peers"]
    one_thread = {**os.environ, **dict.fromkeys(THREADS, "1")}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=one_thread) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield PeerProcess(process.stdin, process.stdout)
        process.stdin.close()


@dataclass(frozen=True)
class Outcome:
    """How a search ended."""

    simulations: int
    found: bool
    """Whether the last simulation has a robustness below 0; else the budget is spent."""
    cpu: float
    """Seconds of the search itself."""


def outcome(search: Search, objective: Objective, budget: int) -> Outcome:
    """Run a search until the first robustness below 0, for at most `budget` simulations."""
    for simulations in range(1, budget + 1):
        margins = objective(search.ask())
        if margins[0] < 0 or simulations == budget:
            break
        search.tell(margins)
    search.stop()
    return Outcome(simulations, margins[0] < 0, search.cpu)
