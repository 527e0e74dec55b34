"""The reader of campaign files: from a file or its bytes to a CampaignConfig, or to an error of one line."""

import csv
import difflib
import io
import itertools
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from datetime import date, time
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import ValidationError

from .base import Model
from .campaign import CampaignConfig
from .campaign_defaults import OF_CAMPAIGN, OF_PROBLEM, completed, is_description, leaves_out_problems, with_stand_ins
from .claims import ClaimRequest
from .composition import ComposedClaim
from .errors import CampaignError
from .kernel import MaternKernel, Weighted
from .method_spaces import SPACES, space_needed
from .outside import read_outside
from .problem_models import PROBLEM_MODELS, Gap, Linearised
from .problems import OBJECTIVES, any_of
from .requirements import Requirement
from .space import MAX_CHOICES, MAX_SCENARIOS, MAX_TABLE, ProgramLimits, Range, SystemChoice

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
    ("space", "scenarios"): "a list of starting conditions, or the name of a CSV file",
    ("space", "table"): f"the name of a CSV file with 1 to {MAX_TABLE} rows, or its rows",
    ("system", "program"): 'a list of texts: ["./NAME", "ARGUMENT"]',
    ("system", "columns"): 'a table with the unit of every column in quotes: { distance = "m" }',
    ("system", "noisy"): "true, false, or a list of variants",
    ("system", "variants"): "a list of 'nominal' and 'true'",
    ("system", "environment"): "a list of names",
    ("system", "limits"): "a table: { memory = 4, cpu = 60 }",
}
"""Allowed values in words, where those of the schema and of pydantic are no help."""
_RANGE = 'the ends of its range, [0, 5], or a table: { low = 0, high = 5, unit = "m" }'
_LISTS = {"scenarios": MAX_SCENARIOS, "table": MAX_TABLE}
"""Keys of `[space]` whose starts may be in a CSV file, and the most rows."""
_CLAIM_MODELS: dict[str, type[Model]] = {"drawn": ClaimRequest, "composed": ComposedClaim}
_TAGS = {*PROBLEM_MODELS, *_CLAIM_MODELS, "box", *_LISTS}
"""Names that pydantic gives the members of unions."""


Beside = Callable[[str], bytes]
"""Reads a file beside the campaign file; raises OSError."""
MAX_CAMPAIGN_FILE = 1024 * 1024
"""Bytes of a campaign file."""
MAX_STARTS_FILE = 64 * 2**20
"""Bytes of a file of starts."""


def load_description(path: Path) -> CampaignConfig:
    """Read a campaign file for its system; that of a program needs `[system]` and `[space]` alone.

    Raises:
        CampaignError: as `load_campaign`.

    """
    return parse_campaign(*file_and_place(path), whole=False)


def load_campaign(path: Path, **overrides: int) -> CampaignConfig:
    """Read a campaign file.

    Raises:
        CampaignError: it cannot be read, or is not a campaign.

    """
    data, source, beside = file_and_place(path)
    return parse_campaign(data, source, beside, whole=True, **overrides)


def file_and_place(path: Path) -> tuple[bytes, str, Beside]:
    """Return the bytes of a campaign file, its name, and the reader of files beside it.

    Raises:
        CampaignError: it cannot be read.

    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_CAMPAIGN_FILE + 1)
    except OSError as error:
        if ".py:" in path.name:
            raise CampaignError(f"{path}: this is a system; write a campaign file: perfbound init {path}") from None
        raise CampaignError(f"{path}: {error.strerror}; choose a campaign file, e.g. one of deploy/campaigns") from None
    if len(data) > MAX_CAMPAIGN_FILE:
        raise CampaignError(f"{path}: more than {MAX_CAMPAIGN_FILE} bytes; choose a campaign file")
    return data, str(path), lambda name: read_outside(path.parent / name, MAX_STARTS_FILE)


def parse_campaign(
    data: bytes, source: str, beside: Beside | None = None, *, whole: bool = True, **overrides: Any
) -> CampaignConfig:
    """Read the bytes of a campaign file; `overrides` replace top-level keys.

    `space.scenarios` and `space.table` may name a CSV file, which `beside` reads; the campaign then contains its
    numbers. A file without `name` has that of `source`; with `whole` false it may be one of `load_description`.

    Raises:
        CampaignError: one line with the file, the key and the allowed values.

    """
    table = campaign_table(data, source, beside)
    found = completed({**(table if whole else with_stand_ins(table)), **overrides}, Path(source).stem)
    return validated(found, table, source)


def campaign_table(data: bytes, source: str, beside: Beside | None = None) -> dict[str, Any]:
    """Return the table of a campaign file as it is written, with the rows of the files that `beside` reads.

    Raises:
        CampaignError: it is no TOML, is empty, or has a value that no key takes.

    """
    try:
        table = tomllib.loads(data.decode("utf-8-sig"))
        dates = [f"{key}: {value}" for key, value in _leaves(table, "") if isinstance(value, date | time)]
        json.dumps(table, default=str)
    except UnicodeDecodeError as error:
        raise CampaignError(f"{source}: not UTF-8 (byte {error.start}); save the file as UTF-8") from None
    except (ValueError, RecursionError) as error:  # also integers of thousands of digits, and lists without end
        raise CampaignError(f"{source}: not TOML: {str(error).partition(';')[0]}") from None
    if not table:
        raise CampaignError(f"{source}: the file is empty; see deploy/campaigns for examples")
    if dates:
        raise CampaignError(f"{source}: {dates[0]} is a date or time, which no key takes; put text in quotes")
    if isinstance(space := table.get("space"), dict):
        named = {key: most for key, most in _LISTS.items() if isinstance(space.get(key), str)}
        for key, most in named.items():
            header, rows = _csv_rows(space[key], f"{source}: space.{key}", most, beside)
            table["space"] = {**table["space"], key: rows, **({"header": header} if header else {})}
    return table


def validated(found: dict[str, Any], table: Mapping[str, Any], source: str) -> CampaignConfig:
    """Return the campaign of a table that was completed; `table` is that of its file.

    Raises:
        CampaignError: one line with the file, the key and the allowed values.

    """
    try:
        return CampaignConfig.model_validate_json(json.dumps(found, default=str))
    except ValidationError as error:
        one_problem = leaves_out_problems(table)
        fault = _list_fault(found, one_problem) or _first_fault(error, found, one_problem)
        if not OF_PROBLEM & table.keys() and is_description(table):
            fault += f"; this file describes a program alone: perfbound init {source} makes a campaign of it"
        raise CampaignError(f"{source}: {fault}") from None


def _csv_rows(name: str, key: str, most: int, beside: Beside | None) -> tuple[list[str], list[list[float]]]:
    """Return the header of a CSV file, empty if it has none, and its rows: one start a row."""
    where = f"{key}: {name}"
    if beside is None or "/" in name or "\\" in name or name.startswith("."):
        raise CampaignError(f"{where} is not allowed: name a CSV file beside the campaign file")
    try:
        text = io.StringIO(beside(name).decode("utf-8-sig"), newline="")
        # One row more than a header and the most starts: all lines of a large file would take thirty times its size.
        rows = list(itertools.islice(filter(None, csv.reader(text)), most + 2))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8"
        reason = f"not CSV: {error}" if isinstance(error, csv.Error) else reason
        raise CampaignError(f"{where}: {reason}; name a CSV file beside the campaign file") from None
    # A header has no number at all: a first start with a misspelt one is an error like any other.
    header = [cell.strip() for cell in rows.pop(0)] if rows and not any(map(_is_finite, rows[0])) else []
    for number, row in enumerate(rows):
        if not all(map(_is_finite, row)):
            raise CampaignError(
                f"{where}: row {number} is {','.join(row)[:80]!r}; allowed are numbers, one start a row"
            )
    if not 0 < len(rows) <= most:
        count = f"more than {most} starts" if rows else "no start"
        raise CampaignError(f"{where}: {count}; allowed are 1 to {most} rows of numbers")
    return header, [[float(cell) for cell in row] for row in rows]


def _is_finite(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Yield (key, value) of everything in a TOML value that is neither table nor list."""
    inner: Any = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if inner is None:
        yield key, value
        return
    for part, child in inner:
        yield from _leaves(child, f"{key}.{part}" if key else str(part))


def _list_fault(table: Mapping[str, Any], one_problem: bool) -> str | None:
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


def _first_fault(error: ValidationError, table: dict[str, Any], one_problem: bool) -> str:
    """Return the first fault in one line: key, value, what is allowed; and how many more there are.

    With `one_problem` the keys of the only problem are those of the file.
    """
    # A misspelt key makes two faults; the first one to report is the unknown key, not the missing one.
    faults = sorted(error.errors(include_url=False), key=lambda fault: fault["type"] != "extra_forbidden")
    text = _describe(faults[0], _key(faults[0]["loc"], table, one_problem), one_problem)
    places = {_place(fault["loc"]) for fault in faults}
    # A list is "too short" for pydantic if its entries are wrong: that is no fault of its own.
    more = sum(not any(other != place == other[: len(place)] for other in places) for place in places) - 1
    return text if more == 0 else f"{text} (and {more} more)"


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
    tags = {1} if location[:1] == ("space",) else {2} if location[:1] in {("problems",), ("claims",)} else set()
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
        given = f"{found!r} is not allowed: allowed is" if found is not None else "this key is required:"
        return f"{f'{key}.' if key else ''}method: {given} {choices}"
    listed = fault["loc"][1] if location[:1] == ("space",) and fault["loc"][1:2] else ""
    if kind == "extra_forbidden" and listed in _LISTS:
        return f"{key}: not allowed beside space.{listed}, which has all parameters; remove one of the two"
    if kind == "extra_forbidden":
        allowed = [*_model_at(location[:-1]).model_fields, *(OF_PROBLEM if one_problem and len(location) == 1 else ())]
        if (
            location[0] == "problems" and len(location) == 4 and location[-1] in OF_PROBLEM
        ):  # problems, its place, its method, the key
            return f"{key}: has no meaning in method {str(location[2])!r}; remove this key, or choose another method"
        near = difflib.get_close_matches(str(location[-1]), allowed, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        return f"{key}: unknown key; {hint}allowed are {', '.join(sorted(allowed))}"
    if kind == "value_error":
        reason = message.removeprefix("Value error, ")
        return f"{key}.{reason}" if key else reason
    if kind == "json_invalid":
        return f"not a value that JSON can represent: {message}"
    known = "a list of texts" if listed in _LISTS and location[1:2] == ("header",) else _allowed(location)
    most = f"at most {fault['ctx']['max_length']} entries" if kind == "too_long" else ""
    allowed_text = known or most or message.removeprefix("Input should be ").replace("an object", "a table")
    if kind == "missing" and isinstance(location[-1], str):
        what = "" if allowed_text == message else f": {allowed_text}"
        return f"{key}: this key is required{what}"
    value = fault.get("input")
    shown = "a table" if isinstance(value, dict) else repr(value)[:80]
    below = len(location) == 2 and location[0] == "space" and location[1] in OF_PROBLEM | OF_CAMPAIGN
    hint = "; a key of the campaign stands above the first [table]" if below else ""
    return f"{key}: {shown} is not allowed: allowed is {allowed_text}{hint}"


def _allowed(location: Location) -> str:
    """Return the allowed values of a key in words; empty where the words of pydantic are better."""
    names = tuple(part for part in location if isinstance(part, str))
    if names[0] == "system" and names[1:2] != ("limits",):
        names = names[:2]  # an entry of `columns` or of a list
    if names[0] == "space" and len(names) == 3:
        names = ("space", names[2]) if names[2] == "choices" else names
    elif names[0] == "space" and len(names) == 2 and names[1] not in _LISTS:
        return _RANGE
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


def differences(one: CampaignConfig, other: CampaignConfig) -> list[str]:
    """Return the keys in which two campaigns differ, with both values: `problems.0.alpha is 0.05 and 0.04`."""
    a, b = (dict(_leaves(each.model_dump(mode="json"), "")) for each in (one, other))
    keys = [key for key in a | b if a.get(key) != b.get(key)]
    return [f"{key} is {a.get(key, 'absent')!r} and {b.get(key, 'absent')!r}" for key in keys]
