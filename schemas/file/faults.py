"""The faults of a campaign file in words: a line for each, with the key, its value, and what is allowed."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

from pydantic import ValidationError

from ..base import Model
from ..errors import meant, nearest_name
from .composition import ComposedClaim
from .config import CampaignConfig
from .consistency import InconsistentKeysError
from .defaults import DERIVED, OF_CAMPAIGN, OF_PROBLEM
from .drawn_claims import ClaimRequest
from .method_spaces import SPACES, space_needed
from .objectives import OBJECTIVES, any_of
from .parameters import MAX_CHOICES, NUMBER_TAGS, Range
from .problem_models import PROBLEM_MODELS, Gap, Linearised, MaternKernel, Weighted
from .requirements import Requirement
from .signals import MAX_KNOTS, MAX_PROFILE, PARTS
from .space import MAX_SCENARIOS, MAX_TABLE, ProgramLimits, SystemChoice

MOST_FAULTS = 20
"""Lines of an error; a list of starts may have thousands."""
MOST_ALLOWED = 20
"""Allowed keys that are listed beside the one that was meant."""

Location = tuple[int | str, ...]
"""Place of a fault, as pydantic gives it."""

_UNION_MEMBER = re.compile(
    r"constrained-float|Linearised|float|str|bool|(literal|tuple|dict|constrained-dict|function-.*)\[.*"
)
_LIMITS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
_LENGTHS = "a number > 0, or one per parameter: { name = number, ... }"
_WORDS = {
    ("name",): "1 to 64 of a-z, 0-9, '-' and '_', the first a letter or digit",
    ("clip",): "[low, high], two numbers",
    ("falsify", "scale"): "a table with a number > 0 for each column, its usual range: { speed = 120, rpm = 4750 }; "
    "`perfbound init SYSTEM --question fails` writes those of a pilot",
    ("falsify",): "a table, and falsify = {} takes every default",
    ("claims",): 'a list of tables: [{ quantity = "failure_probability" }]',
    ("claims", "drawn"): 'a table: { quantity = "failure_probability" }',
    ("system",): 'a table with one system, as [system] and below it python = "FILE.py:NAME"',
    ("system", "logs"): 'a table, [system.logs], as { columns = { speed = "Speed (km/h)" } }',
    ("space",): "a table with one entry per parameter: name = [low, high]",
    ("problems",): "a list of tables, each under [[problems]]",
    ("problems", "paper", "regulariser"): "'1+eta' or a number > 0",
    ("problems", "rigorous", "regulariser"): "a number > 0, or a list of { value, weight }",
    ("problems", "paper", "kernel", "length_scale"): _LENGTHS,
    ("problems", "rigorous", "kernel", "length_scale"): _LENGTHS,
    ("problems", "kriging", "kernel", "length_scale"): _LENGTHS,
    ("problems", "scenario", "linearised"): "'past', or a table: { centre = 0.7, spread = 0.1 }",
    ("problems", "rigorous", "noise_scale"): "'derived' or a number >= 0",
    ("specifications", "name"): "a letter, then at most 39 letters, digits, '-' and '_'",
    ("claims", "composed", "problems"): f"a list of one or two of {any_of(tuple(OBJECTIVES))}",
    ("space", "choices"): f"a list of 2 to {MAX_CHOICES} numbers",
    ("space", "times"): f"a list of 1 to {MAX_KNOTS:,} times in s",
    ("space", "profile"): f"the name of a CSV file with 1 to {MAX_PROFILE:,} rows t,value, or its rows",
    ("space", "scenarios"): "a list of starting conditions, or the name of a CSV file",
    ("space", "table"): f"the name of a CSV file with 1 to {MAX_TABLE:,} rows, or its rows",
    ("system", "program"): 'a list of texts: ["./NAME", "ARGUMENT"]',
    ("system", "policy"): "FILE.py:NAME, or FILE.zip:PPO, a model of Stable-Baselines3 and its algorithm",
    ("system", "controller"): "FILE.py:NAME, a function of the model and its data",
    ("system", "tolerance"): "a table with a number for a parameter: { speed = 0.2 }",
    ("system", "files"): 'a list of paths: ["policy.pt", "tables/*.csv"]',
    ("system", "columns"): 'a table with the unit of every column in quotes: { distance = "m" }',
    ("system", "noisy"): "true, false, or a list of variants",
    ("system", "variants"): "a list of 'nominal' and 'true'",
    ("system", "environment"): "a list of names",
    ("system", "limits"): "a table: { memory = 4, cpu = 60 }",
}
"""Allowed values in words, where those of the schema and of pydantic are no help."""
_OTHERWISE = {"min": "low", "max": "high", "lower": "low", "upper": "high", "std": "sd"}
"""Keys by the names that others give them."""
_RANGE = 'the ends of its range, [0, 5], or a table: { low = 0, high = 5, unit = "m" }'
LISTS = {"scenarios": MAX_SCENARIOS, "table": MAX_TABLE}
"""Keys of `[space]` whose starts may be in a CSV file, and the most rows."""
_CLAIM_MODELS: dict[str, type[Model]] = {"drawn": ClaimRequest, "composed": ComposedClaim}
_TAGS = {*PROBLEM_MODELS, *_CLAIM_MODELS, "box", *LISTS, *NUMBER_TAGS}
"""Names that pydantic gives the members of unions."""


def list_fault(table: Mapping[str, Any], one_problem: bool) -> str | None:
    """Return the fault of a method that takes no list of starts: with another method its missing keys do not matter."""
    space, problems = table.get("space"), table.get("problems")
    if not isinstance(space, Mapping) or not isinstance(space.get("scenarios"), list) or not isinstance(problems, list):
        return None
    for number, problem in enumerate(problems):
        method = problem.get("method") if isinstance(problem, Mapping) else None
        for name, kinds in SPACES.items():
            if method == name and "scenarios" not in kinds:
                key = "" if one_problem else f"problems.{problem.get('name', number)}."
                return f"{key}{space_needed(name, 'scenarios')}"
    return None


def faults(error: ValidationError, table: dict[str, Any], one_problem: bool) -> list[str]:
    """Return each fault in one line: key, value, what is allowed; at most `MOST_FAULTS`, unknown keys first.

    With `one_problem` the keys of the only problem are those of the file.
    """
    found = sorted(error.errors(include_url=False), key=lambda fault: fault["type"] != "extra_forbidden")
    places = [_place(fault["loc"]) for fault in found]
    # A list is "too short" for pydantic if its entries are wrong: that is no fault of its own.
    within = {place[:length] for place in places for length in range(len(place))}
    ranges_wrong = any(place[:1] == ("space",) for place in places)
    lines: list[str] = []
    misspelt: set[str] = set()
    for number, (fault, place) in enumerate(zip(found, places, strict=True)):
        key, missing = _key(fault["loc"], table, one_problem), fault["type"] == "missing"
        if fault["type"] == "extra_forbidden":
            wrong = str(place[-1])
            near = nearest_name(_OTHERWISE.get(wrong, wrong), _keys_at(fault["loc"], one_problem))
            misspelt |= {key.removesuffix(wrong) + near} if near else set()
        # A misspelt key has further faults: what it was meant to be is missing, and what would be needed without it.
        again = missing and bool(misspelt)
        # Length scales that follow from the ranges need those to be right.
        again |= missing and ranges_wrong and place[2:3] == ("kernel",) and fault["loc"][2] in DERIVED
        # Each member of a union has a fault at the place of all.
        if not again and place not in within and place not in places[:number]:
            lines += _lines(fault, key, one_problem)
    more = len(lines) - MOST_FAULTS
    return lines if more <= 0 else [*lines[:MOST_FAULTS], f"{more} more faults; fix these first"]


def _lines(fault: Any, key: str, one_problem: bool) -> list[str]:
    """Return a line for each fault of one of pydantic: keys that do not go together may be several."""
    if fault["type"] != "value_error":
        return [_describe(fault, key, one_problem)]
    cause = fault["ctx"]["error"]
    lines = cause.lines if isinstance(cause, InconsistentKeysError) else (str(cause),)
    return [f"{key}.{line}" if key else line for line in lines]


def _key(location: Location, table: dict[str, Any], one_problem: bool) -> str:
    """Return the dotted key of a fault; a problem and a requirement go by their names."""
    parts = [str(part) for part in _place(location)]
    if parts[:2] == ["problems", "0"] and one_problem:
        return ".".join(parts[2:])
    if parts and parts[0] == "problems" and len(parts) > 1 and parts[2:] != ["name"]:
        problem = table["problems"][int(parts[1])]
        name = problem.get("name") if isinstance(problem, dict) else None
        parts[1] = name if isinstance(name, str) and name in OBJECTIVES else parts[1]
    if parts[:1] == ["specifications"] and len(parts) > 1:
        requirement = table["specifications"][int(parts[1])]
        name = requirement.get("name") if isinstance(requirement, dict) else None
        parts[1] = name if isinstance(name, str) and len(parts) > 2 else parts[1]
    return ".".join(parts)


def _place(location: Location) -> Location:
    """Return the keys and positions of the file alone, without pydantic's names of the members of unions."""
    tags = {1, 4} if location[:1] == ("space",) else {2} if location[:1] in {("problems",), ("claims",)} else set()
    return tuple(
        part
        for position, part in enumerate(location)
        if not (position in tags and part in _TAGS) and not (isinstance(part, str) and _UNION_MEMBER.fullmatch(part))
    )


def _tagged(location: Location) -> Location:
    """Return the location without the members of unions, but with the method of a problem and the kind of a claim."""
    kinds = {"problems": PROBLEM_MODELS.keys(), "claims": _CLAIM_MODELS.keys()}.get(
        str(location[:1] and location[0]), ()
    )
    kind = location[2:3] if location[2:3] and location[2] in kinds else ()
    place = _place(location)
    return (*place[:2], *kind, *place[2:])


def _describe(fault: Any, key: str, one_problem: bool) -> str:
    kind, message, location = fault["type"], str(fault["msg"]), _tagged(fault["loc"])
    if kind.startswith("union_tag"):
        choices = f"one of {', '.join(map(repr, PROBLEM_MODELS))}"
        found = fault["input"].get("method") if isinstance(fault["input"], dict) else fault["input"]
        near = meant(str(found), PROBLEM_MODELS)
        given = f"{found!r} is not allowed: {near}allowed is" if found is not None else "this key is required:"
        return f"{f'{key}.' if key else ''}method: {given} {choices}"
    listed = fault["loc"][1] if location[:1] == ("space",) and fault["loc"][1:2] else ""
    if kind == "extra_forbidden" and listed in LISTS:
        return f"{key}: not allowed beside space.{listed}, which has all parameters; remove one of the two"
    if kind == "extra_forbidden":
        if location[0] == "space" and len(location) == 3 and isinstance(fault["input"], list | dict):  # dots of an FMU
            return f"{key}: a name has no dot here; write {'_'.join(map(str, location[1:])).lower()}"
        return f"{key}: {_unknown(location, _keys_at(fault['loc'], one_problem))}"
    if kind == "json_invalid":
        return f"not a value that JSON can represent: {message}"
    if kind == "string_pattern_mismatch" and location == ("system", "python"):
        return f"{key}: {fault['input']!r} is not allowed: allowed is FILE.py:NAME, a function or class in a file"
    known = "a list of texts" if listed in LISTS and location[1:2] == ("header",) else _allowed(location)
    if known == _RANGE and isinstance(fault.get("input"), str):
        known += '; of a disturbance also "within 3 sd"'
    most = f"at most {fault['ctx']['max_length']} entries" if kind == "too_long" else ""
    allowed_text = known or most or message.removeprefix("Input should be ").replace("an object", "a table")
    if kind == "missing" and isinstance(location[-1], str):
        what = "" if allowed_text == message else f": {allowed_text}"
        return f"{key}: this key is required{what}"
    value = fault.get("input")
    shown = "a table" if isinstance(value, dict) else repr(value)[:80]
    below = len(location) == 2 and location[0] == "space" and location[1] in OF_PROBLEM | OF_CAMPAIGN
    hint = f"; if it is the key `{location[1]}` of the campaign, put it above the first [table]" if below else ""
    if isinstance(value, bool) and "number" in allowed_text:
        hint = "; write 1 for true, 0 for false"
    return f"{key}: {shown} is not allowed: allowed is {allowed_text}{hint}"


def _keys_at(location: Location, one_problem: bool) -> list[str]:
    """Return the keys that are allowed where an unknown one is."""
    place = _tagged(location)
    return sorted({*_model_at(place[:-1]).model_fields, *(OF_PROBLEM if one_problem and len(place) == 1 else ())})


def _unknown(location: Location, allowed: Sequence[str]) -> str:
    """Return why a key is not allowed, and what to do."""
    name = str(location[-1])
    if location[0] == "problems" and len(location) == 4 and name in OF_PROBLEM:  # its place, its method, the key
        owners = [method for method, model in PROBLEM_MODELS.items() if name in model.model_fields]
        return (
            f"belongs to method {any_of(owners)}, and not to {str(location[2])!r}; remove this key, or choose "
            f"{'that method' if len(owners) == 1 else 'one of those methods'}"
        )
    if len(location) == 1 and name in OF_PROBLEM:
        return "belongs to a problem; move it below its [[problems]]"
    hint = meant(_OTHERWISE.get(name, name), allowed)
    if hint and len(allowed) > MOST_ALLOWED:
        return f"unknown key; {hint.strip()}"
    return f"unknown key; {hint}allowed are {', '.join(allowed)}"


def _allowed(location: Location) -> str:
    """Return the allowed values of a key in words; empty where the words of pydantic are better."""
    names = tuple(part for part in location if isinstance(part, str))
    if names[0] == "system" and names[1:2] != ("limits",):
        names = names[:2]  # an entry of `columns` or of a list
    if names[0] == "space" and len(names) == 3:
        if any(names[2] in parts for parts in PARTS.values()):
            return "a number, or the ends of its range, [0, 5]"
        names = ("space", names[2]) if names[2] in ("choices", "times", "profile") else names
    elif names[0] == "space" and len(names) == 2 and names[1] not in LISTS:
        return _RANGE
    if names[-2:-1] == ("length_scale",):
        return "a number > 0"
    if names in _WORDS:
        return _WORDS[names]
    if names[0] == "system" and len(names) > 1 and names[1] not in SystemChoice.model_fields:
        return "text or a number, as the system has it: see `perfbound systems`"
    field = _model_at(location[:-1]).model_fields.get(names[-1])
    if field is not None and get_origin(field.annotation) is Literal:
        return f"one of {', '.join(map(repr, get_args(field.annotation)))}"
    kinds = {field.annotation, *get_args(field.annotation)} if field else set()
    number = "a whole number" if int in kinds else "a number" if float in kinds else ""
    if field is None or not number:
        return "text in quotes" if str in kinds else ""
    limits = [
        f"{sign} {limit}"
        for constraint in field.metadata
        for bound, sign in _LIMITS.items()
        if (limit := getattr(constraint, bound, None)) is not None
    ]
    return f"{number} {' and '.join(limits)}".strip()


def _model_at(location: Location) -> type[Model]:
    """Return the model of the table at a place in the file."""
    models: dict[int | str, type[Model]] = {
        **dict(PROBLEM_MODELS.items()),
        **dict(_CLAIM_MODELS.items()),
        "linearised": Linearised,
        "regulariser": Weighted,
        "kernel": MaternKernel,
        "gap": Gap,
        "limits": ProgramLimits,
        "system": SystemChoice,
    }
    if location[:1] == ("space",):  # a parameter may have the name of a table of the file
        return Range
    if location[:1] == ("system",):  # whose keys are the user's
        return models.get(location[-1], SystemChoice)
    names = [part for part in location if part in models]
    if names:
        return models[names[-1]]
    return Requirement if location[:1] == ("specifications",) else CampaignConfig
