"""What a worker is asked for: one rollout of a campaign, from its facts alone."""

from orchestrator.campaign import RolloutId
from orchestrator.seeds import rollout_seed
from orchestrator.store.journal import Header
from schemas.rollout import RolloutRequest


def request(header: Header, rollout: RolloutId, x: tuple[float, ...]) -> RolloutRequest:
    """Return the request for a rollout that starts at `x` (p,), in the units of the parameters."""
    config, spec = header.config, header.spec
    return RolloutRequest(
        campaign=config.name,
        config_sha256=header.config_sha256,
        problem=rollout.problem,
        test=rollout.test,
        variant="nominal" if rollout.variant == "nominal" else "true",
        replicate=rollout.replicate,
        seed=rollout_seed(config, rollout),
        system=spec.name,
        spec_sha256=spec.digest,
        options={option.name: option.default for option in spec.options} | config.system.options,
        x=x,
        horizon=config.horizon,
        visual=config.visual == "all",
    )
