"""The rules of a campaign: how seeds, digests and decisions follow from its file and its facts.

A campaign keeps the rules that it was started with, by the number in its header. A change that gives another seed,
digest or decision is a new number here, and a branch at the place that it changes.
"""

from collections.abc import Mapping

from . import __version__
from .errors import JournalError, shortened

RULES = 1
"""The rules of a new campaign."""


def check_rules(rules: int, software: Mapping[str, object], place: str) -> int:
    """Return `rules` if this perfbound follows them.

    Raises:
        JournalError: it does not; the message names `place`, and the perfbound of `software` that does.

    """
    if rules != RULES:
        wrote = shortened(str(software.get("perfbound")), 40)
        raise JournalError(
            f"{place}: the campaign follows rules {rules!r}, this perfbound {__version__} rules {RULES}; use the "
            f"perfbound that began it ({wrote})"
        )
    return rules
