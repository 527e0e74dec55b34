"""The one builder of the requests of a campaign: for a rollout, and for a batch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from .ids import RolloutId
from .rollout import RolloutRequest, WithinBatch
from .system import SCORED, OptionValue, SystemSpec, Variant

if TYPE_CHECKING:
    from .batch import BatchRequest
    from .draws.laws import Floats, Laws


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
        variant: Variant = "nominal" if rollout.variant == "nominal" else "true"
        return {
            "campaign": self.campaign,
            "config_sha256": self.config_sha256,
            "problem": rollout.problem,
            "test": rollout.test,
            "variant": variant,
            "replicate": rollout.replicate,
            "system": self.spec.name,
            "spec_sha256": self.spec.simulators.get(variant, self.spec_sha256),
            "options": dict(self.options),
            "horizon": self.horizon,
            "signals": self.spec.signals,
        }

    def disturbances(
        self, variant: str, starts: Sequence[Sequence[float]], seeds: Sequence[int]
    ) -> tuple[tuple[float, ...], ...]:
        """Return the disturbances of rollouts at these starts (k, p), equally many at each, with a seed each.

        Those that are parameters are given by the start, the others drawn from the seed; in a variant without noise
        each has its median.
        """
        if self.laws is None or variant in self.spec.undisturbed:
            return ()
        if variant not in (self.spec.disturbed or self.spec.noisy):
            return (self.laws.middles,) * len(seeds)
        values = self.laws.values(seeds)
        places = {law.name: place for place, law in enumerate(self.spec.disturbances)}
        first = len(self.spec.own_parameters)
        for number, parameter in enumerate(self.spec.parameters[first:], start=first):
            place = places[parameter.name]
            given = [start[number] for start in starts]
            at = self.laws.at_scores(place, given) if parameter.unit == SCORED else given
            values[:, place] = [value for value in at for _ in range(len(seeds) // len(starts))]
        return tuple(map(tuple, values.tolist()))

    def scores(self, seeds: Sequence[int]) -> "Floats":
        """Return the scores of the disturbances that are drawn (R, k), of a system that has some."""
        assert self.laws is not None, "a system without disturbances has no scores"
        found: Floats = self.laws.scores(seeds)[:, self.spec.drawn_places]
        return found

    def _own(self, start: Sequence[float]) -> tuple[float, ...]:
        """Return the part of a start that is no disturbance."""
        return tuple(start)[: len(self.spec.own_parameters)]

    def _split(self, starts: Sequence[Sequence[float]]) -> dict[str, Any]:
        """Return the fields of the starts of a batch."""
        whole = tuple(map(tuple, starts))
        return {"x": tuple(map(self._own, whole)), "start": whole if self.spec.as_parameters else ()}

    def request(
        self, rollout: RolloutId, x: Sequence[float], seed: int, *, within: WithinBatch | None = None
    ) -> RolloutRequest:
        """Return the request for a rollout that starts at `x` (p,), in the units of the parameters."""
        common = self.common(rollout)
        drawn = self.disturbances(common["variant"], [x], [seed])
        if within is not None and self.laws is not None:
            starts = within.start or within.x
            whole = self.disturbances(common["variant"], starts, within.seeds)
            within = within.model_copy(update={"disturbances": whole, **self._split(starts)})
        return RolloutRequest(
            **common,
            x=self._own(x),
            start=tuple(x) if self.spec.as_parameters else (),
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
            **self._split(starts),
            disturbances=self.disturbances(common["variant"], starts, seeds),
        )
