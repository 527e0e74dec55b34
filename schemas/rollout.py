"""The request for one rollout, and its one builder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from .base import Model
from .file.signals import SignalShape
from .ids import RolloutId
from .ranges import LARGEST_BATCH, Magnitude, ReplicateNumber, Seconds, Seed, TestNumber
from .system import OptionValue, SystemSpec, Variant

Name = Annotated[str, Field(min_length=1, max_length=200)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]

MAX_PARAMETERS = 1000
"""Numbers of one start."""
Start = Annotated[tuple[Magnitude, ...], Field(min_length=1, max_length=MAX_PARAMETERS)]


class WithinBatch(Model):
    """The batch of which a rollout is repeated: of a system that can repeat its batches alone, see `SystemSpec`.

    Starts and seeds are as in a `BatchRequest`; the rollout is the one in `place`.
    """

    x: tuple[Start, ...] = Field(min_length=1, max_length=LARGEST_BATCH)
    seeds: tuple[Seed, ...] = Field(min_length=1, max_length=LARGEST_BATCH)
    place: int = Field(ge=0, lt=LARGEST_BATCH)

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        if len(self.seeds) % len(self.x) or self.place >= len(self.seeds) or len(set(map(len, self.x))) != 1:
            raise ValueError(f"{len(self.x)} starts and {len(self.seeds)} seeds have no rollout in place {self.place}")
        return self


class RolloutRequest(Model):
    """One rollout: its name, and everything that decides its trajectory.

    `x` is the starting condition d (one number per parameter of the system, in its units), `horizon` is in seconds,
    `spec_sha256` the identity of the system that the campaign was planned for. `visual` adds a scene to draw.
    """

    campaign: Name
    config_sha256: Sha256
    problem: str = Field(pattern=r"^[a-z_]{1,40}$")
    test: TestNumber
    variant: Variant
    replicate: ReplicateNumber
    seed: Seed
    system: Name
    spec_sha256: Sha256
    options: dict[str, OptionValue] = Field(default_factory=dict)
    x: tuple[Magnitude, ...] = Field(min_length=1, max_length=MAX_PARAMETERS)
    horizon: Seconds
    visual: bool = False
    signals: tuple[SignalShape, ...] = Field(
        default=(),
        max_length=MAX_PARAMETERS,
        # Requests without signals stay what they were, to the byte: they are in the files of trajectories.
        exclude_if=lambda signals: not signals,
        description="the inputs over time whose knots are in `x`",
    )
    within: WithinBatch | None = Field(
        default=None,
        exclude_if=lambda within: within is None,
        description="the batch to simulate as a whole, of which this rollout is wanted",
    )

    @property
    def rollout(self) -> str:
        """Name of the rollout, unique in its campaign."""
        return str(RolloutId(self.problem, self.test, self.variant, self.replicate))

    def words(self, spec: SystemSpec) -> str:
        """Return start, variant and seed, as messages name a rollout."""
        start = ", ".join(f"{each.name} = {value:g}" for each, value in zip(spec.parameters, self.x, strict=True))
        variant = f", variant {self.variant}" if len(spec.variants) > 1 else ""
        return f"{start}{variant}, seed {self.seed}"

    @property
    def metadata(self) -> dict[str, str]:
        """The metadata record of the trajectory's file."""
        fields: dict[str, Any] = self.model_dump(
            include={"campaign", "problem", "test", "variant", "replicate", "seed", "system", "config_sha256"}
        )
        return {name: str(value) for name, value in fields.items()} | {"rollout": self.rollout}


@dataclass(frozen=True, slots=True)
class RequestTemplate:
    """The common part of the rollouts of one campaign, and the one builder of their requests."""

    spec: SystemSpec
    spec_sha256: str
    options: Mapping[str, OptionValue]
    horizon: float
    visual: bool
    campaign: str
    config_sha256: str

    @classmethod
    def of(
        cls,
        spec: SystemSpec,
        options: Mapping[str, OptionValue],
        *,
        horizon: float,
        visual: bool,
        spec_sha256: str | None = None,
        campaign: str = "simulate",
        config_sha256: str = "0" * 64,
    ) -> "RequestTemplate":
        """Fill in the system's defaults; without `campaign` and `config_sha256` the rollouts belong to none."""
        defaults = {option.name: option.default for option in spec.options}
        return cls(spec, spec_sha256 or spec.digest, defaults | dict(options), horizon, visual, campaign, config_sha256)

    def common(self, rollout: RolloutId) -> dict[str, Any]:
        """Return the fields that a request for a rollout, and one for a batch that begins with it, share."""
        return {
            "campaign": self.campaign,
            "config_sha256": self.config_sha256,
            "problem": rollout.problem,
            "test": rollout.test,
            "variant": "nominal" if rollout.variant == "nominal" else "true",
            "replicate": rollout.replicate,
            "system": self.spec.name,
            "spec_sha256": self.spec_sha256,
            "options": dict(self.options),
            "horizon": self.horizon,
            "signals": self.spec.signals,
        }

    def request(
        self, rollout: RolloutId, x: Sequence[float], seed: int, *, within: WithinBatch | None = None
    ) -> RolloutRequest:
        """Return the request for a rollout that starts at `x` (p,), in the units of the parameters."""
        return RolloutRequest(**self.common(rollout), x=tuple(x), seed=seed, visual=self.visual, within=within)
