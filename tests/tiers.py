"""Tiers of tests by cost, as markers by folder, and what a unit test may not do.

`make test` runs what has no marker `rest`: unit and contract tests, and one journey of each capability end to end.
`make test-all` runs everything. `RUNS_ALWAYS` has the folders that it does not apply to.
"""

import multiprocessing.process
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import pytest

UNIT, INTEGRATION = "unit", "integration"
JOURNEY = "journey"
REST = "rest"
TESTS = Path(__file__).parent
RUNS_ALWAYS = ("unit", "contract", "golden", "architecture", "texts")
"""Folders whose tests `make test` runs, unless a test is marked `rest`; of every other one, those marked `journey`."""
STARTS = frozenset(
    ("subprocess.Popen", "os.posix_spawn", "os.fork", "os.forkpty", "os.exec", "os.spawn", "os.system", "pty.spawn")
)
"""Audit events of a start of a process."""

_in_unit_test = False


class UnitTestError(BaseException):
    """A unit test that starts a process or sleeps; no `except Exception` of the product hides it."""


def mark_by_folder(items: list[pytest.Item]) -> None:
    """Give every test its tier."""
    for item in items:
        if not item.path.is_relative_to(TESTS):
            continue  # an example in a docstring
        folder = item.path.relative_to(TESTS).parts[0]
        if folder in ("unit", "texts") and not item.get_closest_marker(INTEGRATION):
            item.add_marker(UNIT)
        if folder not in RUNS_ALWAYS and not item.get_closest_marker(JOURNEY):
            item.add_marker(REST)


@contextmanager
def enforced(item: pytest.Item) -> Iterator[None]:
    """While a unit test runs, fail it where it starts a process or sleeps: such a test is marked `integration`."""
    global _in_unit_test  # noqa: PLW0603  # an audit hook has no other way to know
    if not item.get_closest_marker(UNIT):
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "sleep", _no_sleep)
        patch.setattr(multiprocessing.process.BaseProcess, "start", _no_process)
        _in_unit_test = True
        try:
            yield
        finally:
            _in_unit_test = False


def _audit(event: str, _arguments: tuple[Any, ...]) -> None:
    if _in_unit_test and event in STARTS:
        raise UnitTestError(f"a unit test starts a process ({event}); mark it integration")


def _no_sleep(seconds: float) -> NoReturn:
    raise UnitTestError(f"a unit test sleeps {seconds} s; give the code a clock, or mark the test integration")


def _no_process(_process: object) -> NoReturn:
    raise UnitTestError("a unit test starts a process; mark it integration")


sys.addaudithook(_audit)
