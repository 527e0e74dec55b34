"""The picture of a rollout: the curves that its specification reads, over time."""

import io
import textwrap
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ....schemas.trajectory.trajectory import Trajectory
from ..style import BLUE, RED, with_unit
from .curves import values_of

WIDTH = 10.0
"""Inches."""
DPI = 150
CHARACTERS, LINE = 115, 0.17
"""Of a line of the title, and its height in inches."""
LABEL, TITLE = 20, 70
"""Characters beside a panel, and above it."""
STYLE: dict[Any, Any] = {"font.family": "DejaVu Sans", "font.size": 9, "axes.linewidth": 0.6}


@dataclass(frozen=True, slots=True)
class Panel:
    """One quantity over time, simulated again and recorded, with the limits of the specification."""

    quantity: str
    unit: str
    limits: tuple[float, ...] = ()
    marked: bool = True
    """Whether it has a mark at the worst sample."""


@dataclass(frozen=True, slots=True)
class Picture:
    """The content of a picture; `worst` is the sample that decides the robustness, where it is one."""

    title: str
    again: Trajectory
    recorded: Trajectory | None
    panels: tuple[Panel, ...]
    worst: int | None


def drawn(picture: Picture) -> bytes:
    """Return the picture as PNG; equal pictures give equal bytes."""
    out = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure = _figure_of(picture)
        figure.savefig(out, format="png", metadata={"Software": None}, pil_kwargs={"optimize": True})
    return out.getvalue()


def _figure_of(picture: Picture) -> Figure:
    height = (1.9 if len(picture.panels) == 1 else 1.4) * len(picture.panels) + 0.6
    # A line as wide as the picture: disturbances make it a long one.
    title = textwrap.fill(picture.title, CHARACTERS)
    figure = Figure(figsize=(WIDTH, height + LINE * title.count("\n")), dpi=DPI, layout="constrained")
    figure.suptitle(title, fontsize=10)
    rows = figure.subplots(len(picture.panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(rows, picture.panels, strict=True):
        _draw_panel(axes, picture, panel)
    rows[-1].set_xlabel("t / s")
    return figure


def _draw_panel(axes: Axes, picture: Picture, panel: Panel) -> None:
    # A single sample has no line.
    marker = "o" if len(picture.again.samples) == 1 else "-"
    if picture.recorded is not None:
        t, values = picture.recorded.samples[:, 0], values_of(picture.recorded, panel.quantity)
        axes.plot(t, values, marker, color=BLUE, alpha=0.3, linewidth=4, markersize=9, label="recorded")
    t, values = picture.again.samples[:, 0], values_of(picture.again, panel.quantity)
    axes.plot(t, values, marker, color=BLUE, linewidth=1, markersize=4, label="simulated again")
    for limit in panel.limits:
        axes.axhline(limit, color=RED, linestyle="--", linewidth=0.9)
    if picture.worst is not None and panel.marked:
        axes.plot([t[picture.worst]], [values[picture.worst]], "o", color=RED, markersize=5)
    if len(panel.quantity) <= LABEL:
        axes.set_ylabel(with_unit(panel.quantity, panel.unit))
    else:  # an expression is longer than a small panel is high
        name = panel.quantity if len(panel.quantity) <= TITLE else f"{panel.quantity[: TITLE - 3]}..."
        axes.set_title(with_unit(name, panel.unit), loc="left", fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.01)
    if picture.recorded is not None:
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, fontsize=8, frameon=False, ncols=2)
