"""The request for one rollout."""

from collections.abc import Sequence
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from .amounts import some_of
from .base import Model
from .file.disturbance import MAX_DISTURBANCES
from .file.signals import SignalShape
from .ids import RolloutId
from .ranges import LARGEST_BATCH, Magnitude, ReplicateNumber, Seconds, Seed, TestNumber
from .system import OptionValue, SystemSpec, Variant

Name = Annotated[str, Field(min_length=1, max_length=200)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]

SHOWN = 6
"""Disturbances in words."""
MAX_PARAMETERS = 2000
"""Numbers of one start."""
Start = Annotated[tuple[Magnitude, ...], Field(min_length=1, max_length=MAX_PARAMETERS)]


Disturbances = Annotated[tuple[Magnitude, ...], Field(max_length=MAX_DISTURBANCES)]
"""The value of each disturbance of the system, in its order."""


def disturbances_of_batch() -> Any:
    """Return the field of the disturbances of each rollout of a batch."""
    return Field(default=(), max_length=LARGEST_BATCH, exclude_if=lambda each: not each)


Whole = Annotated[tuple[Magnitude, ...], Field(max_length=MAX_PARAMETERS + MAX_DISTURBANCES)]
"""A start with the disturbances that are parameters."""


def start_of_campaign(*, most: int | None = None) -> Any:
    """Return the field of a start as the campaign has it, or of at most so many."""
    return Field(
        default=(),
        max_length=most,
        exclude_if=lambda start: not start,
        description="as the campaign has it, where disturbances are parameters: `x` and these follow from it",
    )


def check_disturbances(each: Sequence[Sequence[float]], rollouts: int) -> None:
    """Refuse disturbances that are not equally many for each rollout of a batch; raises ValueError."""
    if each and (len(each) != rollouts or len(set(map(len, each))) != 1):
        raise ValueError(f"disturbances of {len(each)} rollouts, or differently many, in a batch of {rollouts}")


class WithinBatch(Model):
    """The batch of which a rollout is repeated: of a system that can repeat its batches alone, see `SystemSpec`.

    Starts and seeds are as in a `BatchRequest`; the rollout is the one in `place`.
    """

    x: tuple[Start, ...] = Field(min_length=1, max_length=LARGEST_BATCH)
    seeds: tuple[Seed, ...] = Field(min_length=1, max_length=LARGEST_BATCH)
    place: int = Field(ge=0, lt=LARGEST_BATCH)
    disturbances: tuple[Disturbances, ...] = disturbances_of_batch()
    start: tuple[Whole, ...] = start_of_campaign(most=LARGEST_BATCH)

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        if len(self.seeds) % len(self.x) or self.place >= len(self.seeds) or len(set(map(len, self.x))) != 1:
            raise ValueError(f"{len(self.x)} starts and {len(self.seeds)} seeds have no rollout in place {self.place}")
        check_disturbances(self.disturbances, len(self.seeds))
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
    disturbances: Disturbances = Field(
        default=(),
        exclude_if=lambda disturbances: not disturbances,
        description="the values of the disturbances that the system declares",
    )
    start: Whole = start_of_campaign()
    within: WithinBatch | None = Field(
        default=None,
        exclude_if=lambda within: within is None,
        description="the batch to simulate as a whole, of which this rollout is wanted",
    )

    @property
    def chosen(self) -> tuple[float, ...]:
        """The start as the campaign has it."""
        return self.start or self.x

    @property
    def rollout(self) -> str:
        """Name of the rollout, unique in its campaign."""
        return str(RolloutId(self.problem, self.test, self.variant, self.replicate))

    def words(self, spec: SystemSpec) -> str:
        """Return start, variant and seed, as messages name a rollout."""
        start = some_of([f"{each.name} = {value:g}" for each, value in zip(spec.own_parameters, self.x, strict=True)])
        variant = f", variant {self.variant}" if len(spec.variants) > 1 else ""
        drawn = f", with {self.disturbance_words(spec)}" if self.disturbances else ""
        return f"{start}{variant}{drawn}, seed {self.seed}"

    def disturbance_words(self, spec: SystemSpec) -> str:
        """Return the values of the disturbances with their units; of many the first ones."""
        pairs = list(zip(spec.disturbances, self.disturbances, strict=True))
        shown = [f"{each.name} = {value:.4g} {each.unit}".removesuffix(" 1").rstrip() for each, value in pairs[:SHOWN]]
        return ", ".join(shown) + (f", and {len(pairs) - SHOWN} more" if len(pairs) > SHOWN else "")

    @property
    def metadata(self) -> dict[str, str]:
        """The metadata record of the trajectory's file."""
        fields: dict[str, Any] = self.model_dump(
            include={"campaign", "problem", "test", "variant", "replicate", "seed", "system", "config_sha256"}
        )
        return {name: str(value) for name, value in fields.items()} | {"rollout": self.rollout}
