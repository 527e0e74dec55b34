"""A rollout that went wrong beside others, simulated alone: whether workers of one machine disturb one another."""

import hashlib
import tempfile
from pathlib import Path

from ...schemas.errors import PerfboundError
from ...schemas.rollout import RolloutRequest
from ...schemas.system import SystemSpec
from ..campaign.admission import admit
from ..fleet.children.simulate import simulate_to


class PoisonedError(PerfboundError):
    """A rollout fails again and again."""

    def __init__(self, text: str, request: RolloutRequest | None) -> None:
        super().__init__(text)
        self.request = request


LONGEST = 60.0
"""Seconds for each of the two repetitions."""
COLLISION = (
    "alone it gives one trajectory, twice: rollouts of workers of one machine seem to collide, something that it reads "
    "has changed since, or a rollout before it has left something in its process. Give each worker its own files, "
    "ports and locks (the argument `worker` of a function, PERFBOUND_SCRATCH, PERFBOUND_PORT and PERFBOUND_WORKER of a "
    "program), or run one worker on each machine, and declare the `files` that it reads; perfbound check-system runs "
    "two at a time, and names these files"
)


def is_collision(request: RolloutRequest, spec: SystemSpec, reference: str, *, limit: float) -> bool:
    """Whether a rollout that failed or differed beside others repeats alone: two new processes give equal bytes.

    They have to be bytes that the campaign takes: what it refuses is wrong alone, too.
    No other rollout of the campaign may be under way. `limit` is the deadline of a rollout in s.
    """
    found, columns = [], tuple(column.name for column in spec.columns)
    with tempfile.TemporaryDirectory(prefix="perfbound-alone-") as folder:
        for number in range(2):
            path = Path(folder, str(number))
            try:
                simulate_to(path, request, spec, reference, limit=min(limit, LONGEST))
                payload = path.read_bytes()
                admit(request, columns, payload, hashlib.sha256(payload).hexdigest())
            except PerfboundError:
                return False
            found.append(payload)
    return found[0] == found[1]
