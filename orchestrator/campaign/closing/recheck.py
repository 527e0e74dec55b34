"""The recheck before a certificate: rollouts drawn from the evidence are simulated once more and compared."""

from bisect import bisect_right
from collections.abc import Mapping
from itertools import accumulate

from ....schemas.base import digest
from ....schemas.ids import RECHECK, RolloutId, of_extension
from ....schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact
from ....schemas.rollout import RolloutRequest
from ....schemas.trajectory.batch import digest_of
from ....schemas.trajectory.trajectory import Trajectory
from ....schemas.values import Bound, Observation, Proposal
from .. import state
from ..observation import Others, Trajectories
from ..ports import Recorded
from ..seeds import drawn, rollout_seed
from ..series import Series


class Recheck:
    """The decider of the recheck: test i repeats the i-th drawn rollout; its y is 1 where both trajectories agree.

    Drawn when all other evidence is fixed, from the digests of its files: before, nobody can know which rollouts are
    compared. `checked` are the series to draw from, with the rollouts of each of their tests.
    """

    def __init__(
        self,
        header: Header,
        checked: Mapping[str, tuple[Series, state.Plan]],
        recorded: Recorded,
        extensions: int = 0,
    ) -> None:
        self.name = of_extension(RECHECK, extensions)
        self.differing: list[int] = []
        """The tests so far whose repetition gave another trajectory than the original."""
        self._header, self._recorded = header, recorded
        sizes = [plan.count(len(series.observations)) for series, plan in checked.values()]
        ends = list(accumulate(sizes))
        # Not the head of the hash chain: it covers last digits of proposals, which another CPU could not repeat.
        files = digest([series.files for series, _ in checked.values()])
        numbers = drawn(header, self.name, files, sum(sizes), min(header.config.recheck, sum(sizes)))
        names, plans = list(checked), [plan for _, plan in checked.values()]
        self.rollouts: list[RolloutId] = []
        for number in numbers:
            index = bisect_right(ends, number)
            test, place = plans[index].located(number - (ends[index] - sizes[index]))
            self.rollouts.append(RolloutId(names[index], test, *plans[index].rollouts_of(test)[place]))
        variants = tuple(rollout.variant for rollout in self.rollouts)
        self.plan = state.Plan(self.name, len(numbers), len(numbers), (), variants=variants)

    @property
    def first_differing(self) -> RolloutRequest | None:
        """The request for the first original whose repetition gave another trajectory; None where all so far agree."""
        if not self.differing:
            return None
        original = self.rollouts[self.differing[0]]
        start = self._recorded.start(original)
        seed, within = rollout_seed(self._header, original), self._recorded.within(original)
        return self._header.template.request(original, start, seed, within=within)

    @classmethod
    def wanted(cls, header: Header) -> bool:
        """Whether the campaign has a recheck."""
        return header.config.recheck > 0

    def proposal(self, series: Series, test: int) -> ProposalFact:  # noqa: ARG002  (the draw is fixed)
        """Return the start of the test's original."""
        return ProposalFact(
            self.name, test, Proposal(test, self._recorded.start(self.rollouts[test]), None, None, None, None)
        )

    def observation(self, series: Series, test: int, trajectories: Trajectories) -> ObservationFact:
        """Compare the test's trajectory with its original, bit by bit."""
        (again,) = trajectories.values()
        agrees = float(self._recorded.digest(self.rollouts[test]) == digest_of(again))
        found = Observation(agrees, (agrees,))
        return ObservationFact(self.name, test, found, series.next_link(test, found))

    def check(self, series: Series, rollout: RolloutId, trajectory: Trajectory, others: Others) -> None:
        """Do nothing: any two trajectories can be compared."""

    def bound(self, series: Series, fact: ObservationFact) -> BoundFact:  # noqa: ARG002  (nothing is bounded)
        """Return the end of the series after its last test."""
        if fact.observation.y != 1.0:
            self.differing.append(fact.test)
        return BoundFact(self.name, fact.test, Bound(None, None, None), budget=fact.test + 1 >= len(self.rollouts))

    def seed(self, rollout: RolloutId) -> int:
        """Return the seed of the original."""
        return rollout_seed(self._header, self.rollouts[rollout.test])
