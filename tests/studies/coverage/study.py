"""The rows of the study, and one chunk of campaigns of a row."""

from collections.abc import Callable
from typing import Any

import numpy as np

from tests.studies.coverage import composition, kriging, paper, regions, requirements, rigorous, sampling, scenario
from tests.studies.coverage.comparison import campaigns as comparison
from tests.studies.coverage.controls import campaigns as controls
from tests.studies.coverage.controls import wrong_laws
from tests.studies.coverage.records import Chunk, Row, digest

CHUNK = 50
"""Campaigns that are written at once: what a kill may cost."""

CAMPAIGNS: dict[str, Callable[[Any, np.random.Generator], dict[str, float]]] = {
    "rigorous": rigorous.campaign,
    "scenario": scenario.campaign,
    "sampling": sampling.campaign,
    "composition": composition.campaign,
    "regions": regions.campaign,
    "requirements": requirements.campaign,
    "kriging": kriging.campaign,
    "controls": controls.campaign,
    "audit": rigorous.audited,
    "kriging-audit": kriging.campaign,
    "law-audit": wrong_laws.campaign,
    "comparison": comparison.campaign,
    "t-test": comparison.tested,
    "paper": paper.campaign,
}


def all_rows() -> list[Row]:
    """Return every row, kind by kind."""
    makers = (
        rigorous.rows,
        scenario.rows,
        sampling.rows,
        composition.rows,
        regions.rows,
        requirements.rows,
        kriging.rows,
        controls.rows,
        rigorous.audits,
        kriging.audits,
        wrong_laws.rows,
        comparison.rows,
        comparison.tests,
        paper.rows,
    )
    return [row for rows in makers for row in rows()]


def one_chunk(row: Row, chunk: int) -> Chunk:
    """Run the campaigns of one chunk; their seeds depend on the row and the campaign's number, on nothing else."""
    seed = int(digest(row), 16)
    numbers = range(chunk * CHUNK, (chunk + 1) * CHUNK)
    run = CAMPAIGNS[row.kind]
    found = [run(row, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n,)))) for n in numbers]
    return {name: [float(each[name]) for each in found] for name in found[0]}
