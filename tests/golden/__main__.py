"""`python -m tests.golden` records the digests of this class of platforms, where the numbers on record are met.

`--numbers` writes the numbers as well, and discards the digests of every other class: only when a trajectory was
meant to change. The difference then shows in the review.
"""

import argparse
import sys

from perfbound.workers.systems.segway import SegwaySystem
from tests.golden.record import ROLLOUTS, differs, on_record, platform_key, record, write_numbers, write_platform


def main() -> int:
    """Record; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__.partition("\n")[0])
    parser.add_argument("--numbers", action="store_true", help="write the numbers anew, too")
    arguments = parser.parse_args()
    system = SegwaySystem()
    found = {name: record(system, rollout) for name, rollout in ROLLOUTS.items()}
    if arguments.numbers:
        write_numbers(found)
    then = on_record()
    if other := [name for name, each in found.items() if differs(each["numbers"], then[name]["numbers"])]:
        names = ", ".join(other)
        sys.stderr.write(f"golden: other numbers than those on record: {names}; fix that, or choose --numbers\n")
        return 1
    sys.stdout.write(f"{write_platform(platform_key(), found)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
