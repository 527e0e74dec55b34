"""`make mutants`: change the product in a seeded sample of places, and print which changes the tests notice.

Mutants are judged in copies of the work tree below build/mutants; a killed run continues where it stopped.
"""

import argparse
import fcntl
import json
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

from tests.studies.command import ended
from tests.studies.mutants.judge import ROOT, BaselineError, Judge, Tree, digest
from tests.studies.mutants.results import (
    SURVIVED,
    Judgement,
    Mutant,
    append,
    equivalents,
    is_equivalent,
    judgements,
    line,
    share,
)
from tests.studies.mutants.stages import LAST, stages

FOLDER = ROOT / "build" / "mutants"
CHANGES = Path(f"{sys.prefix}-mutants/bin/python")


@dataclass
class Run:
    """A sample while it is judged: threads share it."""

    judge: Judge
    last: int
    found: dict[str, list[Judgement]]
    trees: "queue.Queue[Tree]" = field(default_factory=queue.Queue)
    writing: threading.Lock = field(default_factory=threading.Lock)

    def one(self, mutant: Mutant) -> None:
        """Run the stages that the mutant has not met, up to the first that catches it."""
        tree = self.trees.get()
        try:
            found = self.found.setdefault(mutant.key, [])
            for stage in stages(mutant.path, tree.folder):
                met = {each.stage for each in found}
                if stage.number > self.last or any(each.outcome != SURVIVED for each in found):
                    return
                if stage.number not in met:
                    self._write(self.judge.judge(tree, mutant, stage))
        finally:
            self.trees.put(tree)

    def _write(self, judgement: Judgement) -> None:
        with self.writing:
            self.found[judgement.mutant].append(judgement)
            append(FOLDER / "results.jsonl", judgement)


def main() -> int:
    """Take the sample, judge it, print; return the exit code."""
    options = _options()
    FOLDER.mkdir(parents=True, exist_ok=True)
    with (FOLDER / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            sys.stderr.write(f"mutants: another run uses {FOLDER}; choose a time after its end\n")
            return 1
        trees = [Tree(FOLDER / f"tree-{number}") for number in range(1 if options.show else options.at_once)]
        mutants, code = _sample(options.seed, options.number, trees[0]), digest(trees[0].folder)
        listed = equivalents()
        counted = [each for each in mutants if not is_equivalent(each, listed)]
        run = Run(Judge(code, FOLDER / "usual.json"), options.stages, judgements(FOLDER / "results.jsonl", code))
        if options.show:
            for each in counted:
                _print(line(each, run.found.get(each.key, ()), options.stages))
        else:
            _judge(run, counted, trees)
        for each in mutants:
            if each not in counted:
                _print(f"{each}: equivalent, not counted")
        _print(share(counted, run.found, options.stages))
    return 0


def _judge(run: Run, mutants: Sequence[Mutant], trees: Sequence[Tree]) -> None:
    for tree in trees:
        run.trees.put(tree)
    with ThreadPoolExecutor(len(trees)) as pool:
        futures = {pool.submit(run.one, each): each for each in mutants}
        try:
            for future in as_completed(futures):
                future.result()
                _print(line(futures[future], run.found[futures[future].key], run.last))
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for tree in trees:
                tree.stop()


def _sample(seed: int, number: int, tree: Tree) -> list[Mutant]:
    command = [str(CHANGES), "-m", "tests.studies.mutants.changes", f"--seed={seed}", f"--number={number}"]
    return [Mutant(**each) for each in json.loads(subprocess.check_output(command, cwd=tree.folder))]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.mutants", description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, default=1, help="of the sample (default: 1)")
    parser.add_argument("--number", type=int, default=60, help="mutants (default: 60)")
    parser.add_argument("--stages", type=int, choices=range(1, LAST + 1), default=LAST, help="the last one that is run")
    parser.add_argument("--at-once", type=int, choices=(1, 2), default=2, help="mutants at once (default: 2)")
    parser.add_argument("--show", action="store_true", help="run nothing; only show what earlier runs have found")
    return parser.parse_args()


def _print(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(ended(main, BaselineError))
