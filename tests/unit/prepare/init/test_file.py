"""The text of a first campaign file: a campaign that fits its system, whatever words the system contains."""

import itertools
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from perfbound.orchestrator.campaign.checks import check
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.forecast.remaining import warnings
from perfbound.orchestrator.prepare.calibrate.constants import Constant
from perfbound.orchestrator.prepare.init.file import MOST_KEYS, campaign_text, key_lines
from perfbound.orchestrator.prepare.init.init import _reachable
from perfbound.orchestrator.prepare.init.questions import (
    QUESTIONS,
    FirstCampaign,
    docs_table,
    question_help,
    unknown_question,
)
from perfbound.orchestrator.prepare.init.values import FirstValues
from perfbound.orchestrator.prepare.size import EXACT, MOST_SAMPLES, NOISY, FirstSize, first_samples, first_size
from perfbound.schemas.file.objectives import ProblemName
from perfbound.schemas.file.problem_models import RigorousProblem
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.file.space import SystemChoice
from perfbound.schemas.system import Column, Option, Parameter, SystemSpec
from tests.facts import says

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


def proposal(prior_mean: float, norm: float, noise: float | str, alpha: float, **more: Any) -> tuple[Constant, ...]:
    values = {"prior_mean": prior_mean, "rkhs_norm": norm, "noise_scale": noise, "alpha": alpha} | more
    return tuple(Constant(key, value, "From 150 rollouts.") for key, value in values.items())


def sampled(*, batch: int) -> FirstCampaign:
    """Return a campaign of drawn starts."""
    one = campaign(robustness=proposal(-2.0, 17.0, 0.34, 0.1))
    basis = replace(one.basis, constants={}, clip=None)
    size = FirstSize(2995, 1)
    return replace(one, question=QUESTIONS["how-often"], basis=basis, size=size, batch=batch, candidates=None)


def noise_of(constants: tuple[Constant, ...]) -> object:
    return next(each.value for each in constants if each.key == "noise_scale")


def campaign(*, horizon: float = 8.0, **constants: tuple[Constant, ...]) -> FirstCampaign:
    names: dict[str, ProblemName] = {"robustness": "robustness", "nominal": "nominal_robustness", "gap": "sim_gap"}
    specification = "always (x >= -5.0)" if horizon else "x >= -5.0"
    found = {names[name]: each for name, each in constants.items()}
    return FirstCampaign(
        spec=SPEC,
        system=SystemChoice(name="robot"),
        command="perfbound init 'a b.py:robot'",
        question=QUESTIONS["transfer" if len(found) > 1 else "worst"],
        basis=FirstValues(f"The constants are {EVIL}", horizon, specification, "Put yours here.", (-1.0, 2.5), found),
        lengths={"x0": 0.05, "v": 3.5},
        candidates=500,
        size=NOISY,
        noisy=frozenset(name for name, each in found.items() if noise_of(each)),
    )


def test_a_file_is_the_campaign_that_it_was_made_of() -> None:
    text = campaign_text(campaign(robustness=proposal(-2.0, 17.0, 0.34, 0.1)))
    config = parse_campaign(text.encode(), "robot.toml")
    check(config, SPEC, "robot.toml")
    (problem,) = config.problems
    assert (config.name, config.seed, config.horizon, config.clip) == ("robot", 1, 8.0, (-1.0, 2.5))
    assert (config.composition, config.specification) == ("single", "always (x >= -5.0)")
    assert config.candidates == 500, "nothing else makes a claim one about listed starts"
    assert isinstance(config.space, dict)
    assert {name: (each.low, each.high) for name, each in config.space.items()} == {
        each.name: (each.low, each.high) for each in SPEC.parameters
    }
    expected = {"rkhs_norm": 17.0, "prior_mean": -2.0, "noise_scale": 0.34, "alpha": 0.1}
    assert config.replicates_of(problem) == 8
    assert problem.model_dump(include=set(expected)) == expected
    assert config.system.options == {}, "options are comments"
    assert says(text, "rollout s: system")


def test_every_line_is_printable_and_short() -> None:
    for line in campaign_text(campaign(robustness=proposal(-2.0, 17.0, "derived", 0.1))).splitlines():
        assert line.isprintable(), line
        if line.startswith("# ") and "quoted" not in line:
            assert len(line) <= 100


@pytest.mark.parametrize("line", ["gain = 0.5", 'mode = "a\\"b"'])
def test_an_option_is_set_by_removing_its_hash(line: str) -> None:
    text = campaign_text(campaign(robustness=proposal(-2.0, 17.0, 0.34, 0.1)))
    assert text.count(f"\n# system.{line}") == 1
    found = tomllib.loads(text.replace(f"\n# system.{line}", f"\nsystem.{line}"))
    name = line.partition(" ")[0]
    assert found["system"][name] == next(each.default for each in SPEC.options if each.name == name)


def test_a_campaign_for_a_fleet_removes_one_hash() -> None:
    text = campaign_text(campaign(robustness=proposal(-2.0, 17.0, 0.34, 0.1)))
    assert parse_campaign(text.encode(), "c.toml").second_opinion == 0
    asked = text.replace("\n# second_opinion", "\nsecond_opinion")
    assert parse_campaign(asked.encode(), "c.toml").second_opinion == 0.02


def test_two_problems_carry_a_bound_from_the_nominal_to_the_true_system() -> None:
    text = campaign_text(campaign(nominal=proposal(-2.0, 17.0, 0.0, 0.1), gap=proposal(0.1, 3.0, "derived", 0.1)))
    config = parse_campaign(text.encode(), "c.toml")
    check(config, SPEC, "c.toml")
    assert config.composition == "pointwise"
    assert [config.replicates_of(problem) for problem in config.problems] == [1, 8]


def test_one_sample_has_no_horizon() -> None:
    text = campaign_text(campaign(horizon=0.0, robustness=proposal(-2.0, 17.0, 0.34, 0.1)))
    assert "horizon =" not in text
    check(parse_campaign(text.encode(), "c.toml"), SPEC, "c.toml")


def test_the_kernel_of_the_calibration_is_that_of_the_file() -> None:
    kernel = {"nu": 1.5, "length_scale": {"x0": 0.02, "v": 9.0}}
    text = campaign_text(campaign(robustness=proposal(-2.0, 17.0, 0.34, 0.1, kernel=kernel)))
    (problem,) = parse_campaign(text.encode(), "c.toml").problems
    assert isinstance(problem, RigorousProblem)
    assert problem.kernel.model_dump(exclude_none=True) == kernel


@pytest.mark.parametrize("cost", [0.001, 0.1, 0.7, 5.0])
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("variants", [1, 2])
def test_a_first_campaign_is_of_a_size_for_a_minute(cost: float, noisy: bool, variants: int) -> None:
    found, full = first_size(cost, noisy=noisy, variants=variants), NOISY if noisy else EXACT
    assert found.max_tests * found.replicates <= full.max_tests * full.replicates
    if found != first_size(1e9, noisy=noisy, variants=variants):  # the smallest that there is
        assert found.rollouts(variants) * cost / 2 <= 61


def test_a_small_campaign_names_what_a_large_one_has() -> None:
    small = replace(
        campaign(robustness=proposal(-2.0, 17.0, 0.34, 0.1)),
        size=FirstSize(110, 1, spot_check=110),
        cost=0.5,
    )
    config = parse_campaign(campaign_text(small).encode(), "c.toml")
    assert (config.max_tests, config.replicates_of(config.problems[0])) == (110, 1)
    assert (config.spot_check, config.spot_check_followups) == (110, 110)
    assert says(
        comment(campaign_text(small), "Tests at most"),
        "^Tests most 0.5 s `perfbound init` max_tests = 60 replicates = 8 60 tests 8 rollouts 480 rollouts 110",
    )
    assert says(comment(campaign_text(small), "Tests of the check"), "fewer 0.5 s: 299")


def comment(text: str, start: str) -> str:
    """Return the comment that begins with `start`, on one line; empty if there is none."""
    lines = itertools.dropwhile(lambda line: not line.startswith(f"# {start}"), text.splitlines())
    return " ".join(line.removeprefix("# ") for line in itertools.takewhile(lambda line: line.startswith("# "), lines))


SMALL = (
    " A rollout takes about 2 s, so this first campaign is small. More tests prove more: where rollouts are quick, "
    "`perfbound init` writes max_tests = 100."
)


@pytest.mark.parametrize(
    ("cost", "tests", "checks", "small"), [(0.001, 100, 299, ""), (0.5, 100, 110, ""), (2.0, 20, 20, SMALL)]
)
def test_a_campaign_without_noise_is_called_small_where_it_is(cost: float, tests: int, checks: int, small: str) -> None:
    size = first_size(cost, noisy=False, variants=1)
    text = campaign_text(replace(campaign(robustness=proposal(-2.0, 17.0, 0.0, 0.1)), size=size, cost=cost))
    config = parse_campaign(text.encode(), "c.toml")
    assert (config.max_tests, config.spot_check) == (tests, checks)
    assert says(comment(text, "Tests at most"), f"^Tests most bound end.{small}")
    fewer = f"Tests of the check at the end, fewer since a rollout takes about {cost:.2g} s: without it 299."
    assert comment(text, "Tests of the check") == ("" if checks == 299 else fewer)


def test_a_check_of_the_usual_size_has_no_key() -> None:
    size = first_size(0.16, noisy=True, variants=1)
    text = campaign_text(replace(campaign(robustness=proposal(-2.0, 17.0, 0.34, 0.1)), size=size, cost=0.16))
    assert size.spot_check == 299
    assert f"480 rollouts in place of {size.max_tests}." in comment(text, "Tests at most")
    assert "\nspot_check" not in text


def test_replicates_are_those_of_the_problem_with_noise() -> None:
    found = campaign(nominal=proposal(-2.0, 17.0, 0.0, 0.1), gap=proposal(0.1, 3.0, "derived", 0.1))
    text = campaign_text(replace(found, size=first_size(0.5, noisy=True, variants=2), cost=0.5))
    assert says(comment(text, "Tests of a problem"), "max_tests = 60 replicates = 8 sim_gap 60 tests 8 rollouts")


@pytest.mark.parametrize("noise", [0.34, "derived"])
def test_alpha_is_one_that_the_tests_can_reach(noise: float | str) -> None:
    proposed = campaign(robustness=proposal(-2.0, 17.0, noise, 0.01))
    assert warnings(plans(parse_campaign(campaign_text(proposed).encode(), "c.toml"), SPEC))
    found = parse_campaign(campaign_text(_reachable(proposed)).encode(), "c.toml")
    assert warnings(plans(found, SPEC)) == []
    within_reach = campaign(robustness=proposal(-2.0, 17.0, noise, 16.0))
    assert _reachable(within_reach) == within_reach


# Questions

ONE_SIMULATOR = [name for name, each in QUESTIONS.items() if len(each.problems) == 1]
PROGRAM = SystemChoice(
    program=("./robot", "--fast"), columns={"x": "m", "v": "m/s"}, step=0.01, noisy=True, seed_bits=32, limit=6.0
)


def asking(question: str, **changes: Any) -> FirstCampaign:
    """Return the noisy campaign of a question, as large as it can be."""
    found = QUESTIONS[question]
    base = campaign(robustness=proposal(-2.0, 17.0, 0.34, 0.1))
    basis = replace(
        base.basis,
        constants={} if found.drawn else base.basis.constants,
        clip=base.basis.clip if found.clip else None,
    )
    size = first_samples(None) if found.drawn else NOISY
    written: Any = {"question": found, "basis": basis, "size": size, "candidates": None} | changes
    return replace(base, **written)


@pytest.mark.parametrize("question", ONE_SIMULATOR)
@pytest.mark.parametrize("system", [SystemChoice(name="robot"), PROGRAM], ids=["function", "program"])
def test_a_file_for_one_simulator_is_short(question: str, system: SystemChoice) -> None:
    text = campaign_text(asking(question, system=system))
    assert key_lines(text) <= MOST_KEYS
    config = parse_campaign(text.encode(), "robot.toml")
    assert config.system == system
    if system.program is None:
        check(config, SPEC, "robot.toml")


def test_a_file_for_slow_rollouts_is_short_too() -> None:
    size = first_size(1.0, noisy=True, variants=1)
    text = campaign_text(asking("worst", size=size, cost=1.0, system=PROGRAM))
    assert "spot_check_followups" in text
    assert key_lines(text) <= MOST_KEYS


def test_the_file_of_a_guess_names_the_kernel_that_it_has() -> None:
    text = campaign_text(asking("worst"))
    written = next(line for line in text.splitlines() if line.startswith("# kernel = "))
    with_kernel = parse_campaign(text.replace(written, written.removeprefix("# ")).encode(), "robot.toml")
    assert parse_campaign(text.encode(), "robot.toml").digest == with_kernel.digest


@pytest.mark.parametrize(
    ("question", "asked"),
    [
        ("how-often", [("failure_probability", None)]),
        ("worst-cases", [("quantile", 0.01), ("cvar", 0.01), ("share_of_starts", 0.1)]),
        ("next", [("next_rollout", 0.05)]),
    ],
)
def test_questions_about_drawn_starts_need_no_constant(question: str, asked: list[tuple[str, float | None]]) -> None:
    config = parse_campaign(campaign_text(asking(question)).encode(), "robot.toml")
    (problem,) = config.problems
    assert (problem.method, config.max_tests) == ("sample", MOST_SAMPLES)
    assert [(each.asked.quantity, each.asked.level) for each in config.claims_of(problem)] == asked
    assert (config.clip is None) == (question != "worst-cases")


def test_a_distribution_is_set_by_removing_one_hash() -> None:
    lines = campaign_text(asking("how-often")).splitlines()
    example = next(line for line in lines if line.startswith("# space.v = "))
    text = "\n".join(line for line in lines if not line.startswith("space.v"))
    config = parse_campaign(text.replace(example, example.removeprefix("# ")).encode(), "robot.toml")
    check(config, SPEC, "robot.toml")
    assert isinstance(config.space, dict)
    assert config.space["v"].distribution == "normal"


@pytest.mark.parametrize("cost", [None, 0.001, 0.1, 0.7, 5.0])
def test_the_samples_are_those_of_a_minute_and_show_something(cost: float | None) -> None:
    found = first_samples(cost).max_tests
    assert 59 <= found <= MOST_SAMPLES
    if found > 59:
        assert (found + 20) * (cost or 0.0) / 2 <= 61
    text = campaign_text(asking("worst-cases", size=first_samples(cost), cost=cost))
    parse_campaign(text.encode(), "robot.toml")


def test_a_search_for_a_failing_start_ends_with_it() -> None:
    config = parse_campaign(campaign_text(asking("fails")).encode(), "robot.toml")
    (problem,) = config.problems
    assert config.falsify is not None
    assert (problem.method, config.max_tests) == ("sample", 299)


def test_a_search_has_the_scale_of_its_pilot() -> None:
    found = asking("fails")
    text = campaign_text(replace(found, basis=replace(found.basis, scale={"phi": 0.5, "t": 10.0})))
    assert "falsify = { scale = { phi = 0.5, t = 10.0 } }" in text
    assert key_lines(text) <= MOST_KEYS
    config = parse_campaign(text.encode(), "robot.toml")
    assert config.falsify is not None
    assert config.falsify.scale == {"phi": 0.5, "t": 10.0}


def test_regions_are_a_key_beside_those_of_the_worst_start() -> None:
    safe, worst = (parse_campaign(campaign_text(asking(each)).encode(), "robot.toml") for each in ("safe", "worst"))
    assert safe == worst.model_copy(update={"regions": True})


def test_help_and_error_name_every_question() -> None:
    for name, each in QUESTIONS.items():
        assert f"{name}: {each.words}" in question_help()
        assert f"{name} ({each.words})" in unknown_question("often")


def test_the_docs_have_the_table_of_the_questions() -> None:
    assert docs_table() in (Path(__file__).parents[4] / "docs" / "questions.md").read_text()


@pytest.mark.parametrize("batch", [1, 256])
def test_samples_come_in_batches_where_that_pays(batch: int) -> None:
    text = campaign_text(sampled(batch=batch))
    assert ("batch" in tomllib.loads(text)) == (batch > 1)
    assert parse_campaign(text.encode(), "c.toml").batch == batch
    assert key_lines(text) <= MOST_KEYS
