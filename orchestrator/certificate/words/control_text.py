"""The sentence on what declared disturbances are worth to a claim, apart from `text`, which is long enough."""

import math
from collections.abc import Iterable

from ....schemas.result.certificate import CertificateClaim, ControlResult, ProblemResult
from ...campaign.clip import SAME, is_vacuous
from .bound_text import outward


def control_sentence(claim: CertificateClaim, without: float | None, problems: Iterable[ProblemResult]) -> str:
    """Return the gain over the bound `without` a control, and what the disturbances explain of a rollout."""
    controls = {each.key: each.control for each in problems if each.control is not None}
    if not controls:
        # With few rollouts the range costs more than the noise.
        return "No control by the declared disturbances: they explain too little, or it would widen the range too much."
    names = {each.name for control in controls.values() for each in control.disturbances}
    alone = len(names) == 1
    subject = f"The disturbance {min(names)}" if alone else "The declared disturbances"
    s = "s" if alone else ""
    explain = f"explain{s} " + ", and ".join(
        f"{percent(control.explained)} % of the variance of {'a rollout' if len(controls) == 1 else key}"
        + ("" if alone else _most_of(control))
        for key, control in controls.items()
    )
    if without is None or is_vacuous(without, claim.sense, claim.by_clip):
        return f"{subject} {explain}; without a control the same tests prove nothing."
    before, after = outward(without, claim.sense), outward(claim.bound, claim.sense)
    gain, verb = (claim.bound - without, "raise") if claim.sense == ">=" else (without - claim.bound, "lower")
    if gain > SAME:
        return f"{subject} {verb}{s} the bound from {before} to {after}: {'it' if alone else 'they'} {explain}."
    if gain < -SAME:
        return f"{subject} {explain}; without a control the bound of the same tests would be {before}."
    return f"{subject} {explain}; with and without a control the bound is {before}: few rollouts lose to the range."


MOST = 6
"""Disturbances in a line."""


def control_line(control: ControlResult) -> str:
    """Return the sensitivity to each disturbance, the largest first.

    >>> gust = {"name": "gust", "standard_deviation": 0.1, "knots": (), "levels": ()}
    >>> control_line(ControlResult(explained=0.9, standard_deviation=0.033, before_fit=32, disturbances=(gust,)))
    'control: the standard deviation that it takes out is 0.1 for gust; 0.033 is left'
    """
    found = sorted(control.disturbances, key=lambda each: -each.standard_deviation)
    parts = [f"{each.standard_deviation:.3g} for {each.name}" for each in found[:MOST]]
    more = f", less for {len(found) - MOST:,} more" if len(found) > MOST else ""
    left = f"{control.standard_deviation:.3g} is left"
    return f"control: the standard deviation that it takes out is {', '.join(parts)}{more}; {left}"


def percent(share: float) -> str:
    """Return a share in percent, rounded down: only all is 100.

    >>> percent(0.97649), percent(0.99999), percent(1.0)
    ('97.6', '99.9', '100')
    """
    return f"{math.floor(round(1000.0 * share, 6)) / 10.0:g}"


def _most_of(control: ControlResult) -> str:
    """Return the disturbance that explains most, in words; empty where none has a part."""
    variances = {each.name: each.standard_deviation**2 for each in control.disturbances}
    name = max(variances, key=lambda each: variances[each])
    if variances[name] == 0.0:
        return ""
    return f", most of it {name}" if variances[name] > sum(variances.values()) / 2.0 else f", {name} the largest part"
