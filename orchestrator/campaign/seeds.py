"""The random choices of a campaign: functions of its identity and of the choice alone, never of time or machine."""

import hashlib
import zlib

import numpy as np
from numpy.typing import NDArray

from ...schemas.batch import batch_rollouts
from ...schemas.ids import IMPORTANCE, RECHECK, RISK_CHECK, SPOT_CHECK, RolloutId, check_of_extension
from ...schemas.ranges import SEED_BITS
from ...schemas.result.facts import Header
from ...schemas.system import SystemSpec
from ..mathematics.seed_words import first_states

Floats = NDArray[np.float64]
Integers = NDArray[np.int_]
VARIANTS = ("nominal", "true")


def rollout_seed(header: Header, rollout: RolloutId) -> int:
    """Return the seed of a rollout, below 2^53 or what its system takes; a retry uses the same one."""
    if header.spec.seed_bits < SEED_BITS:
        return _short_seed(header, rollout)
    place = rollout.test, variant_number(header.spec, rollout.variant), rollout.replicate
    state = _sequence(header, rollout.problem, *place).generate_state(1, np.uint64)
    # 53 bits: every JSON reader keeps such a number exactly.
    return int(state[0] >> np.uint64(11))


def rollout_seeds(header: Header, first: RolloutId, tests: int, replicates: int) -> list[int]:
    """Return the seed of every rollout of a batch, see `batch_rollouts`: each is that of `rollout_seed`."""
    if header.spec.seed_bits < SEED_BITS:
        return [rollout_seed(header, rollout) for rollout in batch_rollouts(first, tests, replicates)]
    numbers = np.repeat(np.arange(first.test, first.test + tests), replicates)
    places = np.tile(np.arange(first.replicate, first.replicate + replicates), tests)
    return seeds_of(header, first, numbers, places)


def seeds_of(header: Header, series: RolloutId, tests: Integers, replicates: Integers) -> list[int]:
    """Return the seeds of rollouts (n,) of the problem and variant of `series`, by their tests and replicates."""
    if header.spec.seed_bits < SEED_BITS:
        pairs = zip(tests.tolist(), replicates.tolist(), strict=True)
        return [rollout_seed(header, series._replace(test=test, replicate=each)) for test, each in pairs]
    variants = np.full(tests.shape, variant_number(header.spec, series.variant), dtype=np.uint32)
    entropy = _identity(header)
    words = [tests.astype(np.uint32), variants, replicates.astype(np.uint32)]
    found = first_states(entropy, [zlib.crc32(series.problem.encode())], words)
    return [int(each) for each in found >> np.uint64(11)]


def variant_number(spec: SystemSpec, variant: str) -> int:
    """Return the number of a variant among the seeds: with declared disturbances it is the same for both.

    So nominal and true rollouts of a pair have equal disturbances, and their difference loses what both share.
    """
    return 0 if spec.disturbances else VARIANTS.index(variant)


def first_node(header: Header, problem: str, size: int) -> int:
    """Return the lattice node of a problem's first test, uniform over `size` nodes."""
    return int(np.random.default_rng(_sequence(header, problem)).integers(size))


def uniform(header: Header, name: str, rows: range, width: int, *, attempt: int = 0) -> Floats:
    """Return numbers in [0, 1), shape (rows, width): rows of the endless table `name`, whichever others are asked for.

    `rows` has no gaps. Each `attempt` has a table of its own.
    """
    generator = np.random.PCG64(_sequence(header, name, *([attempt] if attempt else [])))
    generator.advance(rows.start * width)  # one step a number
    return np.random.Generator(generator).random((len(rows), width))


def drawn(header: Header, name: str, evidence: str, size: int, count: int) -> list[int]:
    """Return `count` of `size` numbers without repetition, in order; they follow from the digest of the evidence."""
    words = int(hashlib.sha256((header.config_sha256 + name + evidence).encode()).hexdigest(), 16)
    return sorted(int(each) for each in np.random.default_rng(words).permutation(size)[:count])


def _short_seed(header: Header, rollout: RolloutId) -> int:
    """Return a seed below 2^`seed_bits`: the number of the rollout in its campaign, through a permutation of all seeds.

    Drawn ones would collide: of 100,000 seeds of 32 bits one pair is expected, and equal seeds at one start are copies.
    These differ within a campaign of at most 2^`seed_bits` possible rollouts, and within a test in every campaign.
    """
    config, bits = header.config, header.spec.seed_bits
    # Not the bisection of a counterexample and the simplest failures: their rollouts have the seed of that one.
    series = sorted([*(each.name for each in config.problems), SPOT_CHECK, RECHECK])
    around = config.falsify.sampled_tests if config.falsify else 0
    series += [IMPORTANCE] if around else []
    tests = max(config.spot_check + config.spot_check_followups, around, *map(config.max_tests_of, config.problems))
    replicates = max(config.spot_replicates, *map(config.replicates_of, config.problems))
    test = _numbered(series, tests, rollout)
    number = (test * replicates + rollout.replicate) * len(VARIANTS) + variant_number(header.spec, rollout.variant)
    keys = _sequence(header, "seeds").generate_state(3, np.uint64)
    for key in map(int, keys):
        # Each step can be undone modulo 2^bits: an odd factor has an inverse, and a shifted number gives back its top.
        number = (number + key) * (key | 1) % 2**bits
        number ^= number >> bits // 2
    return number


def _numbered(series: list[str], tests: int, rollout: RolloutId) -> int:
    """Return the number of a test among all tests of the `series`, each of which has so many before any extension."""
    name, extensions = check_of_extension(rollout.problem) or (rollout.problem, 0)
    test = rollout.test
    if name == RISK_CHECK:
        # It has what the spot check left of its tests: those from the end, so that other numbers stay as they were.
        name, test = SPOT_CHECK, tests - 1 - test
    # The spot check after an extension goes on where the one before it ended.
    test += extensions * tests
    if test < tests:
        return series.index(name) * tests + test
    # Behind all of these: a number that a campaign had without extension stays as it was.
    return test * len(series) + series.index(name)


def _sequence(header: Header, problem: str, *place: int) -> np.random.SeedSequence:
    # By name: the order of the problems changes none.
    return np.random.SeedSequence(_identity(header), spawn_key=(zlib.crc32(problem.encode()), *place))


def _identity(header: Header) -> tuple[int, int]:
    # With the digest of the file no two campaigns share rollouts, unless both have the same `draws`.
    return header.config.seed, int(header.config.draws or header.config_sha256, 16)


BITS = 64
"""Of the draw that decides on a second opinion."""


def is_chosen(header: Header, rollout: RolloutId) -> bool:
    """Whether a rollout gets a second opinion; it follows from the campaign's seed, which no request contains."""
    share = header.config.second_opinion
    if not share:
        return False
    text = f"second opinion {header.config.seed} {header.config_sha256} {rollout}"
    drawn = int.from_bytes(hashlib.sha256(text.encode()).digest()[: BITS // 8], "big")
    return drawn < share * 2.0**BITS
