"""The rollouts of single tests for the report: which ones, and how much of their curves a report has room for."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from ....schemas.errors import PerfboundError
from ....schemas.file.problem_models import Problem
from ....schemas.result.facts import Header
from ...store.changes import rollouts_of
from ..data.rollouts import RolloutsOfTest
from ..rollout import of_tests

MOST_CACHED = 60
"""Tests whose rollouts are kept."""
MOST_NUMBERS = 80_000
"""Times and values of all curves in a report, about 10 characters each."""
MOST_FURTHER_NUMBERS = 40_000
"""Those of further columns."""


class SceneCache:
    """The rollouts of tests in `directory`; those of an observed test are read once."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._found: dict[tuple[tuple[str, int], frozenset[str]], RolloutsOfTest] = {}

    def of_test(
        self,
        header: Header,
        test: tuple[str, int],
        of: tuple[Problem, tuple[float, ...]],
        *,
        final: bool,
        system: str | None,
        also: frozenset[str],
    ) -> RolloutsOfTest:
        """Return the rollouts of a test; `of` is the problem whose columns are drawn, and the start of the test.

        Those of a `final` test do not change. Beside the worst rollouts, those `also` named have curves.

        Raises:
            PerfboundError: it has none yet, or the database cannot be read.

        """
        if (test, also) in self._found:
            return self._found[test, also]
        facts = rollouts_of(self._directory, *test)
        if not facts:
            raise PerfboundError(f"{self._directory}: test {test[1]} of {test[0]} has no rollout yet; retry later")
        problem, x = of
        found = of_tests.of_test(self._directory, header, problem, facts, x, system=system, also=also)
        # An observed test gets no more rollouts; a file that could not be read may be restored, so it is read again.
        if found.error is None and final:
            self._found[test, also] = found
            if len(self._found) > MOST_CACHED:
                del self._found[next(iter(self._found))]
        return found


def bounded_scenes(scenes: Iterable[RolloutsOfTest]) -> list[RolloutsOfTest]:
    """Return the first scenes whose curves have room in a report; further columns have less room, and go first."""
    kept, numbers, further = list[RolloutsOfTest](), 0, 0
    for scene in scenes:
        numbers += _numbers_in(scene)
        if numbers > MOST_NUMBERS and kept:
            break
        more = sum(2 * len(curve.t) for curve in scene.further)
        fits = further + more <= MOST_FURTHER_NUMBERS
        further += more if fits else 0
        kept.append(scene if fits else replace(scene, further=()))
    return kept


def without_further(scenes: Iterable[RolloutsOfTest]) -> tuple[RolloutsOfTest, ...]:
    """Return the scenes without the curves that a live page requests."""
    return tuple(replace(scene, further=()) for scene in scenes)


def _numbers_in(scene: RolloutsOfTest) -> int:
    times = [each.t for each in scene.traces] + [each.t for each in scene.drawn] + [each.t for each in scene.inputs]
    return 2 * sum(map(len, times))
