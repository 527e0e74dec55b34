"""Error rate and power of the test of copies, with results that repeat and starts that follow what was seen."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.bounds.checks import copied_blocks
from perfbound.orchestrator.mathematics.bounds.checks.copied_blocks import LEVEL, CopiedBlocks

RUNS = [1_000, pytest.param(10_000, marks=pytest.mark.slow)]
Law = Callable[[np.random.Generator], float]
LAWS: dict[str, Law] = {
    "pass or fail": lambda rng: float(rng.random() < 0.5),
    "rare failure": lambda rng: float(rng.random() < 0.02),
    "three values": lambda rng: float(rng.integers(3)),
    "saturated": lambda rng: max(0.0, float(rng.standard_normal())),
    "continuous": lambda rng: float(rng.random()),
}
TESTS = 24


def campaign(rng: np.random.Generator, law: Law, *, replicates: int, copied: bool = False) -> CopiedBlocks:
    """Return the test after a campaign that stays at a start while its results are alike, and leaves it otherwise."""
    test, start = CopiedBlocks(), 0
    for _ in range(TESTS):
        block = [law(rng)] * replicates if copied else [law(rng) for _ in range(replicates)]
        test.observe(start, block)
        start = start if len(set(block)) == 1 and not copied else (start + 1) % 6
    return test


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("replicates", [2, 8])
@pytest.mark.parametrize("runs", RUNS)
def test_false_alarms_are_as_rare_as_the_level_says(law: str, replicates: int, runs: int) -> None:
    rng = np.random.default_rng(len(law) + replicates)
    found = [campaign(rng, LAWS[law], replicates=replicates) for _ in range(runs)]
    assert sum(each.refutes for each in found) <= LEVEL * runs
    evidence = np.exp([each._log for each in found])
    assert evidence.mean() <= 1.0 + 3.0 * evidence.std() / math.sqrt(runs)


@pytest.mark.parametrize(
    ("law", "replicates", "power"), [("continuous", 2, 0.95), ("continuous", 8, 1.0), ("pass or fail", 8, 0.95)]
)
def test_copies_are_found(law: str, replicates: int, power: float) -> None:
    """Each test has one result in all its rollouts; six starts, with four tests each."""
    rng = np.random.default_rng(3)
    found = [campaign(rng, LAWS[law], replicates=replicates, copied=True).refutes for _ in range(200)]
    assert np.mean(found) >= power


@pytest.mark.parametrize(("replicates", "once", "twice"), [(8, 400, 3), (4, 400, 6), (2, 50, 12)])
def test_copies_are_found_though_most_starts_have_one_test(replicates: int, once: int, twice: int) -> None:
    """Starts with one test can show nothing, and hide nothing."""
    rng, test = np.random.default_rng(4), CopiedBlocks()
    for start in [*range(once), *range(twice), *range(twice)]:
        test.observe(start, [float(rng.random())] * replicates)
    assert test.refutes


def test_a_forgotten_factor_would_show(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the sizes of the classes, results that repeat look like copies."""
    monkeypatch.setattr(copied_blocks, "_least_surprise", lambda counts: math.lgamma(counts.total() + 1))
    rng = np.random.default_rng(5)
    found = [campaign(rng, LAWS["pass or fail"], replicates=8).refutes for _ in range(200)]
    assert sum(found) > 10, "where the level allows 2"
