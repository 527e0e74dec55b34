"""The story's maps and decays as files, in the style of the paper's figures; equal stories give equal bytes."""

import io
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ..mathematics.gp.kernels import Floats
from .data import Problem, ReportData, Series, Surface
from .paper.figures import BLUE, DPI, GREEN, GREYS, RED, STYLE, THICK, THIN, WIDTH, png

SVG = {"svg.hashsalt": "perfbound", "svg.fonttype": "path"}
HATCH = {"hatch.color": RED, "hatch.linewidth": THIN}


def figures(story: ReportData) -> Iterator[tuple[str, bytes]]:
    """Yield (name, bytes) of every figure, as SVG and PNG, for the problems that have tests."""
    for problem in story.problems:
        for kind, figure in _drawn(story, problem):
            yield f"{problem.name}-{kind}.svg", svg(figure)
            yield f"{problem.name}-{kind}.png", png(figure)


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG without date and random names."""
    out = io.BytesIO()
    with mpl.rc_context(STYLE | HATCH | SVG):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def _drawn(story: ReportData, problem: Problem) -> Iterator[tuple[str, Figure]]:
    if problem.surface is not None:
        yield "map", _map(story, problem, problem.surface)
    if any(value is not None and value > 0 for value in problem.tests.distance):
        yield "decay", _decay(problem)


@contextmanager
def _figure(height: float) -> Iterator[tuple[Figure, Axes]]:
    with mpl.rc_context(STYLE | HATCH):
        figure = Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")
        yield figure, figure.subplots()


def _map(story: ReportData, problem: Problem, surface: Surface) -> Figure:
    with _figure(2.8) as (figure, axes):
        axes.set_title(_title(problem), fontsize=8)
        axes.set_xlabel(_label(story.axes[0].name, story.axes[0].unit))
        if len(story.axes) == 1:
            _line(story, problem, surface, axes)
        elif surface.shape is None:
            _listed(story, problem, surface, figure, axes)
        else:
            _plane(story, problem, surface, figure, axes)
    return figure


def _line(story: ReportData, problem: Problem, surface: Surface, axes: Axes) -> None:
    """Draw a band over the only parameter."""
    at = _grid(story, surface)[0] if surface.shape else np.array(surface.points)[:, 0]
    order = np.argsort(at, kind="stable")
    lower, upper = _array(surface.lower)[order], _array(surface.upper)[order]
    axes.fill_between(at[order], lower, upper, color=BLUE, alpha=0.2, linewidth=0)
    axes.plot(at[order], _array(surface.mean)[order], color=BLUE, linewidth=THICK)
    worst = np.array(surface.worst)
    axes.plot(at[worst], np.full(worst.sum(), 0.01), "s", color=RED, transform=axes.get_xaxis_transform(), markersize=2)
    starts = [x[0] for x in problem.tests.x]
    axes.plot(starts, _array(problem.tests.y), "o", color=GREEN, markersize=2, alpha=0.7, markeredgewidth=0)
    axes.set_ylabel(_label("value", problem.unit))


def _plane(story: ReportData, problem: Problem, surface: Surface, figure: Figure, axes: Axes) -> None:
    """Draw the mean over the first two parameters, a line around the worst, and the tests as dots that grow."""
    assert surface.shape is not None, "a lattice"
    first, second = _grid(story, surface)
    mean = _array(surface.mean).reshape(surface.shape).T  # rows are the second parameter
    drawn = axes.contourf(first, second, mean, levels=20, cmap=GREYS)
    _ruled_out(surface, first, second, figure, axes)
    counts = dict(Counter(x[:2] for x in problem.tests.x).most_common())  # small dots upon large ones
    areas = [3.0 + 2.0 * count for count in counts.values()]  # pt^2
    z1, z2 = zip(*counts, strict=True)
    axes.scatter(z1, z2, areas, color=GREEN, alpha=0.7, edgecolor="white", linewidth=THIN, clip_on=False, zorder=3)
    _two_axes(story, problem, figure, axes, drawn)


def _ruled_out(surface: Surface, first: Floats, second: Floats, figure: Figure, axes: Axes) -> None:
    """Hatch where the band rules the worst start out."""
    assert surface.shape is not None, "a lattice"
    worst = np.array(surface.worst, dtype=np.float64).reshape(surface.shape).T
    if worst.all():
        return
    axes.contourf(first, second, worst, levels=[-0.5, 0.5], colors="none", hatches=["/////"])
    axes.contour(first, second, worst, levels=[0.5], colors=RED, linewidths=THIN)
    key = Patch(facecolor="none", edgecolor=RED, linewidth=THIN, hatch="/////", label="the worst start is not here")
    figure.legend(handles=[key], loc="outside lower center", borderaxespad=0)


def _listed(story: ReportData, problem: Problem, surface: Surface, figure: Figure, axes: Axes) -> None:
    """Draw the listed starts, dark where the mean is high, with a red edge where the worst one may be."""
    z1, z2 = np.array(surface.points)[:, :2].T
    edges = [RED if worst else "white" for worst in surface.worst]
    drawn = axes.scatter(z1, z2, 60, c=_array(surface.mean), cmap=GREYS, edgecolor=edges, linewidth=THICK, zorder=3)
    _two_axes(story, problem, figure, axes, drawn)
    key = Line2D([], [], linestyle="", marker="o", color="white", markeredgecolor=RED, label="may be the worst start")
    figure.legend(handles=[key], loc="outside lower center", borderaxespad=0)


def _two_axes(story: ReportData, problem: Problem, figure: Figure, axes: Axes, drawn: object) -> None:
    axes.set_ylabel(_label(story.axes[1].name, story.axes[1].unit))
    figure.colorbar(drawn, ax=axes, label=_label("mean", problem.unit))  # type: ignore[arg-type]


def _decay(problem: Problem) -> Figure:
    with _figure(1.8) as (figure, axes):
        found = [pair for pair in zip(problem.tests.test, problem.tests.distance, strict=True) if pair[1]]
        axes.plot(*zip(*found, strict=True), color=BLUE, linewidth=THICK)
        axes.axhline(problem.alpha, color=RED, linestyle="--", linewidth=THICK, label=rf"$\alpha = {problem.alpha:g}$")
        name = "$F_i$" if problem.distance == "F_i" else "$U - L$"
        axes.set(title=_title(problem), xlabel="test $i$", yscale="log")
        axes.title.set_fontsize(8)
        axes.set_ylabel(_label(name, problem.unit))
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(loc="upper right", borderaxespad=0)
    return figure


def _grid(story: ReportData, surface: Surface) -> list[Floats]:
    assert surface.shape is not None, "a lattice"
    return [np.linspace(axis.low, axis.high, size) for axis, size in zip(story.axes, surface.shape, strict=False)]


def _array(values: Series) -> Floats:
    return np.array([np.nan if value is None else value for value in values])


def _title(problem: Problem) -> str:
    return f"{problem.name}: {len(problem.tests.test)} tests, method {problem.method}"


def _label(name: str, unit: str) -> str:
    """Return an axis label; nothing in a stranger's unit is mathematics, or no character."""
    plain = "".join(each for each in unit if each.isprintable() and each != "\\").replace("$", r"\$")[:40]
    return f"{name} / {plain}" if unit not in ("", "1") else name
