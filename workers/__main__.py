"""`python -m perfbound.workers`: the worker, and the commands of a child process of the orchestrator.

With `--guarded` or `--guarded=LIFELINE,LEFT` as its first argument it has a guardian, see there; the numbers are pipes.
"""

import sys

from .guardian import become_guarded

option, _, pipes = sys.argv[1].partition("=") if sys.argv[1:] else ("", "", "")
if option == "--guarded":
    del sys.argv[1]
    # Before all else: the guardian stays small, and a system that is loaded may start threads, which no fork keeps.
    become_guarded(*map(int, filter(None, pipes.split(","))))

from .cli import group  # noqa: E402

group()
