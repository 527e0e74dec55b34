"""The distribution of one number, as a file describes it."""

from collections.abc import Mapping

from pydantic import Field

from ..base import Model, key_if_given
from ..values import DistributionName

DISTRIBUTIONS: Mapping[DistributionName, tuple[str, ...]] = {
    "uniform": (),
    "normal": ("mean", "sd"),
    "lognormal": ("median", "sigma"),
    "triangular": ("mode",),
    "weibull": ("shape", "scale"),
}
"""The keys that describe each distribution; all of them are required."""
POSITIVE: frozenset[DistributionName] = frozenset({"lognormal", "weibull"})
"""Distributions of positive numbers alone."""


class Distributed(Model):
    """A number with a distribution, which is truncated to [low, high] where these are given."""

    low: float | None = Field(default=None, description="smallest value")
    high: float | None = Field(default=None, description="largest value")
    unit: str = ""
    distribution: DistributionName = "uniform"
    mean: float | None = key_if_given("of `normal`")
    sd: float | None = key_if_given("of `normal`: standard deviation", gt=0)
    median: float | None = key_if_given("of `lognormal`", gt=0)
    sigma: float | None = key_if_given("of `lognormal`: standard deviation of the logarithm, without unit", gt=0)
    mode: float | None = key_if_given("of `triangular`: the most frequent value; the ends are `low` and `high`")
    shape: float | None = key_if_given("of `weibull`: k; 1 is exponential, 2 Rayleigh", gt=0)
    scale: float | None = key_if_given("of `weibull`: the value that 63.2 % do not exceed", gt=0)

    def check_distribution(self) -> None:
        """Refuse keys that do not belong to the distribution, and the lack of those that do; raises ValueError."""
        wanted = DISTRIBUTIONS[self.distribution]
        for name, keys in DISTRIBUTIONS.items():
            for key in keys:
                if key not in wanted and getattr(self, key) is not None:
                    raise ValueError(
                        f"{key}: belongs to distribution {name!r}, and this one is {self.distribution!r}; "
                        f'remove this key, or give distribution = "{name}"'
                    )
        for key in wanted:
            if getattr(self, key) is None:
                raise ValueError(f"{key}: required by distribution {self.distribution!r}; give {' and '.join(wanted)}")
        if self.distribution in POSITIVE and self.low is not None and self.low < 0:
            raise ValueError(
                f"low: {self.low:g} is not allowed: distribution {self.distribution!r} has positive values alone; give "
                "a number >= 0"
            )
        if (
            self.mode is not None
            and self.low is not None
            and self.high is not None
            and not (self.low <= self.mode <= self.high)
        ):
            raise ValueError(
                f"mode: {self.mode:g} is not allowed: allowed is a number in [{self.low:g}, {self.high:g}]"
            )

    @property
    def described(self) -> dict[str, float]:
        """The keys of the distribution with their values."""
        return {key: getattr(self, key) for key in DISTRIBUTIONS[self.distribution]}
