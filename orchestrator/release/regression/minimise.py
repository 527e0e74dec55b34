"""Failures moved towards the nominal start and the medians of their disturbances, by further rollouts."""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ....schemas.errors import PerfboundError, UnusableTrajectoryError
from ....schemas.file.against_system import SEARCHED_SCORE
from ....schemas.ids import RolloutId
from ....schemas.result.facts import Header
from ....schemas.rollout import RolloutRequest
from ....schemas.trajectory.trajectory import Trajectory
from ...campaign.admission import check_whole
from ...campaign.closing.after_counterexample import nominal_start
from ...campaign.closing.simplest import start_groups
from ...campaign.region import condition
from ...campaign.starts import Listed, of_space
from ...fleet.children.rollouts import ChildRolloutError, ChildSystem, finished, simulate_in_child
from ...mathematics.search.nearest import nearest_tests
from ...mathematics.search.simplest import Group, Point
from .failures import Failure
from .outcome import Judge, Outcome, same_moment

Simulate = Callable[[Sequence[RolloutRequest]], Sequence[Outcome | None]]
"""Returns what rollouts show; None of one that gives no trajectory."""
WHILE_MOVED = 0.25
"""Of the horizon: a failure that is moved moves in time as well."""
NAME = "regression"
"""Of these rollouts, in place of a problem."""


class Movable:
    """What can be moved of the failures of a campaign: the numbers of a start, and the scores of drawn disturbances.

    A start of a list stays as it is, as does a choice that is drawn.
    """

    def __init__(self, header: Header, nominal: Mapping[str, float]) -> None:
        spec, space, config = header.spec, of_space(header), header.config
        self._template, self._spec, self._space = replace(header.template, visual=False), spec, space
        self._region = condition(config.where, [each.name for each in spec.parameters])
        self._numbers, self.horizon = len(spec.parameters), config.horizon
        names = [each.name for each in spec.parameters]
        start = [nominal.get(name, value) for name, value in zip(names, nominal_start(header), strict=True)]
        low, high = space.box
        width = high - low
        self.nominal: Point = (*space.nearest(np.array(start), ())[1], *(0.0 for _ in spec.drawn))
        self.widths = (*np.where(width > 0.0, width, 1.0).tolist(), *(SEARCHED_SCORE for _ in spec.drawn))
        of_starts = [] if isinstance(space, Listed) else start_groups(header, names)
        of_laws = [(self._numbers + k,) for k, law in enumerate(spec.drawn) if law.choices is None]
        self.groups: tuple[Group, ...] = (*of_starts, *of_laws)

    def point(self, failure: Failure) -> Point:
        """Return the numbers of a failure."""
        if not failure.disturbances:
            return (*failure.x, *self.nominal[self._numbers :])
        return (*failure.x, *self._template.scores([failure.seed])[0].tolist())

    def is_nominal(self, failure: Failure) -> bool:
        """Whether the start of a failure is the nominal one."""
        return failure.x == self.nominal[: self._numbers]

    def allowed(self, point: Point) -> Point | None:
        """Return the nearest point that the campaign allows; None outside of its region."""
        start = self._space.nearest(np.array(point[: self._numbers]), ())[1]
        if self._region is not None and not self._region([start])[0]:
            return None
        return (*start, *point[self._numbers :])

    def request(self, failure: Failure, point: Point) -> RolloutRequest:
        """Return the request for the rollout at a point, with the seed of a failure."""
        rollout = RolloutId(NAME, 0, failure.rollout.variant, 0)
        request = self._template.request(rollout, point[: self._numbers], failure.seed)
        if not failure.disturbances or self._template.laws is None:
            return request
        values, scores = list(request.disturbances), point[self._numbers :]
        for place, score, own in zip(
            self._spec.drawn_places, scores, self.point(failure)[self._numbers :], strict=True
        ):
            if score != own:
                values[place] = float(self._template.laws.at_scores(place, [score])[0])
        return request.model_copy(update={"disturbances": tuple(values)})


def minimised(
    failures: Sequence[Failure],
    movable: Movable,
    simulate: Simulate,
    *,
    tests: int,
    report: Callable[[int], None],
) -> list[Failure]:
    """Return the nearest failure that follows from each, with at most `tests` rollouts for each.

    All make one step together, for which `simulate` gets a request of each; `report` gets the number of rollouts.

    Raises:
        PerfboundError: a failure does not fail when it is simulated again.

    """
    _check_again(failures, simulate([movable.request(each, movable.point(each)) for each in failures]))
    descents, done = [_Descent(each, movable, tests) for each in failures], 0
    while active := [each for each in descents if each.next is not None]:
        for descent, outcome in zip(active, simulate([each.request for each in active]), strict=True):
            descent.take(outcome)
        done += len(active)
        report(done)
    return [each.best for each in descents]


def _check_again(failures: Sequence[Failure], outcomes: Sequence[Outcome | None]) -> None:
    """Refuse to continue from a failure that is none here."""
    for failure, again in zip(failures, outcomes, strict=True):
        if again is None or not again.fails:
            found = "gives no trajectory" if again is None else f"has the robustness {again.robustness:.6g}"
            raise PerfboundError(
                f"{failure.rollout}: simulated again it {found}, and failed in the campaign with "
                f"{failure.outcome.robustness:.6g}; export on a machine and with packages like those of the campaign"
            )


class _Descent:
    """The steps from one failure to the nearest one."""

    def __init__(self, failure: Failure, movable: Movable, tests: int) -> None:
        self.best = failure
        self._failure, self._movable, self._left = failure, movable, tests
        point = movable.point(failure)
        self._fails = {point: True}
        self._tests = nearest_tests(point, movable.nominal, movable.groups, movable.widths)
        self.next: Point | None = self._allowed(next(self._tests, None))

    @property
    def request(self) -> RolloutRequest:
        """Of the next rollout."""
        assert self.next is not None
        return self._movable.request(self._failure, self.next)

    def take(self, outcome: Outcome | None) -> None:
        """Take what the next rollout shows, None for one without a trajectory, and choose the one after it."""
        assert self.next is not None
        fails = outcome is not None and outcome.fails and self._is_same(outcome)
        if outcome is not None and fails:
            request = self.request
            self.best = replace(self._failure, x=request.chosen, disturbances=request.disturbances, outcome=outcome)
        self._fails[self.next] = fails
        self._left -= 1
        following = self._allowed(self._sent(fails=fails))
        self.next = following if self._left > 0 else None

    def _is_same(self, outcome: Outcome) -> bool:
        """Whether this is the failure that is moved: another requirement or another moment is another one."""
        before = self.best.outcome
        at_once = same_moment(before, outcome, self._movable.horizon, WHILE_MOVED)
        return outcome.violated == before.violated and at_once

    def _allowed(self, point: Point | None) -> Point | None:
        """Return the first point from here on that has to be simulated."""
        while point is not None:
            near = self._movable.allowed(point)
            if near is not None and near not in self._fails:
                return near
            point = self._sent(fails=near is not None and self._fails[near])
        return None

    def _sent(self, *, fails: bool) -> Point | None:
        try:
            return self._tests.send(fails)
        except StopIteration:
            return None


def simulated(system: ChildSystem, judge: Judge, requests: Sequence[RolloutRequest]) -> list[Outcome | None]:
    """Return what rollouts show, from one child process; None of one that gives no trajectory, as where it crashes."""
    found = list[Outcome | None]()
    while len(found) < len(requests):
        left = requests[len(found) :]
        with tempfile.TemporaryDirectory() as folder:
            try:
                simulate_in_child(system, left, Path(folder))
                found += _outcomes(system, left, Path(folder), judge)
            except ChildRolloutError:
                found += [*_outcomes(system, left, Path(folder), judge), None]
    return found[: len(requests)]


def _outcomes(
    system: ChildSystem, requests: Sequence[RolloutRequest], folder: Path, judge: Judge
) -> Iterator[Outcome | None]:
    for request, trajectory, _ in finished(system, requests, folder):
        yield _outcome(trajectory, request, system, judge)


def _outcome(trajectory: Trajectory, request: RolloutRequest, system: ChildSystem, judge: Judge) -> Outcome | None:
    try:
        check_whole(trajectory, tuple(column.name for column in system.spec.columns), request.horizon)
        return judge.outcome(trajectory)
    except (UnusableTrajectoryError, ValueError):
        return None
