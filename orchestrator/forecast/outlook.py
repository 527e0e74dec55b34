"""Three numbers to plan with: the end of a problem, its bound there, and what another thousand rollouts would bring.

A forecast, and no claim: the bounds so far are continued as now - c (x(n) - x(n0)) with x(n) = (1 - n^-p)/p, which is
log n for p = 0, and c by least squares. The power p of a bound is not known: large noise hides a bound at first, and it
falls faster and faster (p < 0); later it approaches a limit (p > 0). So each of `POWERS` is fitted to all bounds and to
the later half of them; those fits count that describe the later half nearly as well as the best one. The distance to
alpha is continued in the same way, and where it is crossed the problem ends. A range is that of the fits with slopes up
to `STEEPER` times as large or as small, and with a part of the deviations of the later half: a bound falls in jumps.
Pure Python, because `perfbound status` loads no numpy. A method that plans its tests has a forecast of its own, from
its weights: see `planned_outlook`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from ...schemas.file.config import CampaignConfig
from ...schemas.file.problem_models import KrigingProblem, PaperProblem, Problem, SampleProblem
from ...schemas.values import Guess, ProblemProgress, distance_after
from .remaining import FEWEST, budget

POWERS = (-0.5, -0.25, 0.0, 0.25, 0.5, 1.0)
"""From a fall that becomes faster to a limit that is approached as 1/n."""
NEARLY = 3.0
"""A fit counts if its residual is at most so many times the least one, which no model of the rest explains."""
MORE = 1000
"""Rollouts of the second number."""
FEWEST_POINTS = 6
"""Of a fit: bounds at marked tests."""
STEEPER = 1.5
JUMPS = 0.25
"""With these two, ranges contained what came in about nine of ten forecasts for campaigns on record."""
LARGEST_POWER = 60.0
"""Of e, in a number of tests that is as good as infinite."""

Point = tuple[int, float]
"""(tests, a falling number after them): the bound on J, or the distance to the tolerance."""
CoursePoint = tuple[int, float, float | None]
"""(tests, bound on J after them, distance to the tolerance), see `ProblemProgress.course`."""


@dataclass(frozen=True, slots=True)
class Outlook:
    """The forecast of a problem, in terms of J: the bound falls."""

    tests: Guess
    """At its end, by its tolerance or its budget."""
    bound: Guess
    gain: Guess
    """By which `MORE` rollouts beyond the budget would lower it."""
    at_budget: Guess
    """The bound at the end of the budget by the fits alone."""


def outlook(
    course: Sequence[CoursePoint], *, least: float | None, most: int, per_test: float, alpha: float | None = None
) -> Outlook | None:
    """Return the forecast of a problem of at most `most` tests; None where the bounds allow none yet.

    `course` are its bounds at some tests, the last one at the last test, `least` is what the bound never falls below:
    its partner from the other side. A test has `per_test` rollouts. Without `alpha` the budget alone ends it.
    """
    bounds = _Continued.of([(tests, upper) for tests, upper, _ in course])
    if bounds is None or per_test <= 0:
        return None
    tests = ending(course, most=most, alpha=alpha) if alpha is not None else None
    tests = tests or Guess(most, most, most)
    floor = -math.inf if least is None else min(least, bounds.now)
    pairs = bounds.pairs(most, most + MORE / per_test, floor)
    further = [max(0.0, first - second) for first, second in pairs]
    return Outlook(tests, bounds.at(tests, floor), _over_fits(further), _over_fits([first for first, _ in pairs]))


def ending(course: Sequence[CoursePoint], *, most: int, alpha: float) -> Guess | None:
    """Return the tests at which the distance has fallen to `alpha`, at most `most`; None where nothing is known yet."""
    distances = _Continued.of([(tests, away) for tests, _, away in course if away is not None])
    return None if distances is None else distances.crossing(alpha, most)


def remaining_tests(config: CampaignConfig, problem: Problem, progress: ProblemProgress) -> Guess | None:
    """Return how many tests a problem still needs, to its tolerance or the end of its budget; None while unknown."""
    most = budget(config, problem, progress.extended)
    if problem.alpha is None:  # their number is fixed
        return Guess(most - progress.tests, most - progress.tests, most - progress.tests)
    end = ending(with_last(progress), most=max(most, progress.tests), alpha=problem.alpha)
    if end is None:
        return None
    return Guess(end.middle - progress.tests, end.low - progress.tests, end.high - progress.tests)


def left_in_words(config: CampaignConfig, problem: Problem, left: Guess) -> str:
    """Return the remaining tests in words; a number of samples is no guess.

    >>> from types import SimpleNamespace
    >>> left_in_words(SimpleNamespace(may_end_early=False), SampleProblem.model_construct(), Guess(9, 9, 9))
    '9 samples'
    """
    words = count_words(left)
    if not isinstance(problem, SampleProblem):
        about = "" if problem.alpha is None else "about "
        return f"{about}{words} test{'' if words == '1' else 's'}"
    most = "at most " if config.may_end_early else ""
    return f"{most}{words} sample{'' if words == '1' else 's'}"


def outlook_lines(config: CampaignConfig, progress: Sequence[ProblemProgress]) -> list[str]:
    """Return a line for each problem that has a forecast, in the unit and sense of the problem."""
    pairs = zip(config.problems, progress, strict=True)
    return [f"{problem.name}, {words}" for problem, each in pairs if (words := in_words(config, problem, each))]


def in_words(config: CampaignConfig, problem: Problem, progress: ProblemProgress) -> str | None:
    """Return the forecast of a problem in words; None where there is none, and for a question that is answered."""
    # A number of samples is fixed, and so is what it can show; method `paper` has no bound before it stops.
    without = isinstance(problem, SampleProblem | PaperProblem)
    if without or progress.stopped_by not in (None, "budget") or not progress.tests:
        return None
    if isinstance(problem, KrigingProblem):
        return _planned_words(config, problem, progress)
    found = problem_outlook(config, problem, progress)
    if found is None:
        return None
    sign = -1 if config.sense_of(problem) == "min" else 1
    gain = found.gain.words(1)
    more = f"{MORE:,} further rollouts would bring about {gain}"
    if progress.stopped_by == "budget":
        return f"forecast: {more}"
    return f"forecast: bound about {found.bound.words(sign)} after {count_words(found.tests)} tests; {more}"


def problem_outlook(config: CampaignConfig, problem: Problem, progress: ProblemProgress) -> Outlook | None:
    """Return the forecast of a problem whose method has a bound after every test; None where there is none yet."""
    if not progress.tests:
        return None
    return outlook(
        with_last(progress),
        least=progress.bound.lower if progress.bound else None,
        most=max(progress.tests, budget(config, problem, progress.extended)),
        per_test=progress.rollouts / progress.tests,
        alpha=None if progress.stopped_by == "budget" else problem.alpha,
    )


def count_words(tests: Guess) -> str:
    """Return a guess of a whole number with its range, which may be a single one.

    >>> count_words(Guess(80.2, 71.0, 120.4)), count_words(Guess(400, 400, 400))
    ('80 (71 to 121)', '400')
    """
    low, high = math.floor(tests.low), math.ceil(tests.high)
    return f"{low:,}" if low == high else f"{round(tests.middle):,} ({low:,} to {high:,})"


def _planned_words(config: CampaignConfig, problem: KrigingProblem, progress: ProblemProgress) -> str | None:
    """Return the forecast of a problem whose tests are planned, and end with the plan."""
    if progress.planned is None:
        return None
    bound, gain = progress.planned
    more = f"a campaign planned for {MORE:,} more rollouts would gain about {gain.words(1)}"
    if progress.stopped_by == "budget":
        return f"forecast: {more}"
    sign = -1 if config.sense_of(problem) == "min" else 1
    return f"forecast: bound about {bound.words(sign)} after {config.max_tests_of(problem):,} tests; {more}"


def with_last(progress: ProblemProgress) -> list[CoursePoint]:
    """Return the course of a problem with its last test."""
    bound = progress.bound
    earlier = [point for point in progress.course if point[0] < progress.tests]
    if bound is None or bound.upper is None:
        return earlier
    return [*earlier, (progress.tests, bound.upper, distance_after(bound, progress.F))]


def _grown(number: float, power: float) -> float:
    """Return x(n) of the model."""
    return math.log(number) if power == 0 else (1 - number**-power) / power


def _tests_at(grown: float, power: float) -> float:
    """Return the n with x(n) = `grown` in the model; infinite where x never grows so far."""
    if power == 0:
        return math.exp(min(grown, LARGEST_POWER))
    base = 1 - power * grown
    return math.exp(min(-math.log(base) / power, LARGEST_POWER)) if base > 0 else math.inf


@dataclass(frozen=True, slots=True)
class _Continued:
    """A falling number after its last test, by every fit that describes it."""

    tests: int
    now: float
    fits: "Sequence[_Fit]"
    judged: int
    """Points behind the residual of a fit."""

    @classmethod
    def of(cls, points: Sequence[Point]) -> "_Continued | None":
        """Return the continuation of a number from its course; None for too few points."""
        usable = [(tests, value) for tests, value in points if tests >= FEWEST and math.isfinite(value)]
        if len(usable) < FEWEST_POINTS:
            return None
        later = usable[len(usable) // 2 :]
        fits = [_Fit.of(some, power, later) for power in POWERS for some in (usable, later)]
        least_residual = min(fit.residual for fit in fits)
        # The neighbours of the best power as well: the true one may be between two of them.
        best = POWERS.index(min(fits, key=lambda fit: fit.residual).power)
        near = POWERS[max(0, best - 1) : best + 2]
        good = [fit for fit in fits if fit.residual <= NEARLY * least_residual or fit.power in near]
        tests, now = usable[-1]
        return cls(tests, now, good, len(later))

    def pairs(self, first: float, second: float, floor: float) -> list[tuple[float, float]]:
        """Return the number after so many tests, and after so many, by each fit."""
        return [
            (max(self.now - fit.fall(self.tests, first), floor), max(self.now - fit.fall(self.tests, second), floor))
            for fit in self.fits
        ]

    def at(self, tests: Guess, floor: float) -> Guess:
        """Return the number after a guessed number of tests; it is never below `floor`, and never rises."""
        if tests.high <= self.tests:
            return Guess(self.now, self.now, self.now)

        def after(fit: _Fit, number: float, steepness: float, jump: float) -> float:
            return min(self.now, max(floor, self.now - steepness * fit.fall(self.tests, number) - jump))

        middle = [after(fit, tests.middle, 1.0, 0.0) for fit in self.fits]
        low = [after(fit, tests.high, STEEPER, self._jump(fit)) for fit in self.fits]
        high = [after(fit, tests.low, 1 / STEEPER, -self._jump(fit)) for fit in self.fits]
        return Guess(median(middle), min(low), max(high))

    def crossing(self, limit: float, most: int) -> Guess:
        """Return the tests after which the number has fallen to `limit`, at most `most`."""
        if self.now <= limit:
            return Guess(self.tests, self.tests, self.tests)

        def crossed(fit: _Fit, steepness: float, jump: float) -> float:
            away = max(0.0, self.now - limit - jump)
            return min(most, max(self.tests + 1, fit.reaches(self.tests, away / steepness)))

        middle = [crossed(fit, 1.0, 0.0) for fit in self.fits]
        low = [crossed(fit, STEEPER, self._jump(fit)) for fit in self.fits]
        high = [crossed(fit, 1 / STEEPER, -self._jump(fit)) for fit in self.fits]
        return Guess(median(middle), min(low), max(high))

    def _jump(self, fit: "_Fit") -> float:
        return JUMPS * fit.residual / math.sqrt(self.judged)


@dataclass(frozen=True, slots=True)
class _Fit:
    """The model u = a - c x(n) with c >= 0, by least squares."""

    power: float
    slope: float
    residual: float

    @classmethod
    def of(cls, points: Sequence[Point], power: float, judged: Sequence[Point]) -> "_Fit":
        """Fit the model to points; its residual is that of the `judged` ones."""
        x = [_grown(number, power) for number, _ in points]
        centre, level = math.fsum(x) / len(x), math.fsum(upper for _, upper in points) / len(points)
        spread = math.fsum((each - centre) ** 2 for each in x)
        common = math.fsum((each - centre) * (upper - level) for each, (_, upper) in zip(x, points, strict=True))
        slope = max(0.0, -common / spread) if spread else 0.0
        missed = (upper - level + slope * (_grown(number, power) - centre) for number, upper in judged)
        return cls(power, slope, math.sqrt(math.fsum(each**2 for each in missed)))

    def fall(self, first: float, second: float) -> float:
        """Return by how much the model falls from one number of tests to another."""
        return self.slope * (_grown(second, self.power) - _grown(first, self.power))

    def reaches(self, first: float, fall: float) -> float:
        """Return the number of tests after which the model has fallen by `fall` since `first`."""
        if self.slope <= 0:
            return math.inf
        return _tests_at(_grown(first, self.power) + fall / self.slope, self.power)


def _over_fits(values: Sequence[float]) -> Guess:
    return Guess(median(values), min(values), max(values))
