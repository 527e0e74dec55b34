"""`make names`: prints the names that are defined in more than one module, and fails above the limit."""

import sys

from tests.architecture.source import shared_names

LIMIT = 25
"""Top-level classes and functions of one name in two modules."""


def main() -> int:
    """Print a line for each name; return the exit code."""
    found = shared_names()
    for name, homes in found.items():
        sys.stdout.write(f"{name}: {', '.join(homes)}\n")
    sys.stdout.write(f"{len(found)} names are defined in more than one module; the limit is {LIMIT}\n")
    return int(len(found) > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
