"""A campaign's table as TOML: the one text that its parser reads, whether it came from a file or from Python."""

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

from ..schemas.errors import CampaignError
from ..schemas.file.toml_text import toml_file


def toml(table: Mapping[str, Any], source: str) -> str:
    """Return the TOML of a table: plain values first, then a section for each table and list of tables.

    Values may be those of numpy; what is None is left out.

    Raises:
        CampaignError: a value has no form in TOML; the text names its key.

    >>> print(toml({"name": "a", "space": {"x": {"low": 0.0, "high": 1}}, "problems": [{"delta": 1e-3}]}, "here"))
    name = "a"
    <BLANKLINE>
    [space]
    x = { low = 0.0, high = 1 }
    <BLANKLINE>
    [[problems]]
    delta = 0.001
    <BLANKLINE>

    """
    return toml_file({key: _as_python(value, key, source) for key, value in table.items() if value is not None})


def _as_python(value: Any, key: str, source: str) -> Any:
    """Return a value as dict, list, text, number or bool of Python."""
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        value = value.tolist()
    if isinstance(value, Mapping):
        return {
            str(name): _as_python(each, f"{key}.{name}", source) for name, each in value.items() if each is not None
        }
    if isinstance(value, list | tuple):
        return [_as_python(each, key, source) for each in value]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, str | bool | int | float):
        return value
    raise CampaignError(f"{source}: {key}: {type(value).__name__} is not allowed: give text, number, list or dict")
