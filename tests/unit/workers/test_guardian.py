"""The guardian of a worker: it adopts, reaps and ends what is left, hands signals on, and ends as the worker did."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from perfbound.schemas.stop_signals import END_FAMILY
from tests.patience import PATIENCE

pytestmark = pytest.mark.integration

BEGIN = """
import os, signal, subprocess, sys, time
from perfbound.workers.guardian import become_guarded
become_guarded(left=int(sys.argv[1]))
def daemon(seconds):
    subprocess.run(["sh", "-c", f"setsid sleep {seconds} > /dev/null 2>&1 & exit 0"])
"""


class Guarded:
    """A process with a guardian, which is `process`; `left` is what that counted."""

    def __init__(self, code: str) -> None:
        self._reading, writing = os.pipe()
        line = [sys.executable, "-c", f"{BEGIN}{code}", str(writing)]
        self.process = subprocess.Popen(line, stdout=subprocess.PIPE, pass_fds=[writing], text=True)
        os.close(writing)

    @property
    def left(self) -> int:
        with os.fdopen(self._reading) as pipe:
            return sum(map(int, pipe.read().split()))

    def wait_for_line(self) -> None:
        assert self.process.stdout is not None
        assert self.process.stdout.readline()

    def wait(self) -> int:
        """Return the exit code."""
        assert self.process.stdout is not None
        with self.process.stdout:
            return self.process.wait(PATIENCE)


@pytest.mark.integration
@pytest.mark.parametrize(
    ("code", "expected"),
    [("", 0), ("sys.exit(3)", 3), ("os.kill(os.getpid(), signal.SIGSEGV)", -signal.SIGSEGV), ("os.abort()", -6)],
)
def test_it_ends_as_its_worker_does(code: str, expected: int) -> None:
    found = Guarded(code)
    assert found.wait() == expected
    assert found.left == 0


@pytest.mark.integration
def test_what_is_left_is_ended_and_counted() -> None:
    found = Guarded("for _ in range(3): daemon(1000)\nsubprocess.Popen(['sleep', '1000'])\nprint('there', flush=True)")
    found.wait_for_line()
    assert found.wait() == 0
    assert found.left == 4


@pytest.mark.integration
def test_what_ends_by_itself_is_not_counted() -> None:
    found = Guarded("daemon(0.1)")
    assert found.wait() == 0
    assert found.left == 0


@pytest.mark.integration
def test_no_zombie_stays_while_the_worker_lives() -> None:
    found = Guarded("for _ in range(20): daemon(0)\ntime.sleep(0.5)\nprint('there', flush=True)\ntime.sleep(1000)")
    found.wait_for_line()
    below = psutil.Process(found.process.pid).children(recursive=True)
    assert len(below) == 1, "the worker"
    os.kill(found.process.pid, END_FAMILY)
    assert found.wait() == -signal.SIGKILL


@pytest.mark.integration
@pytest.mark.parametrize(("number", "expected"), [(signal.SIGTERM, -signal.SIGTERM), (END_FAMILY, -signal.SIGKILL)])
def test_signals_reach_the_worker(number: signal.Signals, expected: int) -> None:
    found = Guarded("daemon(1000)\nprint('there', flush=True)\ntime.sleep(1000)")
    found.wait_for_line()
    os.kill(found.process.pid, number)
    assert found.wait() == expected
    assert found.left == 1


@pytest.mark.integration
def test_a_signal_may_come_before_the_guardian_is_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = "import perfbound.workers.guardian as g, time; g._guard = lambda *a, f=g._guard: (time.sleep(0.5), f(*a))"
    monkeypatch.setattr(sys.modules[__name__], "BEGIN", f"{slow}{BEGIN}")
    found = Guarded("daemon(1000)\nprint('there', flush=True)\ntime.sleep(1000)")
    found.wait_for_line()
    os.kill(found.process.pid, signal.SIGTERM)
    assert found.wait() == -signal.SIGTERM
    assert found.left == 1


@pytest.mark.integration
def test_it_does_not_outlive_the_process_that_started_it(tmp_path: Path) -> None:
    code = f"{BEGIN}daemon(1000)\nprint(os.getpid(), flush=True)\ntime.sleep(1000)"
    parent = f"import subprocess, sys, time; subprocess.Popen([sys.executable, '-c', {code!r}, '1']); time.sleep(1000)"
    with subprocess.Popen([sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True) as started:
        assert started.stdout is not None
        worker = psutil.Process(int(started.stdout.readline()))
        family = [worker, *worker.parent().children(recursive=True)]  # type: ignore[union-attr]
        started.kill()
    _, alive = psutil.wait_procs(family, PATIENCE)
    assert not [each for each in alive if each.is_running() and each.status() != psutil.STATUS_ZOMBIE]
