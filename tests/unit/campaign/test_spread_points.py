"""Fixed starts in a box: which campaigns choose from them, which points they are, and what their claims are about."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import qmc

from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.campaign.scope import scope
from perfbound.orchestrator.campaign.spread_points import spread_points
from perfbound.orchestrator.mathematics.gp import points as lists
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Column, Parameter, SystemSpec
from tests.fakes.simulators import predicate, robustness, simulate, spec, verified

SQUARE = ((0.0, 1.0), (-5.0, 5.0))
EXACT = {"method": "rigorous", "alpha": 0.02, "rkhs_norm": 3.0, "noise_scale": 0, "kernel": {"length_scale": 0.5}}
HEAD = """name = "c"
system.name = "any"
specification = "v >= 0"
clip = [-1, 1]
METHOD
[space]
"""
RIGOROUS = "alpha = 0.1\nrkhs_norm = 2.0\nnoise_scale = 0.1\nkernel = { length_scale = 1.0 }\n"
SCENARIO = 'method = "scenario"\nalpha = 0.1\n'


def hill(request: RolloutRequest) -> float:
    """Return a value whose least one over the unit square is 0.1, at (0.3, 0.7)."""
    x, y = request.x
    return 0.1 + (x - 0.3) ** 2 + (y - 0.7) ** 2


# The points


def test_they_stay_what_they_were() -> None:
    found = spread_points(("a", "b"), SQUARE, 4096, None)
    assert found.points[:4] == ((0.0, -5.0), (0.5, 0.0), (0.75, -2.5), (0.25, 2.5))
    assert hashlib.sha256(repr(found.points).encode()).hexdigest().startswith("86aa047810ee9704")


@pytest.mark.rest
@settings(max_examples=30, deadline=None)
@given(count=st.integers(2, 300), more=st.integers(0, 300))
def test_fewer_are_the_first_of_more(count: int, more: int) -> None:
    for where in (None, "a <= 0.5 and b >= 0"):
        few = spread_points(("a", "b"), SQUARE, count, where).points
        assert few == spread_points(("a", "b"), SQUARE, count + more, where).points[:count]


def test_they_fill_the_box_more_evenly_than_chance() -> None:
    found = spread_points(tuple("abcdef"), ((0.0, 1.0),) * 6, 4096, None).nodes
    random = np.random.default_rng(0).random((4096, 6))
    assert qmc.discrepancy(found) < qmc.discrepancy(random) / 10


def test_those_of_a_region_are_inside_and_as_many() -> None:
    where = "a^2 + (b / 5)^2 <= 1"
    found = spread_points(("a", "b"), SQUARE, 500, where).nodes
    assert len(found) == 500
    assert np.all(found[:, 0] ** 2 + (found[:, 1] / 5) ** 2 <= 1)


def test_a_region_of_almost_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perfbound.orchestrator.campaign.spread_points.LEAST_SHARE", 0.5)
    with pytest.raises(CampaignError, match=r"^space\.where: only \d+ of the 400 candidates are in the region; give"):
        spread_points(("a", "b"), SQUARE, 400, "a > 0.95 and b > 4")


def test_kernel_rows_on_demand_are_those_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    points = spread_points(tuple("abcdef"), ((0.0, 1.0),) * 6, 200, None)
    for nu in (0.5, 2.5, 1.7):
        kernel, axes = Matern(nu, (1.0,) * 6), np.arange(1.0, 7.0)
        table = points.kernel_rows(kernel, axes)
        with monkeypatch.context() as patch:
            patch.setattr(lists, "TABLE", 10)
            single = points.kernel_rows(kernel, axes)
            rows = np.array([single.row(k) for k in (7, 0, 199, 7)])
        assert np.array_equal(rows, np.array([table.row(k) for k in (7, 0, 199, 7)]))
        assert np.array_equal(table.row(7)[199], table.row(199)[7])


# Which campaigns have them


def parsed(parameters: int, method: str = RIGOROUS, extra: str = "") -> CampaignConfig:
    space = "\n".join(f"x{k} = [0, 1]" for k in range(parameters))
    return parse_campaign((extra + HEAD.replace("METHOD", method) + space).encode(), "c.toml")


def candidates(config: CampaignConfig) -> Lattice | Points:
    names = [f"x{k}" for k in range(len(config.space))]  # type: ignore[arg-type]
    system = SystemSpec(
        name="any",
        doc="",
        parameters=tuple(Parameter(0, 1, name=name) for name in names),
        columns=(Column(name="t", unit="s"), Column(name="v", unit="")),
        variants=("nominal",),
        noisy=("nominal",),
        max_horizon=1.0,
    )
    (plan,) = plans(config, system).values()
    return plan.chosen_from


@pytest.mark.parametrize(
    ("parameters", "method", "extra", "starts"),
    [
        (3, RIGOROUS, "", None),
        (4, RIGOROUS, "", 4096),
        (6, RIGOROUS, "", 4096),
        (4, RIGOROUS, "resolution = 10\n", None),
        (5, RIGOROUS, "resolution = 7\n", None),
        (2, RIGOROUS, "candidates = 500\n", 500),
        (2, RIGOROUS, 'where = "x0 <= x1"\n', 4096),
        (2, RIGOROUS, 'where = "x0 <= x1"\ncandidates = 64\n', 64),
        (1, SCENARIO, "", 64),
        (6, SCENARIO, "candidates = 20\n", 20),
    ],
)
def test_a_box_has_a_lattice_as_before_or_fixed_starts(
    parameters: int, method: str, extra: str, starts: int | None
) -> None:
    config = parsed(parameters, method, extra)
    assert config.starts_of(config.problems[0]) == starts
    found = candidates(config)
    assert isinstance(found, Lattice if starts is None else Points)
    assert found.size == (starts or config.resolution**parameters)


def test_a_file_without_the_key_is_the_campaign_that_it_was() -> None:
    config = parsed(2)
    assert not {"candidates", "where"} & config.model_dump().keys()
    assert parsed(2, extra="candidates = 500\n").digest != config.digest


PAIR = """name = "c"
system.name = "any"
specification = "v >= 0"
clip = [-1, 1]
horizon = 1
gap.kind = "robustness"
composition = "sum"
[space]
a = [0, 1]
b = [0, 1]
c = [0, 1]
d = [0, 1]
"""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            HEAD.replace("METHOD", 'method = "paper"\nc = 0.1\ncandidates = 9\n' + RIGOROUS) + "x = [0, 1]",
            "candidates: only for ranges, with method 'rigorous' or 'scenario'; remove this key",
        ),
        (
            HEAD.replace("METHOD", SCENARIO + "candidates = 9") + "scenarios = [[0], [1]]",
            "candidates: only for ranges, with method",
        ),
        (
            HEAD.replace("METHOD", SCENARIO + "candidates = 2000") + "x = [0, 1]",
            "candidates: 2000 is not allowed: method 'scenario' takes at most 1000",
        ),
        (
            HEAD.replace("METHOD", RIGOROUS + "candidates = 5001") + "x = [0, 1]",
            "candidates: 5001 is not allowed: allowed is a whole number >= 2 and <= 5000",
        ),
        (
            PAIR
            + "".join(
                f'[[problems]]\nname = "{name}"\nresolution = {resolution}\n{RIGOROUS}'
                for name, resolution in (("nominal_robustness", 21), ("sim_gap", 10))
            ),
            "candidates: the problems choose from different starts; give their number, or one resolution",
        ),
        (
            HEAD.replace("METHOD", RIGOROUS + "resolution = 60") + "x = [0, 1]\ny = [0, 1]\nz = [0, 1]",
            "resolution: 216000 lattice nodes are more than the 100000 allowed",
        ),
    ],
)
def test_what_is_refused(text: str, words: str) -> None:
    with pytest.raises(CampaignError) as error:
        parse_campaign(text.encode(), "c.toml")
    assert words in str(error.value)
    assert "\n" not in str(error.value)


# Their claims


def claimed(text: str | None) -> dict[str, Any]:
    found: dict[str, Any] = predicate(text)["claims"][0]
    return found


@pytest.mark.parametrize("where", [None, "z1 + z2 >= 1"])
def test_the_claim_is_about_these_starts_and_true(tmp_path: Path, where: str | None) -> None:
    config = robustness(EXACT, candidates=64, **({"where": where} if where else {}))
    starts = candidates_of(config)
    worst = min(0.1 + (x - 0.3) ** 2 + (y - 0.7) ** 2 for x, y in starts.points)
    text = simulate(tmp_path, config, hill, noisy=False)
    claim = claimed(text)
    assert claim["starts"] == 64
    assert worst - 0.02 <= claim["bound"] <= worst
    found = predicate(text)
    assert "spot_check" not in found, "fresh starts of the box test no claim about a list"
    details = {each["id"]: each["detail"] for each in found["assumptions"]}
    assert "64 fixed starts, points of the Sobol sequence" in details["finite_space/robustness"]
    assert verified(tmp_path) == []


def candidates_of(config: CampaignConfig) -> Points:
    (plan,) = plans(config, spec(noisy=False)).values()
    assert isinstance(plan.candidates, Points)
    return plan.candidates


@pytest.mark.rest
def test_a_stopped_campaign_resumes_to_the_same_certificate(tmp_path: Path) -> None:
    config = robustness(EXACT, candidates=64)
    whole = simulate(tmp_path / "whole", config, hill, noisy=False)
    asked = iter(range(10**6))
    assert simulate(tmp_path / "parts", config, hill, noisy=False, stop=lambda _: next(asked) == 3) is None
    parts = simulate(tmp_path / "parts", config, hill, noisy=False)
    assert json.loads(str(parts))["predicate"]["claims"] == json.loads(str(whole))["predicate"]["claims"]


@pytest.mark.rest
def test_method_scenario_takes_a_box(tmp_path: Path) -> None:
    config = robustness({"method": "scenario", "alpha": 0.3}, candidates=4, clip=(-1.0, 1.0), max_tests=400)
    claim = claimed(simulate(tmp_path, config, hill, noisy=True))
    worst = min(0.1 + (x - 0.3) ** 2 + (y - 0.7) ** 2 for x, y in candidates_of(config).points)
    assert (claim["starts"], claim["bound"] <= worst) == (4, True)
    assert verified(tmp_path) == []


def test_the_start_of_a_campaign_says_what_its_claim_is_about() -> None:
    (box,) = scope(plans(robustness(EXACT), spec(noisy=False)))
    assert box == "robustness: the claim is about every start of the box"
    (fixed,) = scope(plans(robustness(EXACT, candidates=4096), spec(noisy=False)))
    assert fixed.startswith("robustness: the claim is about the worst of 4,096 fixed starts, spread over the ranges")
    listed = robustness(EXACT, space={"scenarios": [[0.0, 0.0], [1.0, 1.0]]})
    drawn = robustness({"method": "sample"}, clip=(-1.0, 1.0))
    assert [*scope(plans(listed, spec(noisy=False))), *scope(plans(drawn, spec(noisy=False)))] == []
