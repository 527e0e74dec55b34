"""Findings about what rollouts cost and leave behind."""

from collections.abc import Sequence
from statistics import median

from ....schemas.system_check import ChildRun, Measured
from ..size import proposed_batch
from .findings import SystemFinding, passed, warning
from .measurements import Measurements

GROWTH_MARGIN = 2**19
"""Bytes by which the memory of a process may grow without a leak: arenas of the allocator, caches that fill."""
FEWEST = 24
"""Rollouts from which the growth of memory is judged."""
CAMPAIGN, ROOM = 10_000, 8 * 2**30
"""A worker that would need this many bytes after this many rollouts does not survive a campaign."""

GROWING = 3
"""Threads by which a process grows in the second half of its rollouts, if each leaves one; a pool may fill up late."""


def judge_memory(measurements: Measurements) -> SystemFinding | None:
    """Judge the memory of a process over its rollouts."""
    measured = max((run.measured for run in measurements.runs), key=len, default=())
    if not measured:
        return None
    peak = f"a process takes at most {max(found.peak for found in measured) / 1e6:.0f} MB"
    if len(measured) < FEWEST:
        return passed("memory", f"{peak}; growth was not judged over only {len(measured)} rollouts")
    memory = [found.memory for found in measured]
    quarter = len(memory) // 4
    rises = [_rise(memory, quarter, place, place) for place in range(2 * quarter, len(memory) - quarter + 1)]
    # From the highest level of the second quarter to the lowest of the last, but for the largest rise of one rollout:
    # a level that is reached once, as when a compiler meets another horizon, is no growth.
    growth = _rise(memory, quarter, 2 * quarter, len(memory) - quarter) - max(*rises, 0)
    each = growth / (len(memory) - 3 * quarter)
    if growth <= GROWTH_MARGIN:
        return passed("memory", f"{peak}; no growth over {len(memory)} rollouts")
    lost = each * CAMPAIGN > ROOM
    text = f"{peak}; it grows by about {each / 1000:,.0f} kB a rollout"
    return SystemFinding(
        "memory",
        "failed" if lost else "warning",
        f"{text}, {each * CAMPAIGN / 1e9:.1f} GB in {CAMPAIGN:,} rollouts",
        "free what a rollout makes: clear lists and caches, close figures, simulators and files at its end",
    )


def _rise(memory: Sequence[int], begin: int, middle: int, end: int) -> int:
    """Return by how much all levels from `end` on are above all those between `begin` and `middle`."""
    return min(memory[end:]) - max(memory[begin:middle])


def judge_output(measurements: Measurements) -> SystemFinding | None:
    """Judge what the rollouts print."""
    if not measurements.rolled:
        return None
    printing = [found.printed for _, found in measurements.rolled if found.printed]
    if not printing:
        return passed("output", "rollouts print nothing")
    said = next((run.printed for run in measurements.runs if run.printed), "")
    if all(sum(bool(found.printed) for found in run.measured) <= 1 for run in measurements.runs):
        return passed("output", f"one text in each process, at its first use: {said!r}")
    text = f"{len(printing)} of {len(measurements.rolled)} rollouts print, {median(printing):.0f} bytes each: {said!r}"
    remedy = "remove the print, or write to a logger: it costs time, and nobody reads the stdout of a worker"
    return warning("output", text, remedy)


def judge_leftovers(measurements: Measurements) -> SystemFinding | None:
    """Judge the files, threads and processes that stay after a rollout."""
    if not measurements.rolled:
        return None
    files = sorted({name for run in measurements.runs for name in _new_files(run)})
    threads = sorted({name for run in measurements.runs for found in run.measured[-1:] for name in found.threads})
    growing = [
        run for run in measurements.runs if run.measured and run.measured[-1].tasks >= _half(run).tasks + GROWING
    ]
    processes = sorted({name for run in measurements.runs for found in run.measured for name in found.processes})
    if processes:
        return warning(
            "leftovers",
            f"processes run on after a rollout: {_few(processes)}",
            "end every process, and wait for it, before the rollout returns: what runs on takes time from others",
        )
    if files:
        return warning(
            "leftovers",
            f"new files: {_few(files)}",
            "write no files in a rollout, or into the folder of its worker: workers share a folder",
        )
    if threads or growing:
        names = f": {_few(threads)}" if threads else ""
        count = "more with every rollout" if growing else "as many after the last rollout as after the first"
        return warning(
            "leftovers",
            f"threads run on after a rollout, {count}{names}",
            "end and join every thread and pool before the rollout returns: what runs on changes times and results",
        )
    return passed("leftovers", "none")


def _new_files(run: ChildRun) -> set[str]:
    first = {name for found in run.measured[:1] for name in found.files}
    later = {name for found in run.measured[1:] for name in found.files}
    # Libraries may fill a cache in the temporary directory at their first use.
    return later | {name for name in first if not name.startswith("$TMPDIR")}


def _half(run: ChildRun) -> Measured:
    return run.measured[len(run.measured) // 2]


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def judge_speed(measurements: Measurements) -> SystemFinding | None:
    """Inform about time and size."""
    if not measurements.good:
        return None
    # The first rollout of a process loads what later ones find loaded.
    later = [found.seconds for run in measurements.runs for found in run.measured[1:] if not found.error]
    seconds = median(later or [found.seconds for _, found in measurements.good])
    size = max(found.file_bytes for _, found in measurements.good)
    rate, workers = 1 / max(seconds, 1e-9), measurements.processors
    text = f"{seconds * 1000:.3g} ms a rollout, {size / 1000:,.0f} kB its file"
    rates = f"about {_rate_text(rate)} rollouts/s from 1 worker, at most {_rate_text(rate * workers)} from {workers}"
    return passed("speed", f"{text}; {rates} (the processors of this machine){_batch_text(measurements, seconds)}")


def _batch_text(measurements: Measurements, seconds: float) -> str:
    """Return which batch is proposed; nothing where a batch would not pay, or rollouts cannot share a time grid."""
    batched = [found.seconds for found in measurements.batched.measured] if measurements.batched else []
    in_batch = max(batched, default=seconds)
    grids = {found.grid for _, found in measurements.good}
    # In a batch a rollout is its samples, and no pictures.
    size = 8 * max(grid.samples for grid in grids if grid) * len(measurements.spec.columns)
    batch = proposed_batch(in_batch, size, measurements.undecided, measurements.processors)
    if batch == 1 or len(grids) > 1:
        return ""
    # A rollout of its own costs the campaign some milliseconds more than its simulation.
    cost = f"about {in_batch * 1000:.2g} ms" if in_batch else "too little to be measured"
    added = f", of which one more costs {cost}" if batched else ""
    return f"; with the key batch = {batch} a campaign simulates so many at once{added}"


def _rate_text(rate: float) -> str:
    return f"{rate:,.0f}" if rate >= 10 else f"{rate:.2g}"
