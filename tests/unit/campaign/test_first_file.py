"""The text of a first campaign file: a campaign that fits its system, whatever words the system contains."""

import tomllib
from dataclasses import replace

import pytest

from perfbound.orchestrator.campaign.checks import check
from perfbound.orchestrator.campaign.first_file import FirstCampaign, FirstValues
from perfbound.orchestrator.campaign.first_size import EXACT, NOISY, FirstSize, first_size
from perfbound.orchestrator.campaign.forecast import warnings
from perfbound.orchestrator.campaign.pilot import NU, Constants
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.run.first_campaign import _reachable
from perfbound.schemas.campaign_file import parse_campaign
from perfbound.schemas.problem_models import RigorousProblem
from perfbound.schemas.problems import ProblemName
from perfbound.schemas.space import SystemChoice
from perfbound.schemas.system import Column, Option, Parameter, SystemSpec

EVIL = 'a "quoted" \\ word\n[space]\n\x1b[2J\x7f # and more'
SPEC = SystemSpec(
    name="robot",
    doc=EVIL,
    parameters=(Parameter(name="x0", unit='m"\\\n', low=0.1, high=1e-7 + 0.2), Parameter(name="v", low=-3, high=4)),
    columns=(Column(name="t", unit="s"), Column(name="x", unit="$m\n")),
    options=(
        Option(name="gain", default=0.5, low=0.0, unit="1/s\n", doc=EVIL),
        Option(name="mode", default='a"b', choices=('a"b', "c")),
    ),
    max_horizon=100.0,
    default_horizon=8.0,
)


def campaign(*, horizon: float = 8.0, **constants: Constants) -> FirstCampaign:
    names: dict[str, ProblemName] = {"robustness": "robustness", "nominal": "nominal_robustness", "gap": "sim_gap"}
    specification = "always (x >= -5.0)" if horizon else "x >= -5.0"
    found = {names[name]: each for name, each in constants.items()}
    return FirstCampaign(
        spec=SPEC,
        system=SystemChoice(name="robot"),
        command="perfbound init 'a b.py:robot'",
        basis=FirstValues(f"The constants are {EVIL}", horizon, specification, "Put yours here.", (-1.0, 2.5), found),
        lengths={"x0": 0.05, "v": 3.5},
        candidates=500,
        size=NOISY,
        noisy=frozenset(name for name, each in found.items() if each.noise_scale),
    )


def test_a_file_is_the_campaign_that_it_was_made_of() -> None:
    text = campaign(robustness=Constants(-2.0, 17.0, 0.34, 0.1)).text()
    config = parse_campaign(text.encode(), "c.toml")
    check(config, SPEC, "c.toml")
    (problem,) = config.problems
    assert (config.name, config.seed, config.horizon, config.clip) == ("robot", 1, 8.0, (-1.0, 2.5))
    assert (config.candidates, config.composition, config.specification) == (500, "single", "always (x >= -5.0)")
    assert isinstance(config.space, dict)
    assert {name: (each.low, each.high, each.unit) for name, each in config.space.items()} == {
        each.name: (each.low, each.high, each.unit) for each in SPEC.parameters
    }
    expected = {"rkhs_norm": 17.0, "prior_mean": -2.0, "noise_scale": 0.34, "alpha": 0.1, "replicates": 8}
    assert problem.model_dump(include=set(expected)) == expected
    assert config.system.options == {}, "options are comments"
    assert "# Duration of a rollout in s: the default of the system.\n" in text


def test_every_line_is_printable_and_short() -> None:
    for line in campaign(robustness=Constants(-2.0, 17.0, "derived", 0.1)).text().splitlines():
        assert line.isprintable(), line
        if line.startswith("# ") and "quoted" not in line:
            assert len(line) <= 100


@pytest.mark.parametrize("line", ["gain = 0.5", 'mode = "a\\"b"'])
def test_an_option_is_set_by_removing_its_hash(line: str) -> None:
    text = campaign(robustness=Constants(-2.0, 17.0, 0.34, 0.1)).text()
    assert text.count(f"\n# {line}") == 1
    found = tomllib.loads(text.replace(f"\n# {line}", f"\n{line}"))
    name = line.partition(" ")[0]
    assert found["system"][name] == next(each.default for each in SPEC.options if each.name == name)


def test_a_campaign_for_a_fleet_removes_one_hash() -> None:
    text = campaign(robustness=Constants(-2.0, 17.0, 0.34, 0.1)).text()
    assert parse_campaign(text.encode(), "c.toml").second_opinion == 0
    asked = text.replace("\n# second_opinion", "\nsecond_opinion")
    assert parse_campaign(asked.encode(), "c.toml").second_opinion == 0.02


def test_two_problems_carry_a_bound_from_the_nominal_to_the_true_system() -> None:
    text = campaign(nominal=Constants(-2.0, 17.0, 0.0, 0.1), gap=Constants(0.1, 3.0, "derived", 0.1)).text()
    config = parse_campaign(text.encode(), "c.toml")
    check(config, SPEC, "c.toml")
    assert config.composition == "pointwise"
    assert [config.replicates_of(problem) for problem in config.problems] == [1, 8]


def test_one_sample_has_no_horizon() -> None:
    text = campaign(horizon=0.0, robustness=Constants(-2.0, 17.0, 0.34, 0.1)).text()
    assert "horizon =" not in text
    check(parse_campaign(text.encode(), "c.toml"), SPEC, "c.toml")


def test_the_kernel_of_the_pilot_is_that_of_the_file() -> None:
    config = parse_campaign(campaign(robustness=Constants(-2.0, 17.0, 0.34, 0.1)).text().encode(), "c.toml")
    (problem,) = config.problems
    assert isinstance(problem, RigorousProblem)
    assert problem.kernel.nu == NU


@pytest.mark.parametrize("cost", [0.001, 0.1, 0.7, 5.0])
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("variants", [1, 2])
def test_a_first_campaign_is_of_a_size_for_a_minute(cost: float, noisy: bool, variants: int) -> None:
    found, full = first_size(cost, noisy=noisy, variants=variants), NOISY if noisy else EXACT
    assert found.max_tests <= full.max_tests
    assert found.replicates <= full.replicates
    if found != first_size(1e9, noisy=noisy, variants=variants):  # the smallest that there is
        assert found.rollouts(variants) * cost / 2 <= 61


def test_a_small_campaign_names_what_a_large_one_has() -> None:
    small = replace(
        campaign(robustness=Constants(-2.0, 17.0, 0.34, 0.1)),
        size=FirstSize(30, 4, spot_check=115, recheck=5),
        cost=0.5,
    )
    config = parse_campaign(small.text().encode(), "c.toml")
    assert (config.max_tests, config.replicates_of(config.problems[0])) == (30, 4)
    assert (config.spot_check, config.spot_check_followups, config.recheck) == (115, 115, 5)
    assert "# A rollout takes about 0.5 s, and this file has a size for a first result." in small.text()


@pytest.mark.parametrize("noise", [0.34, "derived"])
def test_alpha_is_one_that_the_tests_can_reach(noise: float | str) -> None:
    proposed = campaign(robustness=Constants(-2.0, 17.0, noise, 0.01))
    assert warnings(plans(parse_campaign(proposed.text().encode(), "c.toml"), SPEC))
    found = parse_campaign(_reachable(proposed).text().encode(), "c.toml")
    assert warnings(plans(found, SPEC)) == []
    within_reach = campaign(robustness=Constants(-2.0, 17.0, noise, 16.0))
    assert _reachable(within_reach) == within_reach
