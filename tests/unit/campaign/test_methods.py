"""Campaign files of methods `rigorous` and `scenario`: what is allowed, and the one line for what is not."""

from dataclasses import replace
from typing import Any

import pytest

from perfbound.orchestrator.campaign.plan import plan
from perfbound.orchestrator.forecast import remaining
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.against_system import check_against
from perfbound.schemas.file.problem_models import RigorousProblem
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.file.space import Scenarios
from perfbound.schemas.system import Column, Option, Parameter, SystemSpec
from perfbound.workers.systems import load_system
from tests.campaigns import FOLDER, PAIR, config
from tests.facts import says

RIGOROUS = PAIR.read_text()
SCENARIO = (FOLDER / "segway-scenario.toml").read_text()
SPEC = SystemSpec(
    name="segway",
    doc="",
    parameters=(Parameter(name="x", unit="m", low=0, high=5), Parameter(name="y", unit="m", low=0, high=5)),
    columns=(Column(name="t", unit="s"), Column(name="phi", unit="rad")),
    options=(Option(name="gains", default="paper", choices=("paper",)), Option(name="noise_variance", default=0.05)),
    max_horizon=60,
)
CSV = b"x,y\n0.5,1.0\n1.5,-0.0\n"


def fault(text: str, old: str, new: str, **files: Any) -> str:
    assert old in text
    with pytest.raises(CampaignError) as caught:
        check_against(parse_campaign(text.replace(old, new).encode(), "c.toml", **files), SPEC, "c.toml")
    line = caught.value.lines[0]
    assert "\n" not in line
    assert line.startswith("c.toml: ")
    return line.removeprefix("c.toml: ")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("rkhs_norm = 0.15", "rkhs_norm = 0.0", "^problems.nominal_robustness.rkhs_norm: 0.0"),
        ("nu = 0.5", "nu = -1.0", "problems.nominal_robustness.kernel.nu: "),
        ('noise_scale = "derived"', "noise_scale = -0.1", "problems.sim_gap.noise_scale: "),
        ('noise_scale = "derived"', 'noise_scale = "guessed"', "problems.sim_gap.noise_scale: 'guessed'"),
        ('noise_scale = "derived"', "noise_scale = 0.4\nregulariser = 0.0", "problems.sim_gap.regulariser: "),
        (
            'noise_scale = "derived"',
            "noise_scale = 0.4\nregulariser = [{ value = 1.0, weight = 0.7 }, { value = 2.0, weight = 0.7 }]",
            "^problems.sim_gap.regulariser: most 1",
        ),
        (
            'noise_scale = "derived"',
            "noise_scale = 0.4\nmisspecification = -1.0",
            "problems.sim_gap.misspecification: ",
        ),
        (
            'noise_scale = "derived"',
            "noise_scale = 0.4\nslack = 1.0",
            "^problems.sim_gap.slack: 1 most alpha",
        ),
        ("replicates = 64", "replicates = 0", "^problems.sim_gap.replicates: 0"),
        (
            "replicates = 64",
            "replicates = 64\nsigma = 'std'",
            "^problems.sim_gap.sigma: 'paper' 'rigorous'",
        ),
        ('method = "rigorous"', 'method = "rigourous"', "method: 'rigourous'"),
        ('composition = "pointwise"', 'composition = "product"', "^composition: 'product' 'paper'"),
        ('kind = "robustness"', 'kind = "predicate_sup", lipschitz = 2.0', "gap.lipschitz: 2 must be 1"),
        ('kind = "robustness"', 'kind = "robustness", column = "phi"', "^gap.column: 'robustness'"),
        ('kind = "robustness"', 'kind = "signal_sup"', "^gap.column: required 'signal_sup'"),
    ],
)
def test_a_wrong_key_of_a_rigorous_campaign_is_named(old: str, new: str, expected: str) -> None:
    assert says(fault(RIGOROUS, old, new), expected)


def test_noise_zero_on_a_noisy_variant_without_replicates_is_refused() -> None:
    single = RIGOROUS.replace("replicates = 64", "replicates = 1")
    found = fault(single, 'noise_scale = "derived"', "noise_scale = 0.0")
    assert says(found, "^problems.sim_gap.noise_scale: 0 true segway")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[0.5, 1.5]", "[0.5, 0.5]", "^space.scenarios: 0 1"),
        ("[0.5, 1.5]", "[0.5]", "^space.scenarios: 1 1 2"),
        ("[0.5, 1.5]", "[0.5, 7.5]", "^space.scenarios: 1 y = 7.5 [0 5] m"),
        ("[0.5, 1.5]", "[0.5, nan]", "space.scenarios.1.1: "),
        ("spread = 0.12", "spread = 0.0", "^problems.true_risk.linearised.spread: 0.0"),
        ("delta = 0.05", "delta = 1.0", "^problems.true_risk.delta: 1.0"),
        ('name = "true_risk"', 'name = "sim_gap"', "^problems.sim_gap.name: 'scenario' 'true_risk'"),
        (
            "delta = 0.05",
            "delta = 0.05\nrkhs_norm = 1.0",
            "^problems.true_risk.rkhs_norm: 'paper' 'rigorous' 'kriging' 'scenario'",
        ),
    ],
)
def test_a_wrong_key_of_a_scenario_campaign_is_named(old: str, new: str, expected: str) -> None:
    assert says(fault(SCENARIO, old, new), expected)


def from_csv(content: bytes, name: str = "cells.csv") -> str:
    start, end = SCENARIO.index("scenarios = ["), SCENARIO.index("]\n\n[[problems]]") + 2
    return SCENARIO[:start] + f'scenarios = "{name}"\n' + SCENARIO[end:]


def test_scenarios_may_stand_in_a_csv_file() -> None:
    found = parse_campaign(from_csv(CSV).encode(), "c.toml", lambda _: CSV)
    assert isinstance(found.space, Scenarios)
    assert found.space.scenarios == ((0.5, 1.0), (1.5, 0.0))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"x,y\n0.5,one\n", "space.scenarios: cells.csv: 0 '0.5,one'"),
        (b"x,y\n0.5,nan\n", "space.scenarios: cells.csv: 0 '0.5,nan'"),
        (b"x,y\n", "space.scenarios: "),
        (b"\xff\xfe", "space.scenarios: cells.csv: not UTF-8"),
    ],
)
def test_a_broken_csv_file_is_one_line(content: bytes, expected: str) -> None:
    with pytest.raises(CampaignError) as caught:
        parse_campaign(from_csv(content).encode(), "c.toml", lambda _: content)
    assert says(str(caught.value), f"^c.toml: {expected}")


@pytest.mark.parametrize("name", ["../cells.csv", "/etc/passwd", ".hidden"])
def test_a_csv_file_elsewhere_is_refused(name: str) -> None:
    with pytest.raises(CampaignError, match="beside the campaign file"):
        parse_campaign(from_csv(CSV, name).encode(), "c.toml", lambda _: CSV)


# The forecast


def test_a_budget_that_cannot_reach_its_tolerance_is_said() -> None:
    chosen = config("segway-pair")
    gap = plan(chosen, load_system(chosen.system.name).spec, chosen.problems[1])
    sentence = remaining.out_of_reach(gap)
    assert sentence is not None
    assert says(sentence, "100 alpha = 0.02")
    assert remaining.out_of_reach(replace(gap, budget=2000, noise=0.001)) is None


def test_tests_left_follow_a_power_law_and_end_with_the_budget() -> None:
    chosen = config("test-function-rigorous")
    problem = chosen.problems[0]
    assert isinstance(problem, RigorousProblem)
    start = 2 * problem.rkhs_norm
    assert remaining.tests_left(chosen, problem, start / 10, 5, None) is None
    # 4/n at n = 100 is .04; alpha = .02 needs n = 200
    assert remaining.tests_left(chosen, problem, 0.04, 100, None) in (100, 101)
    assert remaining.tests_left(chosen, problem, 0.9 * start, 100, None) == chosen.max_tests - 100
    assert remaining.tests_left(chosen, problem, 0.9 * start, 100, 9000) == 8900
