"""The form of an input signal: which function of time the knots of a parameter make."""

from typing import Literal

from pydantic import Field, model_validator

from ..base import Model

SignalKind = Literal["pchip", "linear", "constant"]
MAX_KNOTS = 100


def least_knots(kind: SignalKind) -> int:
    """Return how many knots a signal of a kind needs.

    >>> least_knots("constant"), least_knots("pchip")
    (1, 2)
    """
    return 1 if kind == "constant" else 2


class SignalShape(Model):
    """One input signal: the name of its parameter, its interpolation, and the number of its knots."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    kind: SignalKind = "pchip"
    knots: int = Field(default=5, ge=1, le=MAX_KNOTS)

    @model_validator(mode="after")
    def _enough(self) -> "SignalShape":
        if self.knots < least_knots(self.kind):
            raise ValueError(f"knots: {self.knots} is not allowed with {self.kind!r}; give at least 2")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that the knots are, in the order of time.

        Letters, digits and _ alone: such a name is a column of CSV files and tables, a bare key of TOML and JSON, and
        a word in a formula.

        >>> SignalShape(name="throttle", knots=3).names
        ('throttle_0', 'throttle_1', 'throttle_2')
        """
        return tuple(f"{self.name}_{knot}" for knot in range(self.knots))
