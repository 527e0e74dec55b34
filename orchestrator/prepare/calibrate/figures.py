"""The evidence of a calibration as one picture for each problem, in the style of the other figures."""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes

from ...mathematics.calibration.norm_growth import sizes_of
from ...mathematics.calibration.steepness import quotients
from ...mathematics.calibration.trust import KernelTrial
from ...mathematics.calibration.variogram import variogram
from ...report import style
from ...report.style import BLUE, GREEN, GREY, RED, THICK, THIN
from ..rounded import rounded_up
from .budget import BudgetForecast
from .constants import ProblemCalibration
from .forecast import Forecast

WIDTH, HEIGHT, FORECAST = 7.2, 4.4, 2.2
"""Inches; the last one is the height of a forecast below the panels."""
COLOURS = (BLUE, GREEN, RED)
BINS = 30


def calibration_picture(found: ProblemCalibration, guess: Forecast | None) -> bytes:
    """Return the picture of one problem as PNG; the bounds of several budgets are below the panels."""
    budgets = guess if isinstance(guess, BudgetForecast) else None
    with style.new_figure(HEIGHT + FORECAST * (budgets is not None), WIDTH) as figure:
        rows = 2 if budgets is None else 3
        places = figure.add_gridspec(rows, 3)
        for number, draw in enumerate(_PANELS):
            axes = figure.add_subplot(places[divmod(number, 3)])
            axes.spines[["top", "right"]].set_visible(False)
            draw(axes, found)
        if budgets is not None:
            axes = figure.add_subplot(places[2, :])
            axes.spines[["top", "right"]].set_visible(False)
            _draw_budgets(axes, budgets)
        trial = found.choice.chosen
        verdict = (
            "no kernel is trustworthy" if trial is None else f"nu = {trial.fit.nu:g}, B = {rounded_up(trial.bound):g}"
        )
        figure.suptitle(f"{found.name.replace('_', ' ')}: {verdict}", fontsize=9)
    return style.png(figure)


def _drawn_trial(found: ProblemCalibration) -> KernelTrial | None:
    """Return the kernel that is drawn: the chosen one, else the roughest that was tried."""
    return found.choice.chosen or next(reversed(found.choice.trials), None)


def _draw_variogram(axes: Axes, found: ProblemCalibration) -> None:
    axes.set(title="variogram", xlabel="distance / length scales", ylabel=r"half squared difference")
    if (trial := _drawn_trial(found)) is None:
        return
    drawn = variogram(trial.fit, found.measured.data)
    axes.plot(drawn.distances, drawn.halves, "o", color=GREEN, markersize=3)
    axes.plot(drawn.distances, drawn.fitted, color=BLUE, linewidth=THICK, label=f"kernel, nu = {trial.fit.nu:g}")
    axes.set_ylim(bottom=0)
    axes.legend(loc="best")


def _draw_predictions(axes: Axes, found: ProblemCalibration) -> None:
    axes.set(title="each value, from all others", xlabel="predicted", ylabel="observed")
    if (trial := _drawn_trial(found)) is None:
        return
    drawn = trial.predictions
    axes.plot(drawn.predicted, drawn.observed, "o", color=GREEN, markersize=2, alpha=0.7, markeredgewidth=0)
    ends = [float(drawn.observed.min()), float(drawn.observed.max())]
    axes.plot(ends, ends, color=GREY, linewidth=THIN)


def _draw_norms(axes: Axes, found: ProblemCalibration) -> None:
    axes.set(title="norm that the values need", xlabel="starts", ylabel="norm", xscale="log", yscale="log")
    for trial, colour in zip(found.choice.trials, COLOURS, strict=False):
        marker = "o-" if not trial.faults else "x:"
        growth = trial.growth
        axes.plot(
            growth.sizes,
            growth.norms,
            marker,
            color=colour,
            markersize=3,
            linewidth=THICK,
            label=f"nu = {trial.fit.nu:g}",
        )
    sizes = sizes_of(len(found.measured.values))
    style.plain_ticks(axes.xaxis, sizes)
    if (chosen := found.choice.chosen) is not None:
        style.draw_tolerance(axes, rounded_up(chosen.bound), "black", "B")
    style.plain_numbers(axes.yaxis)
    if found.choice.trials:
        axes.legend(loc="best")


def _draw_steepness(axes: Axes, found: ProblemCalibration) -> None:
    axes.set_title("steepest places")
    measured, sizes = found.measured, sizes_of(len(found.measured.values))
    spacing = [size ** (-1.0 / measured.shares.shape[1]) for size in sizes]
    largest = quotients(measured.data, sizes)
    if max(largest) <= 0:
        axes.text(0.5, 0.5, "no difference beyond the noise", ha="center", va="center", transform=axes.transAxes)
        axes.set(xticks=(), yticks=())
        return
    axes.set(xlabel="distance / range", ylabel="difference quotient", xscale="log", yscale="log")
    axes.plot(spacing, largest, "o-", color=BLUE, markersize=3, linewidth=THICK, label="all starts")
    for number, descent in enumerate(measured.descents):
        found_places = [each for each in descent.places if each.quotient > 0]
        axes.plot(
            [each.distance for each in found_places],
            [each.quotient for each in found_places],
            "x-" if descent.is_jump else ".-",
            color=RED if descent.is_jump else GREEN,
            linewidth=THIN,
            markersize=4,
            label={True: "jump", False: "halved"}[descent.is_jump] if number == 0 else None,
        )
    axes.invert_xaxis()
    low, high = axes.get_ylim()
    axes.set_ylim(low / 2, high * 2)  # quotients that differ by percents are equal for this question
    style.plain_numbers(axes.xaxis, (1.0,))
    style.plain_numbers(axes.yaxis)
    axes.legend(loc="best")


def _draw_noise(axes: Axes, found: ProblemCalibration) -> None:
    axes.set(title="noise", xlabel="mean of J at a start", ylabel="standard deviation")
    measured = found.measured
    if not measured.noisy:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "rollouts do not depend\non the seed", ha="center", transform=axes.transAxes)
        return
    means, spreads = measured.values.mean(axis=1), measured.values.std(axis=1, ddof=1)
    axes.plot(means, spreads, "o", color=GREEN, markersize=2, alpha=0.5, markeredgewidth=0, label="each start")
    if measured.at_noisiest.size:
        at = measured.at_noisiest
        axes.plot(at.mean(axis=1), at.std(axis=1, ddof=1), "D", color=RED, markersize=3, label="noisiest, again")
    scale = found.keys.get("noise_scale")
    if isinstance(scale, float):
        style.draw_tolerance(axes, scale, "black", "R")
    spread = found.keys.get("spread")
    if isinstance(spread, float):
        style.draw_tolerance(axes, spread, "black", "spread")
    axes.set_ylim(bottom=0)
    axes.legend(loc="best")


def _draw_histogram(axes: Axes, found: ProblemCalibration) -> None:
    measured = found.measured
    share = "" if measured.clipped is None else f", {100 * measured.clipped:.2g} % at an end of the clip"
    axes.set(title=f"values{share}", xlabel="J", ylabel="rollouts")
    axes.hist(measured.values.ravel(), bins=BINS, color=BLUE, alpha=0.6)
    mean = found.keys.get("prior_mean", float(np.mean(measured.values)))
    if isinstance(mean, float):
        axes.axvline(mean, color="black", linestyle="--", linewidth=THICK)


def _draw_budgets(axes: Axes, guess: BudgetForecast) -> None:
    axes.set(title="forecast", xlabel="rollouts", ylabel="bound", xscale="log")
    sizes = [each.enters for each in guess.budgets]
    middles = [guess.sign * each.bound.middle for each in guess.budgets]
    low, high = (list(each) for each in zip(*(each.bound.ends(guess.sign) for each in guess.budgets), strict=True))
    axes.fill_between(sizes, low, high, color=BLUE, alpha=0.2, linewidth=0)
    axes.plot(sizes, middles, "o-", color=BLUE, markersize=3, linewidth=THICK, label="expected, with its range")
    at, bound = guess.proposed.enters, guess.sign * guess.proposed.bound.middle
    axes.plot([at], [bound], "D", color=RED, markersize=5, label="proposed")
    axes.axhline(guess.sign * guess.fitted, color=GREY, linestyle="--", linewidth=THIN, label="worst fitted start")
    axes.axhline(guess.sign * guess.without, color=GREY, linestyle=":", linewidth=THIN, label="without rollouts")
    style.plain_ticks(axes.xaxis, sizes)
    axes.legend(loc="best")


_PANELS: tuple[Callable[[Axes, ProblemCalibration], None], ...] = (
    _draw_variogram,
    _draw_predictions,
    _draw_norms,
    _draw_steepness,
    _draw_noise,
    _draw_histogram,
)
