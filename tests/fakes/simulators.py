"""Whole campaigns on any function, in one thread: workers that answer at once with a value of the test's own making.

The function has every freedom that a real simulator has: hidden state, failures, results that do not repeat.
"""

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.campaign.software import software
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.issue import issue, manifest
from perfbound.orchestrator.certificate.regions import campaign_regions
from perfbound.orchestrator.certificate.verify.checks import Check
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.run.service import Interrupted, RunStatus, Service
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import SimulationError, Stopped
from perfbound.schemas.file.against_system import check_against
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.link.messages import Assign, ResultHeader
from perfbound.schemas.result.facts import Header
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory, encode
from tests.fakes.puppets import Puppets

Function = Callable[[RolloutRequest], float | tuple[float, ...]]
"""The value of a rollout, or those of all columns; with a `SimulationError` or NaN the attempt fails in the system."""
Stop = Callable[[RolloutRequest], bool]

WORKERS = 2


def spec(*, noisy: bool) -> SystemSpec:
    """Return a system with one variant over the unit square, a rollout of which is one sample of `value`."""
    return SystemSpec(
        name="any-function",
        doc="any function",
        parameters=tuple(Parameter(name=name, unit="1", low=0.0, high=1.0) for name in ("z1", "z2")),
        columns=(Column(name="t", unit="s"), Column(name="value", unit="1")),
        variants=("nominal",),
        noisy=("nominal",) if noisy else (),
        max_horizon=1.0,
    )


def robustness(problem: dict[str, Any], **changes: Any) -> CampaignConfig:
    """Return a campaign that bounds the least `value` over the unit square."""
    box = {"low": 0.0, "high": 1.0, "unit": "1"}
    found = {
        "name": "any-function",
        "seed": 1,
        "composition": "single",
        "specification": "value >= 0",
        "system": {"name": "any-function"},
        "space": {"z1": box, "z2": box},
        "resolution": 9,
        "max_tests": 40,
        "visual": "none",
        "problems": [{"name": "robustness", **problem}],
    }
    return CampaignConfig.model_validate_json(json.dumps(found | changes))


def noise(seed: int) -> float:
    """Return a standard normal number that follows from a seed."""
    return float(np.random.default_rng(seed).standard_normal())


class Crashed(Exception):
    """A function ended its process: a failure of the infrastructure."""


class Simulators(Puppets):
    """Workers with one function; a rollout that it raises in is a failed attempt."""

    def __init__(self, spec: SystemSpec, count: int, function: Function, stop: Stop) -> None:
        super().__init__(spec, count)
        self._function, self._stop, self._columns = function, stop, spec.columns
        self.interrupt: Callable[[], None] = lambda: None

    def answer(self, worker: str, assign: Assign) -> tuple[ResultHeader, bytes]:
        """Return the value of the function as a trajectory, or its failure."""
        request = assign.request
        if self._stop(request):
            self.interrupt()
        units = {column.name: column.unit for column in self._columns}
        try:
            value = self._function(request)
            samples = [[time, *np.atleast_1d(value)] for time in dict.fromkeys((0.0, request.horizon))]
            trajectory = Trajectory(tuple(units), np.array(samples))
        except (SimulationError, ValueError, Crashed) as error:
            failed = ResultHeader(
                rollout=request.rollout,
                attempt=assign.attempt,
                worker=worker,
                outcome="failed",
                kind="infrastructure" if isinstance(error, Crashed) else "system",
                error=str(error),
            )
            return failed, b""
        dumped = request.model_dump(mode="json")
        file = encode(trajectory, request=dumped, metadata=request.metadata, units=units)
        sha256 = hashlib.sha256(file).hexdigest()
        done = ResultHeader(
            rollout=request.rollout, attempt=assign.attempt, worker=worker, outcome="done", sha256=sha256
        )
        return done, file


class _Silent:
    def print_line(self, line: str) -> None:
        """Print nothing."""

    def show(self, status: RunStatus) -> None:
        """Show nothing."""


def simulate(
    directory: Path,
    config: CampaignConfig,
    function: Function,
    *,
    noisy: bool,
    stop: Stop = lambda _: False,
    workers: int = WORKERS,
    system: SystemSpec | None = None,
) -> str | None:
    """Run or resume a campaign; return the text of its certificate, None if it was stopped."""
    system = system or spec(noisy=noisy)
    check_against(config, system, "test")
    resumed = (directory / DATABASE).exists()
    directory.mkdir(parents=True, exist_ok=True)
    journal = (
        Journal.open(directory) if resumed else Journal.create(directory, Header.new(config, system, software(system)))
    )
    try:
        ledger = Ledger(directory, journal)
        ledger.replay()
        ledger.check_files(journal)
        fleet = Simulators(system, workers, function, stop)
        service = Service(ledger, journal, fleet, None, [_Silent()], resumed=False)
        fleet.interrupt = lambda: service.inbox.put(Interrupted(2))
        fleet.start(journal.header.run, service.inbox.put)
        with suppress(Stopped):
            service.run()
        if not ledger.done:
            return None
        found = manifest((sha256, path) for _, sha256, path in read.observed(directory))
        regions = campaign_regions(ledger)
        certificate = issue(ledger, found, irreproducible=read.irreproducible(directory), regions=regions)
        files.write(directory, certificate, found.text, None if regions is None else regions.csv)
    finally:
        journal.close()
    return (directory / files.CERTIFICATE).read_text()


def certificates(
    directory: Path,
    config: CampaignConfig,
    function: Function,
    *,
    noisy: bool,
    cut_after: int,
    system: SystemSpec | None = None,
) -> set[bytes]:
    """Return the certificates of one campaign with one worker, with five, and stopped after a number of rollouts."""
    for name, workers in (("one", 1), ("five", 5)):
        simulate(directory / name, config, function, noisy=noisy, workers=workers, system=system)
    seen = 0

    def stop(_: RolloutRequest) -> bool:
        nonlocal seen
        seen += 1
        return seen == cut_after

    assert simulate(directory / "cut", config, function, noisy=noisy, stop=stop, system=system) is None
    simulate(directory / "cut", config, function, noisy=noisy, system=system)
    return {(directory / name / files.CERTIFICATE).read_bytes() for name in ("one", "five", "cut")}


def predicate(text: str | None) -> dict[str, Any]:
    """Return the predicate of a certificate."""
    assert text is not None
    found: dict[str, Any] = json.loads(text)["predicate"]
    return found


def statuses(text: str | None) -> dict[str, str]:
    """Return the status of every assumption of a certificate."""
    return {each["id"]: each["status"] for each in predicate(text)["assumptions"]}


def checks(directory: Path) -> tuple[Check, ...]:
    """Return the checks of a finished campaign."""
    return verify_certificate(directory, key=None, again=0, report=lambda *_: None).checks.lines()


def verified(directory: Path) -> list[str]:
    """Return the checks of a finished campaign that fail."""
    return [line.name for line in checks(directory) if line.status == "failed"]
