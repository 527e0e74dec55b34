"""Transitions of the two machines, from their legality tables."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from perfbound.orchestrator.campaign import state
from perfbound.orchestrator.fleet.dispatch import machine


class Transition(NamedTuple):
    """One change of phase by one event."""

    before: str
    event: str
    after: str


BESIDE_CAMPAIGN = {Transition(phase, "Observed", "closed") for phase in ("running", "complete")}
"""An earlier test ends the problem."""


def of_dispatch() -> set[Transition]:
    """Return every change of a worker's phase."""
    return _changes(machine.LEGAL) | _changes(machine.SIDE_EFFECTS)


def _changes(table: Mapping[Any, Sequence[str]]) -> set[Transition]:
    found = {Transition(before, event, after) for (before, event), phases in table.items() for after in phases}
    return {each for each in found if each.before != each.after}


def of_legal() -> set[Transition]:
    """Return the changes of a test's phase in the table of the campaign core."""
    return _changes(state.LEGAL)


def of_problem() -> set[Transition]:
    """Return the changes of a problem's standing."""
    return _changes(state.LEGAL_OF_PROBLEM)


def of_campaign() -> set[Transition]:
    """Return every change of a test's phase."""
    return of_legal() | BESIDE_CAMPAIGN
