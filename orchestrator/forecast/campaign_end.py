"""The forecast of the end of a run: its tests, its time, the bound of its first claim, and how much of it is done."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...schemas.file.bases import bases
from ...schemas.file.config import CampaignConfig
from ...schemas.file.problem_models import KrigingProblem, PaperProblem, Problem, SampleProblem
from ...schemas.ids import RECHECK, SPOT_CHECK, closing_check
from ...schemas.result.known import Expected, Span, VerdictWord
from ...schemas.values import Guess, ProblemProgress
from ..campaign.clip import by_clip, floored
from .outlook import problem_outlook, remaining_tests
from .remaining import budget

NEARLY_DONE = 0.99
"""The share before the end: a forecast that is too small must not call a campaign done."""


@dataclass(frozen=True, slots=True)
class RolloutCounts:
    """The rollouts that a campaign needs beside those it has."""

    per_test: Mapping[str, int]
    """Of each problem, by its name."""
    spot_check: tuple[int, int]
    """Of the spot check that follows the problems: without follow-ups, and with all of them."""
    recheck: int


def expected(
    config: CampaignConfig,
    progress: Mapping[str, ProblemProgress],
    closing: Mapping[str, ProblemProgress],
    work: RolloutCounts,
    rate: float,
) -> Expected:
    """Return the forecast of a run; `rate` are its rollouts per second, 0 while it is unknown."""
    pairs = [(problem, progress[problem.name]) for problem in config.problems]
    ends = [_end_of(config, problem, each) for problem, each in pairs]
    most = [max(each.tests, budget(config, problem, each.extended)) for problem, each in pairs]
    checked = sum(each.rollouts for each in closing.values())
    done = sum(each.rollouts for _, each in pairs) + checked
    missing = [
        _rollouts_left(end, each.tests, top, work.per_test[problem.name])
        for (problem, each), end, top in zip(pairs, ends, most, strict=True)
    ]
    left = _sum([*missing, *_left_of_checks(closing, work)])
    known = [end for end in ends if end is not None]
    return Expected(
        share=min(NEARLY_DONE, done / (done + left.middle)) if done else 0.0,
        by_budget=len(known) < len(ends),
        tests=_span(_sum(known)) if len(known) == len(ends) else None,
        most_tests=sum(most),
        seconds=Span(low=left.low / rate, middle=left.middle / rate, high=left.high / rate) if rate > 0 else None,
        bound=_bound_ahead(config, progress),
        verdict=None,
    )


def expected_verdict(found: Expected, now: VerdictWord, required: float | None, *, refuted: bool) -> VerdictWord | None:
    """Return the verdict at the end, where the whole range of the bound has the same one; None while it is open.

    What is refuted or violated stays so.
    """
    if refuted or now == "VIOLATED":
        return now
    if found.bound is None or required is None:
        return None
    if found.bound.low >= required:
        return "SHOWN"
    return "NOT SHOWN" if found.bound.high < required else None


def _left_of_checks(closing: Mapping[str, ProblemProgress], work: RolloutCounts) -> list[Guess]:
    """Return the rollouts that the closing checks still need; how many follow up depends on their outcomes."""
    found = []
    for check, (least, most) in ((SPOT_CHECK, work.spot_check), (RECHECK, (work.recheck, work.recheck))):
        begun = next((each for name, each in closing.items() if closing_check(name) == check), None)
        done = begun.rollouts if begun else 0
        low, high = max(0, least - done), max(0, most - done)
        ended = begun is not None and begun.stopped_by is not None
        found.append(_exactly(0) if ended else Guess((low + high) / 2, low, high))
    return found


def _end_of(config: CampaignConfig, problem: Problem, progress: ProblemProgress) -> Guess | None:
    """Return the tests of a problem at its end; None while there is no forecast."""
    if progress.stopped_by is not None:
        return _exactly(progress.tests)
    left = remaining_tests(config, problem, progress)
    if left is None:
        return None
    return Guess(left.middle + progress.tests, left.low + progress.tests, left.high + progress.tests)


def _rollouts_left(end: Guess | None, tests: int, most: int, per_test: int) -> Guess:
    """Return the rollouts that a problem still needs, up to its budget where nothing else is known."""
    if end is None:
        return Guess((most - tests) * per_test, 0.0, (most - tests) * per_test)
    return Guess((end.middle - tests) * per_test, (end.low - tests) * per_test, (end.high - tests) * per_test)


def _bound_ahead(config: CampaignConfig, progress: Mapping[str, ProblemProgress]) -> Span | None:
    """Return the forecast of the first claim, where it is the bound of one problem; None for every other one."""
    first = bases(config)[0]
    if first.rule != "single" or first.drawn is not None or first.problems[0] not in progress:
        return None
    (name,) = first.problems
    problem = next(each for each in config.problems if each.name == name)
    guess = _bound_of_problem(config, problem, progress[name])
    if guess is None:
        return None
    sense, limit = config.sense_of(problem), by_clip(config, problem)
    sign = -1 if sense == "min" else 1
    low, high = guess.ends(sign)
    return Span(
        low=floored(low, sense, limit),
        middle=floored(sign * guess.middle, sense, limit),
        high=floored(high, sense, limit),
    )


def _bound_of_problem(config: CampaignConfig, problem: Problem, progress: ProblemProgress) -> Guess | None:
    """Return the forecast of the bound on J at the end of a problem."""
    if isinstance(problem, SampleProblem | PaperProblem):
        return None
    upper = progress.bound.upper if progress.bound else None
    if progress.stopped_by is not None:
        return None if upper is None else Guess(upper, upper, upper)
    if isinstance(problem, KrigingProblem):
        return progress.planned[0] if progress.planned else None
    found = problem_outlook(config, problem, progress)
    return found.bound if found else None


def _exactly(number: float) -> Guess:
    return Guess(number, number, number)


def _sum(guesses: Sequence[Guess]) -> Guess:
    return Guess(
        sum(each.middle for each in guesses), sum(each.low for each in guesses), sum(each.high for each in guesses)
    )


def _span(guess: Guess) -> Span:
    return Span(low=guess.low, middle=guess.middle, high=guess.high)
