"""`python -m tests.faults`: campaigns under seeded faults for so many minutes; a table in the end."""

import itertools
import json
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import click

from tests.faults.catalogue import FAULTS, Fault, draw, folder_of, randomness
from tests.faults.runs import Run, perform
from tests.faults.subjects import NAMES, Subject, prepare
from tests.faults.table import rows, text
from tests.missing import MISSING

BUILD = Path(__file__).parents[2] / "build"


@click.command()
@click.option("--minutes", type=float, default=10.0, show_default=True, help="No run begins after so long.")
@click.option("--seed", type=int, default=1, show_default=True, help="Of the schedule.")
@click.option("--only", type=click.Choice(sorted(FAULTS)), default=None, help="Only this class.")
@click.option("--run", "number", type=int, default=None, help="Only the run of this number.")
@click.option("--parallel", type=click.IntRange(1), default=3, show_default=True, help="Runs at a time.")
def main(*, minutes: float, seed: int, only: str | None, number: int | None, parallel: int) -> None:
    """Do faults to small campaigns; exit with 1 if one result was lost, doubled or changed, or anything is left."""
    base = BUILD / "faults"
    shutil.rmtree(base, ignore_errors=True)
    names = [name for name in NAMES if not (name == "segway" and MISSING)]
    if len(names) < len(NAMES):
        click.echo(f"skipped  segway: {MISSING}", err=True)
    subjects = {name: prepare(name, base / "calm" / name) for name in names}
    numbers = itertools.count() if number is None else iter([number])
    schedule = _schedule(numbers, seed, only, _over(minutes))
    done = _perform_all(schedule, seed, subjects, base, parallel)
    table = rows(done)
    (BUILD / "faults.json").write_text(json.dumps({"seed": seed, "classes": table}, indent=1) + "\n")
    click.echo(text(table))
    if not all(run.verdict.good for run in done):
        sys.exit(1)
    shutil.rmtree(base)


def _over(minutes: float) -> Callable[[], bool]:
    """Return the test whether no run shall begin: the time is over or a signal came; those under way clean up."""
    asked, end = threading.Event(), time.monotonic() + 60 * minutes
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.set())
    return lambda: asked.is_set() or time.monotonic() >= end


def _schedule(
    numbers: Iterator[int], seed: int, only: str | None, over: Callable[[], bool]
) -> Iterator[tuple[int, Fault]]:
    """Yield the runs until the end; a fault that the machine cannot do is reported once, and skipped."""
    told = set()
    for number in numbers:
        fault = FAULTS[only] if only else draw(seed, number)
        if over():
            return
        reason = fault.missing()
        if not reason:
            yield number, fault
        elif fault.name not in told:
            told.add(fault.name)
            click.echo(f"skipped  {fault.name}: {reason}", err=True)
        if reason and only:
            return


def _perform_all(
    schedule: Iterator[tuple[int, Fault]], seed: int, subjects: dict[str, Subject], base: Path, parallel: int
) -> list[Run]:
    """Perform the schedule, `parallel` runs at a time."""
    done: list[Run] = []
    turn = threading.Lock()

    def serve() -> None:
        while True:
            with turn:
                following = next(schedule, None)
            if following is None:
                return
            number, fault = following
            folder = folder_of(base, number)
            run = perform(fault, randomness(seed, number), subjects, folder, number=number)
            with turn:
                done.append(run)
                _tell(run, seed)
            if run.verdict.good:
                shutil.rmtree(folder)

    with ThreadPoolExecutor(parallel) as pool:
        for each in [pool.submit(serve) for _ in range(parallel)]:
            each.result()
    return sorted(done, key=lambda run: run.number)


def _tell(run: Run, seed: int) -> None:
    """Print one line of a run, and what is wrong with it below."""
    state = "ok" if run.verdict.good else "FAILED"
    what = "; ".join(run.done)
    click.echo(f"{run.number:4d}  {run.fault:<18} {run.subject:<9} {run.seconds:5.1f} s  {state}  {what}")
    if not run.verdict.good:
        for kind, found in asdict(run.verdict).items():
            _tell_findings(kind, found)
        click.echo(f"      again: python -m tests.faults --seed {seed} --only {run.fault} --run {run.number}")


def _tell_findings(kind: str, found: Sequence[str]) -> None:
    for each in found[:5]:
        click.echo(f"      {kind}: {each}")
    if len(found) > 5:
        click.echo(f"      {kind}: and {len(found) - 5} more")


if __name__ == "__main__":
    main()
