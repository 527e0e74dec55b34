"""A campaign as the text of a campaign file."""

from collections.abc import Iterator, Mapping
from typing import Any

from .campaign import CampaignConfig
from .toml_text import toml_key, toml_value


def campaign_text(config: CampaignConfig) -> str:
    """Return a campaign file with all keys that differ from their defaults; read again, it is the same campaign."""
    table = config.model_dump(mode="json", exclude_defaults=True)
    return "\n".join(_lines(table)) + "\n"


def _lines(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the keys of the file itself, then its tables, then those that it may have several of."""
    own = {key: each for key, each in table.items() if not isinstance(each, Mapping) and not _is_tables(each)}
    yield from _keys(own)
    for key, each in table.items():
        if isinstance(each, Mapping):
            yield from ("", f"[{toml_key(key)}]", *_keys(each))
    for key, several in table.items():
        if _is_tables(several):
            for each in several:
                yield from ("", f"[[{toml_key(key)}]]", *_keys(each))


def _keys(table: Mapping[str, Any]) -> Iterator[str]:
    # TOML has no null: a key without a value is left out.
    yield from (f"{toml_key(key)} = {toml_value(each)}" for key, each in table.items() if each is not None)


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, Mapping) for each in value)
