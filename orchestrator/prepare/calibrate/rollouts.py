"""The rollouts of a calibration: simulated in child processes, kept until its end, scored as those of a campaign."""

import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ....schemas.draws.laws import ReportedLaws
from ....schemas.errors import TrajectoryError
from ....schemas.file.config import CampaignConfig
from ....schemas.file.draft import CLIP
from ....schemas.ids import RolloutId
from ....schemas.requests import RequestTemplate
from ....schemas.rollout import RolloutRequest
from ....schemas.system import Variant
from ....schemas.trajectory.trajectory import Trajectory
from ...campaign import plan as plans
from ...campaign.admission import check_whole
from ...campaign.objectives import measured
from ...campaign.observation import Observer
from ...campaign.region import Start
from ...fleet.children.rollouts import ChildRolloutError, ChildSystem, finished, simulate_in_child
from ...mathematics.gp.kernels import Floats
from ..seen_margins import SeenMargins
from .constants import PilotPace
from .design import NAME, calibration_seed

Report = Callable[[int], None]
"""Progress callback: rollouts so far."""
FEWEST_OF_A_CHILD = 8
"""Rollouts for which another process is worth its start."""


@dataclass(frozen=True, slots=True)
class StartRollout:
    """One rollout of each variant, at a start."""

    test: int
    start: Start
    replicate: int


@dataclass(frozen=True, slots=True)
class RolloutBatch:
    """Rollouts that were simulated together, and the folders of their files."""

    number: int
    """From 1."""
    parts: tuple[tuple[Path, tuple[RolloutRequest, ...]], ...] = ()


class CalibrationRollouts:
    """The rollouts of one problem, in a folder that is there while the calibration runs. Not thread-safe."""

    def __init__(
        self, system: ChildSystem, config: CampaignConfig, number: int, folder: Path, *, seed: int, workers: int
    ) -> None:
        self._system, self._number, self._folder, self._seed, self._workers = system, number, folder, seed, workers
        self._digest, self._horizon = config.digest, config.horizon
        self._plan = plans.plan(config, system.spec, config.problems[number])
        options, horizon = config.system.options, config.horizon
        self._template = RequestTemplate.of(system.spec, options, horizon=horizon, visual=False, campaign=NAME)
        self._batches = 0
        self._reported: dict[tuple[int, int], tuple[float, ...]] = {}
        self.margins = SeenMargins(config, system.spec)
        self.report: Report = lambda _: None
        self.count = 0
        """Rollouts so far."""
        self.clock = time.monotonic
        self.pace = PilotPace(0, 0.0, 1)
        """That of the first batch."""

    def simulate(self, wanted: Sequence[StartRollout]) -> RolloutBatch:
        """Simulate rollouts side by side, those of one start in one process.

        Raises:
            ChildRolloutError: a rollout fails.

        """
        processes = max(1, min(self._workers, len(wanted) // FEWEST_OF_A_CHILD))
        self._batches += 1
        parts = []
        for process in range(processes):
            folder = self._folder / f"{self._batches}-{process}"
            folder.mkdir()
            requests = [
                self._request(each, variant) for each in wanted[process::processes] for variant in self._variants
            ]
            parts.append((folder, tuple(requests)))
        batch = RolloutBatch(self._batches, tuple(parts))
        started, number = self.clock(), len(wanted) * len(self._variants)
        self._run(batch)
        if self._batches == 1:  # later ones are so small that they last as long as workers take to start
            self.pace = PilotPace(number, self.clock() - started, processes)
        self.count += number
        self.report(self.count)
        return batch

    @property
    def _variants(self) -> tuple[Variant, ...]:
        return self._plan.variants

    def _request(self, wanted: StartRollout, variant: Variant) -> RolloutRequest:
        rollout = RolloutId(NAME, wanted.test, variant, wanted.replicate)
        return self._template.request(rollout, wanted.start, self._seed_of(wanted, variant))

    def _seed_of(self, wanted: StartRollout, variant: Variant) -> int:
        digest, place = f"{self._digest} {self._plan.name}", (wanted.test, wanted.replicate)
        return calibration_seed(digest, self._seed, place, variant, self._system.spec)

    def scores(self, wanted: Sequence[StartRollout]) -> Floats:
        """Return the scores of the known disturbances of rollouts (n, w), whose values were asked for if they report.

        The system has some.
        """
        spec = self._system.spec
        reported = np.array([self._reported.get((each.test, each.replicate), ()) for each in wanted])
        drawn = np.empty((len(wanted), 0))
        if spec.drawn:
            drawn = self._template.scores([self._seed_of(each, self._variants[0]) for each in wanted])
        return ReportedLaws(spec.reported).beside(drawn, reported)

    def _run(self, batch: RolloutBatch) -> None:
        ended, done = threading.Event(), [0] * len(batch.parts)

        def step(process: int, files: int) -> None:
            if ended.is_set():
                raise _EndedError
            done[process] = files

        with ThreadPoolExecutor(len(batch.parts)) as pool:
            futures = [
                pool.submit(simulate_in_child, self._system, requests, folder, lambda files, k=process: step(k, files))  # type: ignore[misc]
                for process, (folder, requests) in enumerate(batch.parts)
            ]
            try:
                while waiting := [each for each in futures if not each.done()]:
                    wait(waiting, timeout=1.0, return_when=FIRST_EXCEPTION)
                    self.report(self.count + sum(done))
                    for future in futures:
                        if future.done():
                            future.result()  # the first failure ends the others
                for future in futures:
                    future.result()
            except BaseException:  # also a signal: no child may outlive it
                ended.set()
                raise

    def values(self, batch: RolloutBatch, config: CampaignConfig) -> dict[tuple[int, int], float]:
        """Return J of each (test, replicate) of a batch, with the clip and the constants of `config`.

        Raises:
            ChildRolloutError: a rollout would be refused by a campaign.

        """
        spec, problem = self._system.spec, config.problems[self._number]
        observer, plan = Observer(config, spec), replace(plans.plan(config, spec, problem), replicates=1)

        reported = list[tuple[float, ...]]()

        def value(found: Mapping[str, Trajectory]) -> float:
            observed = observer.observe(plan, {(variant, 0): each for variant, each in found.items()})
            reported.append(tuple(plan.reported_of(observed.each)))
            return observed.y

        values = dict(self._each(batch, value))
        self._reported |= zip(values, reported, strict=True)
        return values

    def robustness(self, batch: RolloutBatch, config: CampaignConfig) -> dict[tuple[int, int], float]:
        """Return the least robustness of the variants of each (test, replicate), not clipped; raises as `values`."""
        observer = Observer(config.model_copy(update={"clip": CLIP}), self._system.spec)

        def value(found: Mapping[str, Trajectory]) -> float:
            return min(observer.robustness(each) or 0.0 for each in found.values())

        return dict(self._each(batch, value))

    def _each(
        self, batch: RolloutBatch, value: Callable[[Mapping[str, Trajectory]], float]
    ) -> Iterator[tuple[tuple[int, int], float]]:
        columns = tuple(column.name for column in self._system.spec.columns)
        for folder, requests in batch.parts:
            found: dict[str, Trajectory] = {}
            made = 0
            for request, trajectory, _ in finished(self._system, requests, folder):
                made += 1
                found[request.variant] = trajectory
                try:
                    check_whole(trajectory, columns, self._horizon)
                    self.margins.add(request, trajectory)
                    if len(found) == len(self._variants):
                        yield (request.test, request.replicate), measured(value(found), "the objective")
                        found = {}
                except (TrajectoryError, ValueError) as fault:
                    words = request.words(self._system.spec)
                    raise ChildRolloutError(f"{words}: a campaign would refuse this rollout: {fault}") from None
            if made < len(requests):
                raise ChildRolloutError(f"{requests[made].words(self._system.spec)}: the rollout was not made")


class _EndedError(Exception):
    """Another child has failed, or the calibration was ended."""


@contextmanager
def rollouts(
    system: ChildSystem, config: CampaignConfig, number: int, seed: int, workers: int
) -> Iterator[CalibrationRollouts]:
    """Yield the rollouts of one problem; their files are gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="perfbound-calibrate-") as folder:
        yield CalibrationRollouts(system, config, number, Path(folder), seed=seed, workers=workers)
