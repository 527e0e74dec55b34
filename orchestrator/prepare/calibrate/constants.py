"""The constants that a calibration proposes for one problem, each with its reason and its margin.

| symbol | name       | meaning                                                           | shape  | unit   |
|--------|------------|-------------------------------------------------------------------|--------|--------|
| J      | `values`   | maximised objective of k rollouts at each start, with other seeds | (n, k) | unit J |
| m0, B, R |          | `prior_mean`, `rkhs_norm`, `noise_scale` of the file              | ()     | unit J |
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....schemas.amounts import counted
from ....schemas.file.config import CampaignConfig
from ....schemas.file.defaults import derived_lengths
from ....schemas.file.objectives import MethodName
from ....schemas.file.problem_models import Problem
from ...campaign.plan import ProblemPlan
from ...mathematics.calibration.kernel_fit import KernelFit
from ...mathematics.calibration.noise import FALLS, MARGIN, largest_deviation, nearest_starts, noise_scale, pooled
from ...mathematics.calibration.sampled import SampledValues
from ...mathematics.calibration.steepness import Descent
from ...mathematics.calibration.trust import Choice, KernelTrial, choose_kernel, margin
from ...mathematics.gp.kernels import Floats
from ..rounded import PARTS, rounded, rounded_up
from .design import Box

SHARE = 0.5
"""Of the distance between the worst start and what is required, the part that the tolerance may take."""


def required_objective(config: CampaignConfig, problem: Problem) -> float | None:
    """Return the largest J that meets what is required; None where the first claim is not that of one objective."""
    return None if getattr(problem, "linearised", None) is not None else required_bound(config, problem)


def required_bound(config: CampaignConfig, problem: Problem) -> float | None:
    """Return the largest bound on J that meets what is required; None where the first claim needs other bounds."""
    if len(config.problems) != 1 or config.specifications:
        return None
    return -config.required_margin if config.sense_of(problem) == "min" else config.required_at_most


Value = float | int | str | list[float] | dict[str, Any]
PLAIN_NU = 2.5
TESTS_AT_ONE_START = 40
"""Tests that would reach `alpha` if all were at one start; a campaign on a box needs several times as many."""
MOST_REPLICATES = 64
FEWEST_REPLICATES = 2
"""The audit compares R with the spread of replicates."""
WORST_SHARE = 0.05
"""Of the starts, those where values are least on average, around which c and s are taken."""
SPREAD_MARGIN = 1.2
"""A larger spread loses less by rare falls."""
FINE_NODES: Mapping[int, int] = {1: 101, 2: 41}
"""Nodes per parameter of method `kriging`, by the number of parameters, where the default is coarse."""


@dataclass(frozen=True, slots=True)
class Constant:
    """One constant of the campaign file."""

    key: str
    """As the file has it."""
    value: Value
    reason: str
    """In a sentence."""
    margin: str = ""
    """By which it is larger than what was seen; empty where none is added."""

    @property
    def why(self) -> str:
        """The reason with the margin."""
        return f"{self.reason} Margin: {self.margin}." if self.margin else self.reason


@dataclass(frozen=True, slots=True)
class PilotPace:
    """How fast the first rollouts of a calibration were, its largest batch, by the clock on the wall."""

    rollouts: int
    seconds: float
    """With the start of the workers: what a campaign costs besides the simulation is about as much."""
    workers: int
    """Side by side."""

    @property
    def cost(self) -> float:
        """Seconds that one worker takes for a rollout."""
        return self.seconds * self.workers / max(1, self.rollouts)

    @property
    def words(self) -> str:
        """The pace in words."""
        rate = float(f"{self.rollouts / max(self.seconds, 1e-3):.2g}")
        return f"{rate:g} rollouts per second on {counted(self.workers, 'worker')}, over {self.rollouts:,} of them"


@dataclass(frozen=True, slots=True)
class ProblemEvidence:
    """What the rollouts of a calibration show of one problem."""

    plan: ProblemPlan
    """With the clip and the constants of a linearised risk that hold for `values`."""
    box: Box
    shares: Floats
    """Starts as shares of the ranges, (n, p)."""
    values: Floats
    """Less what the control explains, as all values below; shape (n, k)."""
    plain: Floats
    """The same without a control."""
    noisiest: tuple[int, ...]
    """Starts with further rollouts."""
    at_noisiest: Floats
    """J of these, (m, l); empty without noise."""
    again: Mapping[int, float]
    """Mean of J of fresh rollouts at the starts that the others predict least; it replaces the first one."""
    descents: tuple[Descent, ...]
    clipped: float | None
    """Share of the rollouts whose robustness is at an end of the clip; None where nothing is clipped."""
    pace: PilotPace
    rollouts: int
    required: float | None = None
    """The largest J that meets what the campaign file requires; None where that is not about this problem alone."""

    @property
    def noisy(self) -> bool:
        """Whether rollouts depend on the seed."""
        return int(self.values.shape[1]) > 1

    @property
    def largest_seen(self) -> float | None:
        """The largest J of a rollout, where no rollout depends on the seed; else None."""
        if self.noisy:
            return None
        ends = (end.value for each in self.descents for place in each.places for end in (place.a, place.b))
        return max(float(self.values.max()), *ends)

    @property
    def explained(self) -> float:
        """Share of the variance of a rollout at its start that the control takes out."""
        whole = pooled(self.plain) ** 2
        return 1.0 - pooled(self.values) ** 2 / whole if whole > 0 else 0.0

    @property
    def data(self) -> SampledValues:
        """The means, with the pooled variance of one."""
        variance = pooled(self.values) ** 2 / self.values.shape[1]
        means = self.values.mean(axis=1)
        for start, mean in self.again.items():
            means[start] = mean
        return SampledValues(self.shares, means, variance if self.noisy else 0.0)

    @property
    def finer(self) -> SampledValues | None:
        """The starts in the middle of the steepest places."""
        # Both ends of the first place are among the starts already.
        ends = {
            end.shares: end.value
            for each in self.descents
            for before, after in zip(each.places, each.places[1:], strict=False)
            for end in (after.a, after.b)
            if end not in (before.a, before.b)
        }
        return SampledValues(np.array(list(ends)), np.array(list(ends.values())), self.data.variance) if ends else None


@dataclass(frozen=True, slots=True)
class ProblemCalibration:
    """The proposal for one problem, and its evidence."""

    measured: ProblemEvidence
    choice: Choice
    constants: tuple[Constant, ...]
    """Without the budget; empty where no kernel is trustworthy."""
    doubts: tuple[str, ...]
    """What speaks against every kernel, in sentences."""

    @property
    def name(self) -> str:
        """Name of the problem."""
        return self.measured.plan.name

    @property
    def keys(self) -> dict[str, Value]:
        """The constants as keys of the problem."""
        return {each.key: each.value for each in self.constants}


def calibrated(measured: ProblemEvidence, given: Mapping[str, Any], chosen: tuple[Constant, ...]) -> ProblemCalibration:
    """Return the proposal for a problem; `given` are its keys in the draft, `chosen` the constants that J has."""
    data = measured.data
    choice = choose_kernel(data, measured.finer, measured.descents, _plain_fit(measured))
    trial = choice.chosen
    if trial is None:
        return ProblemCalibration(measured, choice, (), tuple(_doubts(measured, choice)))
    constants = CONSTANTS[measured.plan.problem.method](measured, choice, trial, given)
    return ProblemCalibration(measured, choice, (*chosen, *constants), ())


def _rigorous_proposal(
    measured: ProblemEvidence, choice: Choice, trial: KernelTrial, given: Mapping[str, Any]
) -> tuple[Constant, ...]:
    """Return the constants of a problem by method `rigorous`, without its budget."""
    found = [*_kernel_constants(measured, choice, trial), _noise_constant(measured)]
    return (*found, *_effort(measured, trial, given, found))


def _kriging_proposal(
    measured: ProblemEvidence, choice: Choice, trial: KernelTrial, given: Mapping[str, Any]
) -> tuple[Constant, ...]:
    """Return the constants of a problem by method `kriging`, without its budget."""
    found = [*_kernel_constants(measured, choice, trial), _spread_constant(measured)]
    nodes = FINE_NODES.get(len(measured.box.names))
    if nodes is not None and "resolution" not in given:
        reason = "Nodes per parameter: the cells around them are so small that they cost the bound little."
        found.append(Constant("resolution", nodes, reason))
    return tuple(found)


CONSTANTS: Mapping[MethodName, Callable[..., tuple[Constant, ...]]] = {
    "rigorous": _rigorous_proposal,
    "kriging": _kriging_proposal,
}
"""What a method needs beside clip, linearised risk and budget: a row for each that is calibrated."""


def linearised_constants(shares: Floats, robustness: Floats) -> Constant:
    """Return centre and spread of a linearised risk, from clipped robustness (n, k), k >= 2, at starts (n, p)."""
    worst = _worst_starts(shares, robustness)
    centre, sd = float(robustness[worst].mean()), pooled(robustness[worst])
    spread = SPREAD_MARGIN * sd or 0.01 * float(np.ptp(robustness)) or 1.0
    value = {"centre": rounded(centre, spread), "spread": rounded_up(spread)}
    reason = (
        f"Mean and standard deviation ({sd:.3g}) of the robustness at the {len(worst)} worst of "
        f"{len(robustness):,} starts, where the bound has to be sharp."
    )
    return Constant("linearised", value, reason, f"spread times {SPREAD_MARGIN:g}")


def _worst_starts(shares: Floats, robustness: Floats) -> NDArray[np.intp]:
    """Return the starts (n, p) with the least robustness (n, k)."""
    # One start ranks by chance, and its own values would then be too low: its neighbours are ranked with it.
    means = robustness.mean(axis=1)[nearest_starts(shares)].mean(axis=1)
    worst = np.argsort(means, kind="stable")[: max(4, round(WORST_SHARE * len(robustness)))]
    return np.unique(nearest_starts(shares)[worst])


def _plain_fit(measured: ProblemEvidence) -> KernelFit:
    """Return the kernel of a file without one, for values that show no structure."""
    box, data = measured.box, measured.data
    lengths = derived_lengths(dict.fromkeys(box.names, (0.0, 1.0)))
    amplitude = math.sqrt(data.variance) or 1.0
    return KernelFit(PLAIN_NU, np.array([lengths[name] for name in box.names]), 1.0, amplitude, 0.0)


def _kernel_constants(measured: ProblemEvidence, choice: Choice, trial: KernelTrial) -> Iterator[Constant]:
    data, box, growth = measured.data, measured.box, trial.growth
    n, spread = len(data.values), float(np.ptp(data.values)) or 1.0
    yield Constant("prior_mean", rounded(float(data.values.mean()), spread), f"Mean of J over {n} starts.")
    lengths = {
        name: float(f"{length:.2g}")
        for name, length in zip(box.names, (trial.fit.lengths * box.widths).tolist(), strict=True)
    }
    if choice.plain:
        why = "The values show nothing but noise, so these are the length scales of a file without a kernel."
    else:
        others = ", ".join(f"{each.fit.nu:g}" for each in choice.trials if each.faults)
        why = (
            "The likelihood is largest with these; of the smoothnesses "
            + (f"whose norm levels off (not nu = {others}), " if others else "2.5, 1.5 and 0.5, which all fit, ")
            + f"this one has the narrowest band. {_prediction(measured, trial)}"
        )
    yield Constant("kernel", {"nu": trial.fit.nu, "length_scale": lengths}, why)
    steps = ", ".join(f"{norm:.3g} at {size}" for size, norm in zip(growth.sizes, growth.norms, strict=True))
    factor = margin(data)
    if choice.plain:
        reason = "So much may hide in the noise: the values show nothing else."
        yield Constant("rkhs_norm", rounded_up(trial.bound), reason, "3 standard errors of a mean, or more")
        return
    yield Constant(
        "rkhs_norm",
        rounded_up(trial.bound),
        f"The norm that the values need levels off: {steps} starts; the trend leads to {growth.limit:.3g}.",
        f"factor {factor:g}" if data.exact else f"factor {factor:g}, at least 3 standard errors of a mean",
    )


def _prediction(measured: ProblemEvidence, trial: KernelTrial) -> str:
    found = trial.predictions
    if measured.data.exact:
        return f"The other values explain {100 * found.explained:.4g} % of the variance of each."
    return f"Predictions of each value from the others miss by {math.sqrt(found.excess):.2f} times its own noise."


def _spread_constant(measured: ProblemEvidence) -> Constant:
    if not measured.noisy:
        least = rounded_up(_least_spread(measured.plain))
        return Constant("spread", least, "The rollouts do not depend on the seed; a hundredth of the range.")
    # Until its first fit a campaign has no control.
    reason = (
        f"Standard deviation of a rollout at the {len(_lowest(measured))} worst of {len(measured.values):,} starts, "
        "where the bound has to be sharp; no assumption."
    )
    return Constant("spread", rounded_up(spread_of(measured, measured.plain)), reason)


def spread_of(measured: ProblemEvidence, values: Floats) -> float:
    """Return the standard deviation of a rollout at the worst starts; `values` (n, k) are with or without a control."""
    return max(pooled(values[_lowest(measured)]), _least_spread(values))


def _lowest(measured: ProblemEvidence) -> NDArray[np.intp]:
    return _worst_starts(measured.shares, -measured.values)


def _least_spread(values: Floats) -> float:
    return 0.01 * float(np.ptp(values)) or 0.01


def _noise_constant(measured: ProblemEvidence) -> Constant:
    if not measured.noisy:
        return Constant("noise_scale", 0.0, "The rollouts do not depend on the seed.")
    scale = rounded_up(noise_scale(measured.values, measured.at_noisiest))
    limit = measured.plan.hoeffding
    at, each = measured.at_noisiest.shape
    sd = float(measured.at_noisiest.std(axis=1, ddof=1).max()) if at else pooled(measured.values)
    falls = largest_deviation(measured.shares, measured.values)
    if falls > FALLS and math.isfinite(limit):
        reason = f"A rollout deviates by {falls:.0f} standard deviations: no multiple of one bounds such falls."
        return Constant("noise_scale", "derived", f"{reason} R = {limit:.3g} follows from the clip.")
    if not 0 < scale < limit and math.isfinite(limit):
        reason = f"Half the range of the clipped objective, {limit:.3g}, is no more than {MARGIN:g} times what is seen."
        if scale == 0:
            reason = "No two rollouts at a start differ, and they may: R follows from the clip."
        return Constant("noise_scale", "derived", reason)
    reason = f"Largest standard deviation, {sd:.3g}, of {each} rollouts at each of the {at} noisiest starts."
    if pooled(measured.values) > sd:
        reason = f"Standard deviation of the rollouts at all starts together, {pooled(measured.values):.3g}."
    return Constant("noise_scale", scale or 1e-9, reason, f"factor {MARGIN:g}")


def _effort(
    measured: ProblemEvidence, trial: KernelTrial, given: Mapping[str, Any], found: list[Constant]
) -> Iterator[Constant]:
    """Yield the tolerance and the rollouts of a test."""
    scale = next(each.value for each in found if each.key == "noise_scale")
    noise = scale if isinstance(scale, float) else measured.plan.hoeffding
    delta, alpha = measured.plan.problem.delta, given.get("alpha")
    if alpha is None:
        values = measured.data.values
        furthest = float(np.abs(values - values.mean()).max()) or 1.0
        part, why = furthest / PARTS, f"A {PARTS}th of the largest distance from the prior mean"
        if (left := _left_for_alpha(measured, trial)) is not None and left < part:
            part, why = left, "Half of what the worst start of the fitted function leaves to what is required"
        # With noise, no less than what the most rollouts of each test can reach.
        alpha = rounded_up(max(part, _reach(noise, MOST_REPLICATES / 2, delta)))
        reach = ", if noise allows it" if measured.noisy else ""
        yield Constant("alpha", alpha, f"{why}{reach}.")
    else:
        yield Constant("alpha", alpha, "From the file.")
    if not measured.noisy:
        return
    wanted = (_reach(noise, 1.0, delta) / alpha) ** 2
    replicates = min(max(FEWEST_REPLICATES, math.ceil(wanted)), MOST_REPLICATES)
    reason = (
        f"{TESTS_AT_ONE_START} tests at one start would reach alpha, with {FEWEST_REPLICATES} to {MOST_REPLICATES} "
        "rollouts each; more rollouts of fewer tests explore less."
    )
    yield Constant("replicates", replicates, reason)


def _left_for_alpha(measured: ProblemEvidence, trial: KernelTrial) -> float | None:
    """Return the tolerance with which the bound may be expected to meet what is required; None if none may."""
    if measured.required is None:
        return None
    left = measured.required - float(trial.fit.mean(measured.data, measured.shares).max())
    return SHARE * left if left > 0 else None


def _reach(scale: float, replicates: float, delta: float) -> float:
    """Return how near upper and lower bound come with all tests at one start, see `forecast.least_distance`."""
    return 2.0 * scale * math.sqrt(2.0 * math.log(1.0 / delta) / (TESTS_AT_ONE_START * replicates))


def _doubts(measured: ProblemEvidence, choice: Choice) -> Iterator[str]:
    for fault in choice.faults:
        yield _DOUBTS[fault](measured, choice)


def _jump(measured: ProblemEvidence, _: Choice) -> str:
    descent = max((each for each in measured.descents if each.is_jump), key=lambda each: each.places[-1].difference)
    first, last = descent.places[0], descent.places[-1]
    a, b = (
        ", ".join(f"{name} = {value:.6g}" for name, value in zip(measured.box.names, start, strict=True))
        for start in measured.box.starts(np.array([last.a.shares, last.b.shares]))
    )
    return (
        f"The objective jumps: it differs by {last.difference:.3g} between the starts ({a}) and ({b}), and "
        f"by {first.difference:.3g} at {2 ** (len(descent.places) - 1)} times their distance. No kernel has a norm "
        "bound for a jump."
    )


def _rises(_: ProblemEvidence, choice: Choice) -> str:
    best = min(choice.trials, key=lambda each: each.growth.last)
    steps = ", ".join(f"{norm:.3g} at {size}" for size, norm in zip(best.growth.sizes, best.growth.norms, strict=True))
    return (
        f"The norm that the values need rises with their number, also for the kernel where it rises least "
        f"(nu = {best.fit.nu:g}): {steps} starts. So no norm bound follows from them."
    )


def _unpredicted(measured: ProblemEvidence, choice: Choice) -> str:
    if measured.data.exact:
        best = max(each.predictions.explained for each in choice.trials)
        return f"The values do not predict one another: of their variance {max(0.0, 100 * best):.0f} % is explained."
    best = min(each.predictions.excess for each in choice.trials)
    return f"The values do not predict one another: the error is {math.sqrt(best):.1f} times their own noise."


def _outlier(measured: ProblemEvidence, choice: Choice) -> str:
    best = min((each.predictions for each in choice.trials), key=lambda each: each.largest)
    (start,) = measured.box.starts(measured.shares[[best.worst]])
    place = ", ".join(f"{name} = {value:.6g}" for name, value in zip(measured.box.names, start, strict=True))
    return (
        f"The value at {place} is {best.largest:.1f} standard deviations from what the others predict: a narrow hole, "
        "or noise with falls that are too rare to be seen twice."
    )


_DOUBTS = {
    "few": lambda measured, _: f"{len(measured.values):,} starts show no trend; give more --rollouts.",
    "equal": lambda measured, _: (
        f"All {len(measured.values):,} values are equal: neither a length scale nor a norm follows from them."
    ),
    "jump": _jump,
    "rises": _rises,
    "unpredicted": _unpredicted,
    "outlier": _outlier,
    "short": lambda *_: "The length scales are as short as the distance of the starts; give more --rollouts.",
}
