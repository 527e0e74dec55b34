"""The reader of campaign files: from a file or its bytes to a CampaignConfig, or to an error with every fault."""

import csv
import io
import itertools
import json
import math
import re
import shlex
import tomllib
from collections.abc import Callable, Iterator, Mapping
from datetime import date, time
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..errors import CampaignError
from ..number_text import number_in
from ..outside import read_outside
from .config import CampaignConfig
from .defaults import OF_PROBLEM, completed, is_description, is_rig, leaves_out_problems, with_stand_ins
from .faults import LISTS, faults, list_fault
from .signals import MAX_PROFILE
from .space import kind_named

Beside = Callable[[str], bytes]
"""Reads a file beside the campaign file; raises OSError."""
MAX_CAMPAIGN_FILE = 1024 * 1024
"""Bytes of a campaign file."""
MAX_STARTS_FILE = 64 * 2**20
"""Bytes of a file of starts."""


NO_NORM = "rkhs_norm: this key is required: a number > 0"
MOST_NAMED = 8
"""Files that a message names."""
SYSTEM_IN_FILE = re.compile(r"^@[\w.]*system\(.*?^(?:def|class) (\w+)", re.MULTILINE | re.DOTALL)
"""The first decorated function or class of a Python file."""


def load_description(path: Path) -> CampaignConfig:
    """Read a campaign file for its system; one that it describes needs `[system]` and `[space]` alone.

    Raises:
        CampaignError: as `load_campaign`.

    """
    return parse_campaign(*file_and_place(path), whole=False)


def load_campaign(path: Path, **overrides: Any) -> CampaignConfig:
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
            command = f"perfbound init {shlex.quote(str(path))}"
            raise CampaignError(f"{path}: this is a system; write a campaign file: {command}") from None
        found = sorted(each.name for each in path.parent.glob("*.toml"))[:MOST_NAMED]
        there = f"in this folder: {', '.join(found)}" if found else "perfbound init SYSTEM writes one"
        raise CampaignError(f"{path}: {error.strerror}; choose a campaign file; {there}") from None
    if path.suffix == ".py":
        system = SYSTEM_IN_FILE.search(data.decode(errors="replace"))
        reference = shlex.quote(f"{path}:{system[1] if system else 'NAME'}")
        raise CampaignError(f"{path}: this is Python and no campaign file; write one: perfbound init {reference}")
    if kind := kind_named(path.suffix):
        raise CampaignError(
            f"{path}: this is a model and no campaign file; write one with {kind} = {path.name!r} under [system]"
        )
    if len(data) > MAX_CAMPAIGN_FILE:
        raise CampaignError(f"{path}: more than {MAX_CAMPAIGN_FILE} bytes; choose a campaign file")
    return data, str(path), lambda name: read_outside(path.parent / name, MAX_STARTS_FILE)


def parse_campaign(
    data: bytes, source: str, beside: Beside | None = None, *, whole: bool = True, **overrides: Any
) -> CampaignConfig:
    """Read the bytes of a campaign file; `overrides` replace top-level keys.

    `space.scenarios`, `space.table` and the `profile` of an input may name a CSV file, which `beside` reads; the
    campaign then contains its numbers. A file without `name` has that of `source`; with `whole` false it may be one of
    `load_description`.

    Raises:
        CampaignError: a line for each fault, with the file, the key and the allowed values.

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
        hint = _syntax_hint(data.decode("utf-8-sig"), str(error))
        raise CampaignError(f"{source}: not TOML: {str(error).partition(';')[0]}{hint}") from None
    if not table:
        raise CampaignError(f"{source}: the file is empty; see deploy/campaigns for examples")
    if dates:
        raise CampaignError(f"{source}: {dates[0]} is a date or time, which no key takes; put text in quotes")
    if isinstance(space := table.get("space"), dict):
        named = {key: most for key, most in LISTS.items() if isinstance(space.get(key), str)}
        for key, most in named.items():
            header, rows = _csv_rows(space[key], f"{source}: space.{key}", most, beside)
            table["space"] = {**table["space"], key: rows, **({"header": header} if header else {})}
        profiles = {
            name: {**each, "profile": _profile(each["profile"], f"{source}: space.{name}.profile", beside)}
            for name, each in space.items()
            if isinstance(each, dict) and isinstance(each.get("profile"), str)
        }
        table["space"] = {**table["space"], **profiles}
    return table


def validated(found: dict[str, Any], table: Mapping[str, Any], source: str) -> CampaignConfig:
    """Return the campaign of a table that was completed; `table` is that of its file.

    Raises:
        CampaignError: a line for each fault, with the file, the key and the allowed values.

    """
    try:
        return CampaignConfig.model_validate_json(json.dumps(found, default=str))
    except ValidationError as error:
        one_problem = leaves_out_problems(table)
        listed = list_fault(found, one_problem)
        lines = faults(error, found, one_problem) if listed is None else [listed]
        misses = [line for line in lines if ": this key is required" in line]
        if misses and "space" in table and not OF_PROBLEM & table.keys() and is_description(table):
            first, *others = lines
            hint = f"; this file describes a system alone: perfbound init {shlex.quote(source)} makes a campaign of it"
            # What a campaign needs in addition is what that command adds.
            lines = [first + hint, *(line for line in others if line not in misses)]
        elif any(line.endswith(NO_NORM) for line in lines) and not is_rig(table):
            command = f"perfbound calibrate {shlex.quote(source)}"
            lines = [*lines, f"a draft without constants of a kernel: `{command}` proposes them"]
        raise CampaignError(*(f"{source}: {line}" for line in lines)) from None


def _profile(name: str, key: str, beside: Beside | None) -> list[list[float]]:
    """Return the rows [t, value] of a CSV file."""
    header, rows = _csv_rows(name, key, MAX_PROFILE, beside, "point")
    wide = next((number for number, row in enumerate(rows) if len(row) != 2), None)
    if wide is not None or (header and header[0] not in ("t", "time")):
        found = f"row {wide} has {len(rows[wide])} numbers" if wide is not None else f"the header is {','.join(header)}"
        raise CampaignError(f"{key}: {name}: {found}; give two columns, t in s and value")
    return rows


def _csv_rows(
    name: str, key: str, most: int, beside: Beside | None, what: str = "start"
) -> tuple[list[str], list[list[float]]]:
    """Return the header of a CSV file, empty if it has none, and its rows: of one start or point each."""
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
    # A header has names alone: a first start with a misspelt number is an error like any other.
    header = [cell.strip() for cell in rows.pop(0)] if rows and all(map(_is_title, rows[0])) else []
    for number, row in enumerate(rows):
        if not all(map(_is_finite, row)):
            raise CampaignError(
                f"{where}: row {number} is {','.join(row)[:80]!r}; allowed are numbers, one {what} a row"
            )
    if not 0 < len(rows) <= most:
        count = f"more than {most:,} {what}s" if rows else f"no {what}"
        raise CampaignError(f"{where}: {count}; allowed are 1 to {most:,} rows of numbers")
    return header, [[number_in(cell) for cell in row] for row in rows]


def _is_finite(cell: str) -> bool:
    try:
        return math.isfinite(number_in(cell))
    except ValueError:
        return False


def _is_title(cell: str) -> bool:
    return not _is_finite(cell) and not re.match(r"[-+.]?[0-9]", cell.strip())


def _leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Yield (key, value) of everything in a TOML value that is neither table nor list."""
    inner: Any = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if inner is None:
        yield key, value
        return
    for part, child in inner:
        yield from _leaves(child, f"{key}.{part}" if key else str(part))


def differences(one: CampaignConfig, other: CampaignConfig) -> list[str]:
    """Return the keys in which two campaigns differ, with both values: `problems.0.alpha is 0.05 and 0.04`."""
    a, b = (dict(_leaves(each.model_dump(mode="json"), "")) for each in (one, other))
    keys = [key for key in a | b if a.get(key) != b.get(key)]
    return [f"{key} is {a.get(key, 'absent')!r} and {b.get(key, 'absent')!r}" for key in keys]


_SLIPS = (
    (re.compile("[\u201c\u201d\u2018\u2019]"), 'use straight quotes, "'),
    (re.compile(r'=.*".*\\'), "write a path with /, or in '...'"),
    (re.compile(r"^\s*[\w.-]+\s*:"), "write KEY = VALUE"),
    (re.compile(r"=\s*-?\d+,\d"), "write a number with a point, as 1.5"),
    (re.compile(r"=\s*-?[\d.]+\s*[A-Za-z%]"), "write a number without its unit"),
    (re.compile(r"=\s*(?!(true|false|inf|nan)\b)[A-Za-z./]"), 'put text in quotes, KEY = "TEXT"'),
)
"""What is often wrong in a line that is no TOML, the first that fits, and what to write."""


def _syntax_hint(text: str, error: str) -> str:
    """Return what to write in the line that an error of TOML names; empty where nothing is known."""
    place = re.search(r"at line (\d+)", error)
    line = text.splitlines()[int(place[1]) - 1] if place else ""
    return next((f"; {remedy}" for slip, remedy in _SLIPS if slip.search(line)), "")
