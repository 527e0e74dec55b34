"""The tiers of the tests: what a unit test may not do, and which skips CI accepts."""

import multiprocessing
import subprocess
import time
from collections import Counter

import pytest

from tests import skips, tiers


def test_a_unit_test_that_starts_a_process_fails() -> None:
    with pytest.raises(tiers.UnitTestError, match="starts a process"):
        subprocess.run(["true"], check=True)
    with pytest.raises(tiers.UnitTestError, match="starts a process"):
        multiprocessing.get_context("spawn").Process(target=print).start()


def test_a_unit_test_that_sleeps_fails() -> None:
    with pytest.raises(tiers.UnitTestError, match="sleeps 0 s"):
        time.sleep(0)


@pytest.mark.integration
def test_one_that_is_marked_may_do_both() -> None:
    time.sleep(0)
    assert subprocess.run(["true"], check=True).returncode == 0


def test_a_skip_that_nobody_listed_is_found_in_ci_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    found = ["fish is not installed", "there is no Chromium here"]
    monkeypatch.delenv(skips.STRICT, raising=False)
    assert skips.not_allowed(found) == []
    monkeypatch.setenv(skips.STRICT, "1")
    assert skips.not_allowed(found) == ["there is no Chromium here"]
    assert skips.summary(Counter(found)) == (
        "2 tests were skipped: 1 fish is not installed; 1 there is no Chromium here"
    )
