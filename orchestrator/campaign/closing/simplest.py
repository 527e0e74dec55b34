"""The simplest failures: each that a search found, with as many parameters as possible at their nominal value."""

from collections.abc import Sequence

from ....schemas.file.parameters import signal_shapes
from ....schemas.ids import SIMPLEST, RolloutId, of_extension
from ....schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact, RolloutFact
from ....schemas.values import Bound, Proposal
from ...mathematics.search.clusters import violated_parts
from ...mathematics.search.simplest import Group, away, simplest_tests
from .. import state
from ..counterexample import Found
from ..observation import Observer
from ..region import Condition, Start, condition
from ..series import Series
from .after_counterexample import AfterCounterexample, nominal_start


class SimplestFailures(AfterCounterexample):
    """The decider of these tests: failure by failure, each test with the seed of its failure.

    The knots of one input over time are set back together first. A start outside the region counts as one that passes.
    """

    def __init__(self, header: Header, failures: Sequence[Found], observer: Observer, extensions: int) -> None:
        super().__init__(failures[0].rollout, observer)
        falsify = header.config.falsify
        assert falsify is not None, "the file asks for it"
        self.name = of_extension(SIMPLEST, extensions)
        names = [parameter.name for parameter in header.spec.parameters]
        region = condition(header.config.where, names)
        self.nominal = nominal_start(header)
        groups = start_groups(header, names)
        self.each = [Simplification(found, self.nominal, groups, region, falsify.simplest_tests) for found in failures]
        self._seeds: list[int] = []
        """Of the tests so far."""
        most = falsify.simplest_tests * sum(each.next_start is not None for each in self.each)
        self.plan = state.Plan(self.name, 1, most, ((self.found.rollout.variant, 0),))

    @property
    def _current(self) -> "Simplification | None":
        """The failure that is simplified now; None after the last one."""
        return next((each for each in self.each if each.next_start is not None), None)

    def of(self, rollout: RolloutId) -> "Simplification | None":
        """Return what became of a failure; None of one that was not simplified."""
        return next((each for each in self.each if each.found.rollout.rollout == rollout), None)

    def proposal(self, series: Series, test: int) -> ProposalFact:  # noqa: ARG002  (one test at a time)
        """Return the next test."""
        current = self._current
        assert current is not None, "else the series has ended"
        assert current.next_start is not None
        return ProposalFact(self.name, test, Proposal(test, current.next_start, None, None, None, None))

    def bound(self, series: Series, fact: ObservationFact) -> BoundFact:
        """Choose the next start."""
        current = self._current
        assert current is not None, "it was tested"
        self._seeds.append(current.found.rollout.seed)
        (rollout,) = series.last_rollouts
        current.take(rollout)
        done = self._current is None
        return BoundFact(self.name, fact.test, Bound(None, None, "converged" if done else None))

    def seed(self, rollout: RolloutId) -> int:
        """Return the seed of the failure that a test is about."""
        if rollout.test < len(self._seeds):
            return self._seeds[rollout.test]
        current = self._current
        assert current is not None, "it was proposed"
        return current.found.rollout.seed


class Simplification:
    """The tests from one failure on, at most so many; `best` is the simplest start that fails."""

    def __init__(
        self, found: Found, nominal: Start, groups: Sequence[Group], region: Condition | None, most: int
    ) -> None:
        self.found, self.tests = found, 0
        self.best: tuple[Start, float, RolloutId] = (
            found.start,
            found.rollout.robustness or 0.0,
            found.rollout.rollout,
        )
        """With its robustness and its rollout."""
        self._nominal, self._region, self._most = nominal, region, most
        self._search = simplest_tests(found.start, nominal, groups)
        self.next_start: Start | None = self._inside(next(self._search, None))

    @property
    def away(self) -> tuple[int, ...]:
        """The numbers of the parameters of the simplest start that are not at their nominal value."""
        return away(self.best[0], self._nominal)

    def take(self, rollout: RolloutFact) -> None:
        """Take the rollout from the next start, and choose the one after it."""
        assert self.next_start is not None
        self.tests += 1
        # Another part that is violated is another failure, which would take the place of this one.
        margin = rollout.robustness or 0.0
        fails = margin < 0.0 and _violated(rollout) == _violated(self.found.rollout)
        if fails:
            self.best = self.next_start, margin, rollout.rollout
        following = self._inside(self._sent(fails=fails))
        self.next_start = following if self.tests < self._most else None

    def _inside(self, point: Start | None) -> Start | None:
        """Return the first start of the region from here on."""
        while point is not None and self._region is not None and not self._region([point])[0]:
            point = self._sent(fails=False)
        return point

    def _sent(self, *, fails: bool) -> Start | None:
        try:
            return self._search.send(fails)
        except StopIteration:
            return None


def _violated(rollout: RolloutFact) -> tuple[int, ...]:
    return violated_parts(rollout.robustness or 0.0, rollout.parts)


def start_groups(header: Header, names: Sequence[str]) -> list[Group]:
    """Return the numbers of the parameters of each input over time, and each other parameter alone."""
    first = {name: shape.names[0] for shape in signal_shapes(header.config.space) for name in shape.names}
    groups: dict[str, list[int]] = {}
    for number, name in enumerate(names):
        groups.setdefault(first.get(name, name), []).append(number)
    return [tuple(each) for each in groups.values()]
