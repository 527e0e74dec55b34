"""The medians as a figure: a line for each benchmark, a mark for each search."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from tests.studies.falsification.page import by_benchmark, by_search, found_in, middle
from tests.studies.falsification.study import BUDGET, OURS, Row

IMAGE = Path("images", "falsification.png")
MARKS = ("o", "x", "s", "^", "v", "D", "P", "*")
COLOURS = {OURS: "#D55E00", "random": "#000000"}
OTHER = "#7F93A8"
"""Of the other searches, which the marks tell apart."""


def draw_beside(page: Path, rows: Sequence[Row]) -> None:
    """Write the picture of a page, of instance 2."""
    target = page.parent / IMAGE
    target.parent.mkdir(exist_ok=True)
    of = [row for row in rows if (row.run.instance, row.run.budget) == (2, BUDGET)]
    figure_of(of).savefig(target, metadata={"Software": None})


def figure_of(rows: Sequence[Row]) -> Figure:
    """Return the medians of the rows, all of one budget; a search that never falsified has no mark."""
    found, searches, budget = by_benchmark(rows), list(by_search(rows)), max(row.run.budget for row in rows)
    figure = Figure(figsize=(8.0, 0.9 + 0.27 * len(found)), dpi=110, layout="constrained")
    ax = figure.subplots()
    for line, of in enumerate(found.values()):
        ax.axhline(line, color="#E6E6E6", linewidth=0.8, zorder=0)
        for search, mine in by_search(of).items():
            if found_in(mine):
                ax.plot(middle(mine), line, **_style(search, searches))
    _axis(ax, [f"{each.name}, {each.dimension}" for each in found], budget)
    marks = [Line2D([], [], label=search, **_style(search, searches)) for search in searches]
    figure.legend(handles=marks, loc="outside upper center", ncols=4, frameon=False, fontsize=8)
    return figure


def _style(search: str, searches: Sequence[str]) -> dict[str, Any]:
    ours = search == OURS
    return {
        "marker": MARKS[list(searches).index(search) % len(MARKS)],
        "color": COLOURS.get(search, OTHER),
        "markersize": 8 if ours else 6,
        "linestyle": "",
        "zorder": 3 if ours else 2,
        "clip_on": False,
    }


def _axis(ax: Axes, names: Sequence[str], budget: int) -> None:
    ticks = [tick for tick in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000) if tick <= budget / 2]
    ax.set_xscale("log")
    ax.set_xlim(0.9, budget)
    ax.set_xticks([*ticks, budget], [*map(str, ticks), f"{budget} or more"], fontsize=8)
    ax.minorticks_off()
    ax.set_yticks(range(len(names)), names, fontsize=8)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.tick_params(length=0)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.set_xlabel("median of the simulations to the first failure", fontsize=9)
