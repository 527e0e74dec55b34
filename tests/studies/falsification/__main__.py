"""`python -m tests.studies.falsification [BENCHMARK ...] --write docs/falsification.md`: run what is missing."""

import argparse
import sys
from pathlib import Path

from perfbound.schemas.platforms import one_blas_thread
from tests.studies.command import ended
from tests.studies.pages import PageError

one_blas_thread()

from tests.studies.falsification.figure import draw_beside  # noqa: E402  (numpy reads the setting once)
from tests.studies.falsification.page import medians, write  # noqa: E402
from tests.studies.falsification.registry import benchmarks  # noqa: E402
from tests.studies.falsification.study import (  # noqa: E402
    BUDGET,
    FINAL,
    PROCESSES,
    RESULTS,
    SEARCHES,
    measure,
    read,
    runs,
)


def main() -> int:
    """Run what is missing, print, write; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.falsification", description=__doc__)
    names = dict.fromkeys(each.name for each in benchmarks())
    parser.add_argument("benchmarks", nargs="*", metavar="BENCHMARK", help="all if there is none: " + ", ".join(names))
    parser.add_argument("--instance", type=int, nargs="+", default=[1, 2], help="1, 2 or both (default: both)")
    parser.add_argument("--search", nargs="+", default=SEARCHES, help="default: " + "; ".join(SEARCHES))
    parser.add_argument("--seeds", type=int, nargs=2, metavar=("FIRST", "AFTER"), default=[FINAL.start, FINAL.stop])
    parser.add_argument("--budget", type=int, default=BUDGET, help="simulations of a search (default: %(default)s)")
    parser.add_argument("--processes", type=int, default=PROCESSES, help="default: %(default)s")
    parser.add_argument("--results", type=Path, default=RESULTS, help="default: %(default)s")
    parser.add_argument("--write", type=Path, help="page whose tables are written anew")
    options = parser.parse_args()
    if unknown := set(options.benchmarks) - set(names):
        parser.error(f"no such benchmark: {', '.join(sorted(unknown))}")
    seeds = range(*options.seeds)
    wanted = runs(options.benchmarks, options.instance, options.search, seeds, options.budget)
    for row in measure(wanted, options.results, options.processes):
        run = row.run
        words = f"{row.simulations}" if row.found else f"not in {row.simulations}"
        sys.stderr.write(f"{run.benchmark} {run.instance} {run.search} {run.seed}: {words}, {row.cpu_ms} ms\n")
    rows = read(options.results)
    asked = set(wanted)
    sys.stdout.write(medians([row for row in rows if row.run in asked]))
    if options.write is not None:
        write(options.write, rows)
        draw_beside(options.write, rows)
    return 0


if __name__ == "__main__":
    sys.exit(ended(main, PageError))
