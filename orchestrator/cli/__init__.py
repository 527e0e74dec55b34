"""The command line: it parses, calls one function, prints and exits; heavy modules load inside the commands."""

from . import (  # each adds its commands
    campaigns,
    certificate,
    export,
    imported,
    manual,
    pki,
    prepare,
    release,
    report,
    router,
    slurm,
    stop,
    systems,
)
from .entry import main

__all__ = [
    "campaigns",
    "certificate",
    "export",
    "imported",
    "main",
    "manual",
    "pki",
    "prepare",
    "release",
    "report",
    "router",
    "slurm",
    "stop",
    "systems",
]
