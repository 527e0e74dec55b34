"""`python -m perfbound.workers`: the worker, and the questions that the orchestrator asks a child process."""

from .cli import group

group()
