"""The strict model of every border, and the one JSON text of a value with its digest."""

import hashlib
import json
from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Model(BaseModel):
    """Frozen, strict, closed: no unknown key, no NaN, no silent conversion."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        validate_default=True,
        ser_json_inf_nan="strings",
        # Names of fields alone: pydantic otherwise keeps the texts of messages too, thousands of them.
        cache_strings="keys",
    )


def key_if_given(text: str, **limits: Any) -> Any:
    """Return the field of a key that is written only where given: other texts stay what they were, to the byte."""
    return Field(default=None, exclude_if=lambda value: value is None, description=text, **limits)


_CANONICAL = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False)
"""Made once: a rollout has a dozen such texts, and `json.dumps` makes an encoder for each."""


def canonical_json(value: Any) -> str:
    """Return the one JSON text of `value`: sorted keys, no spaces, ASCII, shortest floats.

    Raises:
        ValueError: `value` contains a NaN or an infinity.

    """
    return _CANONICAL.encode(value)


def digest(value: Any) -> str:
    """Return the sha256 of the canonical JSON of `value`, as 64 hexadecimal digits.

    >>> digest({"b": 1, "a": 2}) == digest({"a": 2, "b": 1})
    True
    """
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


def merged(one: Any, other: Any) -> Any:
    """Return two JSON values as one with the keys of both, lists entry by entry; where both have a value, `other` wins.

    >>> merged({"a": [{"b": 1}]}, {"a": [{"c": 2}], "d": 3})
    {'a': [{'b': 1, 'c': 2}], 'd': 3}
    """
    if isinstance(one, dict) and isinstance(other, dict):
        return one | {key: merged(one[key], value) if key in one else value for key, value in other.items()}
    if isinstance(one, list) and isinstance(other, list):
        return [merged(*pair) for pair in zip(one, other, strict=True)]
    return other
