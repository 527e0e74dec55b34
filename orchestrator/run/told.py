"""A campaign without workers: its rollouts are handed in, and admitted by the checks of a worker's result."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from ...schemas.batch import alone
from ...schemas.errors import PerfboundError, RequestError, UnusableTrajectoryError, shortened
from ...schemas.failure import Failure
from ...schemas.file.config import CampaignConfig
from ...schemas.host import host_name
from ...schemas.ids import Attempt, RolloutId
from ...schemas.link.configuration import LOCAL
from ...schemas.result.facts import RECORDED, RESTORED, Header
from ...schemas.rollout import RolloutRequest
from ...schemas.system import SystemSpec
from ...schemas.trajectory.batch import digest_of
from ...schemas.trajectory.trajectory import Trajectory
from ..campaign.admission import Admission, admit
from ..campaign.ledger import Ledger, Work
from ..campaign.software import software
from ..certificate import files
from ..store import read
from ..store.journal import Journal
from ..store.rows import DATABASE
from . import session
from .certify import certify
from .directory import stored_differently
from .link import Link
from .options import RunOptions, check_own, reopened

BY_HAND = RunOptions(0, Link(LOCAL))
"""Of sessions without workers."""
TOLD_BY = "told"
"""The worker of a rollout that was handed in."""


@dataclass(frozen=True)
class Admitted:
    """A trajectory that passed the checks of a worker's result, with its file."""

    payload: bytes
    sha256: str
    trajectory: Trajectory

    @classmethod
    def of(cls, payload: bytes, request: RolloutRequest, spec: SystemSpec) -> "Admitted":
        """Return the trajectory in the bytes of a file; raises as `admit`."""
        sha256 = hashlib.sha256(payload).hexdigest()
        columns = tuple(column.name for column in spec.columns)
        return cls(payload, sha256, admit(request, columns, payload, sha256))


class ToldRollouts:
    """The rollouts of a campaign that are told: those that are wanted, and those that are recorded."""

    def __init__(self, directory: Path, journal: Journal) -> None:
        self.directory, self._journal, self._ledger = directory, journal, Ledger(directory, journal)
        self._admission = Admission(self._ledger)
        self.spec, self.mapping = journal.header.spec, journal.header.config.system.logs
        self.wanted: dict[RolloutId, None] = {}
        """In the order of the tests."""
        self._attempts = read.attempts(directory)
        self._ledger.replay()
        self._ledger.check_files(journal)
        with self._ledger.transaction():
            self._take(self._ledger.outstanding())
        self._certify()

    def known(self, name: object) -> RolloutId:
        """Return the rollout of a request that is wanted, or was told before; raises `RequestError`."""
        if not isinstance(name, str):
            raise no_request(name)
        try:
            rollout = RolloutId.parse(name)
        except ValueError:
            raise no_request(name) from None
        if rollout not in self.wanted and all(rollout != fact.rollout for fact in self._journal.recorded()):
            raise RequestError(f"{rollout}: not wanted, or no longer; ask again")
        return rollout

    def request(self, rollout: RolloutId) -> RolloutRequest:
        """Return the request of a rollout that is wanted or was told."""
        if rollout in self.wanted:
            return alone(self._ledger.request(rollout))
        start = self._journal.proposal(rollout.problem, rollout.test).proposal.x
        return self._ledger.header.template.request(rollout, start, self._journal.rollout(rollout).seed)

    def same(self, rollout: RolloutId, told: Admitted) -> bool:
        """Whether a rollout was told the same trajectory before, in whatever form."""
        fact = self._journal.rollout(rollout)
        return fact.sha256 == told.sha256 or self._ledger.recorded.digest(rollout) == digest_of(told.trajectory)

    def check(self, rollout: RolloutId, told: Admitted) -> None:
        """Refuse a trajectory from which the objective cannot be computed."""
        try:
            self._admission.check(rollout, told.trajectory)
        except UnusableTrajectoryError as fault:
            raise UnusableTrajectoryError(f"{rollout}: {fault}") from None

    def record(self, rollout: RolloutId, told: Admitted) -> None:
        """Make a trajectory durable, and everything that follows from it."""
        outcome = RESTORED if self._ledger.restores(rollout) else RECORDED
        with self._ledger.transaction():
            attempt = self._attempt(rollout)
            work = self._ledger.record(rollout, told.payload, told.trajectory, told.sha256)
            self._journal.attempts.ended(attempt, TOLD_BY, outcome)
        del self.wanted[rollout]
        self._take(work)
        self._certify()

    def failed(self, rollout: RolloutId, reason: str) -> None:
        """Record a trial that the system did not survive."""
        with self._ledger.transaction():
            self._journal.attempts.ended(self._attempt(rollout), TOLD_BY, Failure("system", reason))

    def _attempt(self, rollout: RolloutId) -> Attempt:
        attempt = Attempt(rollout, self._attempts.get(rollout, 0) + 1)
        self._attempts[rollout] = attempt.number
        self._journal.attempts.started(attempt, TOLD_BY, host_name(), os.getpid())
        return attempt

    def _take(self, work: Work) -> None:
        self.wanted |= dict.fromkeys(work.wanted)
        for rollout in work.unwanted:
            self.wanted.pop(rollout, None)

    def _certify(self) -> None:
        if not self._ledger.done or files.read(self.directory) is not None:
            return
        self._journal.check_place()
        if self._ledger.check_files(self._journal, whole=True):
            self._take(self._ledger.outstanding())  # what was removed meanwhile is wanted again
        else:
            certify(self.directory, self._ledger)


def no_request(given: object) -> RequestError:
    """Return the error about what is no request."""
    return RequestError(f"{shortened(repr(given), 80)} is no request; give what ask() returned, or its id")


@contextmanager
def journal_in(
    directory: Path, config: CampaignConfig | None, spec: SystemSpec | None, reference: str | None
) -> Iterator[Journal]:
    """Begin a campaign without workers in a directory, or continue the one that is there.

    Raises:
        PerfboundError: there is none, another one, or it is in use.

    """
    if (directory / DATABASE).exists() or config is None or spec is None:
        if config is not None and (found := stored_differently(directory, config)):
            raise PerfboundError(f"{directory}: another campaign is here ({found}); choose another directory")
        # No worker: of an installed system nothing is compared: the caller has it.
        with reopened(directory, replace(BY_HAND, system=reference)) as (journal, _):
            _check_opinions(journal.header.config)
            if spec is not None and spec.repeated != "anywhere":
                check_own(journal.header, spec)
            yield journal
    else:
        _check_opinions(config)
        header = Header.new(config, spec, software(spec))
        with session.created(directory, header, BY_HAND.origin(reference or spec.name)) as journal:
            yield journal


def _check_opinions(config: CampaignConfig) -> None:
    """Refuse a campaign whose certificate would state comparisons that nobody makes."""
    if config.second_opinion:
        raise PerfboundError(
            "second_opinion: rollouts that are handed in have no second worker; leave the key out, or run the campaign"
        )
