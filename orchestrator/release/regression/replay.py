"""Scenarios simulated by the present system: fixed, still failing, or changed."""

import math
import shlex
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

from ....schemas.errors import PerfboundError, UnusableTrajectoryError
from ....schemas.file.against_system import as_in_campaign
from ....schemas.file.config import CampaignConfig
from ....schemas.file.reader import load_campaign
from ....schemas.ids import RolloutId
from ....schemas.requests import RequestTemplate
from ....schemas.rollout import RolloutRequest
from ....schemas.system import SystemSpec
from ....schemas.trajectory.trajectory import Trajectory, decode
from ...campaign.admission import check_whole
from ...certificate.words.refutation_text import margin_words
from ...fleet.children.simulate import simulate_to
from ...run.session import system_of
from ...store.export_tables import robustness_unit
from .minimise import NAME
from .outcome import Judge, Outcome, Specification, at, same_moment
from .scenarios import Scenario, read_scenarios, scenario_columns

State = Literal["fixed", "still failing", "changed"]


@dataclass(frozen=True, slots=True)
class Replay:
    """What became of a scenario."""

    scenario: str
    state: State
    """`changed`: it fails otherwise than in the campaign, or the system no longer takes it."""
    reason: str
    robustness: float | None = None
    """Now; None where nothing was simulated."""
    command: str = ""
    """Which draws it."""

    @property
    def fixed(self) -> bool:
        """Whether the specification is met."""
        return self.state == "fixed"

    def __str__(self) -> str:
        """Return it in words."""
        found = f"{self.scenario}: {self.state}: {self.reason}"
        return f"{found}\ndraw it: {self.command}" if self.command and not self.fixed else found


class _ChangedError(Exception):
    """The present system does not take a scenario."""


class Scenarios:
    """The scenarios of a table of `perfbound export --regression`, and the system of a campaign file that replays them.

    `specification` is a formula, or that of each requirement by its name, and `horizon` is in s. The options of the
    system are those of the campaign file now.

    Raises:
        PerfboundError: the table or the campaign file cannot be read, or the system is missing.

    """

    def __init__(
        self, table: str | Path, *, campaign: str | Path, specification: Specification, horizon: float
    ) -> None:
        self._campaign, self._specification, self._horizon = Path(campaign), specification, horizon
        self._scenarios = read_scenarios(Path(table))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the scenarios, in their order."""
        return tuple(self._scenarios)

    def replay(self, name: str) -> Replay:
        """Simulate a scenario in a child process.

        Raises:
            KeyError: there is no such scenario.
            PerfboundError: the campaign file or its system cannot be loaded.

        """
        scenario = self._scenarios[name]
        try:
            judge, request = self._judge, self._request(scenario)
            found = judge.outcome(self._simulated(request))
        except (_ChangedError, ValueError) as reason:
            return Replay(name, "changed", str(reason))
        state, words = compared(scenario.outcome, found, self._horizon, robustness_unit(self._config, self._spec))
        return Replay(name, state, words, found.robustness, self._command(request, f"{name}.png"))

    @cached_property
    def _config(self) -> CampaignConfig:
        return load_campaign(self._campaign)

    @cached_property
    def _spec(self) -> SystemSpec:
        # Once for all scenarios: it takes a child process.
        spec = system_of(self._config, self._campaign, self._config.system.reference(self._campaign))
        return as_in_campaign(spec, self._config).as_simulated

    @cached_property
    def _judge(self) -> Judge:
        return Judge(self._specification, self._spec, self._config.beyond)

    def _command(self, request: RolloutRequest, picture: str) -> str:
        drawn = zip(self._spec.disturbances, request.disturbances, strict=bool(request.disturbances))
        options = [f"--x={','.join(map(repr, request.x))}", f"--variant={request.variant}", f"--seed={request.seed}"]
        options += [f"--horizon={self._horizon!r}"]
        options += [f"--disturbance={law.name}={value!r}" for law, value in drawn]
        return shlex.join(["perfbound", "simulate", str(self._campaign), *options, f"--plot={picture}"])

    def _request(self, scenario: Scenario) -> RolloutRequest:
        """Return the request for a scenario."""
        columns = scenario_columns(self._spec)
        starts, drawn = ([each.name for each in some] for some in columns)
        options = self._config.system.options
        template = RequestTemplate.of(self._spec, options, horizon=self._horizon, visual=False)
        values = template.disturbances(scenario.variant, [()], [scenario.seed])
        given = [*starts, *(drawn if values else ())]
        if set(given) != scenario.numbers.keys():
            more, less = set(given) - scenario.numbers.keys(), scenario.numbers.keys() - set(given)
            differing = [f"takes {name}" for name in sorted(more)] + [f"has no {name}" for name in sorted(less)]
            raise _ChangedError(f"{self._spec.name} {' and '.join(differing)}, unlike this scenario")
        for column in (each for some in columns for each in some if each.name in given):
            if column.unit != (unit := scenario.units[column.name]):
                raise _ChangedError(f"{column.name} is in {column.unit or '1'} now, and was in {unit or '1'}")
        for law, name in zip(self._spec.disturbances, drawn, strict=True):
            ends = (-math.inf if law.low is None else law.low, math.inf if law.high is None else law.high)
            if name in given and not ends[0] <= scenario.numbers[name] <= ends[1]:
                raise _ChangedError(f"{name} = {scenario.numbers[name]:g} is outside of its law: {law.words}")
        for parameter, name in zip(self._spec.own_parameters, starts, strict=True):
            if not parameter.low <= scenario.numbers[name] <= parameter.high:
                raise _ChangedError(f"{name} = {scenario.numbers[name]:g} is not in {parameter.range_words}")
        rollout = RolloutId(NAME, 0, scenario.variant, 0)
        request = template.request(rollout, [scenario.numbers[name] for name in starts], scenario.seed)
        return request.model_copy(
            update={"disturbances": tuple(scenario.numbers[name] for name in drawn)} if values else {}
        )

    def _simulated(self, request: RolloutRequest) -> Trajectory:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "rollout.mcap"
            try:
                simulate_to(path, request, self._spec, str(self._campaign), limit=self._config.deadline)
                trajectory = decode(path.read_bytes())
                check_whole(trajectory, tuple(column.name for column in self._spec.columns), request.horizon)
            except (PerfboundError, UnusableTrajectoryError) as error:
                raise _ChangedError(str(error)) from None
        return trajectory


def compared(before: Outcome, now: Outcome, horizon: float, unit: str) -> tuple[State, str]:
    """Return what a failing rollout of a campaign is now, in words too."""
    margin = f"robustness {margin_words(now.robustness, unit)}"
    was = f"it was {margin_words(before.robustness, unit)}"
    if not now.fails:
        return "fixed", f"{margin}; {was}"
    margin += at(now.moment)
    was += at(before.moment)
    if now.violated != before.violated:
        return (
            "changed",
            f"violates {' and '.join(now.violated)}, with {margin}; before {' and '.join(before.violated)}",
        )
    if not same_moment(before, now, horizon):
        return "changed", f"fails at another moment: {margin}; {was}"
    return "still failing", f"violates {' and '.join(now.violated)} with {margin}; {was}"
