"""Bounds of the Segway's risk against the number of true rollouts, beside the other claims."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from perfbound.orchestrator.report import style
from perfbound.orchestrator.report.style import GREEN, GREY, RED, THICK, THIN
from tests.studies.tightness.claims import Claim
from tests.studies.tightness.curves import Curve, Worst

FIRST, LAST, RIGHT = 70, 6400, 16_000
LABELS = {  # text; where it is: factor of the rollouts, and what is added to the bound; which end of it is there
    "printed, Theorem 2": ("Theorem 2, printed", (1.1, 0.0), "left"),
    "segway-paper": ("Theorem 2, reproduced", (1.1, 0.0), "left"),
    "printed, direct": ("direct method, printed", (0.9, -0.02), "right"),
    "segway-direct": ("direct method, reproduced", (0.9, 0.012), "right"),
    "segway-pair": ("method rigorous", (1.05, -0.035), "right"),
    "segway-scenario": ("method scenario, about 25 starts", (1.1, 0.037), "right"),
}
GAP = 0.034
"""Between the labels of two lines, in the unit of the risk."""


def figure(curves: Sequence[Curve], truth: Worst, others: dict[str, Claim]) -> Figure:
    """Draw a line for each norm with its range over the seeds, the other claims as marks, and the risk itself."""
    with style.new_figure(3.9, 5.6) as found:
        axes = found.subplots()
        axes.plot([FIRST, LAST * 1.08], [truth.risk] * 2, color=GREY, linewidth=THICK, linestyle="--")
        axes.text(FIRST * 1.05, truth.risk + 0.012, f"risk at the worst start, {truth.risk:.3f}", color=GREY)
        shown = [each for each in curves if each.controlled]
        shades = mpl.colormaps["Blues"](np.linspace(1.0, 0.45, len(shown)))
        for each, colour in zip(shown, shades, strict=True):
            _curve(axes, each, colour)
            for other in curves:
                if not other.controlled and other.norm == each.norm:
                    _without(axes, other, colour)
        ends = [float(np.median(each.bounds[LAST])) for each in shown]
        for each, colour, height in zip(shown, shades, apart(ends), strict=True):
            axes.text(LAST * 1.12, height + GAP / 2, f"$B = {each.norm:g}$", color=colour, va="center")
        for name, claim in others.items():
            _other(axes, name, claim)
        _legend(axes)
        axes.set(xscale="log", xlim=(FIRST, RIGHT), xlabel="rollouts of the true Segway")
        axes.set(ylabel=r"lower bound of the risk $\rho^*$ / rad")
        style.plain_ticks(axes.xaxis, sorted(curves[0].bounds))
        axes.spines[["top", "right"]].set_visible(False)
    return found


def apart(heights: Sequence[float]) -> list[float]:
    """Return heights of labels from top to bottom, each at least GAP below the one before.

    >>> apart([0.63, 0.62, 0.5])
    [0.63, 0.596, 0.5]
    """
    found: list[float] = []
    for height in heights:
        found.append(min(height, found[-1] - GAP) if found else height)
    return found


def _curve(axes: Axes, found: Curve, colour: object) -> None:
    rollouts = sorted(found.bounds)
    each = [found.bounds[count] for count in rollouts]
    medians = np.median(each, axis=1)
    # Without a rollout: what the assumption alone proves.
    axes.plot([FIRST, rollouts[0]], [found.alone] * 2, color=colour, linewidth=THICK, alpha=0.45)
    axes.plot([rollouts[0]] * 2, [found.alone, medians[0]], color=colour, linewidth=THIN, linestyle=":", alpha=0.7)
    axes.fill_between(rollouts, np.min(each, axis=1), np.max(each, axis=1), color=colour, alpha=0.2, linewidth=0)
    axes.plot(rollouts, medians, "o-", color=colour, linewidth=THICK, markersize=3)


def _without(axes: Axes, found: Curve, colour: object) -> None:
    rollouts = sorted(found.bounds)
    medians = [float(np.median(found.bounds[count])) for count in rollouts]
    axes.plot(rollouts, medians, ":", color=colour, linewidth=THICK)


def _other(axes: Axes, name: str, claim: Claim) -> None:
    colour, mark = (RED, "x") if claim.is_refuted else (GREEN, "s")
    # A printed claim has no range: it is hollow.
    printed = name.startswith("printed")
    axes.plot([claim.rollouts] * 2, [claim.least, claim.greatest], color=colour, linewidth=THICK, alpha=0.6, zorder=3)
    axes.plot(
        [claim.rollouts],
        [claim.bound],
        "D" if printed else mark,
        color=colour,
        markerfacecolor="white" if printed else colour,
        markersize=4,
        zorder=4,
    )
    text, (factor, added), side = LABELS[name]
    axes.text(claim.rollouts * factor, claim.bound + added, text, color=colour, ha=side, va="center")


def _legend(axes: Axes) -> None:
    shade = mpl.colormaps["Blues"](0.8)
    axes.plot([], [], "o-", color=shade, linewidth=THICK, markersize=3, label="method kriging: median and range")
    axes.plot([], [], ":", color=shade, linewidth=THICK, label="its median without the control")
    axes.plot([], [], color=shade, linewidth=THICK, alpha=0.45, label="its assumptions alone, without a rollout")
    axes.plot([], [], "s", color=GREEN, markersize=4, label="other claims, not refuted")
    axes.plot([], [], "x", color=RED, markersize=4, label="claims whose own data refute an assumption")
    axes.plot([], [], "D", color=RED, markerfacecolor="white", markersize=4, label="the same as the paper prints them")
    axes.legend(loc="lower right", borderaxespad=0.2)
