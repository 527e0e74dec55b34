"""`make bench`: every benchmark, one table, and the same numbers as JSON in build/bench.json."""

import json
import os
import sys
from pathlib import Path

from schemas.base import one_blas_thread

one_blas_thread()

from tests.benchmarks import campaign, proposal, rigorous, rollout, scenario, stl  # noqa: E402  (numpy reads the setting once)

OUT = Path("build/bench.json")
MEASURES = {
    "rollout": rollout.measure,
    "proposal": proposal.main,
    "rigorous": rigorous.main,
    "stl": stl.main,
    "scenario": scenario.main,
    "campaign": campaign.main,
}


def main() -> None:
    """Run, print and write."""
    results: dict[str, dict[str, float]] = {}
    for name, measure in MEASURES.items():
        results[name] = measure()
        for key, value in results[name].items():
            sys.stdout.write(f"{name + '/' + key:58s} {value:12.4f}\n")
    load = os.getloadavg()[0]
    sys.stdout.write(f"{'load average (1 min)':58s} {load:12.2f}\n")
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps({"load": load, **results}, indent=1, sort_keys=True) + "\n")
    sys.stdout.write(f"written to {OUT}\n")


if __name__ == "__main__":
    main()
