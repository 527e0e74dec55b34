"""Which phase follows which, as the tables of the two cores say, and what stands beside the tables."""

import re
from typing import NamedTuple

from orchestrator import campaign, dispatch

NOTHING = ("-", "(ignored)")
BACK = "(back)"


class Transition(NamedTuple):
    """One change of phase by one event."""

    before: str
    event: str
    after: str


KNOWN = ("new", "idle", "sent", "busy", "shunned")
"""Phases of a worker that is alive."""
BESIDE_DISPATCH = {
    Transition("idle", "HandOut", "sent"),
    *(Transition(phase, event, "shunned") for phase in ("sent", "busy") for event in ("Unwanted", "Delivered")),
}
"""A worker gets a rollout; and its rollout is withdrawn, or recorded from another worker."""
BESIDE_CAMPAIGN = {Transition(phase, "Observed", "closed") for phase in ("running", "complete")}
"""An earlier test ends the problem."""


def of_table(text: str) -> set[Transition]:
    """Return the changes of phase in the table of a docstring: phases in the first column, events in the first line.

    Raises:
        ValueError: a line has not one cell for every event.

    """
    lines = iter(text.splitlines())
    events = next(_cells(line) for line in lines if line.split()[:1] == ["phase"])[1:]
    found = set()
    for line in lines:
        if not line.strip():
            break
        before, *cells = _cells(line)
        for event, cell in zip(events, cells, strict=True):
            after = KNOWN if cell == BACK else () if cell in NOTHING else re.split(", or |, ", cell)
            found |= {Transition(before, event, phase) for phase in after if phase != before}
    return found


def _cells(line: str) -> list[str]:
    return re.split(r"\s{2,}", line.strip())


def of_dispatch() -> set[Transition]:
    """Return every change of a worker's phase."""
    return of_table(dispatch.__doc__ or "") | BESIDE_DISPATCH


def of_legal() -> set[Transition]:
    """Return the changes of a test's phase in the table of the campaign core."""
    legal = {Transition(before, event, after) for (before, event), phases in campaign.LEGAL.items() for after in phases}
    return {each for each in legal if each.before != each.after}


def of_campaign() -> set[Transition]:
    """Return every change of a test's phase."""
    return of_legal() | BESIDE_CAMPAIGN
