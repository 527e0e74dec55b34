"""The command line: it parses, calls one function, prints and exits; heavy modules load inside the commands."""

from . import calibrate, campaigns, certificate, check, report, start, systems  # each adds its commands
from .entry import main

__all__ = ["calibrate", "campaigns", "certificate", "check", "main", "report", "start", "systems"]
