"""Rollouts a second that one orchestrator makes durable, with 100 kB each.

A real journal and real files on the disk of this checkout; the workers are puppets, whose own time is taken off.
Ours and Optuna's are measured in turns, and the best of the rounds counts, because others use the disk too.
"""

import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from perfbound.schemas.file.config import CampaignConfig
from tests.campaigns import table
from tests.fakes.puppets import Stage, scratch
from tests.studies.benchmarks.parts import readers
from tests.studies.benchmarks.report import Row

TESTS = {1: 40, 8: 100, 64: 150}
"""By reports that wait at a time, which are as many as there are puppets."""
ROUNDS = 3
GOALS = {"sqlite, 100 kB": 10.0, "journal, 100 kB": 1.0}


@dataclass(frozen=True)
class Cost:
    """Cost of one campaign."""

    per_second: float
    cpu_ms: float
    fsyncs: float
    """Of files and folders, per rollout."""
    commits: float
    """Per rollout."""


def a_config(tests: int) -> CampaignConfig:
    """Return segway-scenario, whose files have 108 kB, with enough tests in flight for all puppets."""
    found = table("segway-scenario")
    found["problems"][0] |= {"max_tests": tests, "window": 16, "replicates": 8, "alpha": 1e-9}
    return CampaignConfig.model_validate_json(json.dumps(found))


def main(ask: Callable[[], dict[str, Any]] | None) -> list[Row]:
    """Return the rows; `ask` measures Optuna in its own environment."""
    ours: dict[int, list[Cost]] = defaultdict(list)
    theirs: dict[str, list[dict[str, float]]] = defaultdict(list)
    for _ in range(ROUNDS):
        for waiting in TESTS:
            ours[waiting].append(conduct(waiting))
        for name, found in (ask()["rates"] if ask else {}).items():
            theirs[name].append(found)
    best = {waiting: max(costs, key=lambda cost: cost.per_second) for waiting, costs in ours.items()}
    rows = [row for waiting, cost in best.items() for row in _alone(f"100 kB durable, {waiting} waiting", cost)]
    return [*rows, *_beside(best[max(TESTS)], theirs), *readers.main(a_config(10**6))]


def _alone(name: str, cost: Cost) -> Iterator[Row]:
    yield Row(f"{name}: rate", cost.per_second, "rollouts/s")
    yield Row(f"{name}: CPU per rollout", cost.cpu_ms, "ms")
    yield Row(f"{name}: fsyncs of files and folders", cost.fsyncs, "per rollout")
    yield Row(f"{name}: commits", cost.commits, "per rollout")


def _beside(ours: Cost, theirs: dict[str, list[dict[str, float]]]) -> Iterator[Row]:
    for name, costs in theirs.items():
        peer = max(costs, key=lambda each: each["per_second"])
        words = f"Optuna on {name}, {peer['threads']:.0f} threads"
        goal = GOALS.get(name)
        yield Row("100 kB durable: rate", ours.per_second, "rollouts/s", words, peer["per_second"], ratio_at_least=goal)
        yield Row("100 kB durable: CPU per rollout", ours.cpu_ms, "ms", words, peer["cpu_ms"])


def conduct(waiting: int) -> Cost:
    """Run one campaign with `waiting` puppets."""
    with scratch() as folder, _counting_fsyncs() as fsyncs:
        stage, commits = Stage(Path(folder), a_config(TESTS[waiting]), waiting), list[object]()
        sa.event.listen(stage.journal._engine, "commit", commits.append)
        fsyncs.clear()
        stage.play()
        stage.journal.close()
    count, (wall, cpu) = stage.puppets.delivered, stage.per_rollout()
    return Cost(1 / wall, 1000 * cpu, len(fsyncs) / count, len(commits) / count)


@contextmanager
def _counting_fsyncs() -> Iterator[list[int]]:
    calls, real = list[int](), os.fsync

    def counted(descriptor: int) -> None:
        calls.append(descriptor)
        real(descriptor)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", counted)
        yield calls
