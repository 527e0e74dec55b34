"""Cards at the head of the page, apart from the collector of numbers: what a campaign has shown, and its origin.

The origin is who ran the campaign, when, on which machines, from which campaign file.
"""

from collections.abc import Iterable, Sequence

from ....schemas.file.config import campaign_text
from ....schemas.result.facts import Header
from ....schemas.result.known import SoFar
from ...certificate.words.bound_text import parameter_units
from ...certificate.words.known_text import HEAD, bar_words, consequence_of_key, holding_rows, violations_so_far
from ...store.changes import Session
from ..data.claims import assumption_row
from ..data.page import LiveCard, Provenance

MOST_NAMED = 8
"""Accounts, hosts and platforms of each kind that the data name."""


def live_card(found: SoFar | None, header: Header, *, running: bool) -> LiveCard | None:
    """Return the card of a campaign without certificate; None where its orchestrator has written nothing yet."""
    if found is None or found.run != header.run:
        return None
    units = parameter_units(header.spec)
    return LiveCard(
        at=found.at,
        head=HEAD,
        rows=tuple(map(tuple, holding_rows(found, running=running))),
        verdict=found.verdict,
        ahead=found.expected.verdict,
        reason=" ".join(found.reasons),
        share=found.expected.share,
        bar=bar_words(found.expected),
        violations=violations_so_far(found),
        violated=found.violations.violations > 0,
        tested=tuple(assumption_row(each, units) for each in found.assumptions),
        others=found.others,
        then=consequence_of_key(found.on_refuted),
    )


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
