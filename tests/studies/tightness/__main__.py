"""`python -m tests.studies.tightness --write docs/paper.md`: rollouts, bounds, figure and table."""

import argparse
import sys
from pathlib import Path

from perfbound.schemas.platforms import one_blas_thread
from tests.studies.command import ended
from tests.studies.pages import PageError

one_blas_thread()

from tests.studies.tightness.curves import NORMS, SEEDS, curve, worst  # noqa: E402  (numpy reads the setting once)
from tests.studies.tightness.page import summary, table, write  # noqa: E402
from tests.studies.tightness.rollouts import record, subject  # noqa: E402

ROLLOUTS = 7200


def main() -> int:
    """Record what is missing, compute, print, write; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.tightness", description=__doc__)
    parser.add_argument(
        "--rollouts", type=int, default=ROLLOUTS, help="true rollouts of the large design (default: %(default)s)"
    )
    parser.add_argument("--seeds", type=int, default=SEEDS, help="campaigns of each budget (default: %(default)s)")
    parser.add_argument("--write", type=Path, help="page whose table and figure are written anew")
    options = parser.parse_args()
    segway = subject()
    recorded = record(segway, options.rollouts)
    curves = [
        curve(segway, recorded, norm, options.seeds, controlled=controlled)
        for controlled in (True, False)
        for norm in NORMS
    ]
    truth = worst(segway, recorded)
    sys.stdout.write(table(summary(curves, truth, recorded.total)))
    if options.write is not None:
        write(options.write, curves, truth, recorded.total)
    return 0


if __name__ == "__main__":
    sys.exit(ended(main, PageError))
