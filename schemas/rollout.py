"""What a worker needs to simulate one rollout."""

from typing import Annotated, Any

from pydantic import Field

from schemas.base import Model
from schemas.system import OptionValue, Variant

MAX_SEED = 2**53
"""Seeds are below this, so that every JSON reader keeps them exact."""

Name = Annotated[str, Field(min_length=1, max_length=200)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class RolloutRequest(Model):
    """One rollout: which one it is, and everything that decides its trajectory.

    `x` is the starting condition d (one number per parameter of the system, in its units), `horizon` is in seconds,
    `spec_sha256` the identity of the system that the campaign was planned for. `visual` adds what a person sees.
    """

    campaign: Name
    config_sha256: Sha256
    problem: str = Field(pattern=r"^[a-z_]{1,40}$")
    test: int = Field(ge=0, lt=10**9)
    variant: Variant
    replicate: int = Field(ge=0, lt=10**6)
    seed: int = Field(ge=0, lt=MAX_SEED)
    system: Name
    spec_sha256: Sha256
    options: dict[str, OptionValue] = Field(default_factory=dict)
    x: tuple[float, ...] = Field(min_length=1, max_length=1000)
    horizon: float = Field(ge=0)
    visual: bool = False

    @property
    def rollout(self) -> str:
        """Name of the rollout, unique in its campaign."""
        return f"{self.problem}.{self.test}.{self.variant}.{self.replicate}"

    @property
    def metadata(self) -> dict[str, str]:
        """What stands in the metadata record of the trajectory's file."""
        fields: dict[str, Any] = self.model_dump(
            include={"campaign", "problem", "test", "variant", "replicate", "seed", "system", "config_sha256"}
        )
        return {name: str(value) for name, value in fields.items()} | {"rollout": self.rollout}
