"""The limits of the dispatch machine; apart from its state, whose parts need them, too."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Limits:
    """Time limits in seconds, failed attempts that poison a rollout, and failures that set a worker or host aside."""

    resend_after: float = 1.5
    lost_after: float = 3.0
    hung_after: float = 10.0
    deadline: float = 600.0
    max_attempts: int = 5
    others_within: float = 60.0
    """A worker repeats what it has tried only if no other one comes in this time: longer than the default grace."""
    in_a_row: int = 3
    """Rollouts: two may fail by one cause, such as a network that is cut twice; a third is rarely chance."""
    first_pause: float = 30.0
    """Longer than the restart of a worker, a supervisor's delay included, and short beside a campaign of minutes."""
    longest_pause: float = 1800.0
    """A repaired machine is of use again within half an hour; a broken one costs two attempts an hour."""
