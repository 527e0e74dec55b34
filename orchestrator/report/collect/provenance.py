"""Where the evidence of a campaign comes from: who ran it, when, on which machines, from which campaign file."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ....schemas.file.config import campaign_text
from ....schemas.result.facts import Header
from ...store.changes import Session

MOST_NAMED = 8
"""Accounts, hosts and platforms of each kind that the data name."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """The origin of a campaign; names are untrusted text."""

    accounts: tuple[str, ...]
    """Of the users who ran the orchestrator."""
    hosts: tuple[str, ...]
    """Of the orchestrator."""
    platforms: tuple[str, ...]
    started: float | None
    """Unix time of the first session."""
    ended: float | None
    """Unix time of the last result."""
    digest: str
    """SHA-256 of the campaign file in its canonical form."""
    file: str
    """The campaign file: all keys that differ from their defaults."""
    commit: str | None
    """Of the folder of a system that is not installed."""


def provenance(header: Header, sessions: Sequence[Session], ended: float | None) -> Provenance:
    """Return the origin of a campaign; `ended` is the Unix time of its last result."""
    return Provenance(
        accounts=_each_once(each.account for each in sessions),
        hosts=_each_once(each.host for each in sessions),
        platforms=_each_once(each.platform for each in sessions),
        started=min((each.started for each in sessions), default=None),
        ended=ended,
        digest=header.config_sha256,
        file=campaign_text(header.config),
        commit=sessions[-1].revision if sessions else None,
    )


def _each_once(names: Iterable[str | None]) -> tuple[str, ...]:
    """Return the names that are known, each once, in their order."""
    return tuple(dict.fromkeys(each for each in names if each is not None))[:MOST_NAMED]
