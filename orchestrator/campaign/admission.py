"""The admission of a result: against its request, and as a fact that the ledger can use without an error."""

import hashlib
from collections.abc import Callable
from functools import partial
from typing import Literal, TypeVar

import numpy as np

from ...schemas.base import canonical_json
from ...schemas.batch import BatchRequest, alone
from ...schemas.errors import EvidenceError, PerfboundError, RequestError, TrajectoryError, UnusableTrajectoryError
from ...schemas.file.logs import driven_column, driven_fault
from ...schemas.ids import RolloutId
from ...schemas.instants import uncovered
from ...schemas.result.facts import RolloutFact
from ...schemas.rollout import RolloutRequest
from ...schemas.trajectory.batch import Batch, BatchFile, read_batch
from ...schemas.trajectory.reduced import Reduced, Scores, read_stored
from ...schemas.trajectory.trajectory import Trajectory, read_canonical
from .decisions import scores_of_batch
from .ledger import Ledger, Scored
from .objectives import measured
from .observation import Others
from .plan import UNBOUNDED
from .series import ROUND_OFF
from .state import plan_of

T = TypeVar("T")


def admit(request: RolloutRequest, columns: tuple[str, ...], payload: bytes, sha256: str) -> Trajectory:
    """Return the trajectory of the rollout that `request` describes, from the bytes of its file.

    `columns` are those of the system, `sha256` is the digest that the sender announces or the manifest lists.

    Raises:
        RequestError: the file answers another request.
        UnusableTrajectoryError: the trajectory is not finite, has other columns, or does not cover 0 to the horizon.
        EvidenceError: the bytes have another digest, or are no trajectory file.

    """
    file = _read(partial(read_canonical, visual=request.visual), payload, sha256, "a trajectory")
    wanted = request.model_dump(mode="json")
    if canonical_json(file.request) != canonical_json(wanted):  # as text: 1, 1.0 and true are equal in Python
        differing = sorted(key for key in file.request | wanted if file.request.get(key) != wanted.get(key))
        raise RequestError(f"the trajectory was simulated for another request (other {', '.join(differing)[:200]})")
    check_whole(file.trajectory, columns, request.horizon)
    # The metadata name campaign, rollout and seed again; the columns in it were compared with the system's above.
    if {**file.metadata, "columns": ""} != {**request.metadata, "columns": ""}:
        raise RequestError("the metadata of the trajectory are those of another rollout")
    return file.trajectory


def admit_either(
    request: RolloutRequest | BatchRequest, columns: tuple[str, ...], payload: bytes, sha256: str
) -> Trajectory | Batch:
    """Return the trajectory of a rollout, or those of a batch; raises as `admit`."""
    if isinstance(request, BatchRequest):
        return admit_batch(request, columns, payload, sha256)
    return admit(request, columns, payload, sha256)


def admit_batch(request: BatchRequest, columns: tuple[str, ...], payload: bytes, sha256: str) -> Batch:
    """Return the trajectories of the batch that `request` describes, from the bytes of its file; raises as `admit`."""
    file = _read(read_batch, payload, sha256, "a batch of trajectories")
    _check_batch(request, columns, file)
    return file.batch


def admit_stored(request: BatchRequest, columns: tuple[str, ...], payload: bytes, sha256: str) -> Batch | Reduced:
    """Return a batch as a run directory has it, reduced where the campaign keeps not all samples; raises as `admit`."""
    file = _read(read_stored, payload, sha256, "a batch of trajectories")
    _check_batch(request, columns, file)
    return file.batch


def _check_batch(request: BatchRequest, columns: tuple[str, ...], file: BatchFile[Batch] | BatchFile[Reduced]) -> None:
    if file.request != canonical_json(request.model_dump(mode="json")).encode():
        raise RequestError("the batch was simulated for another request")
    batch = file.batch
    if len(batch) != len(request):
        raise RequestError(f"the batch has {len(batch)} rollouts, and {len(request)} were requested")
    if batch.columns != columns:
        raise UnusableTrajectoryError(f"the batch has the columns {', '.join(batch.columns)[:200]}")
    if uncovering := uncovered(batch.time, request.horizon):
        raise UnusableTrajectoryError(uncovering)
    if {**file.metadata, "columns": ""} != {**request.metadata, "columns": ""}:
        raise RequestError("the metadata of the batch are those of another one")


def _read(reader: Callable[[bytes], T], payload: bytes, sha256: str, wanted: str) -> T:
    # Before everything else: a decoder reads no bytes that were damaged on their way.
    if hashlib.sha256(payload).hexdigest() != sha256:
        raise EvidenceError("the result does not have the sha256 that its sender announces")
    try:
        return reader(payload)
    except UnusableTrajectoryError:
        raise
    except TrajectoryError as fault:
        raise EvidenceError(f"the result is not {wanted}: {fault}") from None


def check_whole(trajectory: Trajectory, columns: tuple[str, ...], horizon: float) -> None:
    """Refuse a trajectory that does not have these columns, or does not cover 0 to the horizon in s.

    Raises:
        UnusableTrajectoryError: with what is wrong.

    """
    if trajectory.columns != columns:
        raise UnusableTrajectoryError(f"the trajectory has the columns {', '.join(trajectory.columns)[:200]}")
    t = trajectory.samples[:, 0]
    if fault := uncovered(t, horizon):
        raise UnusableTrajectoryError(fault)


# Every check before a rollout becomes a fact, so that no fact stops the campaign

Compared = Literal["alone", "first of a pair", "same"]
"""The time grid of a result: of a rollout without partner, of one whose partner comes, or that of a recorded one."""


class Admission:
    """The admission of results to a ledger: nothing becomes a fact from which the campaign could not continue."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self.columns = tuple(column.name for column in ledger.header.spec.columns)
        self._tolerance = ledger.config.system.tolerance or {}

    def check(self, rollout: RolloutId, trajectory: Trajectory) -> Compared:
        """Refuse a trajectory from which the objective cannot be computed; see `admit`.

        Return with how much its time grid has been compared.
        """
        if self._ledger.restores(rollout):
            return "same"  # its digest decides: it was recorded, and perhaps observed
        if self._tolerance:
            self._check_driven(rollout, trajectory)
        compared: Compared = "alone"

        def others(key: tuple[str, int]) -> list[Trajectory]:
            nonlocal compared
            found = self._others(rollout, key)
            if compared != "first of a pair":
                compared = "same" if found else "first of a pair"
            return found

        fault = objective_fault(self._ledger, rollout, trajectory, others)
        if fault is not None:
            raise UnusableTrajectoryError(f"the objective cannot be computed: {fault}")
        return compared

    def _check_driven(self, rollout: RolloutId, trajectory: Trajectory) -> None:
        """Refuse a rollout that was driven from another start than was asked for."""
        names = [each.name for each in self._ledger.header.spec.parameters]
        asked = dict(zip(names, alone(self._ledger.request(rollout)).x, strict=True))
        # The first sample of each: the column is one number of the rollout.
        driven = {name: float(trajectory.column(driven_column(name))[0]) for name in self._tolerance}
        if (fault := driven_fault(asked, driven, self._tolerance)) is not None:
            raise UnusableTrajectoryError(fault)

    def score(self, rollout: RolloutId, request: BatchRequest, batch: Batch) -> tuple[Scored, Compared]:
        """Return a batch with its scores; a rollout from which the objective cannot be computed has failed.

        Return as well with how much its time grid has been compared.

        Raises:
            UnusableTrajectoryError: the objective can be computed from none, or not together with the partner of one.

        """
        found = scored(self._ledger, request, batch)
        if self._ledger.restores(rollout):
            return found, "same"
        kinds = self._ledger.batched(rollout.problem).measured
        # The scores of each rollout are those of its robustness.
        compared = "alone" if kinds == {"robustness"} else self._check_each(request, found)
        return found, compared if "gap" in kinds else "alone"

    def _check_each(self, request: BatchRequest, found: Scored) -> Compared:
        """Refuse a batch with a rollout that allows no observation of its test, see `check`."""
        assert isinstance(found.batch, Batch), "a worker reduces none"
        first, series = request.rollouts[0], self._ledger.series[request.problem]
        block = plan_of(self._ledger.state, request.problem).batch_of(first)[0].test
        batches = [fact for fact in series.batches.get(block, ()) if fact.rollout.variant != first.variant]
        facts = [*series.rollouts.get(first.test, ()), *(each for batch in batches for each in batch.each())]
        partners = {fact.rollout: fact for fact in facts}
        for place, rollout in enumerate(request.rollouts):
            if place in found.scores.failures:
                continue

            def others(key: tuple[str, int], test: int = rollout.test) -> list[Trajectory]:
                partner = partners.get(RolloutId(request.problem, test, *key))
                return [] if partner is None else [self._recorded(partner)]

            trajectory = found.batch.trajectory(place)
            # Not of that rollout alone: which one of a pair is at fault nobody knows, and its batch has one grid.
            if (fault := objective_fault(self._ledger, rollout, trajectory, others)) is not None:
                raise UnusableTrajectoryError(f"the objective of {rollout} cannot be computed: {fault}")
        return "same" if any(each.variant != first.variant for each in partners) else "first of a pair"

    def _others(self, rollout: RolloutId, key: tuple[str, int]) -> list[Trajectory]:
        facts = self._ledger.series[rollout.problem].rollouts.get(rollout.test, ())
        return [self._recorded(fact) for fact in facts if fact.rollout[2:] == key]

    def _recorded(self, fact: RolloutFact) -> Trajectory:
        recorded = self._ledger.recorded
        try:
            # A batch is in memory as a whole.
            return recorded.read(fact) if fact.batch else recorded.kept(fact)
        except EvidenceError as fault:
            # No failure of this attempt: what is damaged was recorded before it.
            raise PerfboundError(str(fault)) from None


def scored(ledger: Ledger, request: BatchRequest, batch: Batch | Reduced) -> Scored:
    """Return a batch with its scores; a rollout from which the objective cannot be computed has failed.

    Raises:
        UnusableTrajectoryError: the objective can be computed from none, or not from all of a batch that is the unit;
            or a reduced batch has other scores than its samples.

    """
    if isinstance(batch, Reduced):
        _check_scores(ledger, request, batch)
        return Scored(batch, batch.scores)
    found, spec = scores_of_batch(ledger.observer, request, batch), ledger.header.spec
    if len(found.failures) == len(batch):
        raise UnusableTrajectoryError(next(iter(found.failures.values())))
    if found.failures and spec.batch_is_the_unit:
        # Made again alone it would be another rollout: one that fails is a failure of its batch, which is retried.
        place, reason = min(found.failures.items())
        raise UnusableTrajectoryError(f"the whole batch failed with {request.single(place).words(spec)}: {reason}")
    return Scored(batch, found)


def _check_scores(ledger: Ledger, request: BatchRequest, batch: Reduced) -> None:
    """Refuse scores that no rollout has, or that are not those of the samples that were kept."""
    (low, high), scores = ledger.config.clip or UNBOUNDED, batch.scores
    assert scores.robustness is not None, "no other batch is reduced"
    robustness = scores.robustness[batch.succeeded]
    if ((robustness < low) | (robustness > high)).any():
        raise UnusableTrajectoryError(f"a robustness is not in the clip [{low:g}, {high:g}]")
    if (samples := batch.samples) is None:
        return
    places = list(batch.kept)
    found = scores_of_batch(ledger.observer, request, samples)
    recorded = Scores(scores.robustness[places], scores.by_tolerance[places], scores.ended[places], {})
    if (place := _differing(found, recorded)) is not None:
        raise UnusableTrajectoryError(f"rollout {places[place]} has other scores than its samples give")


def _differing(one: Scores, other: Scores) -> int | None:
    """Return the first rollout whose scores differ in two batches; None where they agree up to round-off."""
    same = (one.by_tolerance == other.by_tolerance) & np.isclose(one.ended, other.ended, equal_nan=True)
    if one.robustness is not None and other.robustness is not None:
        same &= np.isclose(one.robustness, other.robustness, rtol=ROUND_OFF, atol=ROUND_OFF, equal_nan=True)
    return None if same.all() else int(np.flatnonzero(~same)[0])


def objective_fault(ledger: Ledger, rollout: RolloutId, trajectory: Trajectory, others: Others) -> str | None:
    """Return why an open test with this rollout could not be observed; None if it could.

    `others` are the trajectories of its test with which it is compared.
    """
    try:
        robustness = ledger.observer.robustness(trajectory)
        if robustness is not None:
            # A fact from which the mathematics cannot continue would stop the campaign at every resume.
            measured(robustness, "the robustness")
        ledger.deciders[rollout.problem].check(ledger.series[rollout.problem], rollout, trajectory, others)
    except ValueError as fault:
        return str(fault)
    return None
