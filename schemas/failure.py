"""The failure of an attempt: its reason, and whether it is one of the system under test."""

from dataclasses import dataclass
from typing import Literal

from .errors import shortened

FailureKind = Literal["infrastructure", "system"]
"""`system`: the system raised, or its trajectory was not usable. `infrastructure`: all else, such as a lost worker.

The retry after a failure of the system is a second draw. If it succeeds, good outcomes were selected, and the rollout
is not a function of its seed. Failures of the infrastructure are assumed not to depend on the outcome of the rollout.
"""


@dataclass(frozen=True, slots=True)
class Failure:
    """Why an attempt has no result; the reason may be text of a system, a file or a peer, and an excerpt is kept."""

    kind: FailureKind
    reason: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "reason", shortened(self.reason))
