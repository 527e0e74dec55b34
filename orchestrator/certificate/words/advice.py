"""What would help a campaign whose first claim does not show what is required, in sentences."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ....schemas.file.config import CampaignConfig
from ....schemas.file.method_spaces import candidates
from ....schemas.file.problem_models import KernelProblem, Problem
from ....schemas.result.certificate import CertificateClaim, Predicate, ProblemResult
from ....schemas.result.known import Violations
from ....schemas.values import ProblemProgress
from ...forecast.needed_tests import FOR_A_FORECAST, FURTHEST, NeededTests, needed_samples, needed_tests
from .bound_text import as_required

Progress = Callable[[], Sequence[ProblemProgress]]
MORE = "More tests: a larger `max_tests` in a new campaign."
NEW_CONSTANTS = "New constants in a new campaign, from other rollouts"
CALIBRATE = "`perfbound calibrate` proposes constants from rollouts, and says which budget they need."
ENDED_EARLY = (
    "A new campaign without `falsify` and `until_counterexample`: a counterexample ended this one before all its tests "
    "were made, and they show how often the system fails."
)
TEST_ALONE = (
    "This start alone in a campaign by method `scenario` (`scenarios = [[...]]` under `[space]`), which needs no other "
    "constants than the clip: it shows whether the mean there is below what is required."
)
LARGE_NORM = 20.0
"""Widths of the clip: with 50 of them 400 tests of an example did not reach its requirement, with 12 of them 80 did."""
FEWEST_TIMES = 2
"""Without a forecast, so many times as many tests are proposed."""


@dataclass(frozen=True, slots=True)
class Commands:
    """Commands that the advice names; empty where there is none."""

    resume: str = ""
    """Continues the campaign."""
    repeat: str = ""
    """Simulates the worst rollout again."""


NO_COMMANDS = Commands()


@dataclass(frozen=True, slots=True)
class ShortBound:
    """A bound that does not reach what is required."""

    config: CampaignConfig
    predicate: Predicate
    required: float
    violations: Violations
    commands: Commands
    noisy: bool
    """Whether the tested variant of the system is random."""
    progress: Progress
    """Of every problem, for a forecast; empty where there is no time for one."""
    failed_samples: Callable[[], int] = int
    """Returns how many samples of the only problem, the first rollouts at drawn starts, violate the specification."""

    @property
    def missing(self) -> float:
        """By how much the bound of the only problem has to improve, in its unit."""
        return abs(self.required - self.predicate.problems[0].bound)


def instead_of_refuted(claim: CertificateClaim) -> str:
    """Return what to do about refuted assumptions."""
    kinds = {each.partition("/")[0] for each in claim.refuted}
    # What is no rollout of its start refutes any constants.
    if "reproducible_rollouts" not in kinds and kinds & {"rkhs_norm", "noise_scale", "kernel", "prior_mean"}:
        return (
            "Other constants in a new campaign with a new seed: `perfbound calibrate` proposes some that its rollouts "
            "do not refute. Method `sample` needs no constants; it asks about starts that are drawn at random."
        )
    return "Find the cause of what is refuted first: more rollouts do not help."


def for_the_probability(config: CampaignConfig, claim: CertificateClaim, required: float) -> str:
    """Return what to do about a probability that is below the required one."""
    smaller = "a smaller `delta`, or a larger `c`" if claim.method == "paper" else "a smaller `delta`"
    if config.required_probability is not None:
        return f"{smaller[0].upper()}{smaller[1:]}; or a smaller `required_probability`, if that is enough."
    enough, wanted = math.floor(100 * claim.probability) / 100, as_required(required)
    return (
        f"`required_probability = {enough:g}`, if that is enough; or `required_probability = {wanted}` and "
        f"{smaller}. Without this key 1 - delta is required, so that a smaller `delta` alone asks for more."
    )


def for_a_better_bound(short: ShortBound) -> str:
    """Return what would raise a bound that does not reach what is required."""
    claim, problems = short.predicate.claims[0], short.predicate.problems
    if alpha := _smaller_alpha(short):
        return alpha
    if claim.vacuous and problems[0].method == "kriging":
        return "Method `rigorous`: where means differ more than noise, more tests by `kriging` help little."
    spent = [each for each in problems if each.stopped_by == "budget"]
    if any(each.stopped_by == "counterexample" for each in problems):
        return ENDED_EARLY
    if not spent:
        return "A smaller `alpha` in a new campaign, which costs more tests."
    if claim.quantity == "failure_probability":
        return _more_samples(short)
    if not any(each.method in ("rigorous", "scenario") for each in spent) or not short.commands.resume:
        return MORE
    if len(problems) == 1 and claim.rule == "single":
        return _more_tests(short, spent[0], short.config.problems[0])
    return f"More tests: `{short.commands.resume} --max-tests N` continues this campaign."


def _smaller_alpha(short: ShortBound) -> str:
    """Return the advice where values without noise are beyond what is required by less than the tolerance; else none.

    A problem ends when its bounds are `alpha` apart, so that more tests do not help.
    """
    claim, (problem, *others) = short.predicate.claims[0], short.predicate.problems
    alpha, least = problem.parameters.get("alpha"), short.violations.least
    if claim.quantity != "robustness" or others or least is None or not isinstance(alpha, float):
        return ""
    left = least - short.required
    if not 0 < left < alpha:
        return ""
    return (
        f"A smaller `alpha`, such as {left / 2:.2g}, in a new campaign: the worst start so far is only {left:.4g} "
        f"above what is required, and bounds that are alpha = {alpha:g} apart end the tests."
    )


def _more_tests(short: ShortBound, result: ProblemResult, problem: Problem) -> str:
    """Return how many more tests the only problem would probably need, or what else where they will not do."""
    if not short.noisy and result.tests >= _number_of_starts(short.config, problem):
        return (
            "A finer `resolution` in a new campaign, or other constants: every start of the lattice has been tested, "
            f"and a second test there shows nothing. {CALIBRATE}"
        )
    if short.predicate.claims[0].vacuous and (constants := _other_constants(short.config, problem)):
        return constants
    found = next(iter(short.progress()), None)
    usable = found is not None and found.bound is not None and found.bound.upper is not None
    # The constants are those of J, which falls; the bound of a linearised risk is another function of it.
    if not usable or result.parameters.get("linearised"):
        return f"More tests: `{short.commands.resume} --max-tests N` continues this campaign."
    assert found is not None
    assert found.bound is not None
    assert found.bound.upper is not None
    limit = found.bound.upper - short.missing
    if _ends_before(found.bound.lower, limit, result):
        return f"A smaller `alpha` in a new campaign: {_alpha_words(result)} ends the tests before the bound is there."
    if found.tests < FOR_A_FORECAST:
        more = max(FEWEST_TIMES * found.tests, FOR_A_FORECAST)
        return (
            f"More tests: `{short.commands.resume} --max-tests {more}` continues this campaign; "
            f"{found.tests:,} are too few to forecast how many would do."
        )
    return _forecast_words(short, found, needed_tests(found, limit))


def _number_of_starts(config: CampaignConfig, problem: Problem) -> int:
    return candidates(config.space, config.resolution_of(problem), config.starts_of(problem))


def _ends_before(lower: float | None, limit: float, result: ProblemResult) -> bool:
    """Whether the bounds from both sides are alpha apart before the one from above is at the limit."""
    alpha = result.parameters.get("alpha")
    return lower is not None and isinstance(alpha, float) and limit - lower < alpha


def _alpha_words(result: ProblemResult) -> str:
    return f"alpha = {result.parameters['alpha']:g}"


def _other_constants(config: CampaignConfig, problem: Problem) -> str:
    """Return why other constants are needed where B is too large for any number of tests; empty where it is not."""
    if not isinstance(problem, KernelProblem) or config.clip is None:
        return ""
    times = problem.rkhs_norm / (config.clip[1] - config.clip[0])
    if times < LARGE_NORM:
        return ""
    return (
        f"{NEW_CONSTANTS}: `rkhs_norm` = {problem.rkhs_norm:g} is {times:.0f} "
        f"times the width of the clip, which more tests would first have to undo. {CALIBRATE}"
    )


def _forecast_words(short: ShortBound, found: ProblemProgress, needed: NeededTests | None) -> str:
    if needed is None or needed.low is None:
        return (
            f"{NEW_CONSTANTS}: by its course so far, {FURTHEST} times as many "
            f"tests would not bring the bound to what is required. {CALIBRATE}"
        )
    if needed.probable is None or needed.high is None:
        return (
            f"More tests may do, {_about(needed.low):,} at least: `{short.commands.resume} --max-tests "
            f"{2 * found.tests}` continues this campaign, and the course of the bound then shows whether they will."
        )
    high = _about(needed.high)
    return (
        f"About {_about(needed.probable):,} more test{'' if needed.probable == 1 else 's'} "
        f"({_about(needed.low):,} to {high:,}): "
        f"`{short.commands.resume} --max-tests {found.tests + high}` continues this campaign, "
        "and its bound stays valid."
    )


def _about(number: int) -> int:
    """Return a number rounded up to two digits.

    >>> _about(7), _about(341), _about(1201)
    (7, 350, 1300)
    """
    unit = int(10 ** max(0, len(str(number)) - 2))
    return math.ceil(number / unit) * unit


def _more_samples(short: ShortBound) -> str:
    """Return how many drawn starts would show that few enough of them violate the specification."""
    claim, (problem, *_) = short.predicate.claims[0], short.predicate.problems
    failed, samples = short.failed_samples(), claim.samples or problem.tests
    needed = needed_samples(samples, failed, short.required, 1.0 - claim.probability)
    if needed is None:
        share = f"{failed:,} of {samples:,} samples violate the specification"
        return f"More samples will hardly do: {share}, and the required share is {as_required(short.required)}."
    rate = "none of them violates" if not failed else "as large a share of them violates"
    return f"About {_about(needed):,} samples in a new campaign with another seed, if {rate} the specification."
