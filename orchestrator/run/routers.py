"""The routers between a run and its workers: their lines in the log, and the events for the dispatch machine."""

from collections.abc import Callable
from dataclasses import dataclass

from ...schemas.link.reminder import Reminder
from ..certificate.words.format import duration
from ..fleet.dispatch import events
from ..fleet.link.transport import Linked, RouterToken

UNSEEN = 10.0
"""Seconds for the token of a router, which comes with the link."""


@dataclass(frozen=True, slots=True)
class RouterLink:
    """The link to the router; an orchestrator that listens for its workers has none."""

    down_for: float | None
    """Seconds without a link; None while there is one."""
    routers: int
    """Those that show themselves by a token: the one of the link, and those that it is connected with."""


def is_down(link: RouterLink | None) -> bool:
    """Whether an orchestrator behind a router reaches none."""
    return link is not None and link.down_for is not None


class Routers:
    """The routers that one run knows."""

    def __init__(self, print_line: Callable[[str], None]) -> None:
        self._print_line = print_line
        self._known: set[str] = set()
        self._is_linked = False
        """Whether this run has, or had, a link to a router."""
        self._down_since: float | None = None
        self._expected: Reminder | None = None
        """Of a link behind which no router has shown itself yet."""

    def take(self, message: RouterToken | Linked) -> events.RouterChanged | events.LinkChanged:
        """Take a change, and return its event."""
        if isinstance(message, Linked):
            self._say(message)
            return events.LinkChanged(message.at, message.grace, message.up)
        if message.alive:
            self._known.add(message.router)
            self._expected = None
        elif message.router in self._known:
            self._known.remove(message.router)
            # Without its own link the orchestrator sees no router; the line of the link says so.
            if self._known:
                self._print_line(f"a router has ended: workers behind it have {duration(message.grace)} to return")
        return events.RouterChanged(message.at, message.grace)

    def link(self, now: float) -> RouterLink | None:
        """Return the link to the router; None without one."""
        if not self._is_linked:
            return None
        return RouterLink(None if self._down_since is None else now - self._down_since, len(self._known))

    def reminder(self, now: float) -> tuple[str, ...]:
        """Return the line that no router shows itself, if it is due; called every tick."""
        if self._expected is None or not self._expected.is_due(now):
            return ()
        return (
            "connected, but no router of perfbound shows itself: one that was started with --allow... must list "
            "the common name of this certificate as --allow-orchestrator",
        )

    def _say(self, message: Linked) -> None:
        self._is_linked = True
        self._expected = Reminder(UNSEEN, now=message.at) if message.up and not self._known else None
        if not message.up:
            self._down_since = message.at
            self._print_line("the link to the router is down: no worker is given up until it is there again")
        elif self._down_since is not None:
            away = duration(message.at - self._down_since)
            self._down_since = None
            self._print_line(f"the link to the router is there again after {away}")
