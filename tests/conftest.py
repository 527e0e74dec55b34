"""Property tests are the same on every run, and judge no time; PERFBOUND_EXPLORE=1 finds new cases.

Without PyBullet, the tests that fail for want of it are skipped, with the line that says how to get it.
"""

import os
from collections.abc import Generator

import pytest
from hypothesis import HealthCheck, settings
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

from tests import skips, tiers
from tests.fuzz import amount
from tests.missing import MISSING, for_want_of_pybullet

TIMELESS = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("repeatable", TIMELESS, derandomize=True)
settings.register_profile("explore", TIMELESS, max_examples=2000)
settings.load_profile("explore" if os.environ.get("PERFBOUND_EXPLORE") else "repeatable")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.failed and call.excinfo and for_want_of_pybullet(str(call.excinfo.value)):
        path, line, _ = item.location
        report.outcome, report.longrepr = "skipped", (path, (line or 0) + 1, f"Skipped: {MISSING}")
    return report


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    tiers.mark_by_folder(items)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    with tiers.enforced(item):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    if report.failed and for_want_of_pybullet(str(report.longrepr)):
        report.outcome, report.longrepr = "skipped", (str(collector.path), 1, f"Skipped: {MISSING}")
    return report


def pytest_sessionfinish(session: pytest.Session) -> None:
    reporter = session.config.pluginmanager.getplugin("terminalreporter")
    if reporter and (bad := skips.not_allowed(skips.reasons(reporter.stats.get("skipped", ())))):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        reporter.write_line(f"\nskipped for a reason that CI does not accept (tests/skips.py): {'; '.join(bad)}")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not terminalreporter.config.getoption("collectonly"):
        terminalreporter.write_line(skips.summary(skips.reasons(terminalreporter.stats.get("skipped", ()))))
    if amount.CHOSEN:
        terminalreporter.write_line(f"{amount.made():,} random inputs at the borders")


class FilesAndFaultRuns(LoadFileScheduling):  # type: ignore[misc]  # xdist has no types
    """The tests of a file run in one process, since they share what is costly to make; fault runs share nothing."""

    def _split_scope(self, nodeid: str) -> str:
        return nodeid if nodeid.startswith("tests/faults/") else super()._split_scope(nodeid)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadFileScheduling | None:
    return FilesAndFaultRuns(config, log) if config.getoption("dist") == "loadfile" else None
