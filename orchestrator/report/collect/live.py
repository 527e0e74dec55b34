"""What a campaign that has not ended has shown so far, as its page shows it."""

from dataclasses import dataclass

from ....schemas.result.facts import Header
from ....schemas.result.known import SoFar, VerdictWord
from ...certificate.words.bound_text import parameter_units
from ...certificate.words.known_text import HEAD, bar_words, consequence_of_key, holding_rows, violations_so_far
from ..data.claims import AssumptionRow, assumption_row


@dataclass(frozen=True, slots=True)
class LiveCard:
    """The two rows of what holds, the progress bar, and the assumptions that were tested."""

    at: float
    """Unix time of these numbers."""
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    """Proven so far, and expected at the end; as many cells as `head`."""
    verdict: VerdictWord
    """If the campaign ended now."""
    ahead: VerdictWord | None
    """At the end; None while it is open."""
    reason: str
    """Why it is this verdict."""
    share: float
    """Of the work, from 0 to 1."""
    bar: str
    """The meaning of the share."""
    violations: str
    """How many rollouts violate the specification so far."""
    violated: bool
    tested: tuple[AssumptionRow, ...]
    """Refuted ones first."""
    others: tuple[str, ...]
    """Ids of those that only further claims rest on."""
    then: str
    """What a refutation leads to in this campaign."""


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
