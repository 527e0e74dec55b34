"""perfbound's command line, with an account of what it costs.

    python -m tests.studies.benchmarks.parts.launched ACCOUNT.json [--shares] run CAMPAIGN.toml ...

The account holds CPU seconds of this process in total and at the two ends of the loop (`Service.run`), those of the
main thread, those of all children (workers, and the one that lists the systems), and the peak memory. With --shares a
timer interrupts every few milliseconds of CPU time and notes in which room the main thread is.
"""

import json
import resource
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

INTERVAL = 0.004
"""CPU seconds between two samples; the kernel's clock is not finer."""
IMPORTING = "<frozen importlib._bootstrap>"
ROOMS = (
    ("mathematics", ("/orchestrator/mathematics/",)),
    ("objectives", ("/orchestrator/campaign/observation.py", "/orchestrator/campaign/objectives.py")),
    ("evidence files, fsync", ("/orchestrator/store/files.py", "/schemas/atomic.py")),
    ("SQLite", ("/orchestrator/store/", "/sqlalchemy/")),
    ("trajectories (MCAP)", ("/schemas/trajectory/trajectory.py", "/mcap/")),
    ("Zenoh, main thread", ("/orchestrator/fleet/link/transport.py", "/zenoh/")),
    ("pydantic, JSON", ("/pydantic/", "/json/", "/schemas/")),
    ("certificate", ("/orchestrator/certificate/",)),
    ("terminal", ("/orchestrator/run/display/progress.py", "/rich/")),
    ("loop, cores, ledger", ("/orchestrator/",)),
)
STARTING = "imports"
REST = "rest"


class Shares:
    """Samples of a CPU timer, counted by room."""

    def __init__(self) -> None:
        self.looks: Counter[str] = Counter()

    def start(self) -> None:
        """Start the timer."""
        signal.signal(signal.SIGPROF, self._look)
        signal.siginterrupt(signal.SIGPROF, False)  # system calls continue
        signal.setitimer(signal.ITIMER_PROF, INTERVAL, INTERVAL)

    def stop(self) -> None:
        """Stop the timer."""
        signal.setitimer(signal.ITIMER_PROF, 0.0)

    def _look(self, _number: int, frame: FrameType | None) -> None:
        self.looks[room(frame)] += 1


def room(frame: FrameType | None) -> str:
    """Return the room of the innermost frame that is in one; what runs inside an import belongs to it."""
    files = [each.f_code.co_filename for each in _outwards(frame)]
    if IMPORTING in files:
        return STARTING
    found = (name for file in files for name, parts in ROOMS if any(part in file for part in parts))
    return next(found, REST)


def _outwards(frame: FrameType | None) -> Iterator[FrameType]:
    while frame is not None:
        yield frame
        frame = frame.f_back


def main() -> None:
    """Run, and write the account also when the command line exits."""
    out, arguments = Path(sys.argv[1]), sys.argv[2:]
    shares, marks = Shares(), list[float]()
    if arguments[0] == "--shares":
        arguments.pop(0)
        shares.start()
    sys.argv[1:] = arguments
    try:
        _perfbound(marks)
    finally:
        shares.stop()
        if len(marks) == 2:
            out.write_text(json.dumps(_account(marks, shares)))


def _perfbound(marks: list[float]) -> None:
    """Run the command line; `marks` gets the CPU times at both ends of the loop."""
    from perfbound.schemas.platforms import one_blas_thread

    one_blas_thread()  # before numpy comes along
    from perfbound.orchestrator import cli
    from perfbound.orchestrator.run import service

    run = service.Service.run

    def marked(self: Any) -> None:
        marks.append(time.process_time())
        run(self)
        marks.append(time.process_time())

    service.Service.run = marked  # type: ignore[method-assign]
    cli.main()


def _account(marks: list[float], shares: Shares) -> dict[str, object]:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "total": time.process_time(),
        "main_thread": time.thread_time(),
        "loop_begins": marks[0],
        "loop_ends": marks[1],
        "children": children.ru_utime + children.ru_stime,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "looks": shares.looks,
    }


if __name__ == "__main__":
    main()
