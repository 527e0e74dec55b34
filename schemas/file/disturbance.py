"""What is random in the rollouts of a system, said aloud: named numbers with laws, from which the campaign draws."""

import math
from collections.abc import Sequence
from typing import Any

from pydantic import Field, model_validator

from ..base import key_if_given
from ..ranges import Magnitude
from ..written import Written
from .distributed import Distributed

MAX_DISTURBANCES = 100
MAX_CHOICES = 1000


class Disturbance(Distributed, metaclass=Written):
    """One random number of a rollout, independent of the others and of the start.

    Its law is a `distribution`, truncated to [`low`, `high`] where these are given; or `choices` with `probabilities`,
    equal ones where they are left out; or a continuous law of scipy.stats by its name, with the numbers that it takes.
    """

    name: str = Field(default="", pattern=r"^([a-z][a-z0-9_]*)?$", exclude_if=lambda name: not name)
    low: Magnitude | None = key_if_given("smallest value; required by `uniform` and `triangular`")
    high: Magnitude | None = key_if_given("largest value; required by `uniform` and `triangular`")
    choices: tuple[Magnitude, ...] | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        min_length=1,
        max_length=MAX_CHOICES,
        description="all values, in place of a distribution",
    )
    probabilities: tuple[float, ...] | None = key_if_given("of `choices`; equal ones by default")
    scipy: str | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        pattern=r"^[a-z][a-z0-9_]*$",
        description="name of a continuous distribution of scipy.stats, in place of a distribution",
    )
    numbers: dict[str, Magnitude] = Field(
        default_factory=dict,
        exclude_if=lambda value: not value,
        max_length=20,
        description="of `scipy`: its parameters by their names, such as `loc` and `scale`",
    )

    @model_validator(mode="after")
    def _one_law(self) -> "Disturbance":
        self.check_distribution()
        given = [key for key, is_given in self._forms.items() if is_given]
        if len(given) > 1:
            raise ValueError(f"{given[1]}: not together with {given[0]}; remove one of the two")
        if not given and (self.low is None or self.high is None):
            raise ValueError(
                'low: a disturbance needs a law: give low and high, distribution = "normal" with mean and sd, choices, '
                "or scipy"
            )
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ValueError(f"low: {self.low:g} must be less than high = {self.high:g}")
        if self.distribution == "triangular" and (self.low is None or self.high is None):
            raise ValueError("low: required by distribution 'triangular', as is high")
        if self.numbers and self.scipy is None:
            raise ValueError("numbers: they belong to scipy; give the name of its distribution")
        if self.probabilities is not None:
            self._check_probabilities(self.probabilities)
        if self.choices is not None and (self.low, self.high) != (None, None):
            raise ValueError("low: not together with choices; remove one of the two")
        return self

    @property
    def _forms(self) -> dict[str, bool]:
        return {
            "distribution": self.distribution != "uniform",
            "choices": self.choices is not None,
            "scipy": self.scipy is not None,
        }

    def _check_probabilities(self, probabilities: tuple[float, ...]) -> None:
        if self.choices is None or len(probabilities) != len(self.choices):
            raise ValueError("probabilities: give choices, and one probability for each of them")
        if min(probabilities) <= 0 or abs(math.fsum(probabilities) - 1.0) > 1e-9:
            total = math.fsum(probabilities)
            raise ValueError(f"probabilities: they are positive and sum up to 1, not to {total:.12g}")

    def named(self, name: str, unit: str) -> "Disturbance":
        """Return the law under the name and unit of the disturbance that it belongs to."""
        return self if (name, unit) == (self.name, self.unit) else self.model_copy(update={"name": name, "unit": unit})

    @property
    def shares(self) -> tuple[float, ...]:
        """The probability of each of its choices; empty without choices."""
        count = len(self.choices or ())
        return self.probabilities or (1.0 / count,) * count if count else ()

    @property
    def words(self) -> str:
        """The law in words.

        >>> Normal(0, 2, unit="m/s").words
        'normal, mean 0 m/s, sd 2 m/s'
        """
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        limits = [] if self.choices else [(key, getattr(self, key)) for key in ("low", "high")]
        keys = [(key, value) for key, value in [*self.described.items(), *limits] if value is not None]
        if self.choices is not None:
            pairs = zip(self.choices, self.shares, strict=True)
            return ", ".join(f"{value:g}{unit} ({share:g})" for value, share in pairs)
        if self.scipy is not None:
            keys = [*self.numbers.items(), *keys]
        bare = {"sigma", "shape", *self.numbers}
        texts = (f"{key} {value:g}{'' if key in bare else unit}" for key, value in keys)
        return ", ".join([self.scipy or self.distribution, *texts])


def Normal(  # noqa: N802  (as a class that users make)
    mean: float, sd: float, *, unit: str = "", low: float | None = None, high: float | None = None
) -> Disturbance:
    """Return a normal disturbance, truncated to [low, high] where these are given."""
    return _of("normal", unit, low, high, mean=mean, sd=sd)


def Uniform(low: float, high: float, *, unit: str = "") -> Disturbance:  # noqa: N802
    """Return a disturbance that is uniform on [low, high]."""
    return _of("uniform", unit, low, high)


def LogNormal(  # noqa: N802
    median: float, sigma: float, *, unit: str = "", low: float | None = None, high: float | None = None
) -> Disturbance:
    """Return a disturbance whose logarithm is normal with the standard deviation `sigma`."""
    return _of("lognormal", unit, low, high, median=median, sigma=sigma)


def Triangular(low: float, mode: float, high: float, *, unit: str = "") -> Disturbance:  # noqa: N802
    """Return a disturbance on [low, high] that is most frequent at `mode`."""
    return _of("triangular", unit, low, high, mode=mode)


def Weibull(  # noqa: N802
    shape: float, scale: float, *, unit: str = "", low: float | None = None, high: float | None = None
) -> Disturbance:
    """Return a disturbance with the law of Weibull; a `shape` of 1 is exponential, one of 2 that of Rayleigh."""
    return _of("weibull", unit, low, high, shape=shape, scale=scale)


def Choice(  # noqa: N802
    choices: Sequence[float], probabilities: Sequence[float] | None = None, *, unit: str = ""
) -> Disturbance:
    """Return a disturbance with finitely many values, of equal probabilities unless others are given."""
    shares = {} if probabilities is None else {"probabilities": tuple(probabilities)}
    return _made(unit, None, None, choices=tuple(choices), **shares)


def Law(  # noqa: N802
    scipy: str, *, unit: str = "", low: float | None = None, high: float | None = None, **numbers: float
) -> Disturbance:
    """Return a disturbance with a continuous law of scipy.stats, such as `Law("gumbel_r", loc=0, scale=1)`."""
    return _made(unit, low, high, scipy=scipy, numbers=numbers)


def _of(distribution: str, unit: str, low: float | None, high: float | None, **keys: float) -> Disturbance:
    return _made(unit, low, high, distribution=distribution, **keys)


def _made(unit: str, low: float | None, high: float | None, **keys: Any) -> Disturbance:
    # Only what was given: an error shows the call.
    ends: dict[str, Any] = {name: value for name, value in (("low", low), ("high", high)) if value is not None}
    given = keys | ends | ({"unit": unit} if unit else {})
    return Disturbance(**given)
