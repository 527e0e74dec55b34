"""The rollouts of `check-system`: what runs in which process, in which order."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ....schemas.file.parameters import parameter_ranges
from ....schemas.file.space import Space
from ....schemas.ids import RolloutId
from ....schemas.instants import SAMPLES
from ....schemas.requests import RequestTemplate
from ....schemas.rollout import RolloutRequest
from ....schemas.system import OptionValue, Parameter, SystemSpec, Variant
from ....schemas.system_check import ChildRun, Trial
from ...campaign.region import Condition, condition

CORNERS, STARTS = 16, 8
"""Most corners of the box, and random starts in it."""
SEEDS = 2
"""Seeds for each random start."""
GLOBAL_SEEDS = (1, 1, 2)
"""Of the global random states: equal ones that give unequal rollouts show nothing, unequal ones a dependence."""
GROWTH_SECONDS, GROWTH_ROLLOUTS = 10.0, 300
"""Limits of the rollouts that follow to measure the growth of memory, and to see noise that rarely acts."""
TOGETHER_SECONDS, TOGETHER_ROLLOUTS, FEWEST_TOGETHER = 5.0, 200, 8
"""Of each of two processes that run at the same time."""
BATCHED = 32
"""Rollouts of a batch that is compared with them."""
MANY_SEEDS, FEWEST_SEEDS = 40, 10
"""Seeds at one start that show whether a system uses the whole seed, and the fewest that are worth a look."""
MOST_DISTURBED, OTHER_VALUES = 30, 20
"""Disturbances that are tried one by one, and draws of which one differs."""
MOST_ATTEMPTS = 20_000
"""At a start of the region, which has at least 1 in 1,000 starts of the box."""
FIRST_FEW = 6
"""Rollouts after which a system whose every rollout fails is tried no further."""
GOLDEN = (5**0.5 - 1) / 2
"""Its multiples, modulo 1, are spread evenly."""
START, CORNER, RANDOM, GROWTH, SEED, BATCH = "start", "corner", "random", "growth", "seed", "batch"
RESIDUAL, DISTURBED = "residual", "disturbed"
"""Kinds of rollouts: their `problem`."""

Point = tuple[float, ...]


@dataclass(frozen=True)
class Trials:
    """The rollouts of one check: a function of system, box, variants, horizon and seed.

    `halves` adds rollouts of half the horizon.
    """

    template: RequestTemplate
    box: tuple[Parameter, ...]
    variants: tuple[Variant, ...]
    seed: int
    halves: bool = True
    start: int = 0
    """Number of the random start at which each process begins."""
    where: str | None = None
    """The part of the box in which the starts of the campaign are."""

    @classmethod
    def of(
        cls,
        spec: SystemSpec,
        options: Mapping[str, OptionValue],
        *,
        variants: tuple[Variant, ...],
        horizon: float,
        seed: int,
        space: Space | None = None,
    ) -> "Trials":
        """Plan rollouts of `horizon` seconds in the box of a campaign; without one, in the whole box of the system."""
        template = RequestTemplate.of(spec, options, horizon=horizon, visual=True)
        # The knots of an input over time follow the horizon: half of it has another input.
        return cls(template, _box_of(spec, space), variants, seed, halves=not spec.signals)

    @property
    def spec(self) -> SystemSpec:
        """The system."""
        return self.template.spec

    @property
    def horizon(self) -> float:
        """Length of the rollouts, in s."""
        return self.template.horizon

    def of_own_horizon(self, horizon: float) -> "Trials":
        """Return the rollouts of a system that has one horizon alone, in s."""
        return replace(self, template=replace(self.template, horizon=horizon), halves=False)

    def fresh(self) -> tuple[Trial, ...]:
        """Return the rollouts of a process that runs no other: the start of each variant."""
        # Not up to the end of the shorter rollout: its last sample may be one that only an end has.
        beginning = self.horizon / 2 - self.horizon / SAMPLES
        return tuple(
            Trial(request=self._request(START, self.start, variant), beginning=beginning) for variant in self.variants
        )

    def first(self, seconds: float) -> tuple[Trial, ...]:
        """Return the rollouts of the first process; `seconds` is the time of a rollout.

        They begin as `fresh`, so that a difference is one between processes, and not one of what ran before.
        """
        starts = self.fresh()
        return (
            *starts,
            *starts,
            *self._others(),
            *starts,
            *self._reseeded(),
            *self._disturbed(),
            *self._shorter(),
            *self._seeds(seconds),
            *self._growing(seconds),
            *starts,
        )

    def second(self) -> tuple[Trial, ...]:
        """Return the rollouts of the second process: those of the first, once each, in the opposite order."""
        # In the opposite order: what depends on the rollouts before it differs then.
        return tuple(reversed((*self.fresh(), *self._others())))

    def together(self, seconds: float) -> tuple[tuple[Trial, ...], tuple[Trial, ...]]:
        """Return the rollouts of two processes that run at the same time: those that run alone, too."""
        count = max(FEWEST_TOGETHER, min(TOGETHER_ROLLOUTS, int(TOGETHER_SECONDS / max(seconds, 1e-6))))
        forth = tuple(itertools.islice(itertools.cycle(self._others()), count))
        back = itertools.islice(itertools.cycle(reversed(self._others())), count)
        # Pauses, so that the same moments of two rollouts of one length come to meet.
        longest = min(seconds, TOGETHER_SECONDS / count)
        pauses = (longest * (number * GOLDEN % 1) for number in range(count))
        return forth, tuple(each.model_copy(update={"pause": pause}) for each, pause in zip(back, pauses, strict=True))

    def batches(self, seconds: float) -> tuple[Trial, ...]:
        """Return a batch of each variant, of rollouts that take `seconds` each alone."""
        count = max(FEWEST_TOGETHER, min(BATCHED, int(TOGETHER_SECONDS / max(seconds, 1e-6))))
        return tuple(self._batch(variant, count) for variant in self.variants)

    def _batch(self, variant: Variant, count: int) -> Trial:
        requests = [trial.request for trial in self._others() if trial.request.variant == variant][-count:]
        first = RolloutId(BATCH, 0, variant, 0)
        starts, seeds = [each.x for each in requests], [each.seed for each in requests]
        batch = self.template.batch(first, starts, seeds)
        return Trial(request=batch.single(0), batch=batch)

    def few(self) -> tuple[Trial, ...]:
        """Return a few rollouts at other starts, for a system whose first ones all fail."""
        return self._others()[:FIRST_FEW]

    def _others(self) -> tuple[Trial, ...]:
        requests = [
            self._request(CORNER, number, variant, corner)
            for number, corner in enumerate(corners(self.box, self.seed))
            if is_inside(self._region, corner)
            for variant in self.variants
        ]
        requests += [
            self._request(RANDOM, test, variant, replicate=replicate)
            for test in range(STARTS)
            for variant in self.variants
            for replicate in range(SEEDS)
        ]
        return tuple(Trial(request=request) for request in requests)

    def _reseeded(self) -> Iterator[Trial]:
        for trial in self.fresh():
            for seed in GLOBAL_SEEDS:
                yield trial.model_copy(update={"reseed": seed})

    def _disturbed(self) -> Iterator[Trial]:
        """Yield the start with another seed, then with another value of one disturbance after the other."""
        for trial in self.fresh():
            request = trial.request
            if request.variant not in self.spec.noisy or not self.spec.disturbances:
                continue
            rng = np.random.default_rng([self.seed, *DISTURBED.encode()])
            seeds = list(map(int, rng.integers(2**self.spec.seed_bits, size=OTHER_VALUES)))
            yield Trial(request=request.model_copy(update={"problem": RESIDUAL, "seed": seeds[0]}))
            others = self.template.disturbances(request.variant, [request.x] * len(seeds), seeds)
            for k, value in enumerate(request.disturbances[:MOST_DISTURBED]):
                values = list(request.disturbances)
                # Of few choices some draws are alike.
                values[k] = next((each[k] for each in others if each[k] != value), value)
                changes = {"problem": DISTURBED, "replicate": k, "disturbances": tuple(values)}
                yield Trial(request=request.model_copy(update=changes))

    def _shorter(self) -> Iterator[Trial]:
        if self.halves and self.horizon:
            short = {"horizon": self.horizon / 2}
            for trial in self.fresh():
                yield trial.model_copy(update={"request": trial.request.model_copy(update=short)})

    def _seeds(self, seconds: float) -> Iterator[Trial]:
        count = min(MANY_SEEDS, int(GROWTH_SECONDS / max(seconds, 1e-6)))
        if count < FEWEST_SEEDS:
            return
        for trial in self.fresh():
            if trial.request.variant in self.spec.noisy:
                seeds = np.random.default_rng([self.seed, *SEED.encode()]).integers(2**self.spec.seed_bits, size=count)
                for number, seed in enumerate(map(int, seeds)):
                    changes = {"problem": SEED, "replicate": number, "seed": seed}
                    yield Trial(request=trial.request.model_copy(update=changes))

    def _growing(self, seconds: float) -> Iterator[Trial]:
        count = min(GROWTH_ROLLOUTS, int(GROWTH_SECONDS / max(seconds, 1e-6)))
        places = ((start, replicate) for start in itertools.count() for replicate in range(SEEDS))
        each = ((start, replicate, variant) for start, replicate in places for variant in self.variants)
        for start, replicate, variant in itertools.islice(each, count):
            yield Trial(request=self._request(GROWTH, start, variant, replicate=replicate))

    def _request(
        self, kind: str, number: int, variant: Variant, x: Point | None = None, *, replicate: int = 0
    ) -> RolloutRequest:
        """Return a rollout at `x`, by default at a random start of its own; its seed is one as campaigns draw them."""
        rng = np.random.default_rng([self.seed, *kind.encode(), number])
        start = start_inside(self.box, self._region, rng) if x is None else x
        seed = int(rng.integers(2**self.spec.seed_bits, size=SEEDS)[replicate])
        return self.template.request(RolloutId(kind, number, variant, replicate), start, seed)

    @cached_property
    def _region(self) -> Condition | None:
        return condition(self.where, [each.name for each in self.box])


def start_inside(box: Sequence[Parameter], region: Condition | None, rng: np.random.Generator) -> Point:
    """Return a random start, one of the region if there is one; of a tiny one any start of the box."""
    attempts = (random_start(box, rng) for _ in range(MOST_ATTEMPTS))
    first = next(attempts)
    return next((each for each in itertools.chain([first], attempts) if is_inside(region, each)), first)


def is_inside(region: Condition | None, start: Point) -> bool:
    """Whether a start is in the region, or there is none."""
    return region is None or bool(region([start])[0])


def random_start(box: Sequence[Parameter], rng: np.random.Generator) -> Point:
    """Return a point of the box, uniform, in the units of the parameters."""
    return tuple(float(rng.uniform(each.low, each.high)) for each in box)


def corners(box: Sequence[Parameter], seed: int) -> list[Point]:
    """Return the corners of the box; of more than `CORNERS` the lowest, the highest and random ones."""
    ends = [(each.low, each.high) for each in box]
    if 2 ** len(ends) <= CORNERS:
        return list(itertools.product(*ends))
    chosen = np.random.default_rng([seed, len(ends)]).integers(2, size=(CORNERS, len(ends)))
    chosen[0], chosen[1] = 0, 1
    return [tuple(pair[int(side)] for pair, side in zip(ends, row, strict=True)) for row in chosen]


def _box_of(spec: SystemSpec, space: Space | None) -> tuple[Parameter, ...]:
    if not isinstance(space, dict):
        return spec.parameters
    ranges = {name: {"low": each.low, "high": each.high} for name, each in parameter_ranges(space).items()}
    return tuple(each.model_copy(update=ranges[each.name]) for each in spec.parameters)


def own_horizon(spec: SystemSpec, fresh: ChildRun) -> float | None:
    """Return when the rollouts of a system without horizon end, in s; None if they end at the horizon asked for.

    A function that does not take its `horizon` has a duration of its own, often 0.
    """
    if spec.timed or not fresh.measured or fresh.measured[0].grid is None:
        return None
    last, asked = fresh.measured[0].grid.last, fresh.trials[0].request.horizon
    return last if abs(last - asked) > asked / SAMPLES and last <= spec.max_horizon else None
