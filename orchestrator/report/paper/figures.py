"""The paper's Fig. 2 and Fig. 4 from the histories of campaigns, and their numbers as CSV."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ...store.facts import ObservedTest
from .. import style
from ..style import BLUE, GREEN, GREY, GREYS, RED, THICK, THIN
from .table_text import csv_text

Tests = Sequence[ObservedTest]


@dataclass(frozen=True, slots=True)
class Decay:
    """One problem: its tolerance alpha, and its tests by seed; there is at least one seed."""

    problem: str
    alpha: float
    runs: Mapping[int, Tests]


PANELS = {
    "true_risk": (RED, r"true risk, $\rho^*$"),
    "nominal_robustness": (BLUE, r"nominal robustness, $\hat\rho^*$"),
    "sim_gap": (GREEN, r"gap, $e^*$"),
}
"""Colour and name of a problem in Fig. 4."""


def curve(tests: Tests) -> tuple[list[int], list[float]]:
    """Return i and F_i of all tests but the first, which no posterior chose."""
    chosen = [(each.test, each.proposal.F) for each in tests if each.proposal.F is not None]
    return [test for test, _ in chosen], [regret for _, regret in chosen]


def typical(runs: Mapping[int, Tests]) -> int:
    """Return the seed with the median number of tests: the lower of two, the first of equals."""
    count = statistics.median_low(len(tests) for tests in runs.values())
    return min(seed for seed, tests in runs.items() if len(tests) == count)


def figure_2(found: Decay) -> Figure:
    """Draw the test function with the tests and the bound of one campaign; below, F_i of all campaigns."""
    with style.new_figure(4.8) as figure:
        axes = figure.subplot_mosaic("MB;DD", width_ratios=(1, 0.05), height_ratios=(1.45, 1))
        tests, below = found.runs[typical(found.runs)], axes["D"]
        _function_map(axes["M"], tests)
        _colour_bar(figure, axes["B"], tests[-1].bound.upper)
        for each in found.runs.values():
            below.plot(*curve(each), color=GREY, linewidth=THIN, alpha=0.7)
        _entry(below, GREY, f"{len(found.runs)} campaigns")
        style.draw_tolerance(below, found.alpha, RED, rf"tolerance $\alpha = {found.alpha:g}$")
        style.decay_axes(below, "$F_i$")
        below.set_xlim(left=0)
        below.legend(loc="upper right", borderaxespad=0)
    return figure


def _function_map(axes: Axes, tests: Tests) -> None:
    """Draw J(z) = sin(z1) cos(z2) / 2 over [0, 5]^2 with the tested z."""
    side = np.linspace(0.0, 5.0, 201)  # (201,)
    values = np.sin(side[None, :]) * np.cos(side[:, None]) / 2.0  # (201, 201), rows are z2
    style.draw_map(axes, side, side, values, levels=np.linspace(-0.5, 0.5, 21))
    points = style.draw_tests(axes, [each.proposal.x for each in tests])
    axes.set(xlabel="$z_1$", ylabel="$z_2$", xticks=range(6), yticks=range(6))
    axes.set_title(f"{len(tests)} tests at {points} points", color=GREEN)


def _colour_bar(figure: Figure, axes: Axes, bound: float | None) -> None:
    """Draw the colour bar as the axis of J, with the bound on it."""
    bar = figure.colorbar(ScalarMappable(Normalize(-0.5, 0.5), GREYS), cax=axes, ticks=(-0.5, -0.25, 0, 0.25))
    bar.set_label("$J(z)$", labelpad=0)
    if bound is not None:
        axes.set_ylim(-0.5, max(0.53, bound + 0.01))
        axes.axhline(bound, color=BLUE, linewidth=1.8, clip_on=False)
        beside = axes.get_yaxis_transform()
        axes.text(1.3, bound, rf"$\epsilon = {bound:.3f}$", color=BLUE, va="center", transform=beside)


def figure_4(decays: Sequence[Decay]) -> Figure:
    """Draw F_i of the Segway's problems below each other: every seed thin, the typical one thick, a dot at its end."""
    with style.new_figure(0.35 + 1.35 * len(decays)) as figure:
        panels = figure.subplots(len(decays), 1, sharex=True, squeeze=False)[:, 0]
        for axes, each in zip(panels, decays, strict=True):
            _panel(axes, each)
            axes.label_outer()
        panels[0].set_xlim(0, 1.02 * max(len(tests) for each in decays for tests in each.runs.values()))
    return figure


def _panel(axes: Axes, found: Decay) -> None:
    colour, label = PANELS[found.problem]
    typical_seed = typical(found.runs)
    for seed, tests in found.runs.items():
        steps, regrets = curve(tests)
        thick = seed == typical_seed
        width, alpha, size, order = (THICK, 1.0, 5.0, 6) if thick else (THIN, 0.45, 3.5, 5)
        axes.plot(steps, regrets, color=colour, linewidth=width, alpha=alpha, zorder=3 if thick else 2)
        dot = axes.plot(steps[-1:], regrets[-1:], "o", color=colour, markersize=size, zorder=order)
        dot[0].set(markeredgecolor="white", markeredgewidth=0.4)
    _entry(axes, colour, f"{label}: {counted(found.runs)}")
    style.draw_tolerance(axes, found.alpha, colour, rf"$\alpha = {found.alpha:g}$ rad")
    style.decay_axes(axes, "$F_i$ / rad")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, borderaxespad=0, columnspacing=1)


def counted(runs: Mapping[int, Tests]) -> str:
    """Return the number of tests of the campaigns: the median, and least to greatest."""
    counts = [len(tests) for tests in runs.values()]
    middle = f"{statistics.median(counts):.0f} tests"
    return middle if len(counts) == 1 else f"{middle} ({min(counts)} to {max(counts)})"


def _entry(axes: Axes, colour: str, label: str) -> None:
    """Add a line to the legend alone, where the drawn lines are many or thin."""
    axes.plot([], [], color=colour, linewidth=THICK, label=label)


def figure_2_csv(found: Decay) -> str:
    """Return the numbers of Fig. 2; y and upper are in terms of the maximised J."""
    lines = (
        (seed, each.test, *each.proposal.x, each.observation.y, each.proposal.F, each.bound.upper, each.stopped_by)
        for seed, tests in found.runs.items()
        for each in tests
    )
    return csv_text(("seed", "test", "z1", "z2", "y", "F", "upper", "stopped_by"), lines)


def figure_4_csv(decays: Sequence[Decay]) -> str:
    """Return the numbers of Fig. 4; F and alpha in rad."""
    lines = (
        (each.problem, seed, test.test, test.proposal.F, each.alpha, test.stopped_by)
        for each in decays
        for seed, tests in each.runs.items()
        for test in tests
    )
    return csv_text(("problem", "seed", "test", "F", "alpha", "stopped_by"), lines)
