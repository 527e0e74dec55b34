"""The ranges of `[space]`, and the parameters of a box: one for each range, and those of its input signals."""

from collections.abc import Iterator

from pydantic import Field, model_validator

from ..rollout import MAX_PARAMETERS
from ..values import DistributionName
from .distributed import Distributed, described_key
from .signals import MAX_KNOTS, SignalKind, SignalShape, least_knots

MAX_CHOICES = 1000
MAX_STEPS = 1_000_000


class Range(Distributed):
    """All values of one parameter of the starting condition d, and how a drawn start is distributed over them.

    The distribution is that of the keys, truncated to [low, high]. With steps, each value has the probability of the
    numbers that are nearer to it than to its neighbours, in a range that is longer by half a step at both ends.
    """

    low: float = Field(description="smallest value")
    high: float = Field(description="largest value")
    unit: str = Field(
        default="",
        description="if given, must be that of the system's parameter; `sd` for the scores of a disturbance",
    )
    distribution: DistributionName = Field(
        default="uniform",
        exclude_if=lambda name: name == "uniform",
        description="of drawn starts, truncated to [low, high]",
    )
    step: float | None = described_key("drawn values are `low`, `low` + step, ... `high`; 1 for integers", gt=0)
    choices: tuple[float, ...] | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        min_length=2,
        max_length=MAX_CHOICES,
        description="all values, instead of `low` and `high`; drawn with equal probabilities",
    )
    signal: SignalKind | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="an input over time through `knots` values: smooth and monotone between knots, linear, or constant "
        "until the next one",
    )
    knots: int | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        ge=1,
        le=MAX_KNOTS,
        description="of `signal`, required: values at equal distances over [0, horizon]; each is a parameter NAME_0, "
        "NAME_1, ...",
    )

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if self.choices is not None:
            self._check_choices(self.choices)
        if not self.low < self.high:
            raise ValueError(f"low: {self.low:g} must be less than high = {self.high:g}")
        if self.step is not None and not 1 <= self.steps <= MAX_STEPS:
            raise ValueError(
                f"step: {self.step:g} is not allowed: allowed are 1 to {MAX_STEPS:,} steps from {self.low:g} to "
                f"{self.high:g}"
            )
        if self.step is not None and abs(self.steps * self.step - (self.high - self.low)) > 1e-9 * self.step:
            raise ValueError(
                f"step: {self.step:g} must divide high - low = {self.high - self.low:g}; choose another step or end"
            )
        return self

    def _check_choices(self, choices: tuple[float, ...]) -> None:
        for value in choices:
            if choices.count(value) > 1:
                raise ValueError(f"choices: {value:g} is there twice; list each value once")
        for key, value in (("low", min(choices)), ("high", max(choices))):
            if getattr(self, key) != value:
                raise ValueError(f"{key}: follows from choices, {value:g}; remove this key")
        if self.step is not None or self.distribution != "uniform":
            other = "step" if self.step is not None else "distribution"
            raise ValueError(f"choices: not allowed beside {other}; remove one of the two")

    @model_validator(mode="after")
    def _distributed(self) -> "Range":
        self.check_distribution()
        return self

    @model_validator(mode="after")
    def _with_knots(self) -> "Range":
        if self.signal is None and self.knots is not None:
            raise ValueError('knots: needs signal = "pchip", "linear" or "constant"; give one, or remove this key')
        if self.signal is not None and (self.knots or 0) < least_knots(self.signal):
            raise ValueError(
                f"knots: required by signal {self.signal!r}; give a whole number >= {least_knots(self.signal)}"
            )
        return self

    @property
    def steps(self) -> int:
        """Number of steps from `low` to `high`; 0 without steps."""
        # Of a step that is far too small as many as are refused.
        return round(min((self.high - self.low) / self.step, 2.0 * MAX_STEPS)) if self.step else 0

    @property
    def for_draws(self) -> tuple[str, ...]:
        """The keys that only a method that draws its starts takes."""
        given = [key for key in ("step", "choices") if getattr(self, key) is not None]
        return (*(["distribution", *self.described] if self.distribution != "uniform" else []), *given)


Box = dict[str, Range]


def signal_shapes(space: object) -> tuple[SignalShape, ...]:
    """Return the input signals of a space, in its order; a list of starts has none."""
    return tuple(each for _, each in _named_shapes(space)) if isinstance(space, dict) else ()


def parameter_ranges(space: Box) -> Box:
    """Return the range of each parameter: the knots of an input signal have that of the signal.

    >>> box = {"u": Range(low=0.0, high=1.0, signal="linear", knots=2), "v": Range(low=0.0, high=5.0)}
    >>> {name: each.high for name, each in parameter_ranges(box).items()}
    {'u_0': 1.0, 'u_1': 1.0, 'v': 5.0}
    """
    names = {name: shape.names for name, shape in _named_shapes(space)}
    knot = {"signal": None, "knots": None}
    return {
        parameter: each.model_copy(update=knot) if name in names else each
        for name, each in space.items()
        for parameter in names.get(name, (name,))
    }


def check_signals(space: object, horizon: float) -> None:
    """Refuse input signals of rollouts without duration, and more knots than a start has room for.

    Raises:
        ValueError: one line with the key and the remedy.

    """
    if isinstance(space, dict) and (count := len(parameter_ranges(space))) > MAX_PARAMETERS:
        raise ValueError(f"space: {count} parameters with their knots are more than the {MAX_PARAMETERS} allowed")
    for shape in signal_shapes(space) if horizon == 0 else ():
        raise ValueError(
            f"space.{shape.name}.signal: an input over time needs rollouts longer than 0 s; give horizon, or remove "
            "signal and knots"
        )


def _named_shapes(space: Box) -> Iterator[tuple[str, SignalShape]]:
    for name, each in space.items():
        if each.signal is not None and each.knots is not None:
            yield name, SignalShape(name=name, kind=each.signal, knots=each.knots)
