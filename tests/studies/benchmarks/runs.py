"""Whole campaigns of a shipped file, changed, with what they cost."""

import json
import re
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.campaigns import FOLDER

RECORDED = (
    "SELECT COUNT(*), SUM(cpu_seconds), MAX(ended) - MIN(started) "
    "FROM outcomes JOIN attempts USING (rollout, attempt) WHERE outcome = 'recorded'"
)


@dataclass(frozen=True)
class Cost:
    """Cost of one campaign; CPU seconds, except `wall`."""

    rollouts: int
    simulating: float
    """Inside the rollouts, in all workers."""
    wall: float
    """From the first attempt's start to the last one's end."""
    account: dict[str, Any]
    """Of the orchestrator; see `launched.py`."""

    @property
    def orchestrator(self) -> float:
        """All CPU seconds of the orchestrator's process."""
        return float(self.account["total"])

    @property
    def loop(self) -> float:
        """Those between start-up and certificate."""
        return float(self.account["loop_ends"] - self.account["loop_begins"])


def conduct(name: str, changes: Mapping[str, str], *, workers: int = 2, shares: bool = False) -> Cost:
    """Run a shipped campaign with `changes`: other values, in TOML, of keys that occur in it once.

    Raises:
        RuntimeError: it failed; with the end of its stderr.

    """
    with tempfile.TemporaryDirectory() as folder:
        campaign, account, out = (Path(folder) / each for each in ("campaign.toml", "account.json", "run"))
        campaign.write_text(changed((FOLDER / f"{name}.toml").read_text(), changes))
        command = [
            sys.executable,
            "-m",
            "tests.studies.benchmarks.parts.launched",
            str(account),
            *(["--shares"] if shares else []),
        ]
        command += ["run", str(campaign), "--workers", str(workers), "--out", str(out)]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode:
            raise RuntimeError(f"{name} ended with code {ended.returncode}: {ended.stderr.strip()[-500:]}")
        with closing(sqlite3.connect(f"file:{out / 'campaign.db'}?mode=ro", uri=True)) as connection:
            rollouts, simulating, wall = connection.execute(RECORDED).fetchone()
        return Cost(rollouts, simulating, wall, json.loads(account.read_text()))


def changed(text: str, changes: Mapping[str, str]) -> str:
    """Return a campaign file with other values.

    Raises:
        ValueError: a key does not occur in it exactly once.

    >>> changed("seed = 1\\nname = 'a'", {"seed": "2"})
    "seed = 2\\nname = 'a'"
    """
    for key, value in changes.items():
        text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        if count != 1:
            raise ValueError(f"{key} occurs {count} times in the campaign file")
    return text
