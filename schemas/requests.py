"""The one builder of the requests of a campaign: for a rollout, and for a batch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from .ids import RolloutId
from .rollout import RolloutRequest, WithinBatch
from .system import OptionValue, SystemSpec

if TYPE_CHECKING:
    from .batch import BatchRequest
    from .draws.laws import Laws


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
    laws: "Laws | None" = field(default=None, compare=False)
    """Of the disturbances, for a system that has some."""

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
        laws = None
        if spec.disturbances:
            from .draws.laws import Laws  # noqa: PLC0415  (late, as numpy below: `status` and `list` need no request)

            laws = Laws(spec.disturbances)
        identity = spec_sha256 or spec.digest
        return cls(spec, identity, defaults | dict(options), horizon, visual, campaign, config_sha256, laws)

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

    def disturbances(self, variant: str, seeds: Sequence[int]) -> tuple[tuple[float, ...], ...]:
        """Return the disturbances of rollouts with these seeds; of a variant without noise their medians."""
        if self.laws is None:
            return ()
        if variant not in self.spec.noisy:
            return (self.laws.middles,) * len(seeds)
        return tuple(map(tuple, self.laws.values(seeds).tolist()))

    def request(
        self, rollout: RolloutId, x: Sequence[float], seed: int, *, within: WithinBatch | None = None
    ) -> RolloutRequest:
        """Return the request for a rollout that starts at `x` (p,), in the units of the parameters."""
        common = self.common(rollout)
        drawn = self.disturbances(common["variant"], [seed])
        if within is not None and self.laws is not None:
            whole = self.disturbances(common["variant"], within.seeds)
            within = within.model_copy(update={"disturbances": whole})
        return RolloutRequest(
            **common,
            x=tuple(x),
            seed=seed,
            visual=self.visual,
            disturbances=drawn[0] if drawn else (),
            within=within,
        )

    def batch(self, first: RolloutId, starts: Sequence[Sequence[float]], seeds: Sequence[int]) -> "BatchRequest":
        """Return the request for a batch, from `first` on: tests with these starts (k, p), a seed a rollout."""
        from .batch import BatchRequest  # noqa: PLC0415

        common = self.common(first)
        return BatchRequest(
            **common,
            replicates=len(seeds) // len(starts),
            seeds=tuple(seeds),
            x=tuple(map(tuple, starts)),
            disturbances=self.disturbances(common["variant"], seeds),
        )
