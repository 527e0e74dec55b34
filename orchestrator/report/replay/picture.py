"""The picture of a rollout: a strip of moments from the side above the curves that its specification reads."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from ....schemas.trajectory import Trajectory
from ..style import BLUE, GREY, RED, with_unit
from .moments import Moment
from .solids import Film, Outline

WIDTH = 10.0
"""Inches."""
DPI = 150
MARGINS = LinearSegmentedColormap.from_list("margins", (RED, "#F0E442", "#009E73"))
STYLE: dict[Any, Any] = {"font.family": "DejaVu Sans", "font.size": 9, "axes.linewidth": 0.6}
BORDER = 0.08
"""Around the moving solids, relative to their extent."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One column over time, simulated again and recorded, with the limits of the specification."""

    column: str
    unit: str
    limits: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Picture:
    """The content of a picture; `ample` is the margin at the good end of the colours. `film` may be missing."""

    title: str
    again: Trajectory
    recorded: Trajectory | None
    panels: tuple[Panel, ...]
    moments: tuple[Moment, ...]
    film: Film | None
    ample: float = 1.0


def drawn(picture: Picture) -> bytes:
    """Return the picture as PNG; equal pictures give equal bytes."""
    out = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure = _figure_of(picture)
        figure.savefig(out, format="png", metadata={"Software": None}, pil_kwargs={"optimize": True})
    return out.getvalue()


def _figure_of(picture: Picture) -> Figure:
    strip = None if picture.film is None else _strip(picture.film, picture.moments)
    above = 0.0 if strip is None else strip.height
    below = (1.9 if len(picture.panels) == 1 else 1.4) * len(picture.panels) + 0.3
    figure = Figure(figsize=(WIDTH, 0.3 + above + below), dpi=DPI, layout="constrained")
    figure.suptitle(picture.title, fontsize=10)
    lower: Any = figure
    if strip is not None:
        upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=(above, below))[:, 0]
        _draw_strip(upper, picture, strip)
    rows = lower.subplots(len(picture.panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(rows, picture.panels, strict=True):
        _draw_panel(axes, picture, panel)
    rows[-1].set_xlabel("t / s")
    return figure


@dataclass(frozen=True, slots=True)
class _Strip:
    """The outlines at every moment, in one window for all: left, right, bottom, top in m."""

    seen: tuple[tuple[Outline, ...], ...]
    lead: str
    window: tuple[float, float, float, float]

    @property
    def height(self) -> float:
        """Inches on the picture, captions included."""
        left, right, bottom, top = self.window
        return 0.7 + (top - bottom) / (right - left) * 0.9 * WIDTH / len(self.seen)


def _strip(film: Film, moments: Sequence[Moment]) -> _Strip:
    seen = tuple(tuple(film.outlines(moment.frame)) for moment in moments)
    # Solids that never move (a floor) may be much larger than the window.
    points = np.concatenate([each.polygon for outlines in seen for each in outlines if each.frame in film.moving])
    (left, _), (right, top) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    border = BORDER * max(right - left, top)
    return _Strip(seen, film.outermost, (left - border, right + border, -border, top + border))


def _draw_strip(figure: Any, picture: Picture, strip: _Strip) -> None:
    panels = figure.subplots(1, len(picture.moments), squeeze=False)[0]
    scale = Normalize(0.0, picture.ample)
    left, right, bottom, top = strip.window
    for axes, outlines, moment in zip(panels, strip.seen, picture.moments, strict=True):
        colour = None if moment.margin is None else MARGINS(scale(moment.margin))
        for outline in outlines:
            _draw_outline(axes, outline, colour if outline.frame == strip.lead else None)
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xticks=(), yticks=())
        axes.spines[:].set(visible=moment.worst, color=RED, linewidth=1.5)
        axes.set_xlabel(f"{moment.t:.2f} s", color=RED if moment.worst else "black")
        if moment.worst:
            axes.set_title(f"worst: {moment.margin:.3f}", color=RED, fontsize=9)
    if picture.moments[0].margin is not None:
        bar = figure.colorbar(ScalarMappable(scale, MARGINS), ax=panels, fraction=0.015, pad=0.01, aspect=20)
        bar.set_label(with_unit("margin", picture.panels[0].unit))
        bar.outline.set_linewidth(0.4)


def _draw_outline(axes: Axes, outline: Outline, colour: Any) -> None:
    """Draw one solid in `colour`, or in its own if that is None."""
    *own, opacity = outline.color
    axes.add_patch(
        Polygon(outline.polygon, facecolor=colour or own, alpha=opacity, edgecolor="black", linewidth=0.4, zorder=2)
    )


def _draw_panel(axes: Axes, picture: Picture, panel: Panel) -> None:
    # A single sample has no line.
    marker = "o" if len(picture.again.samples) == 1 else "-"
    if picture.recorded is not None:
        t, values = picture.recorded.samples[:, 0], picture.recorded.column(panel.column)
        axes.plot(t, values, marker, color=BLUE, alpha=0.3, linewidth=4, markersize=9, label="recorded")
    t, values = picture.again.samples[:, 0], picture.again.column(panel.column)
    axes.plot(t, values, marker, color=BLUE, linewidth=1, markersize=4, label="simulated again")
    for limit in panel.limits:
        axes.axhline(limit, color=RED, linestyle="--", linewidth=0.9)
    for moment in picture.moments if picture.film else ():
        axes.axvline(moment.t, color=RED if moment.worst else GREY, linewidth=0.5, alpha=0.6, zorder=0)
    for moment in picture.moments:
        if moment.worst:  # the sample, not the frame of the film: it is the one that the robustness comes from
            axes.plot([moment.t], [values[int(np.argmin(np.abs(t - moment.t)))]], "o", color=RED, markersize=5)
    axes.set_ylabel(with_unit(panel.column, panel.unit))
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.01)
    if picture.recorded is not None:
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, fontsize=8, frameon=False, ncols=2)
