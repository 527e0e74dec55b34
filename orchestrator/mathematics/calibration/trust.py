"""The kernel that is proposed: of each smoothness the best one, what speaks against it, and the norm bound with it.

| symbol | name    | meaning                                                                     | shape | unit   |
|--------|---------|-----------------------------------------------------------------------------|-------|--------|
| b      |         | norm to which the values lead, see `norm_growth`                            | ()    | unit J |
| B      | `bound` | norm bound that is proposed                                                 | ()    | unit J |
| B s    | `width` | median half-width of the band at a start, predicted from the others         | ()    | unit J |
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .kernel_fit import SHORTEST, KernelFit, fit_kernel
from .leave_one_out import LeaveOneOut, leave_one_out
from .norm_growth import NormGrowth, needed_norm, norm_growth, refined
from .sampled import SampledValues
from .steepness import Descent

Fault = Literal["few", "equal", "jump", "rises", "unpredicted", "outlier", "short"]
"""Too few values; all of them equal; they jump; the norm rises with the resolution; the other values do not predict one
another, or one of them; the length scales are at the shortest that is tried."""

SMOOTHNESS = (2.5, 1.5, 0.5)
"""nu of the kernels that are tried; the last one has finite norms for nearly everything that is continuous."""
FEWEST = 32
"""Starts below which no trend of the norm is seen."""
# Of 480 functions of known norm, with 128 to 512 starts, B was below the norm in at most 4 % of those within the limits
# of a factor, and in 6 % beyond all of them; with 1.5 at ten times its limit in 14 %.
EXACT_MARGIN, NOISY_MARGIN = 1.5, 2.5
"""B over b. A posterior mean needs less norm than what it is the mean of."""
MARGINS = ((8e-5, EXACT_MARGIN), (4e-4, 2.0), (np.inf, NOISY_MARGIN))
"""B over b up to so much noise: the share of the variance of the values, over their number."""
HIDDEN = 3.0
"""Standard errors of a mean by which J may differ from m0 at a start, and nobody sees it."""
LAST, LAST_TWO = 1.1, 1.25
"""Factors of the norm over the last doubling, and the last two, up to which it levels off. A kink raises that of a
smooth kernel by 1.25 and more in each, a jump that of any kernel."""
NOISY_LAST, NOISY_LAST_TWO = 1.4, 1.8
"""With noise every doubling shows more of the same function."""
EXPLAINED = 0.9
"""Q^2 of exact values from which a kernel predicts them."""
EXCESS = 1.75
"""Square error of the prediction of noisy values, in units of their own noise, up to which a kernel predicts them."""
LARGEST = 3.6
"""Standard deviations from which a noisy value is no prediction error of the kernel."""
CLEAR = 0.003
"""Share of the variance of the values up to which noise hides nothing, so that they count as exact."""
DOUBTED, MOST_DOUBTED = 4, 0.05
"""Starts at least, and the share of them at most, that are simulated again because the others do not predict them:
noise alone would not do so twice."""
DOUBTFUL = 3.0
"""Standard deviations from which all of them are: among many starts skewed noise has some that are as far by chance."""
STRUCTURE = 7.0
"""Gain in likelihood below which noisy values show nothing but noise."""


@dataclass(frozen=True, slots=True)
class KernelTrial:
    """One kernel, the evidence about it, and B with it."""

    fit: KernelFit
    growth: NormGrowth
    predictions: LeaveOneOut
    bound: float
    width: float
    faults: tuple[Fault, ...]


@dataclass(frozen=True, slots=True)
class Choice:
    """The kernels that were tried, and the one to use."""

    trials: tuple[KernelTrial, ...]
    chosen: KernelTrial | None
    """None where no kernel is trustworthy."""
    faults: tuple[Fault, ...]
    """What speaks against every kernel, or the last of those that were tried."""
    plain: bool = False
    """Whether the values show nothing but noise, so that no length scale follows from them."""


def choose_kernel(
    data: SampledValues, finer: SampledValues | None, descents: Sequence[Descent], plain: KernelFit
) -> Choice:
    """Return the kernel with the tightest band among those that nothing speaks against.

    `finer` are the starts of the `descents`. `plain` is the kernel for noisy values that show no structure; of its
    lengths alone use is made. Values are in the unit of J.
    """
    if len(data.values) < FEWEST:
        return Choice((), None, ("few",))
    if not np.ptp(data.values) > 0:
        return Choice((), None, ("equal",))
    trials = tuple(_trial(fit_kernel(nu, data), data, finer) for nu in SMOOTHNESS)
    if any(descent.is_jump for descent in descents):
        return Choice(trials, None, ("jump",))
    if not data.exact and max(each.fit.gain for each in trials) < STRUCTURE:
        flat = _trial(plain, data, finer)
        # A fit to noise has no trend; but the values may differ by more than the noise, too fast for any kernel here.
        unseen = tuple(fault for fault in flat.faults if fault in ("unpredicted", "outlier"))
        return Choice((flat,), None if unseen else flat, unseen, plain=True)
    # By what speaks against a kernel, not by likelihood alone: that takes nu = 2.5 for kinks, whose norm has no limit.
    trusted = [each for each in trials if not each.faults]
    if not trusted:
        return Choice(trials, None, trials[-1].faults)
    return Choice(trials, min(trusted, key=lambda each: each.width), ())


def margin(data: SampledValues) -> float:
    """Return by what the norm that the values need is multiplied: more noise hides more of it."""
    noise = data.variance / max(float(np.var(data.values)), 1e-300) / len(data.values)
    return next(factor for most, factor in MARGINS if noise <= most)


def least_predicted(data: SampledValues) -> list[int]:
    """Return the starts whose noisy values are farthest from what the others predict, in standard deviations."""
    fit = fit_kernel(SMOOTHNESS[1], data)
    found = leave_one_out(fit, data)
    deviations = np.abs(found.observed - found.predicted) / (found.sd * fit.amplitude)
    most = int(MOST_DOUBTED * len(deviations))
    count = max(DOUBTED, min(most, int(np.count_nonzero(deviations > DOUBTFUL))))
    return [int(each) for each in np.argsort(-deviations, kind="stable")[:count]]


def _trial(fit: KernelFit, data: SampledValues, finer: SampledValues | None) -> KernelTrial:
    centre = float(data.values.mean())
    growth, predictions = norm_growth(fit, data, centre), leave_one_out(fit, data)
    norm = growth.limit
    if data.exact and finer is not None:
        # Exact values anywhere are a lower bound of the norm; the steepest places need the most of it.
        norm = max(norm, needed_norm(fit, refined(data, finer.shares, finer.values), centre))
    bound = max(margin(data) * norm, HIDDEN * data.variance**0.5)
    width = bound * float(np.median(predictions.sd))
    clear = data.variance <= CLEAR * float(np.var(data.values))
    return KernelTrial(
        fit, growth, predictions, bound, width, tuple(_trial_faults(fit, growth, predictions, clear=clear))
    )


def _trial_faults(fit: KernelFit, growth: NormGrowth, predictions: LeaveOneOut, *, clear: bool) -> list[Fault]:
    last, last_two = (LAST, LAST_TWO) if clear else (NOISY_LAST, NOISY_LAST_TWO)
    found: list[tuple[bool, Fault]] = [
        (growth.last > last or growth.last_two > last_two, "rises"),
        (predictions.explained < EXPLAINED if clear else predictions.excess > EXCESS, "unpredicted"),
        (not clear and predictions.largest > LARGEST, "outlier"),
        (bool(np.any(fit.lengths < 1.1 * SHORTEST)), "short"),
    ]
    return [fault for holds, fault in found if holds]
