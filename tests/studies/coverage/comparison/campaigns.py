"""Comparisons of two systems with known laws, by `perfbound compare` and by the t-test that is used in its place.

The intervals only shrink, so that one was false at some time if and only if it is at the end: no stop that depends on
outcomes can be worse.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.stats import ttest_ind

from perfbound.orchestrator.release.compare.differences import Pairs, differences
from tests.studies.coverage.laws import Floats
from tests.studies.coverage.oracle import ROUNDING

CLIP = (-1.0, 1.0)
LISTED = 5
"""Starts of the law with listed ones."""
LOOKS = 50
"""Pairs between two looks of somebody who stops at the first significant t-test."""
DIFFERENCE, SD = 0.02, 0.1
"""That of the means, and the standard deviation of b - a, in the row with a difference."""


@dataclass(frozen=True)
class Comparing:
    """One row: two systems in pairs."""

    kind: ClassVar[str] = "comparison"
    law: str
    pairs: int = 1000
    delta: float = 0.05

    @property
    def claimed(self) -> float:
        """The failure probability of all intervals together."""
        return self.delta


@dataclass(frozen=True)
class Testing(Comparing):
    """The same by Welch's t-test of two campaigns."""

    kind: ClassVar[str] = "t-test"


def _gaussian(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    a, b = 0.1 + 0.1 * rng.standard_normal((2, n))
    return a, b


def _alike(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    common = 0.1 * rng.standard_normal(n)
    a, b = 0.1 + common + 0.01 * rng.standard_normal((2, n))
    return a, b


def _rare(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    a, b = np.where(rng.random((2, n)) < 0.002, -0.5, 0.7)
    return a, b


def _heavy(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    a, b = np.clip(0.1 + 0.05 * rng.standard_t(1.5, (2, n)), *CLIP)
    return a, b


def _tied(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    a, b = rng.uniform(-0.1, 0.4, (2, n))
    return a, np.where(rng.random(n) < 0.98, a, b)


def _two_points(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    a, b = np.where(rng.random((2, n)) < 0.5, -1.0, 1.0)
    return a, b


def _different(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    a, b = 0.5 + SD / np.sqrt(2) * rng.standard_normal((2, n))
    return a, b + DIFFERENCE


EQUAL: dict[str, Callable[[np.random.Generator, int], tuple[Floats, Floats]]] = {
    "Gaussian": _gaussian,
    "common disturbances": _alike,
    "rare failures": _rare,
    "heavy tails": _heavy,
    "ties": _tied,
    "two points": _two_points,
}
"""Pairs of which A and B have one law."""
LAWS = EQUAL | {"listed starts": _gaussian, "difference .02, sd .1": _different}


def rows() -> Iterator[Comparing]:
    """Every law of equal systems, and one difference that has to be found."""
    for law in LAWS:
        yield Comparing(law, 2000 if law not in EQUAL else 1000)


def tests() -> Iterator[Comparing]:
    """The laws of equal systems."""
    for law in EQUAL:
        yield Testing(law)


def campaign(row: Comparing, rng: np.random.Generator) -> dict[str, float]:
    """Compare once: whether an interval missed its truth, and whether the one of the means excludes 0."""
    a, b = LAWS[row.law](rng, row.pairs)
    listed = row.law == "listed starts"
    start = rng.integers(LISTED, size=row.pairs).tolist() if listed else None
    found = differences(Pairs(a.clip(*CLIP), b.clip(*CLIP), CLIP, "", start, LISTED if listed else 0), row.delta, {})
    truth = DIFFERENCE if row.law not in (*EQUAL, "listed starts") else 0.0
    truths = {"mean": truth, "failure_probability": 0.0, "worst_start": truth}
    missed = [not each.lower - ROUNDING <= truths[each.quantity] <= each.upper + ROUNDING for each in found]
    mean = found[0]
    return {
        "false": any(missed),
        "decided": mean.verdict != "UNDECIDED",
        "width": mean.upper - mean.lower,
    }


def tested(row: Comparing, rng: np.random.Generator) -> dict[str, float]:
    """Test once at the end, and every `LOOKS` pairs until it is significant."""
    a, b = LAWS[row.law](rng, row.pairs)
    ends = range(LOOKS, row.pairs + 1, LOOKS)
    with np.errstate(invalid="ignore", divide="ignore"):  # without a failure nothing varies
        significant = [ttest_ind(a[:n], b[:n], equal_var=False).pvalue < row.delta for n in ends]
    return {"once": significant[-1], "peeking": any(significant)}
