"""A rollout without a result: its failed attempts, the workers that come next, and the end of its retries.

The retry goes to a worker of another host; where none lives, to another worker; where there is none either, to the
same. Among those of another host, one whose host has recorded a rollout and that is not failing itself comes first. The
retry waits for the best of these while that one is busy: a second failure says more the less it shares with the first,
and bad machines, which are idle most of the time, cannot use up the attempts. If a failure that blames the rollout hits
the only worker, this one is given up, so that a local one is replaced by a fresh process. It is the only one once no
other worker is expected (`waits`).

A failure blames its rollout if the system failed, or if the attempt missed its deadline: a system that does not end
would cost a deadline per attempt. Two of these that are alike, from two workers or from the only one, poison the
rollout. So do `max_attempts` failures of any kind on hosts that have recorded rollouts; or on any, once no worker of
another host lives. Failures that set their worker or host aside (`standing`) do not count.

Failures that blame the rollout are kept through a restart, since the system is the same: after a resume one more that
is alike, of another worker, is poison. Other failures begin anew, since the machines may have been repaired.
"""

import math
from collections.abc import Container
from dataclasses import dataclass

from ....schemas.failure import Failure
from ....schemas.ids import Attempt
from .events import Fail, Opinion
from .limits import Limits

ELSEWHERE, SAME_HOST, SAME_WORKER = range(3)
"""Ranks of the workers for a retry."""
NOT_YET, OVER = math.inf, -math.inf
"""Values of `Open.waits_until` before the wait for another worker, and after it."""


@dataclass(frozen=True, slots=True)
class Open:
    """A rollout that has no result yet; `avoid` is a worker that gets it only if there is no other one."""

    attempts: int = 0
    failures: tuple[Fail, ...] = ()
    hosts: tuple[str, ...] = ()
    """Of the failures, in their order."""
    excused: frozenset[Attempt] = frozenset()
    """Failed attempts that do not count: their workers or hosts were set aside."""
    avoid: str | None = None
    compare: bool = False
    """Whether it needs a second opinion."""
    opinions: tuple[Opinion, ...] = ()
    poisoned: bool = False
    handed_back: int = 0
    """Attempts that ended because their workers did."""
    waits_until: float = NOT_YET
    """The end of its wait for another worker, at the latest."""
    renewed: bool = False
    """Whether the worker that repeats it has been given up since that wait."""

    def rank(self, worker: str, host: str) -> int:
        """Return how much a worker shares with those that failed or shall be avoided: the lowest comes first."""
        names = {self.avoid, *(each.worker for each in self.failures), *(each.worker for each in self.opinions)}
        if worker in names:
            return SAME_WORKER
        tried = host in self.hosts or any(each.host == host for each in self.opinions)
        return SAME_HOST if tried else ELSEWHERE

    @property
    def is_fresh(self) -> bool:
        """Whether any worker may simulate it as well as any other."""
        return not (self.failures or self.opinions) and self.avoid is None

    @property
    def is_waiting(self) -> bool:
        """Whether it waits for another worker."""
        return math.isfinite(self.waits_until)

    def is_blamed(self, deadline: float) -> bool:
        """Whether a failure that counts says something about it; `deadline` of a rollout in s."""
        counted = (each for each in self.failures if each.attempt not in self.excused)
        return any(blames_rollout(each.failure, deadline) for each in counted)


def missed(deadline: float, rollouts: int = 1) -> Failure:
    """Return the failure of an attempt that exceeds its deadline, in s for each of its rollouts."""
    each = f" for each of its {rollouts} rollouts" if rollouts > 1 else ""
    return Failure("infrastructure", f"not done after {deadline:g} s{each}")


def blames_rollout(failure: Failure, deadline: float) -> bool:
    """Whether a failure says something about its rollout, and not about its worker alone."""
    # Not a crash: kill -9, the memory killer and a segmentation fault look alike, and each would blame its rollout.
    return failure.kind == "system" or failure.reason.startswith(missed(deadline).reason)


def is_poison(known: Open, limits: Limits, *, proven: Container[str], alone: bool, elsewhere: bool) -> bool:
    """Whether the last failure is one too many; `proven` are the hosts that have recorded rollouts.

    `alone`: no other worker can try the rollout; `elsewhere`: a worker of a host on which it has not failed can.
    """
    counted = [
        (each, host)
        for each, host in zip(known.failures, known.hosts, strict=True)
        if each.attempt not in known.excused
    ]
    last = known.failures[-1]
    if last.attempt in known.excused:
        return False
    alike = [each.worker for each, _ in counted if each.failure == last.failure]
    # One may come of a broken machine, which must not end the campaign; after two a third attempt teaches nothing.
    if blames_rollout(last.failure, limits.deadline) and len(alike) > 1 and (alone or len(set(alike)) > 1):
        return True
    # Broken machines are mostly idle: they would use up the attempts before a good one ends its first rollout.
    reliable = [each for each, host in counted if host in proven or not elsewhere]
    return len(reliable) >= limits.max_attempts
