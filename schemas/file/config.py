"""A campaign: keys that agree with one another, its identity, and its text as a file."""

from typing import Any

from pydantic import model_validator

from ..base import digest, merged
from .consistency import check_consistent
from .keys import CampaignKeys
from .toml_text import toml_file

DECIDES_NOTHING = {
    *("keep", "visual", "max_attempts", "hung_after", "deadline", "platform", "second_opinion"),
    *("required_margin", "required_at_most", "required_probability"),
}
"""Keys that change no number of a campaign, and so neither its identity nor its seeds."""
IDENTIFIES_ALWAYS: Any = {
    "seed": True,
    "composition": True,
    "problems": {"__all__": {"delta": True, "kernel": {"nu": True}}},
}
"""Keys that are part of the identity also at their default: a file that leaves one out is the same campaign as one that
writes it."""


class CampaignConfig(CampaignKeys):
    """A whole campaign file."""

    @model_validator(mode="after")
    def _consistent(self) -> "CampaignConfig":
        check_consistent(self)
        return self

    @property
    def digest(self) -> str:
        """Identity of the campaign: its keys that differ from their defaults and decide a number."""
        changed = self.model_dump(mode="json", exclude_defaults=True, exclude=DECIDES_NOTHING)
        return digest(merged(changed, self.model_dump(mode="json", include=IDENTIFIES_ALWAYS)))


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
