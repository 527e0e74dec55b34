"""A rollout without a result: its failed attempts, the workers that come next, and the end of its retries.

An idle worker on which the rollout has not failed comes first. After a failure of the system the rollout also waits for
a busy one; where there is none, its worker is given up, so that a local one is replaced by a fresh process. A rollout
is poisoned if the system fails in it with the same reason on two workers, or twice on the only one, or if
`max_attempts` attempts fail for whatever reasons.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from .events import Fail


@dataclass(frozen=True, slots=True)
class Open:
    """A rollout that has no result yet; `avoid` is a worker that gets it only if there is no other one."""

    attempts: int = 0
    failures: tuple[Fail, ...] = ()
    avoid: str | None = None
    poisoned: bool = False

    @property
    def tried(self) -> frozenset[str]:
        """Workers after which another one says more."""
        failed = {failure.worker for failure in self.failures}
        return frozenset(failed if self.avoid is None else failed | {self.avoid})

    @property
    def waits(self) -> bool:
        """Whether it waits until another worker is idle: only a second one shows what the first result means."""
        return self.avoid is not None or any(each.failure.kind == "system" for each in self.failures)


def is_poison(failures: Sequence[Fail], max_attempts: int, *, alone: bool) -> bool:
    """Whether the last failure is one too many; `alone`: no other worker can try the rollout."""
    last = failures[-1].failure
    same = [each.worker for each in failures if each.failure == last]
    repeated = last.kind == "system" and len(same) > 1 and (alone or len(set(same)) > 1)
    return repeated or len(failures) >= max_attempts
