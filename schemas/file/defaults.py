"""The keys that a campaign file may leave out because the rest of it decides them, and the schema of such a file.

The campaign itself, in the database and in certificates, has all of them.
"""

import json
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from pydantic import TypeAdapter, ValidationError

from ..system import ASSUMED_HORIZON, SCORED
from .composition import is_composed
from .config import CampaignConfig
from .objectives import MethodName, ProblemName
from .parameters import Box, Range, parameter_ranges
from .problem_models import PROBLEM_MODELS, KrigingProblem, RigorousProblem
from .requirements import listed
from .signals import MAX_KNOTS, PARTS, extremes
from .space import KINDS

ONLY_PROBLEM: ProblemName = "robustness"
"""The problem of a file without `problems`; its keys are then keys of the file."""
OF_CAMPAIGN = frozenset(CampaignConfig.model_fields)
OF_PROBLEM = frozenset({name for model in PROBLEM_MODELS.values() for name in model.model_fields} - OF_CAMPAIGN)
"""Keys of problems alone; those that a campaign has too mean the same in both places."""

STAND_INS: dict[str, Any] = {
    "horizon": ASSUMED_HORIZON,
    "specification": "",
    "clip": [-1.0, 1.0],
    "alpha": 1.0,
    "rkhs_norm": 1.0,
    "noise_scale": "derived",
    "kernel": {"length_scale": 1.0},
}
"""Of keys that no description of a system needs."""

# Length scales alone: B, R and alpha are assumptions or wishes of a person, and no box says anything of them.
DERIVED: Mapping[Any, type] = {"rigorous": RigorousProblem, "kriging": KrigingProblem}
"""Methods whose length scales follow from the box where the file gives none."""
OF_RIG = 30 * 86_400.0
"""Seconds in which a test of a rig is made, where the file does not say."""
NUMBERS = {key for parts in PARTS.values() for key in parts}
OVER_TIME = {"signal", "profile", *NUMBERS}
"""Keys that make a range an input over time."""
WITHIN = re.compile(r"within ([0-9]+(?:\.[0-9]+)?) sd")
"""Short form of the range of a bounded disturbance."""
ENDS: dict[str, Any] = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
"""JSON Schema of the short form of a range, [low, high]."""


def with_stand_ins(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a file that describes a system, and may have no campaign yet, as that of a campaign.

    It can be simulated and checked; `perfbound init` makes a campaign of it.
    """
    # A worker reads a draft as well for the files of a function, and `perfbound calibrate` proposes its constants.
    system = table.get("system")
    lists_files = leaves_out_problems(table) and isinstance(system, Mapping) and "files" in system
    if not (lists_files or is_description(table)):
        return dict(table)
    method = table.get("method", _method(table, table))
    needed = OF_CAMPAIGN | PROBLEM_MODELS.get(method, RigorousProblem).model_fields.keys()
    return {key: each for key, each in STAND_INS.items() if key in needed} | dict(table)


def is_description(table: Mapping[str, Any]) -> bool:
    """Whether a file describes a system and lists no problems; those of a campaign may be at its top."""
    system = table.get("system")
    described = isinstance(system, Mapping) and any(kind.described and key in system for key, kind in KINDS.items())
    return leaves_out_problems(table) and described


def completed(table: Mapping[str, Any], stem: str = "") -> dict[str, Any]:
    """Return the table of a file with its name, its ranges, its only problem, its methods and its kernels.

    `stem` is the name of the file.

    >>> completed({"alpha": 1.0, "space": {}}, "My Cars")
    {'name': 'my-cars', 'space': {}, 'problems': [{'name': 'robustness', 'method': 'rigorous', 'alpha': 1.0}]}
    """
    name = re.sub("[^a-z0-9_]+", "-", stem.lower()).strip("-_")[:64]
    # Before validation, so that database and certificate have every key, and no reader asks whether one is there.
    found = {"name": name, **table} if name else dict(table)
    if is_rig(table):
        found = {"recheck": 0, "deadline": OF_RIG, **found}  # nobody repeats its rollouts, and a person drives them
        if isinstance(falsify := found.get("falsify"), Mapping):
            found["falsify"] = {"simplest_tests": 0, **falsify}
    if isinstance(tests := found.get("recorded"), list | tuple):
        found.setdefault("max_tests", len(tests))
    if isinstance(space := found.get("space"), Mapping):
        if isinstance(space.get("where"), str) and "where" not in table:
            # A parameter may be called `where`: its value is a range.
            found["where"] = space["where"]
            space = {key: each for key, each in space.items() if key != "where"}
        ranges = {key: _with_ends(each) for key, each in space.items()}
        # A parameter may be called `table`: its value is a range, [0, 5].
        found["space"] = space if "scenarios" in space or isinstance(ranges.get("table"), list) else ranges
    if "specifications" in found:
        found["specifications"] = listed(found["specifications"])
    if leaves_out_problems(table):
        found["problems"] = [{"name": ONLY_PROBLEM, **{key: found.pop(key) for key in table if key in OF_PROBLEM}}]
    if isinstance(problems := found.get("problems"), list):
        signals = _signals(found.get("space"))
        methods = [_with_method(each, found) for each in problems]
        found["problems"] = [
            _with_lengths(_with_kernel(each, found.get("space"), signals), signals) for each in methods
        ]
    return found


def _signals(space: Any) -> dict[str, Box]:
    """Return the parameters of each input signal; none of one whose own keys are wrong, a fault of its own."""
    found: dict[str, Box] = {}
    for name, each in space.items() if isinstance(space, Mapping) else ():
        if isinstance(each, Mapping) and "signal" in each:
            with suppress(ValidationError):
                found[name] = parameter_ranges({name: Range.model_validate_json(json.dumps(each, default=str))})
    return found


def _with_lengths(problem: Any, signals: Mapping[str, Box]) -> Any:
    """Return a problem with the length scale of an input signal given to each of its knots."""
    kernel = problem.get("kernel") if isinstance(problem, Mapping) else None
    lengths = kernel.get("length_scale") if isinstance(kernel, Mapping) else None
    # The numbers of a sine or of a step have different units.
    knots = {name: box for name, box in signals.items() if f"{name}_0" in box}
    if not isinstance(kernel, Mapping) or not isinstance(lengths, Mapping) or not knots.keys() & lengths.keys():
        return problem
    each = {parameter: value for name, value in lengths.items() for parameter in knots.get(name, (name,))}
    return {**problem, "kernel": {**kernel, "length_scale": each}}


def derived_lengths(ranges: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Return the length scale of each parameter, in its unit, from its range: half of it, to two digits.

    Of more than three parameters it is the whole range, since no number of tests fills such a box.

    >>> derived_lengths({"gap": (5.0, 60.0), "speed": (5.0, 35.0)})
    {'gap': 28.0, 'speed': 15.0}
    """
    share = 0.5 if len(ranges) <= 3 else 1.0
    return {name: float(f"{share * (high - low):.2g}") for name, (low, high) in ranges.items()}


def _with_kernel(problem: Any, space: Any, signals: Mapping[str, Box]) -> Any:
    """Return a problem of a method with derived length scales with them, where it gives none and the space is a box."""
    if not isinstance(problem, Mapping) or problem.get("method") not in DERIVED or not isinstance(space, Mapping):
        return problem
    kernel, ends = problem.get("kernel", {}), {name: _ends(each) for name, each in space.items()}
    if not isinstance(kernel, Mapping) or "length_scale" in kernel or not ends or None in ends.values():
        return problem
    ranges = {name: pair for name, pair in ends.items() if pair is not None and name not in signals}
    knots = {each: (box.low, box.high) for name in ends for each, box in signals.get(name, {}).items()}
    ranges = {name: (ranges | knots)[name] for each in ends for name in signals.get(each, (each,))}
    return {**problem, "kernel": {"length_scale": derived_lengths(ranges), **kernel}}


def _ends(value: Any) -> tuple[float, float] | None:
    """Return the ends of a range; None for one that is at fault, which is reported by itself."""
    low, high = (value.get("low"), value.get("high")) if isinstance(value, Mapping) else (None, None)
    valid = isinstance(low, int | float) and isinstance(high, int | float) and 0 < high - low < math.inf
    return (float(low), float(high)) if valid else None  # type: ignore[arg-type]


def _with_ends(value: Any) -> Any:
    """Return the table of a range in a short form, [low, high] or "within 3 sd", or of choices; others as they are."""
    if isinstance(value, str) and (found := WITHIN.fullmatch(value)):
        reach = float(found[1])
        return {"low": -reach, "high": reach, "unit": SCORED}
    if isinstance(value, list) and len(value) == 2 and not any(isinstance(each, list) for each in value):
        return {"low": value[0], "high": value[1]}
    if isinstance(value, Mapping) and "choices" in value:
        given = value["choices"]
        listed_values = given if isinstance(given, list) else []
        numbers = [each for each in listed_values if isinstance(each, int | float) and not isinstance(each, bool)]
        # Of choices that are none any ends: their own fault is the one to report.
        value = {"low": min(numbers, default=0), "high": max(numbers, default=1), **value}
    return _over_time(value) if isinstance(value, Mapping) and value.keys() & OVER_TIME else value


def _over_time(value: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of an input over time with what follows: its kind, the number of its knots, and its ends."""
    found = {"signal": "linear", **value} if "profile" in value else dict(value)
    signal, times = found.get("signal"), found.get("times")
    kind, parts = next(((kind, each) for kind, each in PARTS.items() if kind == signal), ("pchip", {}))
    if isinstance(times, list) and 0 < len(times) <= MAX_KNOTS:
        found = {"knots": len(times), **found}
    found |= {key: _with_ends(found[key]) for each in PARTS.values() for key in each if key in found}
    if not (parts or "profile" in found):
        return {"low": 0.0, "high": 1.0, **found} if NUMBERS & found.keys() else found
    # Of numbers that are none any ends: their own fault is the one to report.
    low, high = 0.0, 1.0
    with suppress(KeyError, TypeError, ValueError):
        if parts:
            low, high = extremes(kind, {key: _two(found.get(key, parts[key].default)) for key in parts})
        else:
            values = [float(value) for _, value in found["profile"]]
            low, high = min(values), max(values)
    return {"low": low, "high": high, **found}


def _two(value: Any) -> tuple[float, float]:
    """Return the ends of a number of a signal; raises TypeError, ValueError or KeyError."""
    return (float(value["low"]), float(value["high"])) if isinstance(value, Mapping) else (float(value), float(value))


def _method(problem: Mapping[str, Any], table: Mapping[str, Any]) -> MethodName:
    """Return the method of a problem that names none: by the space, by claims about drawn starts, or by a search."""
    space = table.get("space")
    if isinstance(space, Mapping) and "scenarios" in space:
        return "scenario"
    # Every other method has a tolerance: where it is given, the space is at fault and not the method.
    asked = bool(table.keys() & {"specifications", "falsify"}) or (isinstance(space, Mapping) and _is_drawn(space))
    # Logs have their starts, and a rig is driven from a few.
    asked = asked or is_rig(table)
    return "sample" if _claims_draws(table) or (asked and "alpha" not in problem) else "rigorous"


def is_rig(table: Mapping[str, Any]) -> bool:
    """Whether the system of a file is a rig."""
    system = table.get("system")
    return isinstance(system, Mapping) and "rig" in system


def _claims_draws(table: Mapping[str, Any]) -> bool:
    claims = table.get("claims", ())
    # A fault in them is theirs, whatever the method.
    return "claims" in table and not (isinstance(claims, list) and any(map(is_composed, claims)))


def _is_drawn(space: Mapping[str, Any]) -> bool:
    rows = space.get("table")
    # A parameter may be called `table`: its value is a range.
    if isinstance(rows, str) or (isinstance(rows, list) and any(isinstance(each, list) for each in rows)):
        return True
    ranges = [each for each in space.values() if isinstance(each, Mapping)]
    ranges += [number for each in ranges for number in each.values() if isinstance(number, Mapping)]
    return any(each.get("distribution", "uniform") != "uniform" or each.keys() & {"step", "choices"} for each in ranges)


def _with_method(problem: Any, table: Mapping[str, Any]) -> Any:
    if not isinstance(problem, Mapping) or "method" in problem:
        return problem
    name = {"name": problem["name"]} if "name" in problem else {}
    return {**name, "method": _method(problem, table), **problem}


def leaves_out_problems(table: Mapping[str, Any]) -> bool:
    """Whether the keys of the only problem are those of the file."""
    return "problems" not in table


def file_schema() -> dict[str, Any]:
    """Return the JSON Schema of a campaign file: that of a campaign, without what may be left out."""
    schema = TypeAdapter(CampaignConfig).json_schema(by_alias=True)
    schema["required"] = [key for key in schema["required"] if key not in ("name", "problems")]
    for model in PROBLEM_MODELS.values():
        problem = schema["$defs"][model.__name__]
        optional = ("method", "kernel") if model in DERIVED.values() else ("method",)
        problem["required"] = [key for key in problem["required"] if key not in optional]
        for key, value in problem["properties"].items():
            # The problem's own model decides which of them go together.
            schema["properties"].setdefault(key, {"description": f"of the only problem: {value.get('description')}"})
    # Left out, they follow from the ranges; method `paper` says that it has no such default.
    schema["$defs"]["MaternKernel"]["required"].remove("length_scale")
    within = {"type": "string", "pattern": f"^{WITHIN.pattern}$"}
    ends = [{"required": schema["$defs"]["Range"].pop("required")}]
    ends += [{"required": [key]} for key in ("choices", "amplitude", "after", "profile")]
    profile = schema["$defs"]["Range"]["properties"]["profile"]
    profile["anyOf"] = [{"type": "string"}, *profile["anyOf"]]
    schema["$defs"]["Range"] = {"anyOf": [ENDS, within, schema["$defs"]["Range"] | {"anyOf": ends}]}
    for name, key in (("Scenarios", "scenarios"), ("StartTable", "table")):
        rows = schema["$defs"][name]["properties"]
        rows[key] = {"anyOf": [{"type": "string"}, rows[key]]}
    named = schema["$defs"]["Requirement"]
    named["required"].remove("name")
    del named["properties"]["name"]
    schema["properties"]["specifications"] = {
        "description": schema["properties"]["specifications"]["description"],
        "type": "object",
        "additionalProperties": {"anyOf": [{"type": "string"}, {"$ref": "#/$defs/Requirement"}]},
    }
    box = next(each for each in schema["properties"]["space"]["oneOf"] if "additionalProperties" in each)
    box["properties"] = {"where": {"anyOf": [{"type": "string"}, box["additionalProperties"]]}}
    schema["properties"]["problems"]["items"] = {"anyOf": schema["properties"]["problems"]["items"]["oneOf"]}
    return schema
