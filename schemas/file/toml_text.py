"""Keys and values as TOML."""

import json
import re
import textwrap
from collections.abc import Mapping
from typing import Any

from ..errors import one_line

BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_file(table: Mapping[str, Any]) -> str:
    """Return a file of text, numbers, bools, lists and dicts: plain values first, then each table and list of tables.

    >>> print(toml_file({"space": {"x": [0, 1]}, "seed": 2, "problems": [{"delta": 1e-3}]}))
    seed = 2
    <BLANKLINE>
    [space]
    x = [0, 1]
    <BLANKLINE>
    [[problems]]
    delta = 0.001
    <BLANKLINE>

    """
    lists = {key: value for key, value in table.items() if _is_tables(value)}
    sections = [(f"[{toml_key(key)}]", value) for key, value in table.items() if isinstance(value, dict)]
    sections += [(f"[[{toml_key(key)}]]", each) for key, value in lists.items() for each in value]
    flat = {key: value for key, value in table.items() if not isinstance(value, dict) and key not in lists}
    blocks = [_key_lines(flat), *(f"{title}\n{_key_lines(section)}" for title, section in sections)]
    return "\n".join(block for block in blocks if block)


def _key_lines(table: Mapping[str, Any]) -> str:
    return "".join(f"{toml_key(key)} = {toml_value(each)}\n" for key, each in table.items())


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, dict) for each in value)


def toml_key(name: str) -> str:
    """Return a key, in quotes where it needs them."""
    return name if BARE.fullmatch(name) else toml_quoted(name)


def toml_value(value: Any) -> str:
    """Return text, a number, a bool, a list or a dict with text as keys in one line.

    >>> toml_value({"low": 0.0, "high": 1, "a b": [True, "m"]})
    '{ low = 0.0, high = 1, "a b" = [true, "m"] }'
    """
    match value:
        case bool():
            return str(value).lower()
        case str():
            return toml_quoted(value)
        case int() | float():
            return repr(value)
        case list():
            return f"[{', '.join(map(toml_value, value))}]"
    inside = ", ".join(f"{toml_key(key)} = {toml_value(each)}" for key, each in value.items())
    return f"{{ {inside} }}" if inside else "{}"


def toml_quoted(text: str) -> str:
    """Return a basic string of TOML: one of JSON, but for DEL, which TOML does not allow as it is."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_comment(text: str, width: int = 100) -> list[str]:
    """Return lines of a comment, none longer than `width` characters where the words allow it.

    >>> toml_comment("length scales, half of each range", width=24)
    ['# length scales, half of', '# each range']
    """
    return [f"# {line}" for line in textwrap.wrap(one_line(text), width - 2, break_on_hyphens=False)]
