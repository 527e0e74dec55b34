"""What the library does to the process that it runs in, and undoes."""

import signal
import threading
from pathlib import Path

import pytest
from rich.console import Console
from threadpoolctl import threadpool_info, threadpool_limits

from perfbound.library.process import interruptible, output, reproducible
from perfbound.schemas.errors import Stopped

SILENT = Console(quiet=True)


def threads() -> set[int]:
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


def test_blas_has_one_thread_inside_alone() -> None:
    with threadpool_limits(2):
        with reproducible():
            assert threads() == {1}
        assert threads() == {2}


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
