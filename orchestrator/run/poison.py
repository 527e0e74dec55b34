"""The last words of a run whose rollout fails again and again."""

import shlex
from collections.abc import Mapping

from ...schemas.places import short_path
from ...schemas.rollout import RolloutRequest
from ..campaign.ledger import Ledger
from ..fleet.children.simulate import LIMIT
from ..fleet.dispatch import events
from ..fleet.dispatch.retries import missed


def poison_text(
    found: events.Poison, request: RolloutRequest, ledger: Ledger, reference: str | None, ends: Mapping[str, str]
) -> str:
    """Return the history of a rollout that fails again and again, the command that repeats it, and the remedy.

    `reference` is that of a system that is not installed; `ends` say how workers have ended.
    """
    config = ledger.config
    by_reason: dict[str, list[str]] = {}
    for each in found.failures:
        end = f" ({how})" if (how := ends.get(each.worker)) else ""
        attempt = f"attempt {each.attempt.number} on {each.worker}{end}"
        by_reason.setdefault(each.failure.reason, []).append(attempt)
    history = "; ".join(f"{', '.join(attempts)}: {reason}" for reason, attempts in by_reason.items())
    options = [f"--option={name}={value}" for name, value in config.system.options.items()]
    start = ",".join(map(repr, request.x))
    rollout = [f"--x={start}", "--variant", request.variant, "--seed", str(request.seed)]
    system = config.system.name if reference is None else short_path(reference)
    limits = ["--horizon", f"{request.horizon:g}"]
    if config.deadline != LIMIT:  # a rollout that hangs is to hang no longer than here
        limits += ["--timeout", f"{config.deadline:g}"]
    command = shlex.join(["perfbound", "simulate", system, *rollout, *limits, *options, "--out", "failed.mcap"])
    repeat = f"Repeat it: {command}"
    if ledger.header.spec.repeated == "session":  # which no command has
        repeat = f"Repeat it: call {request.system.replace('-', '_')} at {start}, with seed {request.seed}"
    if found.failures[-1].failure == missed(config.deadline):
        missing = f"It exceeds deadline = {config.deadline:g} s at the start ({start})"
        repeat = f"{missing}; simulated alone, it names the place in the file. {repeat}"
    # Another code is another system, with which the recorded rollouts cannot be mixed.
    remedy = "If the code of the system is wrong, fix it and start a new campaign (--out); else"
    return (
        f"rollout {found.rollout} failed {len(found.failures)} times, so the campaign cannot continue: {history}. "
        f"{repeat}. {remedy} fix the worker or the machine, then resume"
    )
