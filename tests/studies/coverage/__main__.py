"""`make coverage`: run the campaigns that are missing, print the table, exit 1 if a bound fails too often."""

import argparse
import os
import sys
from pathlib import Path

from perfbound.schemas.platforms import one_blas_thread
from tests.studies.command import ended
from tests.studies.pages import PageError

one_blas_thread()

from tests.studies.coverage.page import collect, tables, write  # noqa: E402  (numpy reads the setting once)
from tests.studies.coverage.run import run  # noqa: E402
from tests.studies.coverage.study import all_rows  # noqa: E402


def main() -> int:
    """Run, print, write; return the exit code."""
    options = _options()
    rows = [row for row in all_rows() if options.kind in {None, row.kind}]
    if not options.show:
        run(rows, options.campaigns, options.workers)
    found = collect(rows, options.campaigns)
    sys.stdout.write(tables(found))
    if options.write is not None:
        write(options.write, found)
    failed = [each.row for each in found if each.fails]
    for row in failed:
        sys.stderr.write(f"fails more often than it claims: {row}\n")
    return 1 if failed else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.coverage", description=__doc__)
    parser.add_argument("--workers", type=_positive, default=os.cpu_count() or 1, help="processes (default: the cores)")
    parser.add_argument("--campaigns", type=_positive, default=1000, help="campaigns a row, rounded up to chunks of 50")
    parser.add_argument("--kind", choices=sorted({row.kind for row in all_rows()}), help="rows of this kind only")
    parser.add_argument("--show", action="store_true", help="run nothing; only show what earlier runs have found")
    parser.add_argument("--write", type=Path, help="page that is written anew, with records and figure")
    return parser.parse_args()


def _positive(text: str) -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive whole number")
    return int(text)


if __name__ == "__main__":
    sys.exit(ended(main, PageError))
