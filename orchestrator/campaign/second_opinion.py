"""The rollouts of a campaign that two workers simulate."""

import hashlib

from ...schemas.ids import RolloutId
from ...schemas.result.facts import Header

BITS = 64


def is_chosen(header: Header, rollout: RolloutId) -> bool:
    """Whether a rollout gets a second opinion; it follows from the campaign's seed, which no request contains."""
    share = header.config.second_opinion
    if not share:
        return False
    text = f"second opinion {header.config.seed} {header.config_sha256} {rollout}"
    drawn = int.from_bytes(hashlib.sha256(text.encode()).digest()[: BITS // 8], "big")
    return drawn < share * 2.0**BITS
