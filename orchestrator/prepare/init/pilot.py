"""The rollouts of a pilot, in one child process: some starts of a system, scored, before there is a campaign."""

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ....schemas.errors import PerfboundError, Stopped, TrajectoryError
from ....schemas.ids import RolloutId
from ....schemas.requests import RequestTemplate
from ....schemas.rollout import RolloutRequest
from ....schemas.system import OptionValue, SystemSpec, Variant
from ....schemas.trajectory.trajectory import Floats, Trajectory
from ...campaign.admission import check_whole
from ...fleet.children.rollouts import (
    BatchCost,
    ChildRolloutError,
    ChildSystem,
    SlowRolloutError,
    cost_in_batch,
    file_size,
    finished,
    simulate_in_child,
    trial_batches,
    undeclared_files,
)
from .values import NOISY_ROLLOUTS, Score, pilot_starts, settled_horizon

SECONDS = 60.0
"""No rollout of a pilot starts later than this, and none may take longer: there would be too few."""
FEWEST_STARTS = 8
LARGEST = 1e100
"""Scores from here on are no quantity of a system, and their squares overflow."""


class PilotError(PerfboundError):
    """A rollout of the pilot failed."""


class SlowPilotError(PilotError):
    """The pilot has too few rollouts in its time."""


@dataclass(frozen=True, slots=True)
class Pilot:
    """The scores of a pilot's rollouts."""

    starts: Floats
    """Shape (n, p)."""
    horizon: float
    """In s, as a campaign has to request it."""
    scores: dict[Variant, Floats]
    """Shape (n, k), k rollouts at each start."""
    cost: float | None = None
    """Seconds of a rollout; None after a single one."""
    undeclared: tuple[str, ...] = ()
    """Files that the rollouts have read and that are no part of the system, relative to its folder."""
    in_batch: BatchCost | None = None
    """Of a rollout; None where rollouts cannot be a batch."""
    spans: Mapping[str, float] = field(default_factory=dict)
    """Of each column in all rollouts, its largest value minus its least."""

    @property
    def size(self) -> str:
        """The number of rollouts and starts, in words."""
        return f"{sum(each.size for each in self.scores.values()):,} rollouts at {len(self.starts):,} starts"


@dataclass(frozen=True, slots=True)
class PilotPlan:
    """What a pilot simulates."""

    reference: str
    """The system, a name, FILE.py:NAME or a campaign file."""
    spec: SystemSpec
    options: Mapping[str, OptionValue]
    variants: tuple[Variant, ...]
    horizon: float
    """In s, as it is asked for; the system may have a duration of its own."""
    limit: float = SECONDS
    """Seconds that a rollout may take."""

    def seeds(self, variant: Variant) -> int:
        """Return the rollouts of a variant at each start."""
        return NOISY_ROLLOUTS if variant in self.spec.noisy else 1

    @property
    def template(self) -> RequestTemplate:
        """The common part of the requests."""
        return RequestTemplate.of(self.spec, self.options, horizon=self.horizon, visual=False, campaign="init")

    def requests(self) -> list[RolloutRequest]:
        """Return the requests, those of a start one after the other."""
        return [
            self.template.request(RolloutId("pilot", test, variant, replicate), x, test * NOISY_ROLLOUTS + replicate)
            for test, x in enumerate(pilot_starts(self.spec.parameters))
            for variant in self.variants
            for replicate in range(self.seeds(variant))
        ]


def run_pilot(plan: PilotPlan, score: Score) -> Pilot:
    """Return the pilot, as far as it comes in its time.

    Raises:
        SlowPilotError: there are too few rollouts.
        PilotError: a rollout fails, or would be refused by a campaign.
        PerfboundError: a rollout has no score.

    """
    requests = plan.requests()
    scores: dict[Variant, list[float]] = {variant: [] for variant in plan.variants}
    horizon, written, beside, grids, ends = None, [], _Beside(), set[bytes](), []
    for request, trajectory, at in _finished(plan, requests, beside):
        written.append(at)
        grids.add(trajectory.samples[:, 0].tobytes())
        ends += [trajectory.samples.min(axis=0), trajectory.samples.max(axis=0)]
        if horizon is None:
            horizon = settled_horizon(plan.horizon, trajectory)
        try:
            check_whole(trajectory, tuple(column.name for column in plan.spec.columns), horizon)
        except TrajectoryError as fault:
            raise PilotError(f"{request.words(plan.spec)}: a campaign would refuse this rollout: {fault}") from None
        scores[request.variant].append(score(trajectory))
        if not abs(scores[request.variant][-1]) < LARGEST:
            raise PilotError(f"{request.words(plan.spec)}: its values are above {LARGEST:g}")
    whole = min(len(found) // plan.seeds(variant) for variant, found in scores.items())
    if horizon is None or whole < FEWEST_STARTS:
        raise SlowPilotError(f"after {SECONDS:g} s it has the rollouts of {whole} starts, and needs {FEWEST_STARTS}")
    shaped = {
        variant: np.array(found[: whole * plan.seeds(variant)]).reshape(whole, -1) for variant, found in scores.items()
    }
    # The first rollout loads the simulator.
    cost = float(np.median(np.diff(written))) if len(written) > 1 else None
    starts = np.array(pilot_starts(plan.spec.parameters)[:whole])
    in_batch = beside.in_batch or (None if cost is None else BatchCost(cost, beside.size))
    with np.errstate(over="ignore"):  # of a column whose span is no float, no range is known
        spans = dict(zip((column.name for column in plan.spec.columns), np.ptp(ends, axis=0).tolist(), strict=True))
    return Pilot(starts, horizon, shaped, cost, beside.undeclared, in_batch if len(grids) == 1 else None, spans)


@dataclass(slots=True)
class _Beside:
    """What the child shows beside its rollouts."""

    undeclared: tuple[str, ...] = ()
    size: float = 0.0
    """Bytes of the file of a rollout."""
    in_batch: BatchCost | None = None


def _finished(
    plan: PilotPlan, requests: list[RolloutRequest], beside: _Beside
) -> Iterator[tuple[RolloutRequest, Trajectory, float]]:
    """Yield the rollouts that one child simulates in its time, and when; fill in what else it shows."""
    system = ChildSystem(plan.reference, plan.spec, plan.limit, SECONDS)
    try:
        with tempfile.TemporaryDirectory() as name:
            simulate_in_child(system, [*requests, *trial_batches(plan.template, requests)], Path(name))
            beside.undeclared = tuple(sorted(undeclared_files(Path(name))))
            beside.in_batch = cost_in_batch(Path(name), len(requests))
            beside.size = file_size(Path(name))
            yield from finished(system, requests, Path(name))
    except SlowRolloutError as error:
        raise SlowPilotError(str(error)) from None
    except ChildRolloutError as error:
        raise PilotError(str(error)) from None
    except Stopped as stop:
        raise Stopped(stop.signal, "the pilot was ended, nothing was written") from None
