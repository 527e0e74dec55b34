"""The figures of a comparison."""

import textwrap
from collections.abc import Collection, Sequence

import numpy as np
from matplotlib.axes import Axes

from ....schemas.result.comparison import Difference
from ....schemas.system import SystemSpec
from ....schemas.trajectory.trajectory import Trajectory
from ...mathematics.gp.kernels import Floats
from ...report import style
from ...report.style import BLUE, GREY, RED, THICK, THIN
from .outputs import NAMES

FULL = 7.0
"""Width of a figure in inches."""
MOST_DOTS = 3000
"""Of a colour: each takes a hundred bytes of the page."""
MOST_COLUMNS = 6
"""Panels of two trajectories."""


def intervals_figure(course: Sequence[tuple[int, Sequence[Difference]]]) -> bytes:
    """Return an SVG with the interval of each difference after growing numbers of pairs."""
    last = course[-1][1]
    with style.new_figure(2.3, FULL) as figure:
        for place, axes in enumerate(figure.subplots(1, len(last), squeeze=False)[0]):
            each = [differences[place] for _, differences in course]
            pairs = [number for number, _ in course]
            found = last[place]
            axes.fill_between(pairs, [one.lower for one in each], [one.upper for one in each], color=BLUE, alpha=0.35)
            axes.axhline(0.0, color=GREY, linewidth=THICK)
            for edge in (-1, 1) if found.equal_within else ():
                axes.axhline(edge * (found.equal_within or 0.0), color=GREY, linewidth=THICK, linestyle=":")
            axes.plot(pairs[-1:], [found.b - found.a], "o", color=BLUE, markersize=3, clip_on=False)
            worse = "below" if found.better == "larger" else "above"
            # The longest name is wider than a third of the figure.
            title = textwrap.fill(NAMES[found.quantity], 30)
            axes.set(title=f"{title}\nB is worse {worse} 0", xlabel="pairs", xlim=(0, pairs[-1]))
            axes.set_ylabel(style.with_unit("B - A", found.unit))
            # The first intervals, which show nothing, would leave no room for the last ones.
            reach = 3.0 * max(abs(found.lower), abs(found.upper), found.equal_within or 0.0)
            axes.set_ylim(-reach, reach)
            axes.spines[["top", "right"]].set_visible(False)
    return style.svg(figure)


def pairs_figure(a: Floats, b: Floats, unit: str) -> bytes:
    """Return an SVG with a dot for each pair, of very many for some: the robustness of B over that of A."""
    with style.new_figure(3.6, 3.6) as figure:
        axes: Axes = figure.subplots()
        low, high = float(min(a.min(), b.min())), float(max(a.max(), b.max()))
        axes.plot([low, high], [low, high], color=GREY, linewidth=THICK, zorder=1)
        for line in (axes.axhline, axes.axvline):
            line(0.0, color=GREY, linewidth=THIN)
        only_a, only_b = (a <= 0) & (b > 0), (b <= 0) & (a > 0)
        groups = [
            (~only_a & ~only_b, GREY, "both hold, or both fail"),
            (only_a, BLUE, "A alone fails"),
            (only_b, RED, "B alone fails"),
        ]
        for chosen, colour, label in groups:
            drawn = np.flatnonzero(chosen)[:: 1 + int(chosen.sum()) // MOST_DOTS]
            axes.scatter(a[drawn], b[drawn], 6, color=colour, alpha=0.6, linewidths=0, zorder=2)
            axes.plot([], [], "o", color=colour, markersize=3, label=f"{label}: {int(chosen.sum()):,}")
        axes.set_xlabel(style.with_unit("robustness of A", unit))
        axes.set_ylabel(style.with_unit("robustness of B", unit))
        axes.set_aspect("equal", adjustable="datalim")
        axes.legend(loc="lower right")
        axes.spines[["top", "right"]].set_visible(False)
    return style.svg(figure)


def trajectories_figure(spec: SystemSpec, a: Trajectory, b: Trajectory, first: Collection[str]) -> bytes:
    """Return an SVG with both trajectories of a pair over one another; the columns `first` come first."""
    common = [each for each in spec.columns[1:] if each.name in b.columns]
    columns = sorted(common, key=lambda each: each.name not in first)[:MOST_COLUMNS]
    with style.new_figure(0.9 * len(columns) + 0.5, FULL) as figure:
        panels = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
        for axes, column in zip(panels, columns, strict=True):
            for label, trajectory, colour in (("A", a, BLUE), ("B", b, RED)):
                t, values = trajectory.samples[:, 0], trajectory.column(column.name)
                axes.plot(t, values, "-" if len(t) > 1 else "o", color=colour, linewidth=THICK, ms=3, label=label)
            axes.set_ylabel(style.with_unit(column.name, column.unit))
            axes.spines[["top", "right"]].set_visible(False)
            axes.margins(x=0.01)
        panels[0].legend(loc="upper right", ncols=2)
        panels[-1].set_xlabel("t / s")
    return style.svg(figure)


def numbers_of(pairs: int, count: int = 16) -> list[int]:
    """Return the numbers of pairs at which an interval is drawn.

    >>> numbers_of(1000, 5), numbers_of(3)
    ([200, 400, 600, 800, 1000], [1, 2, 3])

    """
    return sorted({int(each) for each in np.ceil(np.linspace(0, pairs, min(count, pairs) + 1)[1:])})
