"""The command line: thin, and quick to start; what is heavy is imported inside the commands."""

from orchestrator.cli import campaigns, evidence, pictures, systems  # each adds its commands
from orchestrator.cli.entry import main

__all__ = ["campaigns", "evidence", "main", "pictures", "systems"]
