"""A problem rehearsed before its campaign: its method decides on the rollouts of a pilot, and nothing is simulated.

Every test gets the trajectories of the nearest start of the pilot. How fast the posterior narrows depends on the starts
and on the noise scale more than on the values, so the number of tests is roughly that of the campaign; and the time
that its mathematics take is theirs, since they are the same.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.facts import Header
from ...schemas.trajectory import Floats, Trajectory
from ...schemas.values import MARKED, Guess, Proposal, distance_after
from .forecast import FEWEST
from .methods import method
from .observation import Observer
from .outlook import CoursePoint, ending
from .plan import ProblemPlan
from .region import Start
from .seeds import first_node

APART = 2.0
"""A campaign takes at most so many times as many tests as its rehearsal, and no fewer than its inverse."""
Recorded = Mapping[str, Sequence[Trajectory]]
"""The trajectories of each variant at one start."""


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """The tests of a rehearsal, up to its end or to the end of its time."""

    tests: int
    ended: bool
    """Whether its method stopped, or its budget was spent."""
    course: tuple[CoursePoint, ...]
    seconds: float
    """Of its mathematics."""

    def seconds_for(self, tests: float) -> Guess:
        """Return the time of the mathematics of so many tests; a test takes as long as those before it, or longer.

        >>> Rehearsal(100, True, (), 2.0).seconds_for(200)
        Guess(middle=6.0, low=4.0, high=8.0)
        """
        share = tests / self.tests
        low, high = sorted((self.seconds * share, self.seconds * share**2))
        return Guess((low + high) / 2, low, high)


class NearestStart:
    """The trajectories of a pilot by start: those of the nearest one, each parameter in units of its spread."""

    def __init__(self, starts: Sequence[Start], recorded: Sequence[Recorded]) -> None:
        self._starts, self._recorded = np.array(starts, dtype=np.float64), recorded
        spread = np.ptp(self._starts, axis=0)
        self._widths: Floats = np.where(spread > 0, spread, 1.0)

    def trajectories(self, plan: ProblemPlan, start: Start) -> dict[tuple[str, int], Trajectory]:
        """Return those of a test, by variant and replicate; more replicates than there are rollouts share them."""
        distances = np.linalg.norm((self._starts - np.array(start)) / self._widths, axis=1)
        found = self._recorded[int(np.argmin(distances))]
        return {key: found[key[0]][key[1] % len(found[key[0]])] for key in plan.rollouts}


def rehearsed(
    plan: ProblemPlan,
    header: Header,
    pilot: NearestStart,
    *,
    time: Callable[[], float],
    most: float,
) -> Rehearsal:
    """Rehearse a problem for at most `most` seconds of the clock `time`.

    Raises:
        ValueError: a trajectory allows no observation, or a parameter is outside the range of the method.

    """
    observer, rehearsing, course = Observer(header.config, header.spec), method(plan, header), []
    begin, tests, ended, observing = time(), 0, False, 0.0
    while tests < plan.budget and not ended and (not tests or time() - begin < most):
        first = first_node(header, plan.name, rehearsing.size) if tests == 0 and plan.candidates is not None else None
        chosen = rehearsing.propose(first)
        since = time()
        observation = observer.observe(plan, pilot.trajectories(plan, chosen.x))
        observing += time() - since  # of copies: it costs more where each trajectory is another one
        bound = rehearsing.observe(chosen, observation)
        tests += 1
        ended = bound.verdict is not None
        if tests in MARKED and bound.upper is not None:
            course.append((tests, bound.upper, distance_after(bound, _distance(chosen))))
    return Rehearsal(tests, ended or tests == plan.budget, tuple(course), time() - begin - observing)


def expected_tests(plan: ProblemPlan, found: Rehearsal | None) -> tuple[Guess, str]:
    """Return how many tests a problem will have, and what that rests on."""
    most, alpha = plan.budget, plan.problem.alpha
    if plan.until_counterexample:
        return Guess(most, 1, most), "its budget; a counterexample ends it earlier"
    if alpha is None:
        return Guess(most, most, most), "fixed by the campaign file"
    fewest = min(FEWEST, most)
    if found is None:
        return Guess(most, fewest, most), "its budget; alpha may end it earlier"
    if found.ended:
        words = "alpha reached" if found.tests < most else "budget spent"
        return _within(found.tests, fewest, most), f"rehearsed: {words} after {found.tests} tests"
    ahead = ending(found.course, most=most, alpha=alpha)
    if ahead is None:
        return Guess(most, found.tests, most), "its budget; alpha may end it earlier"
    low, high = max(found.tests, ahead.low / APART), min(most, ahead.high * APART)
    return Guess(ahead.middle, low, high), f"forecast from {found.tests} rehearsed tests"


def _within(tests: int, fewest: int, most: int) -> Guess:
    return Guess(tests, max(fewest, tests / APART), min(most, tests * APART))


def _distance(chosen: Proposal) -> float | None:
    return chosen.F
