"""When a worker ends by itself, and when it leaves a run: decisions on times alone, in seconds of any one clock."""

from dataclasses import dataclass

IDLE_EXIT = 600.0
"""Seconds without a campaign after which a worker with --until-done ends."""
STOP_WITHIN = 25.0
"""Seconds for the rollout under way after SIGTERM: with DELIVERY less than the 30 s before a scheduler's SIGKILL."""
DELIVERY = 3.0
"""Seconds after that in which what is handed back is acknowledged."""
RUN_GONE = 5.0
"""Seconds without its orchestrator after which an idle worker may join another campaign."""
OUTBOX_KEPT = 600.0
"""Seconds without its orchestrator after which undelivered results are given up."""
LINK_GRACE = 30.0
"""Seconds in which, after a router, the orchestrator behind it is announced again."""


@dataclass(frozen=True, slots=True)
class EndOptions:
    """When a worker ends by itself."""

    until_done: bool = False
    """When the campaign that it served has its certificate, and no other one is announced."""
    idle_exit: float | None = None
    """After so many seconds without a campaign."""
    max_seconds: float | None = None
    """From the start: then it takes no new rollout."""
    stop_within: float = STOP_WITHIN
    """Seconds for the rollout under way after SIGTERM."""

    @classmethod
    def of(
        cls, *, until_done: bool, idle_exit: float | None, max_hours: float | None, stop_within: float
    ) -> "EndOptions":
        """Return the options of a command line."""
        patience = IDLE_EXIT if idle_exit is None and until_done else idle_exit
        return cls(until_done, patience, None if max_hours is None else 3600 * max_hours, stop_within)

    def is_idle_for_too_long(self, seconds: float) -> bool:
        """Whether a worker ends that has been without a campaign for so long."""
        return self.idle_exit is not None and seconds >= self.idle_exit

    def is_over(self, seconds: float) -> bool:
        """Whether a worker that was started so long ago takes no new rollout."""
        return self.max_seconds is not None and seconds >= self.max_seconds


def gone_since(before: float, now: float, *, present: bool, linked: bool) -> float:
    """Return from when on a run counts as without its orchestrator; `before` is what this returned last.

    While the link of the worker is down, nothing is known of the orchestrator: the time starts `LINK_GRACE` s after it
    is up again.

    >>> gone_since(10.0, 12.0, present=True, linked=True), gone_since(10.0, 12.0, present=False, linked=True)
    (12.0, 10.0)
    >>> gone_since(10.0, 12.0, present=False, linked=False)
    42.0
    """
    if present:
        return now
    return before if linked else now + LINK_GRACE


def is_abandoned(absent: float, *, outbox_empty: bool) -> bool:
    """Whether a worker leaves a run whose orchestrator has been absent for so many seconds."""
    return absent > (RUN_GONE if outbox_empty else OUTBOX_KEPT)
