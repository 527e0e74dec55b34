"""The failing rollouts of a campaign in groups: with near starts, and alike in what they violate and when."""

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....schemas.errors import EvidenceError, PerfboundError
from ....schemas.ids import RolloutId
from ....schemas.result.facts import Header
from ...campaign.starts import of_space
from ...mathematics.gp.kernels import Floats
from ...mathematics.linkage import linked, unit_points
from ...report.rollout.load import load_recorded
from ...store.robustness import read_values, read_violations
from .outcome import Judge, Outcome

MOST_ROLLOUTS = 1000
"""Failing rollouts that are grouped, the worst ones."""
READ_OF_GROUP = 20
"""Trajectories that are read of failures with near starts, the worst ones."""


@dataclass(frozen=True, slots=True)
class Failure:
    """A rollout that violates the specification."""

    rollout: RolloutId
    """Of one that was moved: that from which it comes."""
    x: tuple[float, ...]
    """Its start, as the campaign has it."""
    seed: int
    disturbances: tuple[float, ...]
    """The value of each; empty in a variant without any."""
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class Failures:
    """The failures of a campaign."""

    rollouts: int
    """That violate the specification."""
    groups: tuple[tuple[Failure, ...], ...]
    """The worst failure of each first, and that with the worst one first."""


def failures_of(directory: Path, header: Header, judge: Judge, report: Callable[[int, int], None]) -> Failures:
    """Return the failures of the tested variant of a campaign; `report` gets how many were read, and of how many.

    Raises:
        PerfboundError: no rollout fails, or the database cannot be read.
        EvidenceError: a trajectory is missing or damaged.

    """
    worst = heapq.nsmallest(MOST_ROLLOUTS, _failing(directory, header))  # a campaign may have a million of them
    if not worst:
        raise PerfboundError(f"{directory}: no rollout violates the specification; there is nothing to export")
    names = len(header.spec.own_parameters)
    points = _in_unit_cube(header, np.array([np.frombuffer(start) for _, _, start in worst])[:, :names])
    near = dict[int, list[RolloutId]]()
    for number, (_, rollout, _) in zip(linked(points), worst, strict=True):
        near.setdefault(number, []).append(rollout)
    groups, read = list[tuple[Failure, ...]](), 0
    wanted = [rollouts[:READ_OF_GROUP] for rollouts in near.values()]
    for rollouts in wanted:
        groups += alike(header, [_read(directory, each, judge) for each in rollouts])
        read += len(rollouts)
        report(read, sum(map(len, wanted)))
    return Failures(
        read_violations(directory, header.claimed_variant).violations,
        tuple(sorted(groups, key=lambda each: each[0].outcome.robustness)),
    )


def alike(header: Header, failures: Sequence[Failure]) -> list[tuple[Failure, ...]]:
    """Return the groups of failures with near starts and moments that violate the same; the worst of each first."""
    if not failures:
        return []
    names = len(header.spec.own_parameters)
    points = _in_unit_cube(header, np.array([each.x for each in failures])[:, :names])
    # One without a moment is like none that has one.
    moments = [-1.0 if each.outcome.moment is None else each.outcome.moment for each in failures]
    times = np.array(moments)[:, None] / (header.config.horizon or 1.0)
    numbers = np.zeros(len(failures), dtype=np.int_)
    for violated in {each.outcome.violated for each in failures}:
        of_kind = [k for k, each in enumerate(failures) if each.outcome.violated == violated]
        numbers[of_kind] = np.array(of_kind)[linked(np.hstack([points, times])[of_kind])]
    groups = dict[int, list[Failure]]()
    for each, number in sorted(zip(failures, numbers.tolist(), strict=True), key=lambda pair: _order(pair[0])):
        groups.setdefault(number, []).append(each)
    return [tuple(each) for each in groups.values()]


def _order(failure: Failure) -> tuple[float, RolloutId]:
    return failure.outcome.robustness, failure.rollout


def _failing(directory: Path, header: Header) -> Iterator[tuple[float, RolloutId, bytes]]:
    """Yield robustness, name and start of every failing rollout."""
    variant = header.claimed_variant
    for block in read_values(directory, variant, [problem.name for problem in header.config.problems]):
        for place, value in enumerate(block.robustness):
            if value < 0.0:
                yield value, block.rollout(variant, place), block.start(place // block.replicates)


def _read(directory: Path, rollout: RolloutId, judge: Judge) -> Failure:
    found = load_recorded(directory, str(rollout))
    if found.trajectory is None:
        raise EvidenceError(found.damage)
    request = found.request
    return Failure(rollout, request.chosen, request.seed, request.disturbances, judge.outcome(found.trajectory))


def _in_unit_cube(header: Header, starts: Floats) -> Floats:
    """Return starts (n, p) of the system's own parameters in the unit cube."""
    low, high = of_space(header).box
    return unit_points(starts, low[: starts.shape[1]], high[: starts.shape[1]])
