"""`perfbound plan`: a pilot of ten rollouts in one child process, and what the campaign will need from a fleet."""

import math
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

from ....schemas.batch import BatchRequest
from ....schemas.errors import PerfboundError, Stopped, TrajectoryError
from ....schemas.file.config import CampaignConfig
from ....schemas.ids import RECHECK, SPOT_CHECK, RolloutId
from ....schemas.result.facts import Header
from ....schemas.rollout import RolloutRequest
from ....schemas.trajectory.trajectory import Trajectory
from ....schemas.values import Guess
from ...campaign.admission import check_whole
from ...campaign.checks import check_new, method_sizes
from ...campaign.closing.recheck import Recheck
from ...campaign.closing.spot_check import spot_check_plan
from ...campaign.consistency import scope
from ...campaign.plan import Plans, ProblemPlan, plans
from ...campaign.region import Start
from ...campaign.seeds import drawn
from ...campaign.starts import Draws
from ...certificate.verify.stages import Report
from ...certificate.words.format import duration
from ...fleet.children.rollouts import (
    ChildRolloutError,
    ChildSystem,
    cost_in_batch,
    finished,
    have_one_grid,
    peak_memory,
    simulate_in_child,
    simulated_spec,
    trial_batches,
)
from ...forecast.evidence import evidence_bytes
from ...mathematics.bounds.cost import MethodSize
from ...mathematics.gp.points import point_at
from ..calibrate.design import calibration_seed
from ..size import proposed_batch, undecided_rollouts
from .fleet_need import FleetPlan, PilotFigures, ProblemSize, batch_work, fleet_plan
from .rehearsal import REPEATED, PilotRollouts, Rehearsal, expected_tests, rehearsed

ROLLOUTS = 10
SECONDS = 60.0
"""No rollout of the pilot starts later than this."""
REHEARSAL = 15.0
"""Seconds of processor time that a problem is rehearsed at most; other work on the machine does not count."""
WORTH = 4
"""Times of its present batch from which on another one is worth a line."""
PILOT = "pilot rollouts"
"""The stage of the progress in which the pilot is simulated."""
LONG = 36_000.0
"""Seconds of mathematics that are worth a line."""
NAME = "plan"
"""The place of a problem's name, which no problem has: seeds and starts of a pilot are not those of its campaign."""


@dataclass(frozen=True, slots=True)
class _Pilot:
    """What a pilot has simulated."""

    figures: PilotFigures
    starts: tuple[Start, ...]
    recorded: tuple[dict[str, list[Trajectory]], ...]
    batch_size: float | None
    """Bytes of a rollout in a batch; None where rollouts cannot be one."""

    @property
    def in_batches(self) -> PilotFigures:
        """The figures of rollouts in batches."""
        return replace(self.figures, size=self.batch_size or self.figures.size)


def plan_campaign(config: CampaignConfig, source: Path, workers: int, report: Report = lambda *_: None) -> FleetPlan:
    """Return what the campaign of a file needs from `workers` workers; nothing is kept of its pilot.

    Raises:
        CampaignError: the campaign does not fit its system, or the system cannot be used here.
        PerfboundError: a rollout fails, or would be refused by a campaign.
        Stopped: with what was ended.

    """
    reference = config.system.reference(source)
    report("system", 0, 1)
    spec = simulated_spec(reference, f"{source}: {config.system.place}", config.horizon)
    report("system", 1, 1)
    check_new(config, spec, str(source))
    header = Header.new(config, spec, {}, run=NAME)
    found = plans(config, header.spec)
    try:
        pilot = _pilot(header, found, ChildSystem(reference, header.spec, config.deadline, SECONDS), report)
        nearest = PilotRollouts(pilot.starts, pilot.recorded)
        problems = [_problem_size(header, plan, _rehearsal(plan, header, nearest, report)) for plan in found.values()]
    except ChildRolloutError as error:
        raise PerfboundError(f"{source}: {error}") from None
    except Stopped as stop:
        raise Stopped(stop.signal, "the pilot was ended, nothing was written") from None
    checks = tuple(_check_sizes(header, found, problems))

    def planned(batch: int) -> FleetPlan:
        figures = pilot.figures if batch == 1 or pilot.batch_size is None else pilot.in_batches
        each = [_in_batches(header, size, batch, figures.size) for size in problems]
        return fleet_plan(workers, figures, each, checks, config.hung_after, second_opinion=config.second_opinion)

    fleet = planned(config.batch)
    notes = [*scope(found, listed_alone=True), *long_mathematics(config)]
    if pilot.batch_size is not None:
        rollouts = undecided_rollouts(found.values())
        batch = proposed_batch(pilot.figures.in_batch, pilot.batch_size, rollouts, workers)
        if batch >= WORTH * config.batch:
            notes.append(_shorter(batch, planned(batch), fleet))
    return replace(fleet, notes=tuple(notes))


def _shorter(batch: int, found: FleetPlan, without: FleetPlan) -> str:
    """Return how long the campaign would take with the batch that is proposed."""
    return (
        f"With the key `batch = {batch}` it would take about {duration(found.seconds.middle)}, in place of "
        f"{duration(without.seconds.middle)}: a worker simulates so many rollouts at once."
    )


def _in_batches(header: Header, size: ProblemSize, batch: int, file_bytes: float) -> ProblemSize:
    """Return the size of a problem whose rollouts come in batches of `batch` at most."""
    config = header.config.model_copy(update={"batch": batch})
    plan = plans(config, header.spec)[size.name]
    machine = plan.machine
    tests = min(machine.block, machine.max_tests)
    each = max(1, tests * len(plan.rollouts) // max(1, len(machine.batches(0))))
    rollouts = max(1.0, size.rollouts.middle)
    stored = evidence_bytes(config, plan, rollouts, file_bytes) / (rollouts * max(1.0, file_bytes))
    work = batch_work(each, file_bytes)
    found = replace(size, window=machine.window * tests, batch=each, work=work, stored=stored)
    # What blocks cost besides their plan is in `BATCHED_LOAD`, and not what was rehearsed test by test.
    return found if machine.block == 1 else replace(found, thinking=_planning(header, plan))


def _rehearsal(plan: ProblemPlan, header: Header, pilot: PilotRollouts, report: Report) -> Rehearsal | None:
    """Return the rehearsal of a problem; None where the trajectories of the pilot do not allow one."""
    if plan.falsify is not None:  # its tests come from a search
        return None
    # Its first test waits for the weights.
    if any(size.method == "kriging" and size.seconds > REHEARSAL for size in _sizes(header, plan)):
        return None
    shown = partial(report, f"rehearsal of {plan.name}")
    shown(0, 1)  # a method may think long before its first test
    try:
        return rehearsed(
            plan, header, pilot, time=time.process_time, most=REHEARSAL, done=lambda share: shown(int(100 * share), 100)
        )
    except (ValueError, ArithmeticError):
        return None
    finally:
        shown(100, 100)


def _problem_size(header: Header, plan: ProblemPlan, rehearsal: Rehearsal | None) -> ProblemSize:
    tests, basis = expected_tests(plan, rehearsal)
    thinking = _planning(header, plan)
    if rehearsal is not None:
        each = [rehearsal.seconds_for(number) for number in (tests.middle, tests.low, tests.high)]
        thinking = Guess(each[0].middle, each[1].low, each[2].high)
    # A method keeps distinct starts alone, and most campaigns return to few.
    matrices = Guess(_matrices(header, plan, tests.middle) / 2, 0.0, _matrices(header, plan, tests.high))
    return ProblemSize(plan.name, tests, len(plan.rollouts), plan.window, basis, thinking, matrices)


def _planning(header: Header, plan: ProblemPlan) -> Guess:
    """Return the seconds of the mathematics before the first test."""
    seconds = sum(size.seconds for size in _sizes(header, plan) if size.method == "kriging")
    return Guess(seconds, seconds / 2, 2 * seconds)


def _sizes(header: Header, plan: ProblemPlan) -> list[MethodSize]:
    return [size for problem, size in method_sizes(header.config) if problem.name == plan.name]


def _matrices(header: Header, plan: ProblemPlan, tests: float) -> float:
    """Return the bytes that so many tests of a problem may take."""
    return sum(replace(size, tests=math.ceil(tests)).memory for size in _sizes(header, plan))


def long_mathematics(config: CampaignConfig) -> Iterator[str]:
    """Yield a line for each problem whose mathematics may take the orchestrator long."""
    for problem, size in method_sizes(config):
        if size.method != "kriging" and size.seconds > LONG:
            yield (
                f"{problem.name}: {size.tests:,} tests, if each is at another of the {size.candidates:,} starts, are "
                f"about {duration(size.seconds)} of mathematics; a smaller max_tests or resolution takes less"
            )


def _check_sizes(header: Header, found: Plans, problems: Sequence[ProblemSize]) -> Iterator[ProblemSize]:
    """Yield the closing checks, as far as the campaign file decides them."""
    evidence = [each.rollouts for each in problems]
    spot = spot_check_plan(header, found.values())
    if spot is not None:
        starts, most = header.config.spot_check, spot.most_tests
        words = f"{starts:,} starts, and follow-ups" if most > starts else f"{starts:,} starts"
        # In tests of one rollout: a follow-up has fewer of them than the first test at a start.
        low, high = spot.count(starts), spot.count(most)
        tests = Guess((low + high) / 2, low, high)
        evidence.append(tests)
        yield ProblemSize(SPOT_CHECK, tests, 1, spot.window * len(spot.rollouts), words)
    if Recheck.wanted(header):
        fewest, largest = sum(each.low for each in evidence), sum(each.high for each in evidence)
        low, high = int(min(header.config.recheck, fewest)), int(min(header.config.recheck, largest))
        yield ProblemSize(RECHECK, Guess(high, low, high), 1, high, "fixed by the campaign file")


def _pilot(header: Header, found: Plans, system: ChildSystem, report: Report) -> _Pilot:
    """Simulate the pilot.

    Raises:
        ChildRolloutError: a rollout fails, or would be refused by a campaign.

    """
    starts, requests = _pilot_starts(header, found), []
    for test, start in enumerate(starts):
        for variant, count in _pilot_variants(header, found).items():
            for replicate in range(count):
                place = RolloutId(NAME, test, variant, replicate)
                digest = f"{header.config_sha256} {NAME}"
                seed = calibration_seed(digest, 0, (test, replicate), variant, header.spec)
                requests.append(header.template.request(place, start, seed))
    with tempfile.TemporaryDirectory(prefix="perfbound-plan-") as name:
        folder, begin = Path(name), time.time()
        wanted: list[RolloutRequest | BatchRequest] = [*requests, *trial_batches(header.template, requests)]
        report(PILOT, 0, len(wanted))
        simulate_in_child(system, wanted, folder, lambda done: report(PILOT, done, len(wanted)))
        pilot = _pilot_of(header, starts, list(finished(system, requests, folder)), folder, begin)
        return _with_batches(pilot, folder, len(requests))


def _pilot_of(
    header: Header,
    starts: Sequence[Start],
    done: Sequence[tuple[RolloutRequest, Trajectory, float]],
    folder: Path,
    begin: float,
) -> _Pilot:
    columns = tuple(column.name for column in header.spec.columns)
    recorded: list[dict[str, list[Trajectory]]] = []
    for request, trajectory, _ in done:
        try:
            check_whole(trajectory, columns, header.config.horizon)
        except TrajectoryError as fault:
            words = request.words(header.spec)
            raise ChildRolloutError(f"{words}: a campaign would refuse this rollout: {fault}") from None
        if request.test == len(recorded):
            recorded.append({})
        recorded[request.test].setdefault(request.variant, []).append(trajectory)
    # A slow pilot may have ended within a start.
    whole = [each for each in recorded if each.keys() == recorded[0].keys()]
    written = [at for _, _, at in done]
    startup = max(0.0, written[0] - begin)
    # The first rollout loads the simulator.
    each = [max(0.0, after - before) for before, after in pairwise(written)] or [startup]
    sizes = [os.path.getsize(folder / f"{number}.mcap") for number in range(len(done))]
    figures = PilotFigures(
        rollouts=len(done),
        seconds=sum(each) / len(each),
        fastest=min(each),
        startup=startup,
        size=sum(sizes) / len(sizes),
        memory=peak_memory(folder),
    )
    one_grid = have_one_grid([trajectory for _, trajectory, _ in done])
    return _Pilot(figures, tuple(starts[: len(whole)]), tuple(whole), figures.size if one_grid else None)


def _with_batches(pilot: _Pilot, folder: Path, rollouts: int) -> _Pilot:
    """Return a pilot with what a rollout of a vectorised system costs in a batch."""
    found = cost_in_batch(folder, rollouts)
    if found is None:
        return pilot
    return replace(pilot, figures=replace(pilot.figures, added=found.seconds), batch_size=found.size)


def _pilot_variants(header: Header, found: Plans) -> dict[str, int]:
    """Return the rollouts of each variant at a start of the pilot."""
    used = dict.fromkeys(variant for plan in found.values() for variant in plan.variants)
    return {variant: REPEATED if variant in header.spec.noisy else 1 for variant in used}


def _pilot_starts(header: Header, found: Plans) -> list[Start]:
    """Return starts of the space, those of the first problem: drawn ones, or candidates at random."""
    plan, count = next(iter(found.values())), max(1, ROLLOUTS // sum(_pilot_variants(header, found).values()))
    if plan.candidates is None:
        draws = Draws(header, NAME)
        return [draws.start(number) for number in range(count)]
    size = plan.candidates.size
    return [point_at(plan.candidates, node) for node in drawn(header, NAME, "", size, min(count, size))]
