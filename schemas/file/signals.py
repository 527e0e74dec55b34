"""The form of an input signal: which function of time its parameters make."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from pydantic import Field, model_validator

from ..base import Model, key_if_given
from ..ranges import Magnitude

SignalKind = Literal["pchip", "linear", "constant", "sine", "step"]
MAX_KNOTS = 1000
MAX_PROFILE = 5000
"""Points of a recorded profile; every request has them all."""
RATED: tuple[SignalKind, ...] = ("pchip", "linear")
"""The kinds whose slope between knots has a limit."""


class Part(NamedTuple):
    """A number that a formula of time takes."""

    unit: str | None = None
    """None for that of the signal."""
    default: float | None = None
    least: float | None = None


PARTS: Mapping[SignalKind, Mapping[str, Part]] = MappingProxyType(
    {
        "sine": {
            "amplitude": Part(least=0.0),
            "frequency": Part("Hz", least=0.0),
            "phase": Part("rad", 0.0),
            "offset": Part(default=0.0),
        },
        "step": {"at": Part("s", least=0.0), "before": Part(), "after": Part()},
    }
)
"""The numbers of the signals that have no knots, in the order of their parameters."""
Ends = tuple[float, float]
Number = Magnitude | tuple[Magnitude, Magnitude]
"""A number that is the same in all starts, or the ends of a parameter."""


def least_knots(kind: SignalKind) -> int:
    """Return how many knots a signal of a kind needs.

    >>> least_knots("constant"), least_knots("pchip")
    (1, 2)
    """
    return 1 if kind == "constant" else 2


def extremes(kind: SignalKind, ends: Mapping[str, Ends]) -> Ends:
    """Return the least and the greatest value of a signal without knots, from the ends of its numbers.

    >>> extremes("sine", {"amplitude": (0.0, 2.0), "offset": (1.0, 1.5)})
    (-1.0, 3.5)
    >>> extremes("step", {"before": (0.0, 0.0), "after": (2.0, 4.0)})
    (0.0, 4.0)
    """
    if kind == "sine":
        reach = ends["amplitude"][1]
        return ends["offset"][0] - reach, ends["offset"][1] + reach
    both = (*ends["before"], *ends["after"])
    return min(both), max(both)


class SignalShape(Model):
    """One input signal: its name, its interpolation, and what of it are parameters of a start.

    Either `knots` values are, at equal distances or at `times`, or the numbers of `parts` that are ends; those of a
    `profile` are fixed. With `rate` the first knot is a value, and each other one a share in [0, 1] of what the limits
    leave it.
    """

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    kind: SignalKind = "pchip"
    knots: int = Field(default=5, ge=0, le=MAX_KNOTS, description="those that are parameters")
    until: float | None = key_if_given("s; the last knot, where it is not at the horizon")
    times: tuple[Magnitude, ...] | None = key_if_given("s; of each knot, where they are not at equal distances")
    rate: float | None = key_if_given("largest slope between knots, in the unit of the signal per s")
    ends: tuple[Magnitude, Magnitude] | None = key_if_given("with `rate`: the least and the greatest value of a knot")
    parts: dict[str, Number] = Field(
        default_factory=dict, exclude_if=lambda parts: not parts, description="the numbers of a sine or of a step"
    )
    profile: tuple[Magnitude, ...] | None = key_if_given("the values of all knots, at `times`")
    recorded: bool = Field(
        default=False,
        exclude_if=lambda recorded: not recorded,
        description="the signal is a column of the trajectory, which its system does not return",
    )

    @model_validator(mode="after")
    def _enough(self) -> "SignalShape":
        if not self.parts and self.profile is None and self.knots < least_knots(self.kind):
            raise ValueError(f"knots: {self.knots} is not allowed with {self.kind!r}; give at least 2")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters of the signal: of knots in the order of time.

        Letters, digits and _ alone: such a name is a column of CSV files and tables, a bare key of TOML and JSON, and
        a word in a formula.

        >>> SignalShape(name="throttle", knots=3).names
        ('throttle_0', 'throttle_1', 'throttle_2')
        >>> SignalShape(name="gust", kind="sine", knots=0, parts={"amplitude": (0.0, 2.0), "frequency": 0.5}).names
        ('gust_amplitude',)
        """
        return tuple(name for name, _ in self.parameters())

    def parameters(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the name of each parameter, and what differs in it from the signal: unit and ends.

        >>> [each for each in SignalShape(name="u", knots=2, rate=0.5, ends=(0.0, 1.0)).parameters()]
        [('u_0', {}), ('u_share_1', {'unit': '', 'low': 0.0, 'high': 1.0})]
        """
        if self.parts:
            for key, part in PARTS[self.kind].items():
                if isinstance(ends := self.parts.get(key), tuple):
                    unit = {} if part.unit is None else {"unit": part.unit}
                    yield f"{self.name}_{key}", {**unit, "low": ends[0], "high": ends[1]}
            return
        for knot in range(self.knots):
            if knot and self.rate is not None:
                yield f"{self.name}_share_{knot}", {"unit": "", "low": 0.0, "high": 1.0}
            else:
                yield f"{self.name}_{knot}", {}

    @property
    def knots_alike(self) -> bool:
        """Whether every parameter is a knot with the unit and the range of the signal."""
        return not self.parts and self.profile is None and self.rate is None

    @property
    def keys(self) -> dict[str, Any]:
        """The signal as the keys of a campaign file, without its range."""
        if self.parts:
            return {"signal": self.kind, **{k: list(v) if isinstance(v, tuple) else v for k, v in self.parts.items()}}
        if self.profile is not None:
            rows = zip(self.times or (), self.profile, strict=True)
            return {"signal": self.kind, "profile": [list(row) for row in rows]}
        given = {"until": self.until, "times": self.times and list(self.times), "rate": self.rate}
        return {"signal": self.kind, "knots": self.knots} | {k: v for k, v in given.items() if v is not None}
