"""`python -m workers`: the worker, and the questions that the orchestrator asks a child process."""

from workers.cli import group

group()
