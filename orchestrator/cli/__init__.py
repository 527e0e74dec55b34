"""The command line: it parses, calls one function, prints and exits; heavy modules load inside the commands."""

from . import (  # each adds its commands
    calibrate,
    campaigns,
    certificate,
    check,
    completion,
    explain,
    pki,
    plan,
    report,
    router,
    slurm,
    start,
    stop,
    systems,
)
from .entry import main

__all__ = [
    "calibrate",
    "campaigns",
    "certificate",
    "check",
    "completion",
    "explain",
    "main",
    "pki",
    "plan",
    "report",
    "router",
    "slurm",
    "start",
    "stop",
    "systems",
]
