"""The style of all figures: colours, sizes, the map and the decay, and their files.

Figures are as wide as a column of the paper. The colours are those of Okabe and Ito, which colour-blind readers can
tell apart.
"""

import io
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator, StrMethodFormatter

from ..mathematics.gp.kernels import Floats

WIDTH = 3.5
"""Inches, a column of the paper."""
DPI = 300
BLUE, GREEN, RED, GREY = "#0072B2", "#009E73", "#D55E00", "#555555"
GREYS = ListedColormap(mpl.colormaps["Greys"](np.linspace(0.02, 0.6, 20)))
THICK, THIN = 1.0, 0.4
"""Widths of lines in points."""
TICKS = tuple(digit * 10.0**power for power in range(-6, 7) for digit in (1, 2, 5))
STYLE: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.linewidth": 0.6,
    "axes.titlesize": 8,
    "legend.fontsize": 7,
    "legend.frameon": False,
    # Equal figures give equal bytes: ids in an SVG are random without a salt.
    "svg.hashsalt": "perfbound",
    "svg.fonttype": "path",
}


@contextmanager
def new_figure(height: float, width: float = WIDTH) -> Iterator[Figure]:
    """Yield a figure of `height` inches in the one style; the style of other figures stays as it is."""
    with mpl.rc_context(STYLE):
        yield Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def png(figure: Figure) -> bytes:
    """Return a figure as PNG; equal figures give equal bytes."""
    return _saved(figure, format="png", metadata={"Software": None}, pil_kwargs={"optimize": True})


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG without a date; equal figures give equal bytes."""
    return _saved(figure, format="svg", metadata={"Date": None, "Creator": None})


def _saved(figure: Figure, **options: Any) -> bytes:
    out = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(out, **options)
    return out.getvalue()


def draw_map(axes: Axes, first: Floats, second: Floats, values: Floats, levels: Any) -> Any:
    """Draw values over the first two parameters, shape (second, first), and return what a colour bar needs."""
    return axes.contourf(first, second, values, levels=levels, cmap=GREYS)


def draw_tests(axes: Axes, starts: Iterable[Sequence[float]]) -> int:
    """Draw tested starts as dots that grow with their tests, and return the number of dots."""
    counts = dict(Counter(tuple(x[:2]) for x in starts).most_common())  # small dots on top of large ones
    areas = [4.0 + 3.0 * count for count in counts.values()]  # pt^2
    z1, z2 = zip(*counts, strict=True)
    axes.scatter(z1, z2, areas, color=GREEN, alpha=0.7, edgecolor="white", linewidth=THIN, clip_on=False, zorder=3)
    return len(counts)


def draw_tolerance(axes: Axes, alpha: float, colour: str, label: str) -> None:
    """Draw alpha as a dashed line with an entry in the legend."""
    axes.axhline(alpha, color=colour, linestyle="--", linewidth=THICK, zorder=4, label=label)


def decay_axes(axes: Axes, label: str) -> None:
    """Make these the axes of a distance that decays over the tests, with plain numbers on a logarithmic scale."""
    axes.set(xlabel="test $i$", ylabel=label, yscale="log")
    axes.yaxis.set_major_locator(FixedLocator(TICKS))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.spines[["top", "right"]].set_visible(False)


def plain_ticks(axis: Axis, at: Sequence[float]) -> None:
    """Give a logarithmic axis ticks at these numbers alone, as plain numbers."""
    axis.set_major_locator(FixedLocator(list(at)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_locator(NullLocator())


def plain_numbers(axis: Axis, of_decade: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Give a logarithmic axis these ticks of each decade, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=of_decade))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_locator(NullLocator())


def with_unit(name: str, unit: str) -> str:
    """Return an axis label; an untrusted unit must not be parsed as mathematics.

    >>> with_unit("phi", "rad"), with_unit("y", "1"), with_unit("y", "$x$")
    ('phi / rad', 'y', 'y / \\\\$x\\\\$')
    """
    return f"{name} / {plain_text(unit)}" if unit not in ("", "1") else name


def plain_text(text: str) -> str:
    """Return untrusted text, such as a unit, so that a figure shows it as it is."""
    return "".join(each for each in text if each.isprintable() and each != "\\").replace("$", r"\$")[:40]
