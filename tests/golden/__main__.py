"""`python -m tests.golden` writes `segway.json` anew.

Only when a trajectory or the file was meant to change; the difference then shows in the review. To move the record to
another platform, first let the old one pass there: its numbers are compared, its digests are not.
"""

from tests.golden.record import write

if __name__ == "__main__":
    write()
