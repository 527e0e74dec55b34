"""The link of an orchestrator to its routers at one moment, for listeners."""

from dataclasses import dataclass


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
