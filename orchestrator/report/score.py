"""Another question of the same evidence: the robustness of all stored rollouts under another formula.

It is exploration: a formula that is chosen when the rollouts are known has no certificate.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...schemas.errors import PerfboundError
from ...schemas.ids import RECHECK, RolloutId, closing_check
from ..campaign.objectives import scored as objective
from ..mathematics.stl.parser import parse_formula
from ..store import facts as recorded_facts
from ..store import read
from .rollout.of_tests import read_recorded

BARS = 12
WIDTH = 50
"""Characters of the longest bar."""
WORST = 5
"""Rollouts that are named."""


@dataclass(frozen=True, slots=True)
class ScoredRollout:
    """A rollout and its robustness under the formula, in the unit of the predicates; not clipped."""

    rollout: str
    variant: str
    robustness: float
    by_tolerance: bool
    """Whether the tolerance around its time stamps could decide the sign."""


def scored(directory: Path, specification: str, report: Callable[[str, int, int], None]) -> list[ScoredRollout]:
    """Return every stored rollout behind an observation with its robustness, those of a recheck left out.

    Raises:
        JournalError: there is no campaign, or it cannot be read.
        EvidenceError: a trajectory file is missing or was changed.
        PerfboundError: the formula cannot be read, names an unknown column, or does not fit the trajectories.

    """
    header = read.stored_header(directory)
    spec, beyond = header.spec, header.config.beyond
    try:
        formula = parse_formula(specification, spec.units)
    except ValueError as error:
        raise PerfboundError(f"--specification: {error}") from None
    recorded = [
        each for each in recorded_facts.observed_rollouts(directory) if closing_check(each.rollout.problem) != RECHECK
    ]
    found = []
    for number, fact in enumerate(recorded):
        report("rollouts", number, len(recorded))
        rollout, trajectory = fact.rollout, read_recorded(directory, fact).trajectory
        try:
            value = objective(formula, trajectory, spec.after_end, beyond)
        except ValueError as error:
            raise PerfboundError(f"--specification: {rollout}: {error}") from None
        found.append(ScoredRollout(str(rollout), rollout.variant, *value))
    return found


def score_lines(directory: Path, specification: str, found: Sequence[ScoredRollout]) -> Iterator[str]:
    """Yield what the rollouts of each variant show, as text."""
    names = [parameter.name for parameter in read.stored_header(directory).spec.parameters]
    starts = read.starts_of_tests(directory)
    yield f"EXPLORATORY: the formula was chosen when the rollouts were known, so nothing is certified: {specification}"
    for variant in dict.fromkeys(each.variant for each in found):
        of_variant = sorted((each for each in found if each.variant == variant), key=lambda each: each.robustness)
        yield ""
        below = sum(each.robustness < 0 for each in of_variant)
        yield f"{variant}: {below:,} of {len(of_variant):,} rollouts violate it"
        if close := sum(each.by_tolerance for each in of_variant):
            yield f"  the sign of {close:,} may depend on a time stamp within a hundredth of a step of a border"
        yield from bars([each.robustness for each in of_variant])
        for each in of_variant[:WORST]:
            start = zip(names, starts[RolloutId.parse(each.rollout)[:2]], strict=True)
            where = ", ".join(f"{name} = {value:.6g}" for name, value in start)
            yield f"  {each.robustness:>12.6g}  {each.rollout}  {where}"


def bars(values: Sequence[float]) -> Iterator[str]:
    """Yield a bar for each part of the range, with 0 as the end of one where it is inside.

    >>> list(bars([-1.0, 1.0, 1.0]))[0].split()[:4]
    ['-1', 'to', '-0.833333', '1']
    """
    low, high = min(values), max(values)
    step = (high - low) / BARS or 1.0
    # From 0 outwards, so that no bar has values of both signs.
    first = step * math.floor(round(low / step, 6)) if low < 0 < high else low
    edges = [first + step * number for number in range(BARS + 2) if first + step * number < high + step / 2] or [low]
    counts = [0] * len(edges)
    for value in values:
        counts[min(max(sum(value >= edge for edge in edges) - 1, 0), len(edges) - 1)] += 1
    largest = max(counts)
    for edge, count in zip(edges, counts, strict=True):
        bar = "#" * round(WIDTH * count / largest)
        yield f"  {edge:>12.6g} to {edge + step:<12.6g} {count:>7,}  {bar}".rstrip()
