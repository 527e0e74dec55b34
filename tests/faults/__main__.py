"""`python -m tests.faults`: so many campaigns under seeded faults, or for so many minutes; a table in the end."""

import itertools
import json
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import click

from tests.faults.catalogue import FAULTS, Fault, draw, folder_of, randomness
from tests.faults.runs import Run, perform
from tests.faults.subjects import NAMES, Subject, prepare
from tests.faults.table import rows, text
from tests.faults.verdict import Verdict
from tests.missing import MISSING

BUILD = Path(__file__).parents[2] / "build"


@click.command()
@click.option("--minutes", type=float, default=None, help="No run begins after so long.  [default: 10 without --runs]")
@click.option("--runs", type=click.IntRange(1), default=None, help="Only the runs of numbers below this.")
@click.option("--seed", type=int, default=1, show_default=True, help="Of the schedule.")
@click.option("--only", type=click.Choice(sorted(FAULTS)), default=None, help="Only this class.")
@click.option("--run", "number", type=int, default=None, help="Only the run of this number.")
@click.option("--batch", type=click.IntRange(1), default=1, show_default=True, help="Rollouts of a batch.")
@click.option("--parallel", type=click.IntRange(1), default=3, show_default=True, help="Runs at a time.")
@click.option("--folder", type=click.Path(path_type=Path), default=BUILD / "faults", help="Of all that is written.")
@click.option("--resume", is_flag=True, help="Repeat no run that is recorded in the folder.")
def main(  # the options of the command
    *,
    minutes: float | None,
    runs: int | None,
    seed: int,
    only: str | None,
    number: int | None,
    batch: int,
    parallel: int,
    folder: Path,
    resume: bool,
) -> None:
    """Do faults to small campaigns; exit with 1 if one result was lost, doubled or changed, or anything is left.

    The folder gets one line of `runs.jsonl` for each run, `faults.json`, and what is left of runs that failed.
    """
    if not resume:
        shutil.rmtree(folder, ignore_errors=True)
    log = Log(folder, seed, only, batch)
    if MISSING:
        click.echo(f"skipped  segway: {MISSING}", err=True)
    subjects = _subjects(folder / "calm", [only] if only else sorted(FAULTS), batch)
    every = range(runs) if runs else itertools.count()
    numbers = [number] if number is not None else (each for each in every if each not in log.known)
    limit = minutes or (10.0 if runs is None else float("inf"))
    schedule = _schedule(numbers, seed, only, _over(limit))
    _perform_all(schedule, subjects, log, parallel)
    table = rows(log.known.values())
    (folder / "faults.json").write_text(json.dumps({"seed": seed, "classes": table}, indent=1) + "\n")
    click.echo(text(table))
    if not all(run.verdict.good for run in log.known.values()):
        sys.exit(1)


def _subjects(folder: Path, faults: Sequence[str], batch: int) -> dict[str, Subject]:
    """Return the campaigns of these classes, each with its calm run; those of an earlier invocation are used again."""
    there = [name for name in NAMES if not (name == "segway" and (MISSING or batch > 1))]
    wanted = [name for name in there if any(name in FAULTS[fault].subjects for fault in faults)]
    return {name: prepare(name, folder / name, batch) for name in wanted}


class Log:
    """The runs of one schedule, also those of an earlier invocation; for one thread at a time."""

    def __init__(self, folder: Path, seed: int, only: str | None, batch: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.seed, self.batch, self._path = folder, seed, batch, folder / "runs.jsonl"
        self.known: dict[int, Run] = {}
        head = json.dumps({"seed": seed, "only": only, "batch": batch})
        lines = self._path.read_text().splitlines() if self._path.exists() else [head]
        if lines[0] != head:
            raise click.UsageError(f"{self._path} is of {lines[0]}; choose another --folder, or leave --resume out")
        self._path.write_text("".join(f"{line}\n" for line in lines))
        for line in lines[1:]:
            found = json.loads(line)
            self.known[found["number"]] = Run(**found | {"verdict": Verdict(**found["verdict"])})

    def add(self, run: Run) -> None:
        """Keep a run, and print it."""
        self.known[run.number] = run
        with self._path.open("a") as file:
            file.write(json.dumps(asdict(run)) + "\n")
        _tell(run, self.seed, self.batch)


def _over(minutes: float) -> Callable[[], bool]:
    """Return the test whether no run shall begin: the time is over or a signal came; those under way clean up."""
    asked, end = threading.Event(), time.monotonic() + 60 * minutes
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.set())
    return lambda: asked.is_set() or time.monotonic() >= end


def _schedule(
    numbers: Iterable[int], seed: int, only: str | None, over: Callable[[], bool]
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


def _perform_all(schedule: Iterator[tuple[int, Fault]], subjects: dict[str, Subject], log: Log, parallel: int) -> None:
    """Perform the schedule, `parallel` runs at a time."""
    turn = threading.Lock()

    def serve() -> None:
        while True:
            with turn:
                following = next(schedule, None)
            if following is None:
                return
            number, fault = following
            folder = folder_of(log.folder, number)
            shutil.rmtree(folder, ignore_errors=True)  # of an invocation that was ended
            run = perform(fault, randomness(log.seed, number), subjects, folder, number=number)
            with turn:
                log.add(run)
            if run.verdict.good:
                shutil.rmtree(folder)

    with ThreadPoolExecutor(parallel) as pool:
        for each in [pool.submit(serve) for _ in range(parallel)]:
            each.result()


def _tell(run: Run, seed: int, batch: int) -> None:
    """Print one line of a run, and what is wrong with it below."""
    state = "ok" if run.verdict.good else "FAILED"
    what = "; ".join(run.done)
    click.echo(f"{run.number:4d}  {run.fault:<18} {run.subject:<9} {run.seconds:5.1f} s  {state}  {what}")
    if not run.verdict.good:
        for kind, found in asdict(run.verdict).items():
            _tell_findings(kind, found)
        again = f"--seed {seed} --batch {batch} --only {run.fault} --run {run.number}"
        click.echo(f"      again: python -m tests.faults {again}")


def _tell_findings(kind: str, found: Sequence[str]) -> None:
    for each in found[:5]:
        click.echo(f"      {kind}: {each}")
    if len(found) > 5:
        click.echo(f"      {kind}: and {len(found) - 5} more")


if __name__ == "__main__":
    main()
