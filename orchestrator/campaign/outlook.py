"""Two numbers to plan with: the bound at the end of the budget, and what another thousand rollouts would bring.

A forecast, and no claim: the bounds so far are continued as now - c (x(n) - x(n0)) with x(n) = (1 - n^-p)/p, which is
log n for p = 0, and c by least squares. The power p of a bound is not known: large noise hides a bound at first, and it
falls faster and faster (p < 0); later it approaches a limit (p > 0). So each of `POWERS` is fitted to all bounds and to
the later half of them; the range is that of the fits that describe the later half nearly as well as the best one. Pure
Python, because `perfbound status` loads no numpy. A method that plans its tests has a forecast of its own, from its
weights: see `planned_outlook`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from ...schemas.campaign import CampaignConfig
from ...schemas.problem_models import KrigingProblem, PaperProblem, Problem, SampleProblem
from ...schemas.values import Guess, ProblemProgress
from .forecast import FEWEST, budget

POWERS = (-0.5, -0.25, 0.0, 0.25, 0.5, 1.0)
"""From a fall that becomes faster to a limit that is approached as 1/n."""
NEARLY = 3.0
"""A fit counts if its residual is at most so many times the least one, which no model of the rest explains."""
MORE = 1000
"""Rollouts of the second number."""
FEWEST_POINTS = 6
"""Of a fit: bounds at marked tests."""

Point = tuple[int, float]
"""(tests, bound on J after them)."""


@dataclass(frozen=True, slots=True)
class Outlook:
    """The forecast of a problem, in terms of J: the bound falls."""

    tests: int
    """At the end of the budget."""
    bound: Guess
    gain: Guess
    """By which `MORE` further rollouts would lower it."""


def outlook(course: Sequence[Point], *, tests: int, least: float | None, most: int, per_test: float) -> Outlook | None:
    """Return the forecast of a problem after `tests` tests of at most `most`; None where the bounds allow none yet.

    `course` are its bounds at some tests, the last one at the last test, `least` is what the bound never falls below:
    its partner from the other side. A test has `per_test` rollouts.
    """
    usable = [(at, upper) for at, upper in course if at >= FEWEST and math.isfinite(upper)]
    if len(usable) < FEWEST_POINTS or per_test <= 0:
        return None
    now, later = usable[-1][1], usable[len(usable) // 2 :]
    fits = [_Fit.of(points, power, later) for power in POWERS for points in (usable, later)]
    least_residual = min(fit.residual for fit in fits)
    # The neighbours of the best power as well: the true one may be between two of them.
    best = POWERS.index(min(fits, key=lambda fit: fit.residual).power)
    near = POWERS[max(0, best - 1) : best + 2]
    good = [fit for fit in fits if fit.residual <= NEARLY * least_residual or fit.power in near]

    def at(number: float) -> list[float]:
        falls = [fit.slope * (_grown(number, fit.power) - _grown(tests, fit.power)) for fit in good]
        return [max(now - fall, -math.inf if least is None else min(least, now)) for fall in falls]

    after = at(most)
    further = [first - second for first, second in zip(after, at(most + MORE / per_test), strict=True)]
    return Outlook(most, _over_fits(after), _over_fits(further))


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
    found = outlook(
        _with_last(progress),
        tests=progress.tests,
        least=progress.bound.lower if progress.bound else None,
        most=max(progress.tests, budget(config, problem, progress.extended)),
        per_test=progress.rollouts / progress.tests,
    )
    if found is None:
        return None
    sign = -1 if config.sense_of(problem) == "min" else 1
    gain = found.gain.words(1)
    more = f"{MORE} further rollouts would bring about {gain}"
    if progress.stopped_by == "budget":
        return f"forecast: {more}"
    return f"forecast: bound about {found.bound.words(sign)} after {found.tests} tests; {more}"


def _planned_words(config: CampaignConfig, problem: KrigingProblem, progress: ProblemProgress) -> str | None:
    """Return the forecast of a problem whose tests are planned, and end with the plan."""
    if progress.planned is None:
        return None
    bound, gain = progress.planned
    more = f"a campaign planned for {MORE} more rollouts would gain about {gain.words(1)}"
    if progress.stopped_by == "budget":
        return f"forecast: {more}"
    sign = -1 if config.sense_of(problem) == "min" else 1
    return f"forecast: bound about {bound.words(sign)} after {config.max_tests_of(problem)} tests; {more}"


def _with_last(progress: ProblemProgress) -> list[Point]:
    upper = progress.bound.upper if progress.bound else None
    earlier = [point for point in progress.course if point[0] < progress.tests]
    return earlier if upper is None else [*earlier, (progress.tests, upper)]


def _grown(number: float, power: float) -> float:
    """Return x(n) of the model."""
    return math.log(number) if power == 0 else (1 - number**-power) / power


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


def _over_fits(values: Sequence[float]) -> Guess:
    return Guess(median(values), min(values), max(values))
