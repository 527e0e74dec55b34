"""`python -m perfbound.workers`: the worker, and the commands of a child process of the orchestrator.

Two options may stand before the command: `--guarded` or `--guarded=LIFELINE,LEFT`, numbers of pipes, for a guardian;
and `--answer=DESCRIPTOR`, where a command answers in place of its standard output.
"""

import sys

from .answers import answer_on
from .guardian import become_guarded

while sys.argv[1:] and (option := sys.argv[1].partition("="))[0] in ("--guarded", "--answer"):
    del sys.argv[1]
    numbers = map(int, filter(None, option[2].split(",")))
    # Before all else: the guardian stays small, and a system that is loaded may start threads, which no fork keeps.
    (become_guarded if option[0] == "--guarded" else answer_on)(*numbers)

from .cli import group  # noqa: E402

group()
