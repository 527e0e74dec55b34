"""One rollout without a campaign, and the list of systems; both asked from a child of `workers`."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from orchestrator.errors import PerfboundError
from orchestrator.session import CHILD_TIMEOUT, system_spec, system_specs
from schemas.rollout import RolloutRequest
from schemas.system import OptionValue, SystemSpec
from schemas.trajectory import decode


def simulate(
    system: str, start: str, variant: str, seed: int, horizon: float, options: Sequence[str], out: Path
) -> Iterator[str]:
    """Run one rollout, write its file, and yield lines that describe it.

    Raises:
        CampaignError, PerfboundError: what is wrong, in one line.

    """
    spec = system_spec(system, "SYSTEM")
    request = RolloutRequest(
        campaign="simulate",
        config_sha256="0" * 64,
        problem="simulate",
        test=0,
        variant="nominal" if variant == "nominal" else "true",
        replicate=0,
        seed=seed,
        system=system,
        spec_sha256=spec.digest,
        options={option.name: option.default for option in spec.options} | _options(spec, options),
        x=_numbers(spec, start),
        horizon=horizon,
        visual=True,
    )
    command = [sys.executable, "-m", "workers", "simulate", "--request", request.model_dump_json(), "--out", str(out)]
    child = subprocess.run(command, stderr=subprocess.PIPE, text=True, timeout=CHILD_TIMEOUT, check=False)
    if child.returncode:
        reason = child.stderr.strip().splitlines()[-1:] or [f"the simulator ended with code {child.returncode}"]
        raise PerfboundError(reason[0].removeprefix("perfbound-worker: "))
    trajectory = decode(out.read_bytes())
    yield f"{'column':<14} {'unit':<8} {'first':>12} {'least':>12} {'greatest':>12} {'last':>12}"
    for column in spec.columns:
        values = trajectory.column(column.name)
        numbers = " ".join(f"{value:12.6g}" for value in (values[0], values.min(), values.max(), values[-1]))
        yield f"{column.name:<14} {column.unit:<8} {numbers}"
    yield f"{len(trajectory.samples)} samples in {out}"


def describe() -> Iterator[str]:
    """Yield a description of every installed system."""
    for name, spec in system_specs().items():
        yield f"{name}: {spec.doc}"
        for parameter in spec.parameters:
            yield f"  parameter {parameter.name} in [{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
        for option in spec.options:
            allowed = " | ".join(option.choices) or f"[{option.low}, {option.high}] {option.unit}"
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
            raise PerfboundError(
                f"--x {text}: {parameter.name} = {number:g} is not in [{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
            )
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
            chosen[name] = value if option.choices else float(value)
        except ValueError:
            raise PerfboundError(f"--option {text}: {value!r} is not a number") from None
    return chosen
