"""`python -m perfbound.workers`: the worker, and the commands of a child process of the orchestrator."""

from .cli import group

group()
