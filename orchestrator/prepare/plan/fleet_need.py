"""What a campaign will need from a fleet: time, storage, memory and network, from a pilot and the size of its problems.

| symbol | name         | meaning                                                        | unit |
|--------|--------------|----------------------------------------------------------------|------|
| c      | `seconds`    | time of a rollout on one worker                                | s    |
| n      | `tests`      | tests of a problem, a range                                    | 1    |
| k      | `per_test`   | rollouts of a test                                             | 1    |
| w      | `window`     | tests of a problem in flight                                   | 1    |
| g      | `thinking`   | time of a problem's mathematics in all                         | s    |
| N      | `workers`    | workers                                                        | 1    |
| b      | `batch`      | rollouts of an assignment                                      | 1    |
| K      | `at_once`    | assignments that can run at the same time: sum of w k / b      | 1    |
| s      | `second_opinion` | share of the rollouts that two workers simulate            | 1    |

The rollouts take at least (sum of n k c) / min(N, K), and each problem n/w rounds one after the other. In a batch c is
less: what an assignment costs besides its rollouts is shared. The loop of the
orchestrator does the mathematics and takes the results, one at a time. A second opinion begins when the first result is
there: it makes a rollout longer, and no more of them run side by side. A range goes from all of this at the same time,
at the fewest tests, to one after the other, at the most tests. Standard library only.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from ....schemas.link.messages import heartbeat_interval
from ....schemas.values import Guess

RESULT_SECONDS = 1.8e-3
"""CPU time of the orchestrator's loop for a result of 100 kB, see docs/performance.md."""
RESULT_LOAD = 4.0e-3
"""CPU time of all threads of the orchestrator for a result of 100 kB over a link, see docs/performance.md."""
BATCH_LOAD, BATCHED_LOAD, BATCHED_BYTE_LOAD = 3.7e-3, 6.5e-6, 5.3e-9
"""CPU time of the orchestrator for a batch, for a rollout in it and for a byte of that, see docs/performance.md."""
HEARTBEAT_SECONDS = 105e-6
"""CPU time of the orchestrator for a heartbeat, in the transport and in the loop, see docs/performance.md."""
MESSAGE = 300
"""Bytes of a heartbeat, or of an assignment, on the wire."""
ROUND_TRIP = 0.01
"""Seconds between the end of a rollout and the start of the next one on the same worker."""
DATABASE_BYTES = 460
"""Of a rollout, with its part of test and bound, see docs/performance.md."""
BLOCK = 4096
"""Bytes of a block of a file system."""
REPORT_BYTES = 20_000_000
"""Certificate, manifest and report at most, beside a kilobyte for each rollout."""
BASE_BYTES = 180_000_000
"""Memory of an orchestrator with few rollouts."""
ROLLOUT_BYTES = 53
"""Memory of the orchestrator for a rollout, see docs/performance.md."""
CLOSING = (0.5, 3.0, 20.0)
"""Seconds from the last rollout to the exit: certificate and report; low, middle, high."""
FASTER, SLOWER = 0.8, 2.0
"""A rollout in the campaign, in times of the pilot's fastest, and of its mean."""
BUSY = 0.7
"""Share of one core from which on the orchestrator limits the campaign."""
FIRST_RESULTS = 3
"""Results of each worker that are compared in any case, see fleet/opinions.py."""

NOTHING = Guess(0.0, 0.0, 0.0)
End = Literal["low", "middle", "high"]
"""Of a range."""


@dataclass(frozen=True, slots=True)
class PilotFigures:
    """What a pilot measured of one worker."""

    rollouts: int
    seconds: float
    """Of a rollout, the mean; the first one, which loads the simulator, does not count."""
    fastest: float
    """Seconds of the fastest of them: on a busy machine the mean says little about an idle one."""
    startup: float
    """Seconds until a worker has simulated its first rollout."""
    size: float
    """Bytes of the file of a rollout, the mean."""
    memory: int
    """Bytes of the process at most."""
    added: float | None = None
    """Seconds that one more rollout of a batch takes; None where a batch takes as long as its rollouts."""

    @property
    def in_batch(self) -> float:
        """Seconds of a rollout in a large batch."""
        return self.seconds if self.added is None else min(self.added, self.seconds)


@dataclass(frozen=True, slots=True)
class Pace:
    """The seconds of a rollout on its worker."""

    alone: float
    added: float
    """Of one more rollout of a batch."""
    trip: float = 0.0
    """Of an assignment, between two of them."""

    @classmethod
    def of(cls, pilot: PilotFigures, alone: float, slower: float) -> "Pace":
        """Return the pace of rollouts that take `alone` seconds alone, in times of it."""
        return cls(slower * alone, slower * min(pilot.in_batch, alone))

    def seconds(self, batch: int) -> float:
        """Return the seconds of a rollout in a batch of so many.

        >>> Pace(0.5, 0.1, 0.1).seconds(1), Pace(0.5, 0.1, 0.1).seconds(5)
        (0.6, 0.2)
        """
        return self.added + (self.alone - self.added + self.trip) / batch


@dataclass(frozen=True, slots=True)
class ProblemSize:
    """The tests of one problem, or of a closing check."""

    name: str
    tests: Guess
    per_test: int
    window: int
    basis: str
    thinking: Guess = NOTHING
    """Seconds of its mathematics in all."""
    matrices: Guess = NOTHING
    """Bytes of the matrices of its method: none, half of what its tests may take, what the most tests may take."""
    batch: int = 1
    """Rollouts of an assignment."""
    work: float = 1.0
    """Of the orchestrator for a rollout, in times of that for a result of one."""
    stored: float = 1.0
    """Share of the bytes of its trajectories that stays on the disk."""

    @property
    def rollouts(self) -> Guess:
        """Its rollouts."""
        return Guess(self.tests.middle * self.per_test, self.tests.low * self.per_test, self.tests.high * self.per_test)

    @property
    def at_once(self) -> int:
        """Its assignments that can run at the same time."""
        rollouts = max(1, min(self.window, math.ceil(self.tests.high))) * self.per_test
        return math.ceil(rollouts / self.batch)


@dataclass(frozen=True, slots=True)
class Load:
    """The share of a core that the orchestrator needs while the problems run."""

    results: float
    heartbeats: float
    results_per_second: float
    """Rollouts, whose results may come in batches."""
    heartbeats_per_second: float
    work: float = 1.0
    """Of a rollout, as in `ProblemSize`."""

    @property
    def whole(self) -> float:
        """Both shares."""
        return self.results + self.heartbeats

    @property
    def most_results(self) -> float:
        """Rollouts per second that one core takes beside the heartbeats; a tenth of a core stays for them."""
        return 1 / (self.result * self.work)

    @property
    def result(self) -> float:
        """Seconds for a result of one rollout, with all threads on one core beside the heartbeats."""
        return RESULT_LOAD / max(0.1, 1.0 - self.heartbeats)

    @property
    def limits(self) -> bool:
        """Whether the orchestrator, and not the workers, decides how long it takes."""
        return self.whole > BUSY


@dataclass(frozen=True, slots=True)
class FleetPlan:
    """What a campaign will need."""

    workers: int
    pilot: PilotFigures
    problems: tuple[ProblemSize, ...]
    checks: tuple[ProblemSize, ...]
    rollouts: Guess
    second_opinions: Guess
    """Attempts beside those of the rollouts; they leave no file."""
    seconds: Guess
    useful_workers: int
    """More of them have nothing to do while the problems run: so many assignments are under way at most."""
    useful_in_checks: int
    files: Guess
    """Bytes of the trajectories on the disk."""
    storage: Guess
    """Bytes of the run directory."""
    memory: Guess
    """Bytes of the orchestrator."""
    network: float
    """Bytes per second into the router, and out of it."""
    load: Load
    notes: tuple[str, ...] = ()
    """What else is to be known before the campaign, in sentences."""


def fleet_plan(
    workers: int,
    pilot: PilotFigures,
    problems: Sequence[ProblemSize],
    checks: Sequence[ProblemSize],
    hung_after: float,
    *,
    second_opinion: float = 0.0,
) -> FleetPlan:
    """Return what a campaign needs from `workers` workers; `hung_after` in s limits the time between two heartbeats.

    `second_opinion` is the share of the rollouts that two workers simulate.
    """
    useful = sum(each.at_once for each in problems)
    rollouts = _added([each.rollouts for each in (*problems, *checks)])
    load = orchestrator_load(workers, pilot, problems, hung_after)
    blocks = _added([_per_assignment(each) for each in (*problems, *checks)])
    stored = _added([_times(each.rollouts, each.stored * pilot.size) for each in (*problems, *checks)])
    files = Guess(stored.middle + blocks.middle * BLOCK / 2, stored.low * 0.8, stored.high * 1.25 + blocks.high * BLOCK)
    rate = min(load.results_per_second, load.most_results)
    return FleetPlan(
        workers=workers,
        pilot=pilot,
        problems=tuple(problems),
        checks=tuple(checks),
        rollouts=rollouts,
        second_opinions=second_opinions(workers, rollouts, second_opinion),
        seconds=campaign_seconds(workers, pilot, problems, checks, hung_after, second_opinion=second_opinion),
        useful_workers=useful,
        useful_in_checks=max((each.at_once for each in checks), default=0),
        files=files,
        storage=Guess(
            files.middle + rollouts.middle * DATABASE_BYTES + REPORT_BYTES / 20,
            files.low + rollouts.low * DATABASE_BYTES,
            files.high + rollouts.high * (2 * DATABASE_BYTES + 1000) + REPORT_BYTES,
        ),
        memory=orchestrator_memory(problems, rollouts),
        network=rate * (pilot.size + 2 * MESSAGE) + MESSAGE * load.heartbeats_per_second,
        load=load,
    )


def _times(number: Guess, factor: float) -> Guess:
    return Guess(number.middle * factor, number.low * factor, number.high * factor)


def second_opinions(workers: int, rollouts: Guess, share: float) -> Guess:
    """Return the attempts that come on top of the first one of each rollout.

    >>> second_opinions(4, Guess(100, 100, 100), 0.0)
    Guess(middle=0.0, low=0.0, high=0.0)
    >>> second_opinions(2, Guess(100.0, 100.0, 100.0), 1.0)
    Guess(middle=100.0, low=100.0, high=100.0)
    """
    if not share:
        return NOTHING
    # One comparison is one for each of both workers, if both still need it.
    first = FIRST_RESULTS * workers * (1 - share) if workers > 1 else 0.0
    return Guess(
        min(rollouts.middle, share * rollouts.middle + first / 2),
        share * rollouts.low,
        min(rollouts.high, share * rollouts.high + first),
    )


def campaign_seconds(
    workers: int,
    pilot: PilotFigures,
    problems: Sequence[ProblemSize],
    checks: Sequence[ProblemSize],
    hung_after: float,
    *,
    second_opinion: float = 0.0,
) -> Guess:
    """Return how long a campaign takes.

    >>> one = ProblemSize("robustness", Guess(100, 100, 100), 1, 1, "fixed")
    >>> found = campaign_seconds(4, PilotFigures(10, 2.0, 2.0, 1.0, 1e5, 10**8), [one], [], 10.0)
    >>> found.low < 100 * 2.0 < found.high
    True
    """
    share = second_opinion
    if share and workers == 1:  # a worker that is alone is replaced before each second opinion
        loading = share / (1 + share) * pilot.startup
        pilot = replace(pilot, seconds=pilot.seconds + loading, fastest=pilot.fastest + loading)
    useful = sum(each.at_once for each in problems)
    result = orchestrator_load(workers, pilot, problems, hung_after).result
    rollouts = _added([each.rollouts for each in (*problems, *checks)])
    extra = second_opinions(workers, rollouts, share)
    # Of those with `share` the sizes below have account.
    first = Guess(extra.middle - share * rollouts.middle, 0.0, extra.high - share * rollouts.high)
    at_once = max(1, min(workers, useful))
    problems, checks = ([_with_second_opinions(each, share) for each in sizes] for sizes in (problems, checks))
    fast = Pace.of(pilot, pilot.fastest, FASTER)
    usual, slow = (replace(Pace.of(pilot, pilot.seconds, times), trip=ROUND_TRIP) for times in (1.0, SLOWER))
    batch = problems[0].batch if problems else 1
    low = [_phase(workers, fast, problems, "low"), *_in_turn(workers, fast, checks, "low")]
    middle = [
        _phase(workers, usual, problems, "middle", result),
        *_in_turn(workers, usual, checks, "middle", result),
        first.middle * usual.seconds(batch) / at_once,
    ]
    high = [
        _one_after_the_other(workers, slow, problems, result),
        *_in_turn(workers, slow, checks, "high", result),
        first.high * replace(slow, trip=2 * ROUND_TRIP).seconds(batch) / at_once,
    ]
    return Guess(
        pilot.startup + sum(middle) + CLOSING[1],
        FASTER * pilot.startup + sum(low) + CLOSING[0],
        2 * SLOWER * pilot.startup + sum(high) + CLOSING[2],
    )


def _with_second_opinions(size: ProblemSize, share: float) -> ProblemSize:
    """Return a size whose rollouts are all attempts; no more of them run side by side than before."""
    tests = Guess(*((1 + share) * number for number in (size.tests.middle, size.tests.low, size.tests.high)))
    return replace(size, tests=tests, window=max(1, min(size.window, math.ceil(size.tests.high))))


def _in_turn(workers: int, pace: Pace, checks: Sequence[ProblemSize], end: End, result: float = 0.0) -> list[float]:
    """Return the seconds of the checks, which come one after the other."""
    return [_phase(workers, pace, [each], end, result) for each in checks]


def _phase(workers: int, pace: Pace, sizes: Sequence[ProblemSize], end: End, result: float = 0.0) -> float:
    """Return the seconds of problems that run side by side, where everything runs at the same time that can.

    `result` is the time that the orchestrator takes for a result, with all its threads on one core.
    """
    if not sizes:
        return 0.0
    at_once = min(workers, sum(each.at_once for each in sizes))
    # At best the trip of one result hides behind the rollout of another, and a result is small.
    in_loop = RESULT_SECONDS / 3 if end == "low" else RESULT_SECONDS
    work = sum(_end_of_range(each.rollouts, end) * each.work for each in sizes)
    loop = work * in_loop + sum(_end_of_range(each.thinking, end) for each in sizes)
    longest = max(_rounds(each, workers, pace, end) for each in sizes)
    return max(_simulated(pace, sizes, end) / at_once, work * result, loop, longest)


def _simulated(pace: Pace, sizes: Sequence[ProblemSize], end: End) -> float:
    """Return the seconds that one worker takes for all rollouts."""
    return sum(_end_of_range(each.rollouts, end) * pace.seconds(each.batch) for each in sizes)


def _rounds(size: ProblemSize, workers: int, pace: Pace, end: End) -> float:
    """Return the seconds of one problem alone: its rounds, one after the other, and its mathematics between them."""
    return _simulated(pace, [size], end) / min(workers, size.at_once) + _end_of_range(size.thinking, end)


def _one_after_the_other(workers: int, pace: Pace, sizes: Sequence[ProblemSize], result: float) -> float:
    """Return the seconds of problems at their most tests, where nothing of the loop runs beside the rollouts."""
    at_once = min(workers, sum(each.at_once for each in sizes))
    shared = _simulated(replace(pace, trip=2 * ROUND_TRIP), sizes, "high") / at_once
    longest = max((_rounds(each, workers, pace, "high") for each in sizes), default=0.0)
    work = sum(each.rollouts.high * each.work for each in sizes)
    loop = work * 2 * RESULT_SECONDS + SLOWER * sum(each.thinking.high for each in sizes)
    return max(shared, longest, work * result) + loop


def batch_work(batch: int, size: float) -> float:
    """Return the work for a rollout of a batch, as in `ProblemSize`; `size` is its bytes.

    >>> batch_work(1, 3200.0), round(batch_work(256, 3200.0), 3)
    (1.0, 0.009)
    """
    if batch == 1:
        return 1.0
    return min(1.0, (BATCH_LOAD / batch + BATCHED_LOAD + BATCHED_BYTE_LOAD * size) / RESULT_LOAD)


def orchestrator_load(workers: int, pilot: PilotFigures, problems: Sequence[ProblemSize], hung_after: float) -> Load:
    """Return the load of the orchestrator while the problems run."""
    rollouts = sum(each.rollouts.middle for each in problems)
    pace = Pace(pilot.seconds, pilot.in_batch, ROUND_TRIP)
    seconds = _simulated(pace, problems, "middle") / rollouts if rollouts else pace.seconds(1)
    work = sum(each.rollouts.middle * each.work for each in problems) / rollouts if rollouts else 1.0
    rate = min(workers, sum(each.at_once for each in problems)) / max(seconds, 1e-6)
    beats = workers / heartbeat_interval(workers, hung_after)
    return Load(rate * RESULT_LOAD * work, beats * HEARTBEAT_SECONDS, rate, beats, work)


def _per_assignment(size: ProblemSize) -> Guess:
    """Return the assignments of a problem, each of which is a file."""
    return _times(size.rollouts, 1 / size.batch)


def orchestrator_memory(problems: Sequence[ProblemSize], rollouts: Guess) -> Guess:
    """Return the memory of the orchestrator: a base, each rollout, and the matrices of the methods."""
    matrices = _added([each.matrices for each in problems])
    return Guess(
        BASE_BYTES + matrices.middle + ROLLOUT_BYTES * rollouts.middle,
        0.5 * BASE_BYTES + matrices.low,
        1.5 * BASE_BYTES + matrices.high + 2 * ROLLOUT_BYTES * rollouts.high,
    )


def _end_of_range(guess: Guess, end: End) -> float:
    return {"low": guess.low, "middle": guess.middle, "high": guess.high}[end]


def _added(guesses: Sequence[Guess]) -> Guess:
    return Guess(
        sum(each.middle for each in guesses), sum(each.low for each in guesses), sum(each.high for each in guesses)
    )
