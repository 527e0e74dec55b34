"""The paper's Fig. 2 and Fig. 4 from the histories of campaigns, and the numbers behind them as CSV.

Figures are as wide as a column of the paper. Colours are those of Okabe and Ito, which colour-blind people tell apart.
"""

import io
import statistics
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter
from PIL import Image
from scipy.spatial.distance import cdist

from ...store.read import ObservedTest
from .text import csv_text

WIDTH = 3.5
"""Inches, a column of the paper."""
DPI = 300
BLUE, GREEN, RED, GREY = "#0072B2", "#009E73", "#D55E00", "#555555"
GREYS = ListedColormap(mpl.colormaps["Greys"](np.linspace(0.02, 0.6, 20)))
STYLE: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.linewidth": 0.6,
    "legend.fontsize": 7,
    "legend.frameon": False,
}
THICK, THIN = 1.0, 0.4
"""Widths of lines in points."""

Tests = Sequence[ObservedTest]


@dataclass(frozen=True, slots=True)
class Decay:
    """One problem: its tolerance alpha, and its tests by seed; there is at least one seed."""

    problem: str
    alpha: float
    runs: Mapping[int, Tests]


LOOKS = {
    "true_risk": (RED, r"true risk, $\rho^*$"),
    "nominal_robustness": (BLUE, r"nominal robustness, $\hat\rho^*$"),
    "sim_gap": (GREEN, r"gap, $e^*$"),
}
"""Colour and name of a problem in Fig. 4."""


@contextmanager
def _drawn(height: float) -> Iterator[Figure]:
    """Yield a figure of `height` inches in the one style; nobody else's style changes."""
    with mpl.rc_context(STYLE):
        yield Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")


def png(figure: Figure) -> bytes:
    """Return a figure as PNG with a palette, a third of the size; equal figures give equal bytes."""
    drawn, packed = io.BytesIO(), io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(drawn, format="png")
    pixels = np.asarray(Image.open(drawn).convert("RGB"), dtype=np.int64)  # (h, w, 3)
    palette = _palette()
    picture = Image.fromarray(_nearest(pixels, palette))
    picture.putpalette(palette.tobytes())
    picture.save(packed, format="png", optimize=True, dpi=(DPI, DPI))
    return packed.getvalue()


def _palette() -> npt.NDArray[np.uint8]:
    """Return the colours of lines, each in 64 steps to white, shape (256, 3)."""
    ramps = [np.linspace(to_rgb(colour), (1.0, 1.0, 1.0), 64) for colour in ("black", RED, GREEN, BLUE)]
    return np.round(255 * np.concatenate(ramps)).astype(np.uint8)


def _nearest(pixels: npt.NDArray[np.int64], palette: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return the index of the nearest colour per pixel, shape (h, w); Pillow's own search is inexact."""
    codes, where = np.unique(pixels @ (65536, 256, 1), return_inverse=True)  # (k,), (h, w)
    colours = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1)  # (k, 3)
    nearest: npt.NDArray[np.uint8] = cdist(colours, palette).argmin(axis=1).astype(np.uint8)  # (k,)
    return nearest[where].reshape(pixels.shape[:2])


def curve(tests: Tests) -> tuple[list[int], list[float]]:
    """Return i and F_i of all tests but the start, which no posterior chose."""
    chosen = [(each.test, each.proposal.F) for each in tests if each.proposal.F is not None]
    return [test for test, _ in chosen], [regret for _, regret in chosen]


def typical(runs: Mapping[int, Tests]) -> int:
    """Return the seed with the median number of tests: the lower of two, the first of equals."""
    count = statistics.median_low(len(tests) for tests in runs.values())
    return min(seed for seed, tests in runs.items() if len(tests) == count)


def figure_2(found: Decay) -> Figure:
    """Draw the test function with the tests and the bound of one campaign; below, F_i of all campaigns."""
    with _drawn(4.8) as figure:
        axes = figure.subplot_mosaic("MB;DD", width_ratios=(1, 0.05), height_ratios=(1.45, 1))
        _map(axes["M"], found.runs[typical(found.runs)])
        _bar(figure, axes["B"], found.runs[typical(found.runs)][-1].bound.upper)
        below = axes["D"]
        for tests in found.runs.values():
            below.plot(*curve(tests), color=GREY, linewidth=THIN, alpha=0.7)
        below.axhline(found.alpha, color=RED, linestyle="--", linewidth=THICK)
        _entry(below, GREY, f"{len(found.runs)} campaigns")
        _entry(below, RED, rf"tolerance $\alpha = {found.alpha:g}$", "--")
        _decay_axes(below, "$F_i$")
        below.set_xlim(left=0)
        below.legend(loc="upper right", borderaxespad=0)
    return figure


def _map(axes: Axes, tests: Tests) -> None:
    """Draw J(z) = sin(z1) cos(z2) / 2 over [0, 5]^2, and each tested z as a dot that grows with its tests."""
    side = np.linspace(0.0, 5.0, 201)  # (201,)
    surface = np.sin(side[None, :]) * np.cos(side[:, None]) / 2.0  # (201, 201), rows are z2
    axes.contourf(side, side, surface, levels=np.linspace(-0.5, 0.5, 21), cmap=GREYS)
    counts = dict(Counter(each.proposal.x for each in tests).most_common())  # small dots upon large ones
    z1, z2 = zip(*counts, strict=True)
    areas = [6.0 + 4.0 * count for count in counts.values()]  # pt^2
    axes.scatter(z1, z2, areas, color=GREEN, alpha=0.7, edgecolor="white", linewidth=0.5, clip_on=False, zorder=3)
    axes.set(xlabel="$z_1$", ylabel="$z_2$", xticks=range(6), yticks=range(6))
    axes.set_title(f"{len(tests)} tests at {len(counts)} points", color=GREEN, fontsize=8)


def _bar(figure: Figure, axes: Axes, bound: float | None) -> None:
    """Draw the colour bar: it is the axis of J, and the bound stands on it."""
    bar = figure.colorbar(ScalarMappable(Normalize(-0.5, 0.5), GREYS), cax=axes, ticks=(-0.5, -0.25, 0, 0.25))
    bar.set_label("$J(z)$", labelpad=0)
    if bound is not None:
        axes.set_ylim(-0.5, max(0.53, bound + 0.01))
        axes.axhline(bound, color=BLUE, linewidth=1.8, clip_on=False)
        beside = axes.get_yaxis_transform()
        axes.text(1.3, bound, rf"$\epsilon = {bound:.3f}$", color=BLUE, va="center", transform=beside)


def figure_4(decays: Sequence[Decay]) -> Figure:
    """Draw F_i of the Segway's problems below each other: every seed thin, the typical one thick, a dot at its end."""
    with _drawn(0.35 + 1.35 * len(decays)) as figure:
        panels = figure.subplots(len(decays), 1, sharex=True, squeeze=False)[:, 0]
        for axes, each in zip(panels, decays, strict=True):
            _panel(axes, each)
            axes.label_outer()
        panels[0].set_xlim(0, 1.02 * max(len(tests) for each in decays for tests in each.runs.values()))
    return figure


def _panel(axes: Axes, found: Decay) -> None:
    colour, label = LOOKS[found.problem]
    thick = typical(found.runs)
    for seed, tests in found.runs.items():
        _run(axes, tests, colour, thick=seed == thick)
    axes.axhline(found.alpha, color=colour, linewidth=THICK, linestyle="--", zorder=4)
    _entry(axes, colour, f"{label}: {counted(found.runs)}")
    _entry(axes, colour, rf"$\alpha = {found.alpha:g}$ rad", "--")
    _decay_axes(axes, "$F_i$ / rad")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, borderaxespad=0, columnspacing=1)


def _run(axes: Axes, tests: Tests, colour: str, *, thick: bool) -> None:
    steps, regrets = curve(tests)
    if thick:
        axes.plot(steps, regrets, color=colour, linewidth=THICK, zorder=3)
    else:
        axes.plot(steps, regrets, color=colour, linewidth=THIN, alpha=0.45)
    size, order = (5.0, 6) if thick else (3.5, 5)
    dot = axes.plot(steps[-1:], regrets[-1:], "o", color=colour, markersize=size, zorder=order)
    dot[0].set(markeredgecolor="white", markeredgewidth=0.4)


def counted(runs: Mapping[int, Tests]) -> str:
    """Return how many tests the campaigns needed: the median, and least to greatest."""
    counts = [len(tests) for tests in runs.values()]
    middle = f"{statistics.median(counts):.0f} tests"
    return middle if len(counts) == 1 else f"{middle} ({min(counts)} to {max(counts)})"


def _entry(axes: Axes, colour: str, label: str, style: str = "-") -> None:
    """Add a line to the legend alone."""
    axes.plot([], [], style, color=colour, linewidth=THICK, label=label)


def _decay_axes(axes: Axes, label: str) -> None:
    axes.set(xlabel="test $i$", ylabel=label, yscale="log")
    axes.yaxis.set_major_locator(FixedLocator((0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.spines[["top", "right"]].set_visible(False)


def figure_2_csv(found: Decay) -> str:
    """Return the numbers of Fig. 2; y and upper are those of the maximised J."""
    lines = (_line(seed, each) for seed, tests in found.runs.items() for each in tests)
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


def _line(seed: int, test: ObservedTest) -> tuple[object, ...]:
    chosen, bound = test.proposal, test.bound
    return seed, test.test, *chosen.x, test.observation.y, chosen.F, bound.upper, test.stopped_by
