"""Keys and values as TOML."""

import json
import re
from typing import Any

BARE = re.compile(r"[A-Za-z0-9_-]+")


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
