"""Figures of a run as matplotlib axes: those of `perfbound report`, in the figure manager of the notebook."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib as mpl
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..orchestrator.report import figures, style
from ..orchestrator.report.data.page import Problem
from ..orchestrator.report.write import collected
from ..schemas.errors import PerfboundError
from .process import reproducible

SCREEN = 140
"""Dots per inch."""


class Plot:
    """The figures of one run, drawn from its files at every call; `.figure.savefig(...)` of the axes writes one."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        with reproducible():
            self._data = collected(directory)

    def map(self, problem: str | None = None) -> Axes:
        """Draw mean and tests of a problem, by default the first one, over the first two parameters of its starts.

        "PROBLEM/REQUIREMENT" names a requirement that is bounded on its own.

        Raises:
            PerfboundError: there is no such problem, or it has no test yet.

        """
        found = self._problem(problem)
        if not found.surfaces:
            raise PerfboundError(f"{self._directory}: problem {found.key} has no test yet; retry later")
        with reproducible(), _figure(figures.MAP_HEIGHT) as figure:
            return figures.draw_problem_map(figure, self._data.axes, found)

    def decay(self, problem: str | None = None) -> Axes:
        """Draw how the distance of the bounds of a problem decays over its tests.

        Raises:
            PerfboundError: there is no such problem, or it has no bounds yet.

        """
        found = self._problem(problem)
        if not figures.decays(found):
            several = any(each.requirement for each in self._data.problems)
            remedy = (
                "those of several requirements are not stored for each test; use `map`" if several else "retry later"
            )
            raise PerfboundError(f"{self._directory}: problem {found.key} has no two bounds; {remedy}")
        with reproducible(), _figure(figures.DECAY_HEIGHT) as figure:
            return figures.draw_problem_decay(figure, found)

    def _problem(self, name: str | None) -> Problem:
        found = {each.key: each for each in self._data.problems}
        if name is not None and name not in found:
            raise PerfboundError(f"{self._directory}: no problem {name!r}; choose one of {', '.join(found)}")
        return found[name] if name is not None else next(iter(found.values()))


@contextmanager
def _figure(height: float) -> Iterator[Figure]:
    """Yield a figure of pyplot, which a notebook shows at the end of the cell."""
    with mpl.rc_context(style.STYLE):
        yield pyplot.figure(figsize=(style.WIDTH, height), dpi=SCREEN, layout="constrained")
