"""The first 50 campaigns of every row of the coverage study; `make coverage` runs them all.

What must hold is tested row by row and, with more power, over all rows of one claim together. Then bounds are broken on
purpose: the same judge must reject it.
"""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import perfbound.orchestrator.mathematics.bounds.rigorous.candidate_band
from perfbound.orchestrator.mathematics.bounds.composition import compose_mean
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import scales_squared
from tests.studies.coverage import composition, kriging, rigorous, sampling, scenario
from tests.studies.coverage.composition import Composition
from tests.studies.coverage.controls import campaigns as controls
from tests.studies.coverage.controls import wrong_laws
from tests.studies.coverage.controls.campaigns import Bounds, Controls
from tests.studies.coverage.controls.wrong_laws import DeclaredLaw
from tests.studies.coverage.kriging import Kriging, KrigingAudit
from tests.studies.coverage.oracle import allowed
from tests.studies.coverage.page import Found
from tests.studies.coverage.records import Row
from tests.studies.coverage.rigorous import Audit, Rigorous
from tests.studies.coverage.sampling import Sampling
from tests.studies.coverage.scenario import Scenario
from tests.studies.coverage.study import all_rows, one_chunk

JUDGED = [row for row in all_rows() if Found(row, {}).judged and not row.kind.endswith("audit")]
KINDS = sorted({(row.kind, row.claimed) for row in JUDGED})


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


@cache
def first(number: int) -> Found:
    """Return what the first campaigns of JUDGED[number] found."""
    return Found(JUDGED[number], one_chunk(JUDGED[number], 0))


def together(campaign: Callable[..., dict[str, float]], row: Row, count: int, **told: Any) -> dict[str, int]:
    """Return the failures of `count` campaigns whose method gets another premise."""
    found = [campaign(row, np.random.default_rng(n), **told) for n in range(count)]
    return {name: sum(bool(each[name]) for each in found) for name in found[0]}


@pytest.mark.parametrize("number", range(len(JUDGED)), ids=[str(row) for row in JUDGED])
def test_no_statement_fails_more_often_than_it_claims(number: int) -> None:
    assert not first(number).fails


@pytest.mark.parametrize(("kind", "claimed"), KINDS)
def test_all_rows_of_one_claim_together(kind: str, claimed: float) -> None:
    rows = [first(number) for number, row in enumerate(JUDGED) if (row.kind, row.claimed) == (kind, claimed)]
    for name in rows[0].judged:
        assert sum(row.count(name) for row in rows) <= allowed(sum(row.campaigns for row in rows), claimed)


@pytest.mark.parametrize("factor", [1.5, 2.0])
def test_a_band_too_narrow_is_noticed(factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        perfbound.orchestrator.mathematics.bounds.rigorous.candidate_band,
        "scales_squared",
        lambda *a: scales_squared(*a) / factor**2,
    )
    found = Found(row := Rigorous("list", 1, 2.5), one_chunk(row, 0))
    assert min(found.count("band"), found.count("bound")) > found.allowed


def test_an_understated_delta_of_a_confidence_set_is_noticed() -> None:
    """With noise as large as J, a set with delta = .9 that claims .1 is rejected; its bound is not."""
    row = Rigorous("list", 2, 1.5, noise_scale=1.0)
    found = together(rigorous.campaign, row, 50, told_delta=0.9)
    assert found["set"] > allowed(50, row.claimed)


def test_an_understated_delta_of_weighted_sums_is_noticed() -> None:
    row = Kriging("skewed", flat=True, tests=200, replicates=1)
    found = together(kriging.campaign, row, 50, told_delta=0.9)
    assert min(found["sum"], found["bound"]) > allowed(50, row.claimed)


def test_the_audit_of_kriging_needs_no_noise_to_find_a_norm_that_is_half_the_right_one() -> None:
    """Where all of its weights are cut, it keeps the signs of the coefficients alone, and finds a third of them."""
    found = together(kriging.campaign, KrigingAudit("nearly exact", small_b=2.0, spread=0.006), 20)
    assert found["refuted"] > 12


@pytest.mark.parametrize(
    ("bounds", "disturbances"), [("kriging", "explain nothing"), ("scenario", "two values"), ("risk", "two values")]
)
def test_an_understated_delta_with_a_control_is_noticed(bounds: Bounds, disturbances: str) -> None:
    row = Controls(bounds, disturbances)
    assert together(controls.campaign, row, 50, told=0.9)["lower"] > allowed(50, row.claimed)


@pytest.mark.parametrize("bounds", ["kriging", "mean"])
def test_a_scale_that_is_wrong_by_a_tenth_makes_bounds_wrong_and_is_mostly_refuted(bounds: Bounds) -> None:
    found = together(wrong_laws.campaign, DeclaredLaw(bounds, law_scale=1.1, rollouts=2048), 20)
    assert found["bound"] == 20
    assert found["law"] > 12
    assert together(wrong_laws.campaign, DeclaredLaw(bounds, rollouts=2048), 20)["law"] <= allowed(20, 0.01)


def test_an_understated_delta_of_scenarios_is_noticed() -> None:
    row = Scenario("skewed", size=1)
    assert together(scenario.campaign, row, 100, told=0.9)["ell"] > allowed(100, row.claimed)


@pytest.mark.parametrize(
    ("law", "claim", "samples"),
    [
        ("two points", "failures, upper", 300),
        ("uniform, fine atoms", "failures, lower", 300),
        ("two points", "failures, fixed n, upper", 300),
        ("normal", "quantile", 300),
        ("normal", "next rollout, fixed n", 100),
        ("a jump at the tenth", "CVaR", 100),
        ("two points", "mean", 100),
        ("two points", "risk", 100),
    ],
)
def test_an_understated_delta_of_samples_is_noticed(law: str, claim: str, samples: int) -> None:
    row = Sampling(law, claim, samples, delta=0.9)
    assert together(sampling.campaign, row, 50)["false"] > allowed(50, 0.05)


def test_a_composition_that_forgets_most_of_the_gap_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(composition, "compose_mean", lambda rho, gap, **given: compose_mean(rho, 0.3 * gap, **given))
    found = Found(row := Composition("list", 1), one_chunk(row, 0))
    assert min(found.count(name) for name in ("extremes", "pointwise")) > found.allowed


def test_a_norm_four_times_too_small_is_noticed_by_the_judge_more_often_than_by_the_audit() -> None:
    found = Found(row := Audit(small_b=4.0), one_chunk(row, 0))
    assert found.count("bound") > found.allowed
    assert found.count("unnoticed") > 0


def test_a_noise_scale_four_times_too_small_is_refuted_by_replicates() -> None:
    found = Found(row := Audit(small_r=4.0), one_chunk(row, 0))
    assert found.count("spread") == found.campaigns
