"""The rollouts of a calibration: how its budget is divided, its starts, and seeds that no campaign draws."""

import itertools
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....schemas.draws.distributions import to_digits
from ....schemas.errors import CampaignError
from ....schemas.file.config import CampaignConfig
from ....schemas.file.parameters import parameter_ranges
from ....schemas.system import SystemSpec
from ...campaign.region import Start, condition
from ...campaign.seeds import variant_number
from ...campaign.starts import DIGITS
from ...mathematics.calibration.noise import NOISIEST
from ...mathematics.calibration.steepness import PLACES
from ...mathematics.calibration.trust import DOUBTED
from ...mathematics.gp.kernels import Floats
from ...mathematics.sobol import sobol_blocks

ROLLOUTS = 400
"""Of a problem and a variant, by default."""
CORNERS = 8
"""Starts at corners of the box, where a system is often at its worst."""
NAME = "calibration"
"""Series of its rollouts; no problem of a campaign has this name."""


@dataclass(frozen=True, slots=True)
class RolloutBudget:
    """How many rollouts go where."""

    starts: int
    replicates: int
    """Rollouts at each of them."""
    halvings: int
    """Of each of the steepest places."""
    at_halves: int
    """Rollouts in the middle of a place."""
    at_noisiest: int
    """Further rollouts at each of the noisiest starts."""
    at_doubted: int
    """Further rollouts at each of the starts whose values the others predict least."""

    @classmethod
    def of(cls, rollouts: int, *, noisy: bool) -> "RolloutBudget":
        """Divide a number of rollouts.

        >>> RolloutBudget.of(400, noisy=False), RolloutBudget.of(400, noisy=True).starts
        (RolloutBudget(starts=376, replicates=1, halvings=6, at_halves=1, at_noisiest=0, at_doubted=0), 128)
        """
        replicates, halvings, at_halves = (2, 4, 4) if noisy else (1, 6, 1)
        at_noisiest, at_doubted = (max(6, rollouts * 3 // 100), max(4, rollouts * 2 // 100)) if noisy else (0, 0)
        if rollouts < ROLLOUTS and noisy:
            at_halves = 2
        spent = PLACES * halvings * at_halves + NOISIEST * at_noisiest + DOUBTED * at_doubted
        return cls((rollouts - spent) // replicates, replicates, halvings, at_halves, at_noisiest, at_doubted)


@dataclass(frozen=True, slots=True)
class Box:
    """The ranges of the parameters, in the order of the system, and the region in them."""

    names: tuple[str, ...]
    low: Floats
    high: Floats
    where: str | None

    @classmethod
    def of(cls, config: CampaignConfig, spec: SystemSpec) -> "Box":
        """Return the box of a campaign on ranges."""
        assert isinstance(config.space, dict), "a draft has ranges"
        ranges, names = parameter_ranges(config.space), tuple(each.name for each in spec.parameters)
        ends = np.array([(ranges[name].low, ranges[name].high) for name in names], dtype=np.float64)
        return cls(names, ends[:, 0], ends[:, 1], config.where)

    @property
    def widths(self) -> Floats:
        """Widths of the ranges; 1 for a parameter that is fixed."""
        return np.where(self.high > self.low, self.high - self.low, 1.0)

    def starts(self, shares: Floats) -> list[Start]:
        """Return starts for shares of the ranges (n, p), rounded as those of a campaign, in the box."""
        values = self.low + shares * (self.high - self.low)
        columns = [
            to_digits(values[:, k], *ends, DIGITS) for k, ends in enumerate(zip(self.low, self.high, strict=True))
        ]
        return list(zip(*columns, strict=True))

    def shares(self, starts: Sequence[Start]) -> Floats:
        """Return starts as shares of the ranges, (n, p)."""
        return (np.array(starts, dtype=np.float64) - self.low) / self.widths

    def admitted(self, starts: Sequence[Start]) -> list[bool]:
        """Whether each start is in the region."""
        inside = condition(self.where, self.names)
        return [True] * len(starts) if inside is None else [bool(each) for each in inside(starts)]

    def space_filling(self, count: int, seed: int) -> list[Start]:
        """Return corners, then points of the Sobol sequence that a random shift moves; all in the region.

        Any first part of them fills the space as well, so that each number of starts is a resolution.

        Raises:
            CampaignError: almost nothing of the box is in the region.

        """
        dimension = len(self.names)
        shift = np.random.default_rng(_seed_sequence(seed, NAME)).random(dimension)
        corners = np.array(list(itertools.islice(itertools.product((0.0, 1.0), repeat=dimension), CORNERS)))
        found: dict[Start, None] = {}
        blocks = itertools.islice(sobol_blocks(dimension), 100)
        for shares in itertools.chain([corners], ((block + shift) % 1.0 for block in blocks)):
            starts = self.starts(shares)
            found |= {start: None for start, kept in zip(starts, self.admitted(starts), strict=True) if kept}
            if len(found) >= count:
                return list(found)[:count]
        raise CampaignError("space.where: almost no start of the ranges is in the region; choose narrower ranges")


def calibration_seed(digest: str, seed: int, place: tuple[int, int], variant: str, spec: SystemSpec) -> int:
    """Return the seed of a rollout, in the system's bits, from the draft's digest, `--seed` and (start, replicate).

    Campaigns derive theirs from the names of their problems, of which none is `NAME`.
    """
    sequence = _seed_sequence(seed, digest, *place, variant_number(spec, variant))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(64 - spec.seed_bits))


def _seed_sequence(seed: int, text: str, *place: int) -> np.random.SeedSequence:
    return np.random.SeedSequence((seed, zlib.crc32(text.encode())), spawn_key=(zlib.crc32(NAME.encode()), *place))
