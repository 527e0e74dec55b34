"""`perfbound check-system`: rollouts in child processes, and the findings about the system, as a table and as JSON."""

import json
import math
import os
import shlex
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ....schemas.errors import CampaignError, PerfboundError, Stopped, TrajectoryError
from ....schemas.file.against_system import as_in_campaign, check_against, searched
from ....schemas.rollout import RolloutRequest
from ....schemas.system import SystemSpec, Variant
from ....schemas.system_check import ChildRun, Trial
from ....schemas.trajectory.trajectory import decode
from ...campaign.plan import plans
from ...campaign.starts import check_where
from ...certificate.verify.stages import Report
from ...fleet.children.child import named_campaign, system_options
from ...fleet.children.rollouts import simulated_spec
from ...fleet.children.simulate import chosen_horizon, chosen_options
from ..seen_margins import SeenMargins
from ..size import undecided_rollouts
from .findings import SystemFinding
from .judge import judge
from .measure import measure_in_children
from .measurements import Measurements
from .trials import Trials, own_horizon

LIMIT = 60.0
"""Seconds that a rollout may take where neither `--timeout` nor a campaign file says otherwise."""
COLOURS = {"passed": "green", "warning": "yellow", "failed": "bold red", "skipped": "dim"}


@dataclass(frozen=True)
class SystemCheck:
    """The findings about one system."""

    spec: SystemSpec
    horizon: float
    findings: tuple[SystemFinding, ...]
    violations: str = ""
    """How many rollouts violate the specification of a campaign file, and the worst one; empty without one."""

    @property
    def good(self) -> bool:
        """Whether no check failed."""
        return not self.count("failed")

    def count(self, status: str) -> int:
        """Return the number of checks with this status."""
        return sum(finding.status == status for finding in self.findings)


def checked_system(
    reference: str,
    *,
    variant: Variant | None,
    horizon: float | None,
    options: Sequence[str],
    seed: int,
    limit: float | None,
    report: Report,
) -> SystemCheck:
    """Run the rollouts of a check, `limit` seconds each at most, and judge them.

    A campaign file gives its options, its horizon, its space, and without `limit` its deadline, too.

    Raises:
        CampaignError: the system is not installed, its file cannot be used, or the campaign file does not fit it.
        PerfboundError: an option is not one of the system.
        Stopped: with what was ended.

    """
    config = named_campaign(reference)
    spec = as_in_campaign(simulated_spec(reference, "SYSTEM"), config)
    if config is not None:
        check_against(config, spec, reference)
    bounded, spec = spec.as_parameters, spec.as_simulated  # the system is checked with the laws that it declares
    if config is not None and isinstance(config.space, dict) and config.where is not None:
        check_where(config.space, config.where, reference)
    if variant is not None and variant not in spec.variants:
        raise PerfboundError(f"--variant {variant}: {spec.name} has {', '.join(spec.variants)}")
    if limit is None:  # the default deadline of a campaign is one for all systems
        limit = config.deadline if config is not None and "deadline" in config.model_fields_set else LIMIT
    given = horizon if horizon is not None or config is None else config.horizon
    trials = Trials.of(
        spec,
        ({} if config is None else config.system.options) | chosen_options(spec, options),
        variants=spec.variants if variant is None else (variant,),
        horizon=chosen_horizon(spec, given),
        seed=seed,
        space=None if config is None else config.space,
    )
    # A condition on bounded disturbances is none on the starts of a system.
    if config is not None and config.where is not None and (not bounded or searched(config)):
        trials = replace(trials, where=config.where)
    program = config is not None and config.system.program is not None
    folder = ("--folder", str(Path(reference).absolute().parent)) if program else ()
    # A file that describes a system alone has no specification yet.
    try:
        margins = SeenMargins(config, spec) if config is not None and config.formula != "" else None
    except ValueError as error:  # a formula that is none, or about other columns
        raise CampaignError(f"{reference}: specification: {error}") from None
    rolled_at_once = partial(
        _in_children, arguments=(*system_options(reference), *folder), limit=limit, report=report, margins=margins
    )

    def rolled(stage: str, trials: Sequence[Trial]) -> ChildRun:
        return rolled_at_once(stage, [trials])[0]

    fresh, ended = rolled("start", trials.fresh()), []
    if fresh.ended and fresh.loaded is not None:  # a start that no process survives must not hide the others
        ended, trials = [fresh], replace(trials, start=trials.start + 1)
        fresh = rolled("another start", trials.fresh())
    own = own_horizon(spec, fresh) if given is None else None
    if own is not None:
        trials = trials.of_own_horizon(own)
        fresh = rolled("start", trials.fresh())
    runs = [fresh]
    if not fresh.ended and all(found.error for found in fresh.measured):
        runs.append(rolled("rollouts", trials.few()))
    together: tuple[ChildRun, ...] = ()
    batched: ChildRun | None = None
    usable = any(not found.error for run in runs for found in run.measured)
    if usable and not runs[-1].ended:
        seconds = min((found.seconds for found in fresh.measured), default=0.0)
        runs.append(rolled("rollouts", trials.first(seconds)))
        # If the first one has ended early, this one comes to the rollouts behind the one that ended it.
        runs.append(rolled("opposite order", trials.second()))
        if not any(run.ended for run in runs):
            together = rolled_at_once("two at a time", trials.together(seconds))
        if spec.vectorised:
            # Not the first one of a process, which may compile.
            later = min(found.seconds for run in runs for found in run.measured if not found.error)
            batched = rolled("batches", trials.batches(later))
    measurements = Measurements(
        spec,
        (*runs, *ended),
        together=together,
        batched=batched,
        undecided=undecided_rollouts(plans(config, spec).values()) if margins and config else math.inf,
        limit=limit,
        processors=len(os.sched_getaffinity(0)),
        own_horizon=own is not None,
        program=shlex.join((config and config.system.program) or ()),
    )
    return SystemCheck(spec, trials.horizon, judge(measurements), margins.words if margins else "")


def _in_children(
    stage: str,
    works: Sequence[Sequence[Trial]],
    *,
    arguments: Sequence[str],
    limit: float,
    report: Report,
    margins: SeenMargins | None,
) -> tuple[ChildRun, ...]:
    done = [0 for _ in works]
    total = sum(map(len, works))
    longest = max(trial.request.horizon for trials in works for trial in trials)

    def advance(number: int) -> None:
        request = works[number][done[number]].request
        # Those of a shorter horizon are none of a campaign, and those of two at a time may have disturbed each other.
        if margins is not None and request.horizon == longest and len(works) == 1:
            _score(request, Path(keep, str(done[number])), margins)
        done[number] += 1
        report(stage, sum(done), total)

    report(stage, 0, total)
    try:
        with tempfile.TemporaryDirectory(prefix="perfbound-check-") as keep:
            kept = () if margins is None or len(works) > 1 else ("--keep", keep)
            return measure_in_children(works, (*arguments, *kept), limit=limit, done=advance)
    except Stopped as stop:
        state = f"the check was ended after {sum(done)} of {total} rollouts ({stage}), nothing was written"
        raise Stopped(stop.signal, state) from None


def _score(request: RolloutRequest, file: Path, margins: SeenMargins) -> None:
    """Add a rollout to those that the specification is evaluated on, and remove its file."""
    # A rollout without a file has failed; one that the formula does not fit is a finding of another check.
    with suppress(FileNotFoundError, TrajectoryError, ValueError):
        data = file.read_bytes()
        file.unlink()
        margins.add(request, decode(data))


def print_findings(found: SystemCheck, console: Console) -> None:
    """Print one row for each check: what was found, and what to do about it."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("check", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("finding and remedy", overflow="fold")
    for finding in found.findings:
        bad = finding.status in {"warning", "failed"}
        text = Text(finding.detail, "" if bad else "dim")
        if finding.remedy:
            text.append(f"\n{finding.remedy[0].upper()}{finding.remedy[1:]}.", "default")
        table.add_row(finding.check, Text(finding.status, COLOURS[finding.status]), text)
    console.print(table)
    if found.violations:
        console.print(Text(f"\n{found.violations}"), soft_wrap=True)
    counts = ", ".join(f"{found.count(status)} {status}" for status in COLOURS if found.count(status))
    verdict = "no check failed" if found.good else "fix what failed before you run a campaign"
    line = f"\n{found.spec.name}, rollouts of {found.horizon:g} s: {counts}; {verdict}"
    console.print(Text(line, "bold" if found.good else "bold red"))


def findings_json(found: SystemCheck) -> str:
    """Return the findings as JSON."""
    checks = [
        {
            "check": finding.check,
            "status": finding.status,
            "detail": finding.detail,
            "remedy": finding.remedy,
            "meaning": finding.meaning,
        }
        for finding in found.findings
    ]
    head = {"passed": found.good, "system": found.spec.name, "horizon": found.horizon}
    return json.dumps({**head, "checks": checks}, indent=1)
