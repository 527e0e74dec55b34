"""The data of the charts of one problem beyond its tests; `page/` draws nothing else, as with `data`.

Numbers have the unit and the sign of the problem's objective, except for a robustness, which has its own.
"""

from dataclasses import dataclass

from .rollouts import DrawnValue

Series = tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class ParameterImportance:
    """The variation that one parameter explains, and the mean over all others."""

    axis: int
    """Its number among the axes of the report."""
    first: float
    """Share that it explains by itself."""
    total: float | None
    """Share with all that it does together with others; None where it is not known."""
    at: tuple[float, ...]
    """Its values, in their order."""
    effect: tuple[float, ...]
    """The mean over all others at these values."""


@dataclass(frozen=True, slots=True)
class Importance:
    """The importance of each parameter, the most important first."""

    of_model: bool
    """Of the posterior mean over the whole box; else of the values that were observed at drawn starts."""
    values: int
    """Nodes of the lattice, or tests."""
    chance: float | None
    """A share up to this may be chance; None for a model, of which nothing is sampled."""
    parameters: tuple[ParameterImportance, ...]


@dataclass(frozen=True, slots=True)
class Prediction:
    """Fresh starts after the campaign, which the model did not see: predicted and observed; lists of equal lengths."""

    starts: int
    """Number of all of them; the lists have a choice of very many, with every one outside."""
    inside: int
    """Starts whose observed value is within the predicted bounds."""
    noisy: bool
    """Whether an observed value has noise: the bounds are then those of its expectation."""
    rollouts: int
    """Rollouts of each start whose mean is observed."""
    limit: float
    """The bound of the certificate that they test."""
    interpolated: bool
    """Whether the mean is interpolated between candidates, and the bounds are those of the nearest one."""
    observed: Series
    mean: Series
    lower: Series
    upper: Series
    outside: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class VariantCounts:
    """The robustness of the rollouts of one variant as a histogram."""

    variant: str
    """"nominal" or "true"."""
    counts: tuple[int, ...]
    rollouts: int
    violations: int
    least: float
    test: int
    """The test of the least value."""
    at_clip: tuple[int, int]
    """Rollouts at the lower and at the upper end of the clip, which may be beyond it."""


@dataclass(frozen=True, slots=True)
class RolloutHistogram:
    """The robustness of all rollouts of a problem, by variant, over common edges."""

    edges: tuple[float, ...]
    """Of the bars; 0 is one of them where it is inside."""
    unit: str
    variants: tuple[VariantCounts, ...]


@dataclass(frozen=True, slots=True)
class FailingStart:
    """A fresh start of the spot check where rollouts violate the specification, or contradict the bound."""

    x: tuple[float, ...]
    series: str
    """The spot check."""
    test: int
    """Its first test there."""
    value: float
    """Mean of all rollouts there, of the objective."""
    rollouts: int
    violations: int
    """Rollouts that violate the specification; 0 where the problem is not about it."""
    contradicts: bool
    """Whether the bound is refuted there."""


@dataclass(frozen=True, slots=True)
class DisturbanceShare:
    """What one declared disturbance explains of the rollouts."""

    place: int
    """Its number among the disturbances of the report."""
    share: float
    """Of the variance of a rollout."""
    deviation: float | None
    """Standard deviation of what the control takes out for it; None without a control."""
    at: tuple[float, ...]
    """Its values, in their order."""
    effect: tuple[float, ...]
    """What the control takes out at these values in the middle of the starts, or the mean of the rollouts near them."""


@dataclass(frozen=True, slots=True)
class DisturbanceScatter:
    """Rollouts by their values of one or two disturbances; lists of equal lengths."""

    axes: tuple[int, ...]
    """Numbers among the disturbances of the report, one or two."""
    at: tuple[tuple[float, ...], ...]
    """The values, a list for each axis."""
    margin: tuple[float, ...]
    marked: tuple[bool, ...]
    """The rollouts that violate the specification; where none does, the worst ones."""
    test: tuple[int, ...]
    rollouts: int
    """Number of all; the lists have the worst, and an even choice of the others."""
    violations: int
    """Of all."""


@dataclass(frozen=True, slots=True)
class WorstRollout:
    """The rollout of least robustness, with its disturbances."""

    id: str
    test: int
    robustness: float
    disturbances: tuple[DrawnValue, ...]


@dataclass(frozen=True, slots=True)
class DisturbanceCharts:
    """What the declared disturbances do to the rollouts of a problem."""

    unit: str
    """Of the robustness."""
    explained: float | None
    """Share of the variance of a rollout that the control takes out; None without one."""
    left: float | None
    """Standard deviation of what it leaves."""
    before_fit: int
    """Rollouts of which it takes nothing, because they come before its first fit."""
    sampled: int
    """Rollouts from which the shares are estimated; 0 with a control."""
    chance: float | None
    """A share up to this may be chance; None with a control."""
    shares: tuple[DisturbanceShare, ...]
    """The largest first, at most 12."""
    scatter: DisturbanceScatter | None
    worst: WorstRollout | None


@dataclass(frozen=True, slots=True)
class ProblemCharts:
    """What the charts of a problem show beyond its tests."""

    required: float | None = None
    """The bound that the campaign file requires of the first claim; None for a problem that it is not about."""
    of_robustness: bool = False
    """Whether the bounded values are a robustness, so that 0 is the border of the specification."""
    clip: tuple[float | None, float | None] = (None, None)
    """The ends of what one observation can be."""
    overshoots: float = 0.0
    """Share of the candidates at which the mean of the model is beyond these ends, and is drawn at them."""
    importance: Importance | None = None
    prediction: Prediction | None = None
    failing: tuple[FailingStart, ...] = ()
    """The worst first, at most 100."""
    rollouts: RolloutHistogram | None = None
    disturbances: DisturbanceCharts | None = None
    """Of a system that declares some."""
