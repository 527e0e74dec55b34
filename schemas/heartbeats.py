"""The interval of the heartbeats of a worker: half a second, longer in a large fleet.

| symbol | name         | meaning                                          | unit |
|--------|--------------|--------------------------------------------------|------|
| N      | `workers`    | workers that are alive                           | 1    |
| h      | `hung_after` | time without progress that ends an attempt       | s    |

An interval is .5 s times a power of two: the shortest one at which the whole fleet sends at most `MOST` heartbeats a
second, but never more than h/3, so that two heartbeats in a row may be lost before a worker counts as hung. A lost
worker is found by its liveliness token, whatever the interval. Standard library only.
"""

HEARTBEAT = 0.5
"""Seconds between two heartbeats of a worker that got no other interval; it sends one on each change, too."""
MOST = 250
"""Heartbeats of a fleet in a second, some hundredths of a core of the orchestrator; more where h is too short."""


def heartbeat_interval(workers: int, hung_after: float) -> float:
    """Return the seconds between two heartbeats of each of `workers` workers.

    >>> [heartbeat_interval(workers, hung_after=60.0) for workers in (1, 125, 126, 1000, 10_000)]
    [0.5, 0.5, 1.0, 4.0, 16.0]
    >>> heartbeat_interval(1000, hung_after=10.0)
    2.0
    """
    interval = HEARTBEAT
    # Powers of two: a worker that comes or goes seldom changes the interval of all others.
    while workers > MOST * interval and 2 * interval <= hung_after / 3:
        interval *= 2
    return interval


def is_near(interval: float, wanted: float) -> bool:
    """Whether a worker may keep its interval, which is not too short, and not more than twice the wanted one.

    Without that margin one worker that comes and goes would change the interval of all others each time.
    """
    return wanted <= interval <= 2 * wanted
