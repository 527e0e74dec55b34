"""The commands `simulate` and `systems`: arguments parsed, a child of `workers` run, its answer as lines of text."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from ...schemas.errors import PerfboundError
from ...schemas.ids import RolloutId
from ...schemas.rollout import RequestTemplate
from ...schemas.system import OptionValue, SystemSpec
from ...schemas.trajectory import decode
from .child import ask, system_options, system_spec, system_specs


def simulate_once(
    system: str, start: str, variant: str, *, seed: int, horizon: float, options: Sequence[str], out: Path
) -> Iterator[str]:
    """Run one rollout, write its file, and yield lines that describe it.

    Raises:
        CampaignError: the system is not installed.
        PerfboundError: an option is not one of the system, or the rollout fails.

    """
    spec = system_spec(system, "SYSTEM")
    if not 0 <= horizon <= spec.max_horizon:  # also refuses NaN
        raise PerfboundError(f"--horizon {horizon:g}: {spec.name} takes 0 to {spec.max_horizon:g} s")
    template = RequestTemplate.of(spec, _options(spec, options), horizon=horizon, visual=True)
    request = template.request(RolloutId("simulate", 0, variant, 0), _numbers(spec, start), seed)
    ask("simulate", "--request", request.model_dump_json(), "--out", str(out), *system_options(system))
    trajectory = decode(out.read_bytes())
    yield f"{'column':<14} {'unit':<8} {'first':>12} {'least':>12} {'greatest':>12} {'last':>12}"
    for column in spec.columns:
        values = trajectory.column(column.name)
        numbers = " ".join(f"{value:12.6g}" for value in (values[0], values.min(), values.max(), values[-1]))
        yield f"{column.name:<14} {column.unit:<8} {numbers}"
    yield f"{len(trajectory.samples)} samples in {out}"


def describe(reference: str | None = None) -> Iterator[str]:
    """Yield a description of one system, or of every installed one."""
    for spec in system_specs().values() if reference is None else [system_spec(reference, "SYSTEM")]:
        yield f"{spec.name}: {spec.doc}"
        for parameter in spec.parameters:
            yield f"  parameter {parameter.name} in [{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
        for option in spec.options:
            allowed = " | ".join(option.choices) or option.allowed_numbers
            yield f"  option    {option.name} = {option.default} (allowed: {allowed}) {option.doc}"
        yield f"  columns   {', '.join(f'{column.name} ({column.unit})' for column in spec.columns)}"


def _numbers(spec: SystemSpec, text: str) -> tuple[float, ...]:
    names = [parameter.name for parameter in spec.parameters]
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != len(names):
        raise PerfboundError(f"--x {text}: {spec.name} takes {len(names)} numbers: {','.join(names)}")
    for parameter, number in zip(spec.parameters, numbers, strict=True):
        if not parameter.low <= number <= parameter.high:  # also refuses NaN
            allowed = f"[{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
            raise PerfboundError(f"--x {text}: {parameter.name} = {number:g} is not in {allowed}")
    return numbers


def _options(spec: SystemSpec, texts: Sequence[str]) -> dict[str, OptionValue]:
    known = {option.name: option for option in spec.options}
    chosen: dict[str, OptionValue] = {}
    for text in texts:
        name, _, value = text.partition("=")
        option = known.get(name)
        if option is None:
            raise PerfboundError(f"--option {text}: {spec.name} has the options {', '.join(known) or 'none'}")
        if option.choices and value not in option.choices:
            raise PerfboundError(f"--option {text}: allowed are {', '.join(option.choices)}")
        try:
            chosen[name] = value if option.choices else _finite_number(value)
        except ValueError:
            raise PerfboundError(f"--option {text}: {value!r} is not a finite number") from None
    return chosen


def _finite_number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(text)
    return number
