"""The kernel and the regulariser of a problem in the campaign file."""

from typing import Annotated

from pydantic import Field

from .base import Model

Positive = Annotated[float, Field(gt=0)]


class MaternKernel(Model):
    """Matern kernel of unit amplitude."""

    nu: float = Field(
        default=2.5, gt=0, le=50, description="smoothness; at most 40 in method `rigorous` and with `refine = true`"
    )
    length_scale: Positive | Annotated[dict[str, Positive], Field(min_length=1)] = Field(
        description="distance over which the objective changes, of all parameters, or of each by name in its unit; "
        "by default half of each range, or the whole range with more than three parameters"
    )

    @property
    def described(self) -> float | str:
        """The length scale as one value of an assumption: the number, or the numbers with their parameters."""
        if not isinstance(self.length_scale, dict):
            return self.length_scale
        # By name: a file and its copy in the database may list them in different orders.
        return ", ".join(f"{length:g} ({name})" for name, length in sorted(self.length_scale.items()))

    def scaled(self, factor: float) -> "MaternKernel":
        """Return the kernel with every length scale multiplied."""
        lengths = self.length_scale
        changed = (
            {name: factor * length for name, length in lengths.items()}
            if isinstance(lengths, dict)
            else factor * lengths
        )
        return self.model_copy(update={"length_scale": changed})


class Weighted(Model):
    """One regulariser of a mixture that is fixed beforehand."""

    value: float = Field(ge=1e-9, description="lambda")
    weight: float = Field(gt=0, le=1, description="the weights sum to at most 1")
