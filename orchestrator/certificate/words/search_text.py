"""The sentences on what a search has found: the clusters of failing starts, and how long a search at random takes."""

import math
from collections.abc import Mapping
from decimal import ROUND_CEILING, ROUND_FLOOR, Context

from ....schemas.amounts import counted, some_of
from ....schemas.result.certificate import ClosestStart, FailureCluster, Failures, RandomTests, Search
from .bound_text import outward
from .refutation_text import margin_words, named_start, simplest_words

MOST_CLUSTERS = 3
"""Clusters in the summary at the end of a run, which is one screen."""
TOO_LARGE = 0.5
"""Share of failing tests above which an upper bound alone is not worth a sentence."""


def failure_parts(
    found: Failures | None, unit: str, units: Mapping[str, str] | None = None, most: int | None = None
) -> tuple[str, ...]:
    """Return how many clusters of failing starts there are, then each, the first one found first; empty for None.

    `unit` and `units` as in `counterexample_parts`; of many clusters the first `most`, by default all.
    """
    if found is None:
        return ()
    tests = sum(each.tests for each in found.clusters) + found.undecided
    head = f"{counted(len(found.clusters), 'cluster')} of failing starts, from {counted(tests, 'failing test')}"
    if found.undecided:
        head += f", of which {found.undecided:,} may be of one of them or of another"
    shown = found.clusters[:most]
    each = [f"cluster {number}: {_cluster_words(one, unit, units)}" for number, one in enumerate(shown, 1)]
    if more := len(found.clusters) - len(shown):
        each.append(f"the certificate has {counted(more, 'further cluster')}")
    return (head, *each)


def _cluster_words(found: FailureCluster, unit: str, units: Mapping[str, str] | None) -> str:
    """Return what the tests of a cluster violate, how many they are, and the worst one."""
    violated = f" against {some_of(list(found.violated))}" if found.violated else ""
    worst = f"robustness {margin_words(found.robustness, unit)} at {named_start(found.start, units)}, seed {found.seed}"
    which = "worst " if found.tests > 1 else ""
    words = f"{counted(found.tests, 'test')}{violated}, {which}{worst} (rollout {found.rollout})"
    simplest = simplest_words(found.simplest, unit, units)
    return f"{words}; {simplest}" if simplest else words


def search_parts(found: Search | None, unit: str, units: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """Return how close a search came to a failure, and how long one at random takes, in a part each; empty for None."""
    if found is None:
        return ()
    closest = "" if found.closest is None else _closest_words(found.closest, unit, units)
    at_random = "" if found.at_random is None else random_words(found.at_random)
    return tuple(filter(None, (closest, at_random)))


def _closest_words(found: ClosestStart, unit: str, units: Mapping[str, str] | None) -> str:
    where = f"{margin_words(found.robustness, unit)} at {named_start(found.start, units)}, seed {found.seed}"
    return f"no test of the search fails; the least robustness is {where} (rollout {found.rollout})"


def random_words(found: RandomTests) -> str:
    """Return how many tests a search at random takes.

    >>> random_words(RandomTests(tests=75, failures=2, share=(0.0021, 0.11), probability=0.95))
    '2 of 75 tests at random fail: of such tests between 0.21 % and 11 % do, with probability at least 0.9500, so that \
a search at random takes between 9 and 477 tests for a failure on average'
    >>> random_words(RandomTests(tests=75, failures=0, share=(0.0, 0.0484), probability=0.95))
    'none of 75 tests at random fails: of such tests at most 4.9 % do, with probability at least 0.9500, so that a \
search at random takes at least 20 tests for a failure on average'
    >>> random_words(RandomTests(tests=2, failures=0, share=(0.0, 0.89), probability=0.95))
    'none of 2 tests at random fails, which are too few to say how many tests a search at random takes'
    """
    low, high = found.share
    fails = "fails" if found.failures < 2 else "fail"
    head = f"{found.failures or 'none'} of {counted(found.tests, 'test')} at random {fails}"
    if high > TOO_LARGE and not low:
        return f"{head}, which are too few to say how many tests a search at random takes"
    if low:
        share = f"between {_percent(low, ROUND_FLOOR)} and {_percent(high, ROUND_CEILING)}"
        takes = f"between {math.floor(1 / high):,} and {counted(math.ceil(1 / low), 'test')}"
    else:
        share, takes = f"at most {_percent(high, ROUND_CEILING)}", f"at least {counted(math.floor(1 / high), 'test')}"
    right = f"with probability at least {outward(found.probability, '>=')}"
    return (
        f"{head}: of such tests {share} do, {right}, so that a search at random takes {takes} for a failure on average"
    )


def _percent(share: float, rounding: str) -> str:
    """Return a share with two digits, rounded away from what is claimed."""
    return f"{float(Context(prec=2, rounding=rounding).create_decimal(repr(100 * share))):g} %"
