"""Single rollouts, batches and visual parts from a child of `workers`; the commands `simulate` and `systems`."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ....schemas.batch import BatchRequest, alone
from ....schemas.errors import PerfboundError, Stopped, meant
from ....schemas.file.against_system import as_in_campaign
from ....schemas.file.config import CampaignConfig
from ....schemas.ids import RolloutId
from ....schemas.number_text import number_in
from ....schemas.requests import RequestTemplate
from ....schemas.rollout import RolloutRequest
from ....schemas.system import OptionValue, SystemSpec, Variant, differences
from ....schemas.trajectory.trajectory import Trajectory, encode
from .child import HangError, ask, installed_systems, named_campaign, system_options, system_spec

LIMIT: float = CampaignConfig.model_fields["deadline"].default
"""Seconds that a rollout may take where no campaign says otherwise."""


@dataclass(frozen=True, slots=True)
class WantedRollout:
    """One rollout without a campaign, as the command line names it."""

    system: str
    """A name, FILE.py:NAME, or a campaign file, whose options and horizon are then taken."""
    start: str
    """One number per parameter: `5,0`."""
    variant: Variant
    seed: int
    horizon: float | None
    """In s; None for the one of the campaign file, or that the system assumes."""
    options: Sequence[str]
    """KEY=VALUE each."""
    limit: float | None = None
    """Seconds that it may take; None for the `deadline` of the campaign file, or of a campaign without that key."""
    disturbances: Sequence[str] = ()
    """NAME=VALUE each, in place of the values that are drawn from the seed."""

    def request(self) -> tuple[SystemSpec, RolloutRequest, float]:
        """Return the system, the request to it, and the seconds that it may take.

        Raises:
            CampaignError: the system is not installed.
            PerfboundError: start, horizon or an option is not one of the system.

        """
        config = named_campaign(self.system)
        spec = as_in_campaign(system_spec(self.system, "SYSTEM"), config).as_simulated
        horizon = chosen_horizon(spec, config.horizon if config and self.horizon is None else self.horizon)
        if self.seed >= 2**spec.seed_bits:
            limit = 2**spec.seed_bits - 1
            raise PerfboundError(f"--seed {self.seed}: {spec.name} takes 0 to {limit}; choose a smaller one")
        options = ({} if config is None else config.system.options) | chosen_options(spec, self.options)
        template = RequestTemplate.of(spec, options, horizon=horizon, visual=True)
        start = _numbers(spec, self.start)
        deadline = LIMIT if config is None else config.deadline
        limit = deadline if self.limit is None else self.limit
        request = template.request(RolloutId("simulate", 0, self.variant, 0), start, self.seed)
        drawn = _with_given(spec, request.disturbances, self.disturbances)
        return spec, request.model_copy(update={"disturbances": drawn}), limit


def chosen_horizon(spec: SystemSpec, horizon: float | None) -> float:
    """Return the horizon in s that `--horizon` names, or the one that the system assumes.

    Raises:
        PerfboundError: the system does not take it.

    """
    if horizon is None:
        return spec.assumed_horizon
    if not 0 <= horizon <= spec.max_horizon:  # also refuses NaN
        raise PerfboundError(f"--horizon {horizon:g}: {spec.name} takes 0 to {spec.max_horizon:g} s")
    return horizon


def simulate_to(
    path: Path,
    request: RolloutRequest | BatchRequest,
    spec: SystemSpec,
    system: str | None,
    *,
    limit: float = LIMIT,
    on_line: Callable[[str], None] | None = None,
) -> None:
    """Run one rollout in a child for at most `limit` seconds, and write its file.

    `system` is its reference, None for an installed one; `on_line` gets what the system prints.

    Raises:
        PerfboundError: the rollout fails, or does not end.
        Stopped: with what was ended.

    """
    words, started = f"the {_name_of(request)} of {spec.name} at {alone(request).words(spec)}", time.monotonic()
    given, text = path.with_name(f"{path.name}.request"), request.model_dump_json()
    if isinstance(request, BatchRequest):  # longer than an argument may be
        given.write_text(text)
        text = f"@{given}"
    arguments = ("--request", text, "--out", str(path), *system_options(system))
    try:
        ask("simulate", *arguments, limit=limit, on_line=on_line)
    except HangError as fault:
        raise PerfboundError(
            f"{words} gave no result within {limit:g} s, and was ended{fault.place}; fix what does not end there, or "
            "give it more time: perfbound simulate --timeout SECONDS, `deadline` in a campaign file"
        ) from None
    except PerfboundError as fault:
        raise _other_build(request, spec, system) or fault from None
    except Stopped as stop:
        seconds = time.monotonic() - started
        raise Stopped(stop.signal, f"{words} was ended after {seconds:.1f} s, nothing was written") from None
    finally:
        given.unlink(missing_ok=True)


def draw_to(
    path: Path,
    trajectory: Trajectory,
    request: RolloutRequest,
    spec: SystemSpec,
    system: str | None,
    *,
    limit: float = LIMIT,
) -> None:
    """Write the file of a trajectory that `request` gave, with the visual part that its system draws in a child.

    Raises:
        PerfboundError: it cannot be drawn.

    """
    units = {column.name: column.unit for column in spec.columns}
    given = path.with_name(f"{path.name}.given")
    given.write_bytes(
        encode(trajectory, request=request.model_dump(mode="json"), metadata=request.metadata, units=units)
    )
    try:
        ask("visual", "--file", str(given), "--out", str(path), *system_options(system), limit=limit)
    except PerfboundError as fault:
        raise _other_build(request, spec, system) or fault from None


def _name_of(request: RolloutRequest | BatchRequest) -> str:
    return f"batch of {len(request)} rollouts" if isinstance(request, BatchRequest) else "rollout"


def _other_build(request: RolloutRequest | BatchRequest, spec: SystemSpec, system: str | None) -> PerfboundError | None:
    """Return what differs between the system that is here and the one that was asked for; None if that is not it."""
    # The worker knows the identity of the system that is asked for, and not what it consists of.
    try:
        here = system_spec(system or spec.name, "SYSTEM")
    except PerfboundError:
        return None
    if request.spec_sha256 == here.digest or not (differing := differences(spec, here)):
        return None
    return PerfboundError(
        f"{spec.name} is another build than that of the campaign: {'; '.join(differing)}; use that one"
    )


def column_lines(spec: SystemSpec, trajectory: Trajectory) -> Iterator[str]:
    """Yield a table with the first, least, greatest and last value of every column."""
    yield f"{'column':<14} {'unit':<8} {'first':>12} {'least':>12} {'greatest':>12} {'last':>12}"
    for column in spec.columns:
        values = trajectory.column(column.name)
        numbers = " ".join(f"{value:12.6g}" for value in (values[0], values.min(), values.max(), values[-1]))
        yield f"{column.name:<14} {column.unit:<8} {numbers}"


def describe(reference: str | None = None) -> Iterator[str]:
    """Yield a description of one system, or of every installed one."""
    for spec in installed_systems().values() if reference is None else [system_spec(reference, "SYSTEM")]:
        if isinstance(spec, str):
            yield spec
            continue
        yield f"{spec.name}: {spec.doc}"
        for parameter in spec.parameters:
            over_time = ", an input over time" if parameter.signal else ""
            yield f"  parameter {parameter.name} in {parameter.range_words}{over_time}"
        for each in spec.disturbances:
            yield f"  random    {each.name}: {each.words}"
        for option in spec.options:
            allowed = " | ".join(option.choices) or option.allowed_numbers
            yield f"  option    {option.name} = {option.default} (allowed: {allowed}) {option.doc}"
        yield f"  columns   {', '.join(f'{column.name} ({column.unit})' for column in spec.columns)}"


def _numbers(spec: SystemSpec, text: str) -> tuple[float, ...]:
    names = [parameter.name for parameter in spec.parameters]
    try:
        numbers = tuple(number_in(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != len(names):
        raise PerfboundError(f"--x {text}: {spec.name} takes {len(names)} numbers: {','.join(names)}")
    for parameter, number in zip(spec.parameters, numbers, strict=True):
        if not parameter.low <= number <= parameter.high:  # also refuses NaN
            raise PerfboundError(f"--x {text}: {parameter.name} = {number:g} is not in {parameter.range_words}")
    return numbers


def chosen_options(spec: SystemSpec, texts: Sequence[str]) -> dict[str, OptionValue]:
    """Return the options that `--option KEY=VALUE` sets.

    Raises:
        PerfboundError: one is none of the system, or not allowed.

    """
    known = {option.name: option for option in spec.options}
    chosen: dict[str, OptionValue] = {}
    for text in texts:
        name, _, value = text.partition("=")
        option = known.get(name)
        if option is None:
            there = f"{meant(name, known)}{spec.name} has the options {', '.join(known) or 'none'}"
            raise PerfboundError(f"--option {text}: {there}")
        if option.choices and value not in option.choices:
            raise PerfboundError(f"--option {text}: allowed are {', '.join(option.choices)}")
        try:
            chosen[name] = value if option.choices else _finite_number(value)
        except ValueError:
            raise PerfboundError(f"--option {text}: {value!r} is not a finite number") from None
    return chosen


def _with_given(spec: SystemSpec, drawn: Sequence[float], texts: Sequence[str]) -> tuple[float, ...]:
    """Return the disturbances, those that `--disturbance NAME=VALUE` names with its values."""
    values = dict(zip((each.name for each in spec.disturbances), drawn, strict=True))
    for text in texts:
        name, _, value = text.partition("=")
        if name not in values:
            there = f"{meant(name, values)}{spec.name} has the disturbances {', '.join(values) or 'none'}"
            raise PerfboundError(f"--disturbance {text}: {there}")
        try:
            values[name] = _finite_number(value)
        except ValueError:
            raise PerfboundError(f"--disturbance {text}: {value!r} is not a finite number") from None
    return tuple(values.values())


def _finite_number(text: str) -> float:
    number = number_in(text)
    if not math.isfinite(number):
        raise ValueError(text)
    return number
