"""The answer of a calibration in one line: whether a campaign may be expected to show what is required.

It compares bounds of J and is the first line of the output. A fit of rollouts is no proof, so the line names how many.
"""

from dataclasses import dataclass

from ....schemas.amounts import counted
from ....schemas.file.objectives import OBJECTIVES
from ...certificate.words.bound_text import as_required, in_unit
from ...certificate.words.format import duration
from ...store.export_tables import unit
from ..size import first_samples
from .calibrate import Calibration
from .constants import required_bound
from .forecast import Forecast
from .tolerance import ERRORS

LEAST_DIGITS, MOST_DIGITS = 3, 12


@dataclass(frozen=True, slots=True)
class Requirement:
    """What a campaign file requires of the bound of its only problem."""

    name: str
    limit: float
    """Of J."""
    sign: int
    """1 where J is the objective, -1 where it is minus the objective."""
    unit: str = ""

    @property
    def words(self) -> str:
        """The required bound of the objective."""
        return in_unit(as_required(self.sign * self.limit + 0.0), self.unit)

    @property
    def claim(self) -> str:
        """The claim that would meet it."""
        return f"{self.name} {'<=' if self.sign > 0 else '>='} {self.words}"

    def number(self, value: float) -> str:
        """Return a value of J as the objective, with so many digits that it differs from the limit."""
        shown = (f"{self.sign * value:.{digits}g}" for digits in range(LEAST_DIGITS, MOST_DIGITS))
        apart = (each for each in shown if float(each) != self.sign * self.limit)
        return in_unit(next(apart, f"{self.sign * value:g}"), self.unit)

    def missed(self, value: float) -> str:
        """Return a value of J that misses the limit, beside it."""
        return f"{self.number(value)}, {'above' if self.sign > 0 else 'below'} the required {self.words}"


def answer(found: Calibration) -> str:
    """Return the answer of a calibration, in one line."""
    pilot = counted(sum(each.measured.rollouts for each in found.problems), "pilot rollout")
    required, seen = requirement(found), found.problems[0].measured.largest_seen
    if required is not None and seen is not None and seen > required.limit:
        return f"Cannot be shown with any budget: one of {pilot} has {required.missed(seen)}."
    if not found.trusted:
        return _without_kernel(found, pilot)
    if required is not None:
        words = compared(required, found.forecasts[0], _effort(found))
    else:
        words = f"{_not_compared(found)}: the bound would be about {_bounds(found)}, after {_effort(found)}"
    return f"{words}. Fitted on {pilot}; no proof."


def requirement(found: Calibration) -> Requirement | None:
    """Return what the draft requires of the bound of one problem; None where it requires nothing of it alone."""
    config, problem = found.draft.config, found.draft.config.problems[0]
    limit = required_bound(config, problem)
    if limit is None:
        return None
    mean = found.problems[0].measured.noisy and not OBJECTIVES[problem.name].risk
    name = f"expected {problem.name}" if mean else problem.name
    return Requirement(name, limit, _sign(found, 0), _unit(found, 0))


def compared(required: Requirement, guess: Forecast, effort: str) -> str:
    """Return whether a forecast meets what is required; `effort` are its rollouts and their time in words."""
    limit, bound = required.limit, guess.bound
    if guess.fitted > limit:
        if guess.fitted - ERRORS * guess.error > limit:
            return f"Cannot be shown with any budget: the fitted worst value is {required.missed(guess.fitted)}"
        missed, error = required.missed(guess.fitted), in_unit(f"{guess.error:.2g}", required.unit)
        return (
            f"Probably cannot be shown with any budget: the fitted worst value is {missed}, with a standard error of "
            f"{error}"
        )
    if bound.high <= limit:
        return f"Can be shown: {effort} for {required.claim}; the bound would be about {required.number(bound.middle)}"
    if bound.middle <= limit:
        low, high = bound.ends(required.sign)
        return (
            f"May be shown: {effort} for {required.claim}, but the bound would be {low:.3g} to {high:.3g}; "
            f"{guess.remedy(limit)}"
        )
    missed = required.missed(bound.middle)
    return f"Likely not with the proposed budget, {effort}: the bound would be about {missed}; {guess.remedy(limit)}"


def _without_kernel(found: Calibration, pilot: str) -> str:
    if found.text is None:
        return f"Not known: no kernel is trustworthy after {pilot}, and without a specification no other method fits."
    pace = found.problems[0].measured.pace
    samples = first_samples(pace.cost).max_tests
    effort = _effort_words(samples, samples * pace.cost / pace.workers, pace.workers)
    doubt = f"Not for every start: no kernel is trustworthy after {pilot}"
    return f"{doubt}. At drawn starts, {effort} show how often it fails."


def _not_compared(found: Calibration) -> str:
    config = found.draft.config
    if len(config.problems) > 1 or config.specifications:
        return "Not compared with what is required, since the claim joins several bounds"
    return "Nothing is required"


def _bounds(found: Calibration) -> str:
    bounds = (
        in_unit(f"{_sign(found, number) * guess.bound.middle:.3g}", _unit(found, number))
        for number, guess in enumerate(found.forecasts)
    )
    if len(found.problems) == 1:
        return next(bounds)
    return " and ".join(f"{bound} for {each.name}" for each, bound in zip(found.problems, bounds, strict=True))


def _effort(found: Calibration) -> str:
    """Return the rollouts of a campaign with their time, one problem after the other."""
    rollouts, seconds = sum(each.rollouts for each in found.forecasts), sum(each.seconds for each in found.forecasts)
    return _effort_words(rollouts, seconds, found.problems[0].measured.pace.workers)


def _effort_words(rollouts: int, seconds: float, workers: int) -> str:
    return f"about {rollouts:,} rollouts ({duration(max(1.0, seconds))} on {counted(workers, 'worker')})"


def _sign(found: Calibration, number: int) -> int:
    config = found.draft.config
    return -1 if config.sense_of(config.problems[number]) == "min" else 1


def _unit(found: Calibration, number: int) -> str:
    config = found.draft.config
    return unit(config.problems[number], config, found.spec)
