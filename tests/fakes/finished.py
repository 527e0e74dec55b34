"""Finished and unfinished campaigns in a second, as input of readers: puppets answer with noise around 0.05."""

import json
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.issue import issue, manifest
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.file.config import CampaignConfig
from tests.campaigns import table
from tests.fakes.puppets import Stage

SPECIFICATION = "always (value >= 0.002)"
"""Of the puppets' values, uniform in [0, 0.1]: sometimes violated."""
KERNEL = {"nu": 2.5, "length_scale": 2.0}


def a_pair(method: str, **changes: Any) -> CampaignConfig:
    """Return a minimum and a maximum over a box of two parameters, 7 x 7 nodes."""
    problem = {"method": method, "delta": 0.05, "alpha": 0.001, "rkhs_norm": 0.3, "kernel": KERNEL}
    problem |= {"noise_scale": 0.01, "c": 0.05} if method == "paper" else {"noise_scale": "derived", "window": 2}
    problems = [{**problem, "name": name} for name in ("nominal_robustness", "sim_gap")]
    return _test_function(
        problems=problems,
        composition="sum",
        gap={"kind": "signal_sup", "column": "value"},
        resolution=7,
        max_tests=8,
        **changes,
    )


def a_list(**changes: Any) -> CampaignConfig:
    """Return five listed starts."""
    problem = {"name": "true_risk", "method": "scenario", "delta": 0.1, "alpha": 0.01, "replicates": 4, "window": 3}
    return _test_function(
        problems=[problem],
        composition="single",
        space={"scenarios": [[0.0, 0.0], [1.5, 0.0], [3.0, 1.0], [4.5, 2.0], [1.0, 3.0]]},
        max_tests=12,
        **changes,
    )


def _test_function(**changes: Any) -> CampaignConfig:
    found = table("test-function", horizon=0.3, specification=SPECIFICATION, clip=[-0.05, 0.15], **changes)
    return CampaignConfig.model_validate_json(json.dumps(found))


def play(directory: Path, config: CampaignConfig, look: Callable[[], bool] = lambda: False) -> Stage:
    """Run a campaign to its end, and call `look` at every turn; it has no certificate yet, and its journal is open."""
    stage = Stage(directory, config, 3)
    stage.play(look)
    return stage


def finish(stage: Stage, directory: Path) -> None:
    """Issue the certificate of a campaign that was played to its end, and close its journal."""
    ledger, journal = stage.ledger, stage.journal
    found = manifest((sha256, path) for _, sha256, path in read.observed(directory))
    files.write(directory, issue(ledger, found, irreproducible=read.irreproducible(directory)), found.text)
    journal.close()


def insert(directory: Path, table_name: str, **row: Any) -> None:
    """Write a row that no orchestrator would write; the database is closed, and nothing waits for the disk."""
    with sqlite3.connect(directory / DATABASE) as connection:
        connection.execute("PRAGMA synchronous = OFF")
        places = ", ".join("?" for _ in row)
        connection.execute(f"INSERT INTO {table_name} ({', '.join(row)}) VALUES ({places})", tuple(row.values()))
    connection.close()


def contents(directory: Path) -> dict[str, int]:
    """Return the time of modification of every file and folder."""
    return {str(path.relative_to(directory)): path.stat().st_mtime_ns for path in sorted(directory.rglob("*"))}
