"""Drawn starts: functions of the campaign, the design and their number; those of the spot check stay what they were."""

import hashlib
import json
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.stats import qmc

from perfbound.orchestrator.campaign.checks import check
from perfbound.orchestrator.campaign.closing.spot_check import _uniform_starts
from perfbound.orchestrator.campaign.consistency import scope
from perfbound.orchestrator.campaign.plan import plans, spread_points
from perfbound.orchestrator.campaign.seeds import uniform
from perfbound.orchestrator.campaign.starts import BLOCK, Draws, check_distributions
from perfbound.orchestrator.mathematics.gp import points as lists
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.parameters import Box, Range, signal_shapes
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.file.space import Scenarios, Space, StartTable
from perfbound.schemas.result.facts import Header
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.workers.systems import load_system
from tests.campaigns import config
from tests.facts import says
from tests.fakes.simulators import predicate, robustness, simulate, spec, verified

BOX: Box = {
    "x": Range(low=0.0, high=5.0, distribution="normal", mean=2.0, sd=1.0),
    "y": Range(low=0.0, high=5.0, distribution="weibull", shape=2.0, scale=2.0),
}
TABLE = StartTable(table=((1.0, 2.0), (3.0, 4.0), (1.0, 2.0)))

GOLDEN = [(2.08893159, 2.40542962), (1.50259173, 0.160941863), (1.13925664, 0.61537386)]
GOLDEN_ROWS = [1, 0, 0, 0, 0, 0, 1, 0]


def header(space: Space = BOX, **changes: Any) -> Header:
    """Return the header of the paper's campaign on another space, whatever its method takes."""
    found = config("segway-paper", **changes).model_copy(update={"space": space})
    return Header.new(found, load_system("segway").spec, {}, run="0" * 16)


def fixed(space: Space = BOX) -> Header:
    return replace(header(space), config_sha256="1234" * 16)


def test_starts_of_the_spot_check_stay_what_they_were() -> None:
    # A change here refutes every certificate with a spot check.
    found = replace(header(config("segway-paper").space, spot_check=299), config_sha256="1234" * 16)
    starts = _uniform_starts(found, list(plans(found.config, found.spec).values()), "spot_check")
    assert starts[0] == (3.658339854727783, 1.9530640519583016)
    assert hashlib.sha256(repr(starts).encode()).hexdigest().startswith("a811733fe43480a359842503647e691f")


@given(first=st.integers(0, 2000), count=st.integers(1, 50), width=st.integers(1, 5))
def test_rows_of_a_series_are_those_of_the_whole(first: int, count: int, width: int) -> None:
    found = fixed()
    whole = uniform(found, "spot_check", range(first + count), width)
    assert np.array_equal(uniform(found, "spot_check", range(first, first + count), width), whole[first:])


def test_starts_stay_what_they_were() -> None:
    drawn, listed = Draws(fixed(), "robustness"), Draws(fixed(TABLE), "robustness")
    assert [drawn.start(j) for j in (0, 1, 1000)] == GOLDEN
    assert [TABLE.rows.index(listed.start(j)) for j in range(8)] == GOLDEN_ROWS


@settings(max_examples=20)
@given(numbers=st.lists(st.integers(0, 5 * BLOCK), min_size=1, max_size=20), space=st.sampled_from([BOX, TABLE]))
def test_the_order_in_which_starts_are_asked_for_changes_none(numbers: list[int], space: Space) -> None:
    found = fixed(space)
    one = Draws(found, "robustness")
    assert [one.start(number) for number in numbers] == [Draws(found, "robustness").start(number) for number in numbers]


def test_another_campaign_or_design_has_other_starts() -> None:
    headers = [header(), header(seed=2), header(risk_weight=0.3), header({**BOX, "x": Range(low=0.0, high=4.9)})]
    starts = {Draws(each, design).start(0) for each in headers for design in ("robustness", "risk")}
    assert len(starts) == 2 * len(headers)


def test_parameters_are_in_the_order_of_the_system() -> None:
    assert [Draws(fixed(dict(reversed(BOX.items()))), "a").start(j) for j in range(3)] == [
        Draws(fixed(), "a").start(j) for j in range(3)
    ]


def test_starts_are_inside_and_of_the_declared_distributions() -> None:
    """The seed is fixed; at another one a correct program fails in at most one of 1,000."""
    drawn = Draws(fixed(), "robustness")
    starts = np.array([drawn.start(j) for j in range(10_000)])
    assert starts.min() >= 0.0
    assert starts.max() <= 5.0
    for column, law in enumerate((stats.norm(2.0, 1.0), stats.weibull_min(2.0, scale=2.0))):
        mass = law.cdf(5.0) - law.cdf(0.0)
        found = stats.kstest(starts[:, column], lambda x, law=law, mass=mass: (law.cdf(x) - law.cdf(0.0)) / mass)
        assert found.pvalue > 0.001 / 4
    assert stats.spearmanr(starts[:, 0], starts[:, 1]).pvalue > 0.001 / 4
    assert stats.spearmanr(starts[:-1, 0], starts[1:, 0]).pvalue > 0.001 / 4


def test_no_distribution_is_uniform_on_the_box() -> None:
    space: Space = {"x": Range(low=-20.0, high=25.0), "y": Range(low=1000.0, high=1000.001)}
    drawn = Draws(fixed(space), "robustness")
    starts = np.array([drawn.start(j) for j in range(10_000)])
    assert stats.kstest(starts[:, 0], stats.uniform(-20.0, 45.0).cdf).pvalue > 0.001 / 2
    assert stats.kstest(starts[:, 1], stats.uniform(1000.0, 0.001).cdf).pvalue > 0.001 / 2
    assert len(set(starts[:, 1])) > 9_900, "rounding keeps the values of a narrow range apart"


def test_rows_are_drawn_with_replacement_as_often_as_they_are_there() -> None:
    drawn = Draws(fixed(TABLE), "robustness")
    counts = Counter(drawn.start(j) for j in range(9_000))
    assert counts.keys() == {(1.0, 2.0), (3.0, 4.0)}
    assert stats.binomtest(counts[3.0, 4.0], 9_000, 1 / 3).pvalue > 0.001


def test_the_last_share_is_the_last_row(monkeypatch: pytest.MonkeyPatch) -> None:
    largest = np.full((BLOCK, 1), 1 - 2.0**-53)
    monkeypatch.setattr("perfbound.orchestrator.campaign.starts.uniform", lambda *_: largest)
    assert Draws(fixed(StartTable(table=((0.0, 0.0), (0.0, 1.0), (0.0, 2.0)))), "a").start(0) == (0.0, 2.0)


def counted(given: Range) -> dict[float, int]:
    """Return how often the values of a parameter are drawn, of 9,000."""
    drawn = Draws(fixed({"x": given, "y": Range(low=0.0, high=1.0)}), "robustness")
    return dict(sorted(Counter(drawn.start(j)[0] for j in range(9_000)).items()))


def test_choices_and_steps_are_drawn_alike() -> None:
    choices = counted(Range(low=-1.0, high=7.0, choices=(7.0, -1.0, 0.25)))
    steps = counted(Range(low=0.1, high=0.5, step=0.1))
    assert list(choices) == [-1.0, 0.25, 7.0]
    assert list(steps) == [0.1, 0.2, 0.3, 0.4, 0.5]
    for counts in (choices, steps):
        assert stats.chisquare(list(counts.values())).pvalue > 0.001 / 2


def test_a_step_has_the_probability_of_the_numbers_around_it() -> None:
    counts = counted(Range(low=0.0, high=4.0, step=1.0, distribution="normal", mean=1.0, sd=1.0))
    ends = stats.norm(1.0, 1.0).cdf(np.arange(6) - 0.5)
    expected = np.diff(ends) / (ends[-1] - ends[0])
    assert list(counts) == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert stats.chisquare(list(counts.values()), expected * 9_000).pvalue > 0.001


def test_knots_are_drawn_alike_and_independently() -> None:
    """The seed is fixed; at another one a correct program fails in at most one of 1,000."""
    space: Box = {
        "x": Range(low=0.0, high=5.0, distribution="normal", mean=2.0, sd=1.0, signal="pchip", knots=3),
        "y": Range(low=0.0, high=1.0),
    }
    found = header(space)
    over_time = tuple(each.model_copy(update={"signal": each.name == "x"}) for each in found.spec.parameters)
    spread = found.spec.model_copy(update={"parameters": over_time}).spread(signal_shapes(space))
    drawn = Draws(replace(found, spec=spread, config_sha256="1234" * 16), "robustness")
    starts = np.array([drawn.start(j) for j in range(5_000)])
    assert starts.shape == (5_000, 4)
    law, ends = stats.norm(2.0, 1.0), stats.norm(2.0, 1.0).cdf([0.0, 5.0])
    for knot in starts[:, :3].T:
        assert stats.kstest(knot, lambda x: (law.cdf(x) - ends[0]) / (ends[1] - ends[0])).pvalue > 0.001 / 6
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert stats.spearmanr(starts[:, one], starts[:, other]).pvalue > 0.001 / 6


def test_a_number_below_0_and_a_list_are_refused() -> None:
    with pytest.raises(IndexError, match="start -1 of a design"):
        Draws(fixed(), "a").start(-1)
    with pytest.raises(TypeError, match="list of scenarios"):
        Draws(fixed(Scenarios(scenarios=((1.0, 2.0),))), "a").start(0)


def test_a_distribution_of_another_unit_is_refused_before_the_campaign() -> None:
    space: Box = {**BOX, "y": Range(low=0.0, high=5.0, distribution="normal", mean=2000.0, sd=100.0)}
    reason = (
        r"^c\.toml: space\.y\.distribution: almost nothing of 'normal' with mean 2000 and sd 100 is in \[0, 5\]; "
        r"fix the unit or the range$"
    )
    with pytest.raises(CampaignError, match=reason):
        check_distributions(space, "c.toml")
    found = header(space)
    with pytest.raises(CampaignError, match=reason):
        check(found.config, found.spec, "c.toml")
    check(header().config, found.spec, "c.toml")


@pytest.mark.integration
def test_scipy_is_loaded_only_for_distributions() -> None:
    code = "import sys, perfbound.orchestrator.campaign.starts; sys.exit('scipy' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


# Fixed starts in a box: which campaigns choose from them, which points they are, and what their claims are about.

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
    assert found.points[:4] == ((0.0, -5.0), (0.0, 5.0), (1.0, -5.0), (1.0, 5.0))
    assert found.points[4:7] == ((0.5, 0.0), (0.75, -2.5), (0.25, 2.5)), "its first point is a corner"
    assert hashlib.sha256(repr(found.points).encode()).hexdigest().startswith("c1a4f9a3a2548ed7")


@pytest.mark.rest
@settings(max_examples=30, deadline=None)
@given(count=st.integers(8, 300), more=st.integers(0, 300))
def test_fewer_are_the_first_of_more(count: int, more: int) -> None:
    for where in (None, "a <= 0.5 and b >= 0"):
        few = spread_points(("a", "b"), SQUARE, count, where).points
        assert few == spread_points(("a", "b"), SQUARE, count + more, where).points[:count]


def test_they_fill_the_box_more_evenly_than_chance() -> None:
    found = spread_points(tuple("abcdef"), ((0.0, 1.0),) * 6, 4096 + 64, None).nodes[64:]
    random = np.random.default_rng(0).random((4096, 6))
    assert qmc.discrepancy(found) < qmc.discrepancy(random) / 10


def test_those_of_a_region_are_inside_and_as_many() -> None:
    where = "a^2 + (b / 5)^2 <= 1"
    found = spread_points(("a", "b"), SQUARE, 500, where).nodes
    assert len(found) == 500
    assert np.all(found[:, 0] ** 2 + (found[:, 1] / 5) ** 2 <= 1)


def test_a_region_of_almost_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perfbound.orchestrator.campaign.plan.LEAST_SHARE", 0.5)
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
        (6, RIGOROUS, "candidates = 4096\n", 4096),
        (4, RIGOROUS, "resolution = 10\n", None),
        (5, RIGOROUS, "resolution = 7\n", None),
        (2, RIGOROUS, "candidates = 500\n", 500),
        (2, RIGOROUS, 'where = "x0 <= x1"\ncandidates = 64\n', 64),
        (1, SCENARIO, "candidates = 64\n", 64),
        (6, SCENARIO, "candidates = 20\n", 20),
    ],
)
def test_a_box_has_a_lattice_or_the_listed_starts_that_its_file_asks_for(
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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            HEAD.replace("METHOD", 'method = "paper"\nc = 0.1\ncandidates = 9\n' + RIGOROUS) + "x = [0, 1]",
            "candidates: 'rigorous' 'scenario'",
        ),
        (
            HEAD.replace("METHOD", SCENARIO + "candidates = 9") + "scenarios = [[0], [1]]",
            "candidates: ranges",
        ),
        (
            HEAD.replace("METHOD", SCENARIO + "candidates = 2000") + "x = [0, 1]",
            "candidates: 2000 'scenario' most 1000",
        ),
        (
            HEAD.replace("METHOD", RIGOROUS + "candidates = 5001") + "x = [0, 1]",
            "candidates: 5001 >= 2 <= 5000",
        ),
        (HEAD.replace("METHOD", SCENARIO) + "x = [0, 1]", "problems.robustness.method: candidates = 64 'sample'"),
        (
            HEAD.replace("METHOD", RIGOROUS + 'where = "x >= 0.5"') + "x = [0, 1]",
            "space.where: 'rigorous' candidates = 4096 'sample'",
        ),
        (
            HEAD.replace("METHOD", RIGOROUS) + "\n".join(f"{name} = [0, 1]" for name in "abcd"),
            "resolution: resolution = 17 candidates = 4096",
        ),
        (
            HEAD.replace("METHOD", RIGOROUS + "resolution = 60") + "x = [0, 1]\ny = [0, 1]\nz = [0, 1]",
            "resolution: 216,000 more 100,000",
        ),
    ],
)
def test_what_is_refused(text: str, words: str) -> None:
    with pytest.raises(CampaignError) as error:
        parse_campaign(text.encode(), "c.toml")
    assert says(str(error.value), words)
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
    (checked,) = found["spot_check"]["problems"]
    # The least value of the whole box is between the starts, that of the region at its edge.
    assert (checked["status"], checked["violations"] > 0) == (("not refuted", False) if where else ("beyond", True))
    assert claim["refuted"] == [], "no claim about a list is refuted by a start between"
    details = {each["id"]: each["detail"] for each in found["assumptions"]}
    assert says(details["finite_space/robustness"], "64 Sobol")
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
    assert says(box, "^robustness: every start box")
    (fixed,) = scope(plans(robustness(EXACT, candidates=4096), spec(noisy=False)))
    assert says(fixed, "^robustness: 4,096 listed")
    listed = robustness(EXACT, space={"scenarios": [[0.0, 0.0], [1.0, 1.0]]})
    drawn = robustness({"method": "sample"}, clip=(-1.0, 1.0))
    assert [*scope(plans(listed, spec(noisy=False))), *scope(plans(drawn, spec(noisy=False)))] == []
