"""The ranges of `[space]`, and the parameters of a box: one for each range, and those of its input signals."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, model_validator

from ..base import key_if_given
from ..rollout import MAX_PARAMETERS
from ..values import DistributionName
from .distributed import Distributed
from .signals import MAX_KNOTS, MAX_PROFILE, PARTS, RATED, Ends, SignalKind, SignalShape, extremes, least_knots

MAX_CHOICES = 1000
MAX_STEPS = 1_000_000
LATE = 1e-9
"""Of the horizon: a time that is so little behind it is the horizon, rounded."""


NUMBER_TAGS = ("number", "range")
"""Of a number of a signal: it is fixed, or has a range."""


def _number_model(value: Any) -> str:
    return NUMBER_TAGS[not isinstance(value, int | float)]


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
    step: float | None = key_if_given("drawn values are `low`, `low` + step, ... `high`; 1 for integers", gt=0)
    choices: tuple[float, ...] | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        min_length=2,
        max_length=MAX_CHOICES,
        description="all values, instead of `low` and `high`; drawn with equal probabilities",
    )
    signal: SignalKind | None = key_if_given(
        "an input over time: through `knots` values, smooth and monotone between knots, linear, or constant until the "
        "next one; or a `sine` or a `step` by its numbers"
    )
    knots: int | None = key_if_given(
        "required without `times`: how many values, at equal distances over [0, horizon]; each is a parameter NAME_0, "
        "NAME_1, ...",
        ge=1,
        le=MAX_KNOTS,
    )
    until: float | None = key_if_given("s: the knots are spread over [0, until], and the last one is held", gt=0)
    times: tuple[float, ...] | None = key_if_given(
        "s: the time of each knot, from 0 on; of `constant` those at which the value changes",
        min_length=1,
        max_length=MAX_KNOTS,
    )
    rate: float | None = key_if_given(
        "of `linear` and `pchip`: largest slope between two knots, in the unit per s; behind the first knot the "
        "parameters are then NAME_share_1, ...: shares in [0, 1] of what the rate leaves the knot",
        gt=0,
    )
    amplitude: "Number | None" = key_if_given("of a `sine`: offset + amplitude * sin(2 pi * frequency * t + phase)")
    frequency: "Number | None" = key_if_given("of a `sine`, in Hz")
    phase: "Number | None" = key_if_given("of a `sine`, in rad; by default 0")
    offset: "Number | None" = key_if_given("of a `sine`; by default 0")
    at: "Number | None" = key_if_given("of a `step`: the time of the step, in s")
    before: "Number | None" = key_if_given("of a `step`: the value before it")
    after: "Number | None" = key_if_given("of a `step`: the value from then on")
    profile: tuple[tuple[float, float], ...] | None = key_if_given(
        "a recorded input, the same in all starts: the name of a CSV file beside this one, or its rows [t, value], "
        'from t = 0 on; the last value is held; by default with `signal = "linear"`',
        min_length=1,
        max_length=MAX_PROFILE,
    )

    @model_validator(mode="after")
    def _over_time(self) -> "Range":
        _check_signal_keys(self)
        if self.signal in PARTS:
            _check_parts(self)
        elif self.profile is not None:
            _check_times("profile", [t for t, _ in self.profile], "first row at 0")
        elif self.signal is not None:
            _check_knots(self, self.signal)
        if self.has_extremes:
            low, high = self.extremes
            for key, inside, end in (("low", self.low <= low, low), ("high", high <= self.high, high)):
                if not inside:
                    raise ValueError(
                        f"{key}: {getattr(self, key):g} is inside the values of the signal, [{low:g}, {high:g}]; give "
                        f"{end:g} or remove this key, which follows from them"
                    )
        return self

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if self.choices is not None:
            self._check_choices(self.choices)
        if not (self.low < self.high or (self.has_extremes and self.low == self.high)):
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

    @property
    def has_extremes(self) -> bool:
        """Whether the values of an input over time follow from its numbers, or from its profile."""
        return self.signal in PARTS or self.profile is not None

    @property
    def extremes(self) -> Ends:
        """The least and the greatest value of such an input."""
        if self.profile is not None:
            values = [value for _, value in self.profile]
            return min(values), max(values)
        assert self.signal is not None, "it has numbers"
        return extremes(self.signal, {key: _ends(each) for key, each in self.numbers.items()})

    @property
    def numbers(self) -> dict[str, "Range | float"]:
        """The numbers of a sine or of a step, each fixed or with a range; none of another input."""
        given = {key: (getattr(self, key), part.default) for key, part in PARTS.get(self.signal or "pchip", {}).items()}
        found = {key: default if each is None else each for key, (each, default) in given.items()}
        return {key: each for key, each in found.items() if each is not None}

    @property
    def steps(self) -> int:
        """Number of steps from `low` to `high`; 0 without steps."""
        # Of a step that is far too small as many as are refused.
        return round(min((self.high - self.low) / self.step, 2.0 * MAX_STEPS)) if self.step else 0

    @property
    def for_draws(self) -> tuple[str, ...]:
        """The keys that only a method that draws its starts takes."""
        given = [key for key in ("step", "choices") if getattr(self, key) is not None]
        inner = [
            f"{key}.{name}" for key, each in self.numbers.items() if isinstance(each, Range) for name in each.for_draws
        ]
        return (*(["distribution", *self.described] if self.distribution != "uniform" else []), *given, *inner)


Number = Annotated[
    Annotated[float, Tag(NUMBER_TAGS[0])] | Annotated[Range, Tag(NUMBER_TAGS[1])],
    Discriminator(_number_model),
]
"""A number that is the same in all starts, or a range of one."""
Range.model_rebuild()
Box = dict[str, Range]
SIGNAL_KEYS = (
    "signal",
    "knots",
    "until",
    "times",
    "rate",
    *(key for parts in PARTS.values() for key in parts),
    "profile",
)
"""The keys of an input over time."""


def _ends(value: Range | float) -> Ends:
    return (value.low, value.high) if isinstance(value, Range) else (value, value)


def _check_signal_keys(given: Range) -> None:
    """Refuse keys that do not go together; raises ValueError."""
    signal, kinds = given.signal, "'pchip', 'linear' or 'constant'"
    for key in SIGNAL_KEYS[1:]:
        if getattr(given, key) is None:
            continue
        owner = next((kind for kind, parts in PARTS.items() if key in parts), None)
        if signal is None:
            needed = f'"{owner}"' if owner else '"pchip", "linear" or "constant"'
            raise ValueError(f"{key}: needs signal = {needed}; give {'it' if owner else 'one'}, or remove this key")
        if owner is not None and owner != signal:
            raise ValueError(f"{key}: belongs to signal {owner!r}, and not to {signal!r}; remove this key")
        if owner is None and signal in PARTS:
            raise ValueError(f"{key}: belongs to signals {kinds}, and not to {signal!r}; remove this key")
        if given.profile is not None and key != "profile":
            raise ValueError(f"{key}: not allowed beside profile, which has the times and values; remove this key")
    if given.until is not None and given.times is not None:
        raise ValueError("until: not allowed beside times, which end with it; remove one of the two")
    if given.rate is not None and signal not in RATED:
        raise ValueError(f"rate: {signal!r} has no slope; choose 'linear' or 'pchip', or remove this key")
    own = "rate, with which each knot is drawn evenly from what it leaves it" if given.rate is not None else ""
    own = f"signal {signal!r}, whose numbers have theirs" if signal in PARTS else own
    own = "profile, which has its values" if given.profile is not None else own
    if own and given.for_draws and "." not in given.for_draws[0]:
        raise ValueError(f"{given.for_draws[0]}: not allowed beside {own}; remove this key")


def _check_knots(given: Range, signal: SignalKind) -> None:
    """Refuse knots that are too few, or not at the times of the file; raises ValueError."""
    least = least_knots(signal)
    if given.times is None:
        if (given.knots or 0) < least:
            raise ValueError(f"knots: required by signal {signal!r}; give a whole number >= {least}")
        return
    _check_times("times", given.times, "first one at 0")
    if len(given.times) < least:
        raise ValueError(f"times: {list(given.times)} is not allowed with {signal!r}; give at least {least}")
    if given.knots not in (None, len(given.times)):
        raise ValueError(f"knots: {given.knots} is not allowed: times has {len(given.times)}; remove this key")


def _check_times(key: str, times: "list[float] | tuple[float, ...]", first: str) -> None:
    if times[0] != 0:
        raise ValueError(f"{key}: begins at {times[0]:g} s; give the {first}")
    for one, other in itertools.pairwise(times):
        if not one < other:
            raise ValueError(f"{key}: {other:g} s comes after {one:g} s; give times that increase")


def _check_parts(given: Range) -> None:
    """Refuse the lack of a number of a sine or of a step, and one that it cannot have; raises ValueError."""
    assert given.signal is not None, "it has numbers"
    for key, part in PARTS[given.signal].items():
        value = given.numbers.get(key)
        if value is None:
            raise ValueError(f"{key}: required by signal {given.signal!r}; give a number, or [low, high]")
        if isinstance(value, Range) and value.signal is not None:
            raise ValueError(f"{key}: is one number of a rollout; remove signal from it")
        unit = given.unit if part.unit is None else part.unit
        if isinstance(value, Range) and value.unit not in ("", unit):
            raise ValueError(
                f"{key}.unit: {value.unit!r} is not allowed: it is in {unit or 'the unit of the signal'}; remove it"
            )
        if part.least is not None and _ends(value)[0] < part.least:
            raise ValueError(f"{key}: {_ends(value)[0]:g} is not allowed: allowed are numbers >= {part.least:g}")


def signal_shapes(space: object) -> tuple[SignalShape, ...]:
    """Return the input signals of a space, in its order; a list of starts has none."""
    return tuple(each for _, each in _named_shapes(space)) if isinstance(space, dict) else ()


def knots_alike(space: object, parameters: Sequence[str]) -> list[list[int]]:
    """Return the places among the parameters of the knots of each input that has one range for all of them.

    >>> knots_alike({"u": Range(low=0.0, high=1.0, signal="linear", knots=2)}, ("v", "u_0", "u_1"))
    [[1, 2]]
    """
    shapes = [each for each in signal_shapes(space) if each.knots_alike]
    return [[parameters.index(name) for name in each.names] for each in shapes]


def parameter_ranges(space: Box) -> Box:
    """Return the range of each parameter: the knots of an input signal have that of the signal.

    >>> box = {"u": Range(low=0.0, high=1.0, signal="linear", knots=2), "v": Range(low=0.0, high=5.0)}
    >>> {name: each.high for name, each in parameter_ranges(box).items()}
    {'u_0': 1.0, 'u_1': 1.0, 'v': 5.0}
    """
    return dict(_named_ranges(space))


def _named_ranges(space: Box) -> Iterator[tuple[str, Range]]:
    shapes, share = dict(_named_shapes(space)), Range(low=0.0, high=1.0)
    for name, each in space.items():
        if (shape := shapes.get(name)) is None:
            yield name, each
            continue
        numbers = {f"{name}_{key}": number for key, number in each.numbers.items()}
        knot = each.model_copy(update=dict.fromkeys(SIGNAL_KEYS))
        for parameter, differs in shape.parameters():
            number = numbers.get(parameter)
            yield parameter, number if isinstance(number, Range) else share if differs else knot


def check_signals(space: object, horizon: float) -> None:
    """Refuse input signals of rollouts without duration, and more knots than a start has room for.

    Raises:
        ValueError: one line with the key and the remedy.

    """
    if not isinstance(space, dict):
        return
    names = [name for name, _ in _named_ranges(space)]
    if len(names) > MAX_PARAMETERS:
        raise ValueError(f"space: {len(names)} parameters with their knots are more than the {MAX_PARAMETERS} allowed")
    if not names:
        raise ValueError("space: no parameter has a range, so that there is one start; give a number of a signal one")
    if len(set(names)) < len(names):
        double = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"space.{double}: is also a parameter of an input over time; choose another name")
    for name, shape in _named_shapes(space):
        if horizon == 0:
            raise ValueError(
                f"space.{name}.signal: an input over time needs rollouts longer than 0 s; give horizon, or remove "
                "signal and knots"
            )
        for key, last in _last_times(space[name], shape):
            if last > horizon * (1.0 + LATE):
                raise ValueError(
                    f"space.{name}.{key}: {last:g} s is behind the horizon, {horizon:g} s; give an earlier time, or a "
                    "longer horizon"
                )


def _last_times(given: Range, shape: SignalShape) -> Iterator[tuple[str, float]]:
    if given.until is not None:
        yield "until", given.until
    if given.times is not None:
        yield "times", given.times[-1]
    if "at" in shape.parts:
        yield "at", _ends(given.numbers["at"])[1]


def _named_shapes(space: Mapping[str, Range]) -> Iterator[tuple[str, SignalShape]]:
    for name, each in space.items():
        if each.signal is not None:
            yield name, _shape(name, each, each.signal)


def _shape(name: str, given: Range, signal: SignalKind) -> SignalShape:
    if signal in PARTS:
        parts = {key: _ends(each) if isinstance(each, Range) else each for key, each in given.numbers.items()}
        return SignalShape(name=name, kind=signal, knots=0, parts=parts)
    if given.profile is not None:
        times, values = zip(*given.profile, strict=True)
        return SignalShape(name=name, kind=signal, knots=0, times=times, profile=values)
    return SignalShape(
        name=name,
        kind=signal,
        knots=given.knots or len(given.times or ()),
        until=given.until,
        times=given.times,
        rate=given.rate,
        ends=None if given.rate is None else (given.low, given.high),
    )
