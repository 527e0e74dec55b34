"""A campaign as the text of a campaign file."""

from typing import Any

from .campaign import CampaignConfig
from .toml_text import toml_file


def campaign_text(config: CampaignConfig) -> str:
    """Return a campaign file with all keys that differ from their defaults; read again, it is the same campaign."""
    found: dict[str, Any] = _without_null(config.model_dump(mode="json", exclude_defaults=True))
    return toml_file(found)


def _without_null(value: Any) -> Any:
    """Return a value without the keys that have none: TOML has no null, and none of them has another default."""
    match value:
        case dict():
            return {key: _without_null(each) for key, each in value.items() if each is not None}
        case list():
            return [_without_null(each) for each in value]
        case _:
            return value
