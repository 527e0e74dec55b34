"""A problem rehearsed before its campaign: its method decides on the rollouts of a pilot, and nothing is simulated.

A method with a kernel observes a function of this kernel through the values of the pilot, with noise like theirs; every
other one the trajectories of the pilot's nearest start. How fast a bound falls depends on the starts, the constants and
the noise more than on the values, so the number of tests is roughly that of the campaign; and the time that its
mathematics take is theirs, since they are the same.

| symbol | name       | meaning                                                        | shape  | unit |
|--------|------------|----------------------------------------------------------------|--------|------|
| z      | `starts`   | starts of the pilot                                            | (n, p) | parameter |
| y      | `values`   | observed objective of a test at each of them                   | (n,)   | J    |
| s      | `sd`       | standard deviation of one replicate, pooled over the starts    | ()     | J    |
| f      |            | m0 + k(., z) (K + (s^2/k)/B^2 I)^-1 (y - m0), k replicates     |        | J    |
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....schemas.file.problem_models import KernelProblem
from ....schemas.result.facts import Header
from ....schemas.trajectory.trajectory import Floats, Trajectory
from ....schemas.values import MARKED, Guess, Observation, Verdict, distance_after
from ...campaign.methods import kernel, method
from ...campaign.observation import Observer
from ...campaign.plan import ProblemPlan, value_range
from ...campaign.region import Start
from ...campaign.seeds import first_node
from ...forecast.outlook import CoursePoint, ending
from ...mathematics.gp.kernels import scaled
from ..size import growing_time

FEWER, MORE = 1 / 3, 5.0
"""Tests of a campaign, in times of its rehearsal's: a real objective has more structure than ten rollouts show."""
REPEATED = 2
"""Rollouts of a noisy variant at each start of a pilot."""
LEAST_RIDGE = 1e-8
UNKNOWN = "its budget; alpha may end it earlier"
Recorded = Mapping[str, Sequence[Trajectory]]
"""The trajectories of each variant at one start."""


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """The tests of a rehearsal, up to its end or to the end of its time."""

    tests: int
    verdict: Verdict | None
    """Of the method after the last test; None where the budget or the time ended it."""
    course: tuple[CoursePoint, ...]
    seconds: float
    """Of its mathematics."""

    def seconds_for(self, tests: float) -> Guess:
        """Return the time of the mathematics of so many tests."""
        return growing_time(self.seconds, self.tests, tests)


class PilotRollouts:
    """The trajectories of a pilot by start. Each parameter counts in units of its spread over the starts."""

    def __init__(self, starts: Sequence[Start], recorded: Sequence[Recorded]) -> None:
        self.starts, self._recorded = np.array(starts, dtype=np.float64), recorded
        spread = np.ptp(self.starts, axis=0)
        self._widths: Floats = np.where(spread > 0, spread, 1.0)

    def at(self, plan: ProblemPlan, number: int) -> dict[tuple[str, int], Trajectory]:
        """Return those of a test at a start of the pilot; more replicates than there are rollouts share them."""
        found = self._recorded[number]
        return {key: found[key[0]][key[1] % len(found[key[0]])] for key in plan.rollouts}

    def nearest(self, plan: ProblemPlan, start: Start) -> dict[tuple[str, int], Trajectory]:
        """Return those of a test at the nearest start."""
        distances = np.linalg.norm((self.starts - np.array(start)) / self._widths, axis=1)
        return self.at(plan, int(np.argmin(distances)))


class _KernelSurface:
    """A function of the problem's own kernel through the values of a pilot, observed with noise."""

    def __init__(self, plan: ProblemPlan, problem: KernelProblem, observer: Observer, pilot: PilotRollouts) -> None:
        found = [observer.observe(plan, pilot.at(plan, number)) for number in range(len(pilot.starts))]
        distinct = min(REPEATED, plan.replicates)
        each = np.array([one.each[:distinct] for one in found])
        self._sd = float(np.sqrt(each.var(axis=1, ddof=1).mean())) if distinct > 1 else _given_noise(plan)
        self._prior, self._replicates = problem.prior_mean, plan.replicates
        self._kernel = kernel(plan, problem)
        self._points = scaled(pilot.starts, self._kernel.axes)
        gram = self._kernel(np.linalg.norm(self._points[:, None, :] - self._points[None, :, :], axis=2))
        ridge = max(self._sd**2 / plan.replicates / problem.rkhs_norm**2, LEAST_RIDGE)
        values = np.array([one.y for one in found]) - self._prior
        # Not the value of the nearest start: piecewise constant, it contradicts B, and the method would end early.
        self._weights = np.linalg.solve(gram + ridge * np.eye(len(gram)), values)
        low, high = value_range(plan)
        self._ends = -np.inf if low is None else low, np.inf if high is None else high
        self._random = np.random.default_rng(0)

    def observation(self, start: Start) -> Observation:
        """Return an observation at a start."""
        distances = np.linalg.norm(self._points - scaled(np.array([start]), self._kernel.axes), axis=1)
        mean = self._prior + float(self._kernel(distances) @ self._weights)
        each = np.clip(mean + self._sd * self._random.standard_normal(self._replicates), *self._ends)
        return Observation(float(each.mean()), tuple(each.tolist()))


def _given_noise(plan: ProblemPlan) -> float:
    """Return the noise of a test where a pilot shows none: the scale of the file; 0 where it is only an upper limit."""
    return plan.noise_per_rollout if plan.noise_per_rollout < plan.hoeffding else 0.0


def rehearsed(
    plan: ProblemPlan,
    header: Header,
    pilot: PilotRollouts,
    *,
    time: Callable[[], float],
    most: float,
    done: Callable[[float], None] = lambda _: None,
) -> Rehearsal:
    """Rehearse a problem for at most `most` seconds of the clock `time`; `done` is called with the share that is over.

    Raises:
        ValueError: a trajectory allows no observation, or a parameter is outside the range of the method.

    """
    # Invented values follow from no disturbances, which would explain nothing of them.
    parts = tuple(replace(each, controlled=False, reports=None) for each in plan.parts)
    plan = replace(plan, controlled=False, reports=None, parts=parts)
    observe, course = _surface(plan, header, pilot), list[tuple[int, float, float | None]]()
    rehearsing = method(plan, header)
    begin, tests, verdict, observing, passed = time(), 0, None, 0.0, 0.0
    while tests < plan.budget and verdict is None and (not tests or passed < most):
        first = first_node(header, plan.name, rehearsing.size) if tests == 0 and plan.candidates is not None else None
        chosen = rehearsing.propose(first)
        since = time()
        observation = observe(chosen.x)
        observing += time() - since
        bound = rehearsing.observe(chosen, observation)
        tests, verdict = tests + 1, bound.verdict
        if tests in MARKED and bound.upper is not None:
            course.append((tests, bound.upper, distance_after(bound, chosen.F)))
        passed = time() - begin
        done(min(1.0, max(tests / plan.budget, passed / most)))
    return Rehearsal(tests, verdict, tuple(course), passed - observing)


def _surface(plan: ProblemPlan, header: Header, pilot: PilotRollouts) -> Callable[[Start], Observation]:
    """Return what a rehearsal observes at a start."""
    observer = Observer(header.config, header.spec)
    if isinstance(plan.problem, KernelProblem) and not plan.parts:
        return _KernelSurface(plan, plan.problem, observer, pilot).observation
    return lambda start: observer.observe(plan, pilot.nearest(plan, start))


def expected_tests(plan: ProblemPlan, found: Rehearsal | None) -> tuple[Guess, str]:
    """Return how many tests a problem will have, and what that rests on."""
    most, alpha = plan.budget, plan.problem.alpha
    if plan.falsify is not None and plan.falsify.until == "budget":
        return Guess(most, most, most), "its budget"
    if plan.may_end_early:
        clusters = None if plan.falsify is None else plan.falsify.clusters
        earlier = "a counterexample ends" if clusters is None else f"{clusters} clusters of failing starts end"
        return Guess(most, 1, most), f"its budget; {earlier} it earlier"
    if alpha is None:
        return Guess(most, most, most), "fixed by the campaign file"
    # Invented values may contradict the constants; the real ones may not.
    if found is None or found.verdict not in (None, "converged"):
        return Guess(most, 1, most), UNKNOWN
    if found.verdict is not None:
        return _times_apart(found.tests, most), f"rehearsed: alpha after {found.tests:,}"
    if found.tests == most:
        return _times_apart(most, most), "rehearsed: the whole budget"
    ahead = ending(found.course, most=most, alpha=alpha)
    if ahead is None:
        return Guess(most, found.tests * FEWER, most), UNKNOWN
    low, high = max(1, ahead.low * FEWER), min(most, ahead.high * MORE)
    return Guess(ahead.middle, low, high), f"forecast after {found.tests:,} rehearsed tests"


def _times_apart(tests: int, most: int) -> Guess:
    return Guess(tests, max(1, tests * FEWER), min(most, tests * MORE))
