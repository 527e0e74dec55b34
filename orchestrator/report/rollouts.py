"""The rollouts of one test as curves, from their files."""

import shlex
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath

from ...schemas.campaign import Problem
from ...schemas.errors import EvidenceError, PerfboundError, TrajectoryError
from ...schemas.facts import Header, RolloutFact
from ...schemas.trajectory import Trajectory, decode
from ..store import files
from . import curves
from .data import Curve, Rollout, RolloutsOfTest

MOST_REPLICATES = 3
"""Whose curves are drawn, the worst first."""
MOST_ROLLOUTS = 24
"""Named in one scene."""


def scene(
    directory: Path, header: Header, problem: Problem, facts: Sequence[RolloutFact], x: tuple[float, ...]
) -> RolloutsOfTest:
    """Return the scene of one test, whose start is `x`; what cannot be read is left out and said in `error`."""
    columns = curves.shown(header, problem)
    found, lost = _read(directory, _drawn(facts))
    limits = curves.limits(header, columns)
    test = facts[0].rollout.test
    return RolloutsOfTest(
        problem=problem.name,
        test=test,
        traces=tuple(trace for fact, each in found for trace in traces(header, columns, fact, each)),
        limits=tuple(limit for _, limit in limits),
        rollouts=tuple(rollout(directory, fact, x) for fact in _worst_first(facts)[:MOST_ROLLOUTS]),
        limit_columns=tuple(column for column, _ in limits),
        error="; ".join(lost) or None,
    )


def rollout(directory: Path, fact: RolloutFact, x: tuple[float, ...]) -> Rollout:
    """Return what the story says of a recorded rollout."""
    name = fact.rollout
    return Rollout(
        id=str(name),
        problem=name.problem,
        test=name.test,
        variant=name.variant,
        replicate=name.replicate,
        seed=fact.seed,
        x=x,
        robustness=fact.robustness,
        path=fact.path if inside(fact.path) else "",
        command=shlex.join(["perfbound", "replay", str(directory), str(name)]),
    )


def inside(path: str) -> bool:
    """Whether a path of the database stays in the run directory, and can be no address of another kind."""
    parts = PurePosixPath(path).parts
    return bool(parts) and parts[0] == files.FOLDER and ".." not in parts


def traces(
    header: Header, columns: Sequence[str], fact: RolloutFact, trajectory: Trajectory, note: str = ""
) -> Iterator[Curve]:
    """Yield the curves of one rollout; none of a single sample, which is a number and no curve."""
    if len(trajectory.samples) < 2:
        return
    label = f"{fact.rollout.variant}, replicate {fact.rollout.replicate}{note}"
    for column in columns:
        t, values = curves.thinned(trajectory.samples[:, 0], trajectory.column(column))
        yield Curve(label, fact.rollout.variant, column, curves.column_unit(header, column), t, values)


def _drawn(facts: Sequence[RolloutFact]) -> Iterator[RolloutFact]:
    """Yield the rollouts of the worst replicates, with the nominal one that a true one is compared with."""
    true = [fact for fact in facts if fact.rollout.variant == "true"]
    nominal = {fact.rollout.replicate: fact for fact in facts if fact.rollout.variant == "nominal"}
    yielded = set()
    for fact in _worst_first(true or facts)[:MOST_REPLICATES]:
        partner = nominal.get(fact.rollout.replicate) or nominal.get(0)
        if true and partner and partner.rollout not in yielded:
            yielded.add(partner.rollout)
            yield partner
        yield fact


def _worst_first(facts: Iterable[RolloutFact]) -> list[RolloutFact]:
    return sorted(facts, key=lambda fact: (0.0 if fact.robustness is None else fact.robustness, fact.rollout))


def _read(directory: Path, facts: Iterable[RolloutFact]) -> tuple[list[tuple[RolloutFact, Trajectory]], list[str]]:
    found, lost = [], []
    for fact in facts:
        try:
            found.append((fact, trajectory(directory, fact)))
        except PerfboundError as error:
            lost.append(str(error))
    return found, lost


def trajectory(directory: Path, fact: RolloutFact) -> Trajectory:
    """Return the trajectory of a recorded rollout.

    Raises:
        EvidenceError: its file is missing, damaged, or not in the run directory.

    """
    if not inside(fact.path):
        raise EvidenceError(f"{directory}: rollout {fact.rollout}: {fact.path!r} is not a path in the run directory")
    try:
        return decode(files.read(directory, fact.path, fact.sha256))
    except TrajectoryError as error:
        raise EvidenceError(f"{directory / fact.path}: {error}") from None
