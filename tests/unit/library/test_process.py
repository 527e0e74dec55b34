"""What the library does to the process that it runs in, and undoes."""

import os
import signal
import threading
from pathlib import Path

import pytest
from rich.console import Console
from threadpoolctl import threadpool_info, threadpool_limits

from perfbound.library.process import _one_thread, interruptible, output, reproducible
from perfbound.schemas.errors import Stopped
from tests.patience import PATIENCE

SILENT = Console(quiet=True)


def threads() -> set[int]:
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


def test_blas_has_one_thread_inside_alone() -> None:
    with threadpool_limits(2):
        with reproducible():
            assert threads() == {1}
        assert threads() == {2}


def test_threads_that_compute_share_the_limit_and_give_it_back() -> None:
    inside, leave = threading.Barrier(2), threading.Event()

    def compute() -> None:
        with reproducible():
            inside.wait(PATIENCE)
            leave.wait(PATIENCE)

    with threadpool_limits(2):
        other = threading.Thread(target=compute)
        with reproducible():
            other.start()
            inside.wait(PATIENCE)
        assert threads() == {1}, "the other one computes on"
        with reproducible(), reproducible():
            pass
        assert threads() == {1}
        leave.set()
        other.join(PATIENCE)
        assert threads() == {2}


def test_a_thread_is_limited_while_another_one_has_set_the_number() -> None:
    found: list[set[int]] = []

    def compute() -> None:
        with reproducible():
            found.append(threads())
        found.append(threads())

    with threadpool_limits(2):
        other = threading.Thread(target=compute)
        other.start()
        other.join(PATIENCE)
    assert found == [{1}, {2}]


@pytest.mark.integration
def test_a_fork_of_what_computes_in_a_thread_can_compute() -> None:
    entered, leave = threading.Event(), threading.Event()

    def compute() -> None:
        with reproducible(), _one_thread._lock:
            entered.set()
            leave.wait(PATIENCE)

    other = threading.Thread(target=compute)
    other.start()
    assert entered.wait(PATIENCE)
    child = os.fork()
    if not child:
        signal.alarm(60)
        with reproducible():
            os._exit(0 if threads() == {1} else 1)
    leave.set()
    other.join(PATIENCE)
    assert os.waitpid(child, 0)[1] == 0


@pytest.mark.parametrize(("number", "kind"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)])
def test_a_stop_is_an_interrupt_and_the_handlers_are_back(number: int, kind: type[BaseException]) -> None:
    before = signal.getsignal(number)

    def session() -> None:
        signal.signal(number, signal.SIG_IGN)  # as a session leaves it
        raise Stopped(number)

    with pytest.raises(kind), interruptible(Path("run"), SILENT):
        session()
    assert signal.getsignal(number) is before


def test_a_thread_touches_no_handler() -> None:
    caught: list[BaseException] = []

    def stop() -> None:
        try:
            with interruptible(Path("run"), SILENT):
                raise Stopped(signal.SIGINT)
        except KeyboardInterrupt as interrupt:
            caught.append(interrupt)

    thread = threading.Thread(target=stop)
    thread.start()
    thread.join()
    assert [str(each) for each in caught] == ["stopped; perfbound.resume('run') continues"]


def test_without_progress_nothing_is_printed() -> None:
    assert output(progress=False).quiet
