"""`make bench`: every benchmark, one table on stdout, and the same as JSON in build/bench.json.

python -m tests.studies.benchmarks [PART ...] [--no-peers]
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from perfbound.schemas.platforms import one_blas_thread

one_blas_thread()

from tests.missing import MISSING, for_want_of_pybullet  # noqa: E402
from tests.studies.benchmarks import report  # noqa: E402  (numpy reads the setting once)
from tests.studies.benchmarks.parts import (  # noqa: E402  (numpy reads the setting once)
    batches,
    campaign,
    disturbed,
    durability,
    falsification,
    fleet,
    forms,
    kriging,
    observing,
    proposal,
    reactions,
    requirements,
    rigorous,
    rollout,
    routing,
    scenario,
    search,
    stl,
    throughput,
)

OUT = Path("build/bench.json")
PEERS = Path(".venv-bench/bin/python")
ASKED = {"proposal", "rigorous"}
"""Parts that need what `peers.py` measures."""
PARTS = (
    "proposal",
    "rigorous",
    "scenario",
    "kriging",
    "observing",
    "search",
    "falsification",
    "requirements",
    "stl",
    "rollout",
    "forms",
    "campaign",
    "fleet",
    "durability",
    "batches",
    "routing",
    "reactions",
    "throughput",
    "disturbed",
)
"""In this order: wall times last."""


def main() -> int:
    """Run, print and write; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.benchmarks", description=__doc__.partition("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--no-peers", action="store_true", help="ours alone, without the environment of the peers")
    arguments = parser.parse_args()
    if unknown := set(arguments.parts).difference(PARTS):
        parser.error(f"no part is called {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    if not arguments.no_peers and not PEERS.exists():
        sys.stderr.write(f"bench: {PEERS} is missing; `make bench` installs it, --no-peers does without\n")
        return 1
    parts = [part for part in PARTS if part in (arguments.parts or PARTS)]
    before = report.surroundings()
    peers = {} if arguments.no_peers or not ASKED.intersection(parts) else child("peers")
    rows = [
        row
        for part in parts
        for row in unless_missing(part, partial(measure, part, peers, alone=arguments.no_peers), MISSING)
    ]
    after = {"load_after": os.getloadavg()[0], "peers": peers.get("versions", {})}
    sys.stdout.write(report.table(rows))
    report.write(OUT, report.document(rows, before | after))
    sys.stderr.write(f"load {before['load']:.2f} before, {after['load_after']:.2f} after; written to {OUT}\n")
    return 0


def unless_missing(part: str, measured: Callable[[], list[report.Row]], missing: str) -> list[report.Row]:
    """Return the rows of a part; none, and a line, for one that needs PyBullet where there is none."""
    try:
        return measured()
    except Exception as error:
        if not for_want_of_pybullet(str(error), missing):
            raise
        sys.stderr.write(f"skipped  {part}: {missing}\n")
        return []


def measure(part: str, peers: dict[str, Any], *, alone: bool) -> list[report.Row]:
    """Return the rows of one part."""
    sys.stderr.write(f"{part}\n")
    if part in ASKED:
        return {"proposal": proposal.main, "rigorous": rigorous.main}[part](peers.get("peers", {}))
    if part == "stl":
        return stl.main(stl.measured() if alone else child("stl"))
    if part == "durability":
        return durability.main(None if alone else lambda: child("peers_storage"))
    if part == "batches":
        return batches.main(None if alone else PEERS)
    if part == "falsification":
        return falsification.main(alone=alone)
    plain = {
        "scenario": scenario.main,
        "kriging": kriging.main,
        "observing": observing.main,
        "search": search.main,
        "requirements": requirements.main,
        "rollout": rollout.main,
        "forms": forms.main,
        "fleet": fleet.main,
        "routing": routing.main,
    }
    whole = {
        "campaign": campaign.main,
        "reactions": reactions.main,
        "throughput": throughput.main,
        "disturbed": disturbed.main,
    }
    return (plain | whole)[part]()


def child(module: str) -> dict[str, Any]:
    """Return what one of our scripts prints in the environment of the peers."""
    sys.stderr.write(f"{module}, with {PEERS}\n")
    return dict(json.loads(subprocess.check_output([PEERS, "-m", f"tests.studies.benchmarks.{module}"])))


if __name__ == "__main__":
    sys.exit(main())
