"""The maps and decays of a report as files, in the style of the paper's figures; equal data give equal bytes."""

import itertools
import textwrap
from collections.abc import Iterator
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...schemas.amounts import counted
from ..certificate.words.bound_text import outward
from ..mathematics.gp.kernels import Floats
from . import style
from .data.page import Axis, Drawn, Problem, ReportData, Series, Surface
from .data.rollouts import InputCurve
from .style import BLUE, GREEN, GREYS, RED, THICK, THIN

MAP_HEIGHT, DECAY_HEIGHT, HISTOGRAM_HEIGHT, INPUT_HEIGHT = 2.8, 1.8, 2.4, 1.0
"""Inches."""
MOST_MARKS = 20
"""Marks along each side of a map, about, where the worst start is ruled out."""
MANY = 200
"""More listed starts are drawn smaller."""
MAP_CHARACTERS = 60
"""Of a line of the title of a map."""
PER_PARAMETER = 0.25
"""Inches of each parameter's axis."""
MOST_LINES = 500
"""Tests drawn as lines across all parameters, the worst ones."""
LINES = ListedColormap(mpl.colormaps["Greys"](np.linspace(0.2, 0.85, 20)))
DASHES = ("--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), "-", (0, (1, 3)), (0, (8, 3)))
DISTANCES = {"F_i": "$F_i$", "U - L": "$U - L$"}


def figures(data: ReportData) -> Iterator[tuple[str, bytes]]:
    """Yield (name, bytes) of every figure, as SVG and PNG, for the problems that have tests."""
    for problem in data.problems:
        for kind, figure in _figures_of(data, problem):
            name = "-".join(filter(None, (problem.name, problem.requirement, kind)))
            yield f"{name}.svg", style.svg(figure)
            yield f"{name}.png", style.png(figure)


def _figures_of(data: ReportData, problem: Problem) -> Iterator[tuple[str, Figure]]:
    if problem.drawn is not None:
        with style.new_figure(HISTOGRAM_HEIGHT) as figure:
            draw_histogram(figure, problem, problem.drawn)
        yield "histogram", figure
    if problem.surfaces:
        with style.new_figure(MAP_HEIGHT) as figure:
            draw_problem_map(figure, data.axes, problem)
        yield "map", figure
    inputs = next((each.inputs for each in data.scenes if each.problem == problem.name), ())
    if inputs:
        with style.new_figure(INPUT_HEIGHT * len(inputs) + 0.3) as figure:
            _draw_inputs(figure, inputs)
        yield "inputs", figure
    read = [k for k, each in enumerate(data.axes) if not each.signal]
    if len(data.axes) > 2 and len(read) > 1 and problem.tests.x:
        with style.new_figure(1.2 + PER_PARAMETER * len(read)) as figure:
            draw_problem_tests(figure, data.axes, problem)
        yield "tests", figure
    if decays(problem):
        with style.new_figure(DECAY_HEIGHT) as figure:
            draw_problem_decay(figure, problem)
        yield "decay", figure


def decays(problem: Problem) -> bool:
    """Whether there is a decay to draw: its scale is logarithmic."""
    return any(value is not None and value > 0 for value in problem.tests.distance)


def draw_problem_map(figure: Figure, parameters: tuple[Axis, ...], problem: Problem) -> Axes:
    """Draw the band of a problem that has one in the plane of the first two parameters, with its tests."""
    surface, axes = problem.surfaces[0], figure.subplots()
    axes.set(title=_title(problem), xlabel=style.with_unit(parameters[0].name, parameters[0].unit))
    if surface.shape and len(parameters) > 2:
        axes.set_title(textwrap.fill(f"{_title(problem)}; {_through(parameters, surface)}", MAP_CHARACTERS))
    if len(parameters) == 1:
        _profile(axes, parameters[0], problem, surface)
        return axes
    axes.set_ylabel(style.with_unit(parameters[1].name, parameters[1].unit))
    if surface.shape is None:
        drawn, keys = _scattered(axes, surface)
    else:
        nodes = [np.linspace(each.low, each.high, size) for each, size in zip(parameters, surface.shape, strict=False)]
        drawn, keys = _plane(axes, problem, surface, *nodes)
    figure.colorbar(drawn, ax=axes, label=style.with_unit("mean", problem.unit))
    if keys:
        figure.legend(handles=keys, loc="outside lower center", borderaxespad=0)
    return axes


def _through(parameters: tuple[Axis, ...], surface: Surface) -> str:
    """Return where the plane of the first two parameters is in the others."""
    others = list(zip(parameters, surface.through, strict=True))[2:]
    values = (
        f"{each.name} = {value:.4g} {style.plain_text(each.unit)}".removesuffix(" 1").rstrip() for each, value in others
    )
    return f"at the worst start observed, {', '.join(values)}"


def _profile(axes: Axes, parameter: Axis, problem: Problem, surface: Surface) -> None:
    """Draw a band over the only parameter."""
    listed = np.array([x[0] for x in surface.points])
    at = np.linspace(parameter.low, parameter.high, surface.shape[0]) if surface.shape else listed
    order = np.argsort(at, kind="stable")  # listed starts have no order
    lower, upper = _array(surface.lower)[order], _array(surface.upper)[order]
    axes.fill_between(at[order], lower, upper, color=BLUE, alpha=0.2, linewidth=0)
    axes.plot(at[order], _array(surface.mean)[order], color=BLUE, linewidth=THICK)
    worst = at[np.array(surface.worst)]
    axes.plot(worst, np.full(len(worst), 0.01), "s", color=RED, transform=axes.get_xaxis_transform(), markersize=2)
    starts = [x[0] for x in problem.tests.x]
    axes.plot(starts, _array(problem.tests.y), "o", color=GREEN, markersize=2, alpha=0.7, markeredgewidth=0)
    axes.set_ylabel(style.with_unit("value", problem.unit))


def _plane(axes: Axes, problem: Problem, surface: Surface, first: Floats, second: Floats) -> tuple[Any, list[Artist]]:
    """Draw the mean over the first two parameters, a line around the possible worst starts, and the tests."""
    mean, worst = (_array(values).reshape(surface.shape or ()).T for values in (surface.mean, surface.worst))
    drawn = style.draw_map(axes, first, second, mean, levels=20)
    style.draw_tests(axes, problem.tests.x)
    if worst.all():
        return drawn, []
    # Dots on the other side: a hatching would change the greys that one reads, a line alone has no side.
    axes.contour(first, second, worst, levels=[0.5], colors=RED, linewidths=THICK)
    step = max(1, len(first) // MOST_MARKS)
    x, y = np.meshgrid(first[::step], second[::step])
    out = worst[::step, ::step] == 0
    axes.plot(x[out], y[out], "o", color=RED, markersize=1.0, markeredgewidth=0)
    key = Line2D([], [], color=RED, linewidth=THICK, marker="o", markersize=1.5, label="worst start ruled out (dotted)")
    return drawn, [key]


def _scattered(axes: Axes, surface: Surface) -> tuple[Any, list[Artist]]:
    """Draw the listed starts, dark where the mean is high, with a red edge where the worst one may be."""
    z1, z2 = np.array(surface.points)[:, :2].T
    edges = [RED if worst else "white" for worst in surface.worst]
    area, width = (60, THICK) if len(z1) <= MANY else (8, THIN)
    drawn = axes.scatter(z1, z2, area, c=_array(surface.mean), cmap=GREYS, edgecolor=edges, linewidth=width, zorder=3)
    key = Line2D([], [], linestyle="", marker="o", color="white", markeredgecolor=RED, label="may be the worst start")
    return drawn, [key]


def draw_problem_tests(figure: Figure, parameters: tuple[Axis, ...], problem: Problem) -> Axes:
    """Draw the worst tests of a problem as lines across all parameters, dark where the observed value is bad."""
    read = [k for k, each in enumerate(parameters) if not each.signal]
    parameters = tuple(parameters[k] for k in read)
    axes, y, rows = figure.subplots(), _array(problem.tests.y), np.arange(len(parameters))
    badness = y if problem.sense == "max" and problem.method != "sample" else 0.0 - y
    kept = np.argsort(np.where(np.isnan(badness), -np.inf, badness), kind="stable")[-MOST_LINES:]  # the worst on top
    low, high = np.array([(each.low, each.high) for each in parameters]).T
    shares = (np.array(problem.tests.x)[kept][:, read] - low) / np.where(high > low, high - low, 1.0)  # (n, p)
    lines = LineCollection([np.column_stack((each, rows)) for each in shares], cmap=LINES, linewidths=2 * THIN)
    lines.set_array(badness[kept])
    # Half of the tests have either half of the colours: one value far away would leave one colour for the others.
    ends = np.nanquantile(badness, (0.0, 0.5, 1.0)) if np.isfinite(badness).any() else np.zeros(3)
    if ends[0] < ends[1] < ends[2]:
        lines.set_norm(TwoSlopeNorm(ends[1], ends[0], ends[2]))
    axes.add_collection(lines)
    axes.plot(shares[-1], rows, color=RED, linewidth=THICK, clip_on=False, label="worst observed")
    axes.hlines(rows, 0.0, 1.0, color="black", linewidth=THIN)
    names = [style.with_unit(each.name, each.unit) for each in parameters]
    axes.set_yticks(rows, [f"{name}   {each.low:.4g}" for name, each in zip(names, parameters, strict=True)])
    for row, each in enumerate(parameters):
        axes.text(1.04, row, f"{each.high:.4g}", verticalalignment="center")
    axes.tick_params(axis="y", length=0)
    axes.set(xlim=(-0.02, 1.02), ylim=(rows[-1] + 0.4, -0.4), xticks=())
    axes.set_title(_title(problem) if len(kept) == len(y) else f"the worst {len(kept):,} of {problem.observed:,} tests")
    axes.spines[:].set_visible(False)
    colours = figure.colorbar(lines, ax=axes, orientation="horizontal", pad=0.02, aspect=40)
    values = np.unique(ends).tolist()
    colours.set_ticks(values, labels=[f"{value if badness is y else 0.0 - value:.4g}" for value in values])
    unit = problem.unit if problem.drawn is None else problem.drawn.unit
    colours.set_label(style.with_unit("observed", unit))
    figure.legend(loc="outside lower center", borderaxespad=0)
    return axes


def _draw_inputs(figure: Figure, inputs: tuple[InputCurve, ...]) -> None:
    """Draw the input signals of the worst test over time, as the system gets them, with their knots."""
    panels: list[Axes] = list(figure.subplots(len(inputs), 1, sharex=True, squeeze=False).flat)
    for axes, each in zip(panels, inputs, strict=True):
        t, values = np.array(each.t), np.array(each.values)
        axes.plot(t, values, color=BLUE, linewidth=THICK)
        knots = np.isin(t, each.knots)
        axes.plot(t[knots], values[knots], "o", color=BLUE, markersize=2.5, clip_on=False)
        axes.set_ylabel(style.with_unit(each.name, each.unit))
        margin = 0.05 * (each.high - each.low)
        axes.set_ylim(each.low - margin, each.high + margin)  # one scale for the inputs of all tests
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.01)
    panels[0].set_title("input signals of the worst test")
    panels[-1].set_xlabel("t / s")


def draw_histogram(figure: Figure, problem: Problem, drawn: Drawn) -> Axes:
    """Draw the robustness at drawn starts, violations in red, with the bounds of the claims."""
    axes = figure.subplots()
    edges, counts = np.array(drawn.edges), np.array(drawn.counts)
    colours = [RED if right <= 0 else BLUE for right in edges[1:]]
    axes.bar(edges[:-1], counts, np.diff(edges), align="edge", color=colours, linewidth=0, alpha=0.6)
    for mark, dashes in zip(drawn.marks, itertools.cycle(DASHES)):
        label = f"{style.plain_text(mark.name)}: {outward(mark.value, mark.sense)}"
        axes.axvline(mark.value, color="black", linestyle=dashes, linewidth=THICK, label=label)
    if edges[0] < 0 < edges[-1]:
        axes.axvline(0.0, color=RED, linewidth=THIN)
    axes.set(title=_title(problem), xlabel=style.with_unit("robustness", drawn.unit), ylabel="rollouts")
    axes.spines[["top", "right"]].set_visible(False)
    if drawn.marks:
        figure.legend(loc="outside lower center", ncols=2, borderaxespad=0)
    return axes


def draw_problem_decay(figure: Figure, problem: Problem) -> Axes:
    """Draw how the distance of a problem's bounds decays over its tests, down to its tolerance."""
    axes = figure.subplots()
    found = [pair for pair in zip(problem.tests.test, problem.tests.distance, strict=True) if pair[1]]
    axes.plot(*zip(*found, strict=True), color=BLUE, linewidth=THICK)
    assert problem.alpha is not None, "what has a distance has a tolerance"
    style.draw_tolerance(axes, problem.alpha, RED, rf"tolerance $\alpha = {problem.alpha:g}$")
    axes.set_title(_title(problem))
    style.decay_axes(axes, style.with_unit(DISTANCES[problem.distance], problem.unit))
    axes.legend(loc="upper right", borderaxespad=0)
    return axes


def _array(values: Series) -> Floats:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _title(problem: Problem) -> str:
    number = problem.observed
    name = ", ".join(filter(None, (problem.name.replace("_", " "), problem.requirement)))
    return f"{name}: {counted(number, 'test')}, method {problem.method}"
