"""The feed of a live page: what the orchestrator sends to its process once a second, and no database contains.

A message is sent whole or not at all, and the kernel takes 200 kB of them; so their size is bounded.
"""

import json
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

from ...store.commit_times import CommitTimes
from ..routers import RouterLink

if TYPE_CHECKING:
    from ..service import RunStatus

MOST_WORKERS = 500
"""Workers in a message by name; `phases` counts all."""


class LiveState(NamedTuple):
    """The current state of a worker, from its orchestrator; `heartbeat` is a Unix time."""

    state: str
    rollout: str | None = None
    heartbeat: float | None = None


@dataclass(frozen=True, slots=True)
class RunFigures:
    """The state of a run at one moment, as far as its database lacks it."""

    at: float
    """Unix time."""
    workers: Mapping[str, LiveState]
    phases: Mapping[str, int]
    """Number of workers by phase, "set aside" and "out of reach" among them."""
    waiting: int
    """Rollouts without a worker."""
    under_way: int
    """Rollouts that workers simulate."""
    messages: int
    """Those received that wait for the loop."""
    commits: CommitTimes
    done: bool
    """Whether only the certificate is left."""
    link: RouterLink | None = None
    """To the router; None without one."""


def figures_of(status: "RunStatus") -> RunFigures:
    """Return what a message has of a status."""
    now = time.time()
    to_unix, workers = now - time.monotonic(), {}
    for name, phase in islice(status.workers.items(), MOST_WORKERS):
        known = status.known.get(name)
        state = "busy" if phase == "sent" else phase
        rollout = known.state.rollout if known and known.state and state == "busy" else None
        workers[name] = LiveState(state, rollout, known.last_heartbeat + to_unix if known else None)
    loop, phases = status.loop, dict(Counter(status.workers.values()))
    figures = RunFigures(now, workers, phases, status.waiting, status.under_way, loop.messages, loop.commits, loop.done)
    return replace(figures, link=status.link)


def message(status: "RunStatus") -> bytes:
    """Return a message of the feed."""
    return json.dumps(asdict(figures_of(status))).encode()


def read_message(message: bytes) -> RunFigures:
    """Return what a message of the feed says."""
    found = json.loads(message)
    workers = {name: LiveState(*state) for name, state in found.pop("workers").items()}
    commits, link = found.pop("commits"), found.pop("link")
    times = CommitTimes(tuple(commits["numbers"]), commits["seconds"])
    return RunFigures(workers=workers, commits=times, link=link and RouterLink(**link), **found)
