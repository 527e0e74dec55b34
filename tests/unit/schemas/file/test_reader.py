import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.against_system import check_against
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.objectives import CLAIMS, OBJECTIVES
from perfbound.schemas.file.problem_models import PaperProblem
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.system import Column, Option, Parameter, SystemSpec
from tests.campaigns import FOLDER, config, table
from tests.facts import facts, says

PAPER = (FOLDER / "segway-paper.toml").read_text()


def faults_of(text: str, **overrides: Any) -> list[str]:
    with pytest.raises(CampaignError) as caught:
        parse_campaign(text.encode(), "c.toml", **overrides)
    lines = caught.value.lines
    assert not any("\n" in line for line in lines)
    assert all(line.startswith("c.toml: ") for line in lines)
    return [line.removeprefix("c.toml: ") for line in lines]


def fault_of(text: str, **overrides: Any) -> str:
    return faults_of(text, **overrides)[0]


def keys_of(lines: list[str]) -> list[str]:
    return [line.partition(":")[0] for line in lines]


def changed(old: str, new: str) -> str:
    assert old in PAPER
    return PAPER.replace(old, new, 1)


# Content of a file


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.toml")), ids=lambda file: file.stem)
def test_the_shipped_files_are_campaigns_of_their_own_name(file: Path) -> None:
    assert parse_campaign(file.read_bytes(), str(file)).name == file.stem


def test_what_a_file_leaves_out_has_a_default() -> None:
    lines = [line for line in PAPER.splitlines() if not line.startswith(("resolution", "max_tests", "visual", "risk_"))]
    found = parse_campaign("\n".join(lines).encode(), "c.toml")
    assert (found.window, found.replicates, found.resolution, found.max_tests) == (1, 1, 21, 2000)
    assert (found.risk_weight, found.visual, found.max_attempts) == (0.2, "all", 5)
    assert (found.hung_after, found.deadline) == (10.0, 600.0)
    problem = found.problems[0]
    assert isinstance(problem, PaperProblem)
    assert (problem.prior_mean, problem.regulariser, problem.sigma, problem.tail) == (
        0.0,
        "1+eta",
        "variance",
        "gaussian",
    )


WRITTEN_OUT = """name = "a"
seed = 1
composition = "single"
specification = "value <= 0.6"
system.name = "any"
space.z = { low = 0.0, high = 5.0 }

[[problems]]
name = "robustness"
method = "rigorous"
noise_scale = 0.0
delta = 0.05
alpha = 0.05
rkhs_norm = 2.0
kernel = { nu = 2.5, length_scale = 1.0 }
"""


@pytest.mark.parametrize(
    "left_out",
    [
        "",
        "seed = 1\n",
        'method = "rigorous"\n',
        'name = "a"\n',
        'composition = "single"\n',
        "delta = 0.05\n",
        "nu = 2.5, ",
    ],
)
def test_a_default_that_is_left_out_or_written_is_one_campaign(left_out: str) -> None:
    """The digest is that of a perfbound which required these keys: campaigns from then resume."""
    assert left_out in WRITTEN_OUT
    found = parse_campaign(WRITTEN_OUT.replace(left_out or "\0", "").encode(), "a.toml").digest
    assert found == "b3b69bba932a0d602ac61cd7464b905f9be7f1bb53ed67626fa7437464ac5aac"


def test_another_value_of_these_keys_is_another_campaign() -> None:
    known = parse_campaign(WRITTEN_OUT.encode(), "c.toml").digest
    for old, new in (("delta = 0.05", "delta = 0.1"), ("nu = 2.5", "nu = 1.5")):
        assert parse_campaign(WRITTEN_OUT.replace(old, new).encode(), "c.toml").digest != known


def test_a_problem_overrides_what_the_campaign_says() -> None:
    first, second = table("segway-paper")["problems"]
    gap = {"column": "x", "lipschitz": 2.0}
    found = config(
        "segway-paper", problems=[first, {**second, "replicates": 3, "resolution": 5, "max_tests": 7, "gap": gap}]
    )
    nominal, sim_gap = found.problems
    assert (found.replicates_of(nominal), found.resolution_of(nominal), found.max_tests_of(nominal)) == (1, 21, 2000)
    assert (found.replicates_of(sim_gap), found.resolution_of(sim_gap), found.max_tests_of(sim_gap)) == (3, 5, 7)
    chosen = found.gap_of(sim_gap)
    assert chosen is not None
    assert (chosen.column, chosen.lipschitz) == ("x", 2.0)
    assert found.gap_of(nominal) is None, "it compares no trajectories"
    assert found.window_of(sim_gap) == 1


def test_an_override_of_the_command_line_replaces_a_key_and_is_checked() -> None:
    assert parse_campaign(PAPER.encode(), "c.toml", seed=7).seed == 7
    assert says(fault_of(PAPER, seed=-1), "^seed: -1 >= 0")
    assert fault_of("", seed=7).startswith("the file is empty")


def test_the_digest_tells_content_from_layout() -> None:
    one = parse_campaign(PAPER.encode(), "one.toml")
    assert one.digest == parse_campaign(("# another comment\n" + PAPER).encode(), "two.toml").digest
    assert one.digest != parse_campaign(PAPER.encode(), "one.toml", seed=2).digest


ONE_PROBLEM = """specification = "value <= 0.6"
alpha = 0.05
rkhs_norm = 2.0
noise_scale = 0.0
kernel = { length_scale = 1.0 }
system.name = "any"
space.z = { low = 0.0, high = 5.0 }
"""


def test_a_file_with_one_problem_has_its_keys_at_the_top() -> None:
    assert parse_campaign(ONE_PROBLEM.encode(), "a.toml") == parse_campaign(WRITTEN_OUT.encode(), "c.toml")


def test_on_a_list_of_starts_the_method_is_scenario() -> None:
    text = 'alpha = 0.1\nclip = [-1, 1]\nspecification = "v >= 0"\nsystem.name = "a"\nspace.scenarios = [[0], [1.5]]'
    (problem,) = parse_campaign(text.encode(), "c.toml").problems
    assert (problem.name, problem.method) == ("robustness", "scenario")


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("alpha = 0.05\n", "", "^alpha: required > 0"),
        ("alpha = 0.05", "alfa = 0.05", "^alfa: unknown 'alpha'"),
        ("rkhs_norm = 2.0", "rkhs_norm = -1", "^rkhs_norm: -1 > 0"),
        ("alpha = 0.05", 'alpha = 0.05\nmethod = "best"', "^method: 'best' 'paper'"),
        (
            "kernel = { length_scale = 1.0 }",
            "kernel = { nu = 0 }",
            "^kernel.nu: 0 > 0",
        ),
        ("alpha = 0.05", "alpha = 0.05\nslack = 1", "slack: 1 must be at most alpha = 0.05"),
    ],
)
def test_a_fault_of_the_only_problem_is_named_where_it_is(old: str, new: str, reason: str) -> None:
    assert old in ONE_PROBLEM
    assert says(fault_of(ONE_PROBLEM.replace(old, new)), reason)


def test_a_key_of_the_campaign_below_a_table_is_told_where_it_stands() -> None:
    text = ONE_PROBLEM.replace("alpha = 0.05\n", "").replace("space.z =", "[space]\nalpha = 0.05\nz =")
    assert says(fault_of(text), "above [table]")


def test_keys_of_a_problem_at_the_top_are_refused_beside_problems() -> None:
    assert says(fault_of("alpha = 1.0\n" + WRITTEN_OUT), "^alpha: below [[problems]]")


def test_the_name_is_that_of_the_file() -> None:
    assert parse_campaign(ONE_PROBLEM.encode(), "runs/My Cars_2.toml").name == "my-cars_2"
    with pytest.raises(CampaignError, match=facts("name: required 1 64")):
        parse_campaign(ONE_PROBLEM.encode(), "\u00fc.toml")


# Errors in a file


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (changed("horizon = 15.0", "horizon = 0.0"), "^horizon: 'nominal_robustness'"),
        (changed("clip = [-0.05, 0.75]", "clip = [1.0]"), "^clip.1: [1.0] [low high]"),
        (changed('name = "segway-paper"', 'name = "A"'), "^name: 'A' 1 64"),
        (
            changed('name = "segway"\n', 'python = "hole:hole3"\n'),
            "^system.python: 'hole:hole3' FILE.py:NAME",
        ),
        (changed('name = "segway"\n', ""), "^system.name: name = python"),
        (changed('gains = "paper"', "gains = [1]"), "^system.gains: [1]"),
        (
            changed('gap = { kind = "signal_sup", column = "phi", lipschitz = 1.0 }', ""),
            "gap: required by problem 'sim_gap'",
        ),
        (
            changed('name = "sim_gap"', 'name = "true_risk"').replace('sense = "max"', ""),
            "problems.true_risk.replicates: ",
        ),
        (changed('name = "sim_gap"', 'name = "maximum"'), "^problems.maximum.column: required 'maximum'"),
        (
            changed('sense = "min"', 'column = "phi"'),
            "^problems.nominal_robustness.column: 'maximum'",
        ),
        (changed('sense = "min"', "window = 2"), "^problems.nominal_robustness.window: 1"),
        (changed('composition = "product"', 'composition = "single"'), "composition: 'single' is for one problem"),
        (
            PAPER.replace('"sim_gap"', '"nominal_robustness"').replace('"max"', '"min"'),
            "problems: 'nominal_robustness' appears twice",
        ),
        (
            changed("low = 0.0, high = 5.0", "lo = 0.0, hi = 5.0"),
            "^space.x.lo: unknown 'low'",
        ),
        (changed("delta = 0.05", "delta = 2.0\nepsilon = 1"), "problems.nominal_robustness.epsilon: unknown key; "),
        (
            changed("delta = 0.05", "delta = 2.0").replace("alpha = 0.01", "alpha = 0"),
            "problems.nominal_robustness.delta: ",
        ),
        (changed("delta = 0.05", "delta = 1979-05-27"), "^problems.0.delta: 1979-05-27"),
        ("problems = 3", "system: this key is required"),
        ("composition = 3", "^composition: 3"),
    ],
)
def test_the_fault_is_named(text: str, reason: str) -> None:
    assert says(fault_of(text), reason)


def test_every_fault_has_a_line() -> None:
    found = faults_of(changed("seed = 1\n", "seed = 1.5\n").replace("delta = 0.05", "delta = 2.0"))
    assert keys_of(found) == ["seed", "problems.nominal_robustness.delta", "problems.sim_gap.delta"]
    assert len(faults_of(PAPER[: PAPER.rindex("[[problems]]")].replace("delta = 0.05", "delta = 2.0"))) == 1


def test_a_misspelt_key_is_one_fault_beside_others() -> None:
    text = changed("alpha = 0.05", "alhpa = 0.05").replace("seed = 1\n", "seed = -1\n").replace("low = 0.0", "lw = 0.0")
    assert keys_of(faults_of(text)) == ["space.x.lw", "space.y.lw", "problems.nominal_robustness.alhpa", "seed"]


def test_every_rule_of_several_keys_has_a_line() -> None:
    text = changed("horizon = 15.0", "horizon = 0.0").replace("max_tests = ", "max_tests = 1 #")
    text = text.replace('sense = "min"', "window = 2").replace('specification = "', 'specification = "" #')
    assert keys_of(faults_of(text)) == [
        "horizon",
        "problems.nominal_robustness.window",
        "problems.sim_gap.max_tests",
    ]


def test_a_key_that_two_rules_need_is_one_fault() -> None:
    without = "\n".join(line for line in PAPER.splitlines() if not line.startswith("clip"))
    assert faults_of(without) == ["clip: required by problem 'nominal_robustness'"]


def test_of_many_faults_the_first_are_listed() -> None:
    found = faults_of("".join(f"wrong{k} = 1\n" for k in range(30)) + PAPER)
    assert len(found) == 21
    assert found[-1] == "10 more faults; fix these first"


@pytest.mark.parametrize("problem", ["3", "{ name = ['a'] }", "{ name = 'sim_gap' }", "{ }"])
def test_a_problem_that_is_hardly_one_is_a_fault_like_others(problem: str) -> None:
    start = PAPER[: PAPER.index("[[problems]]")]
    assert fault_of(f"problems = [{problem}]\n{start}").startswith("problems.")


# Errors that only the system can detect


SPEC = SystemSpec(
    name="segway",
    doc="",
    parameters=tuple(Parameter(name=name, unit="m", low=-20.0, high=25.0) for name in ("x", "y")),
    columns=(Column(name="t", unit="s"), Column(name="phi", unit="rad")),
    options=(
        Option(name="gains", default="paper", choices=("paper", "aggressive")),
        Option(name="noise_variance", default=0.05, low=0.0),
        Option(name="mass", default=1.0),
    ),
    max_horizon=120.0,
)


def refused(text: str) -> str:
    with pytest.raises(CampaignError) as caught:
        check_against(parse_campaign(text.encode(), "c.toml"), SPEC, "c.toml")
    return str(caught.value)


def test_a_file_that_suits_its_system() -> None:
    check_against(parse_campaign(PAPER.encode(), "c.toml"), SPEC, "c.toml")


def test_an_option_without_limits_takes_any_number_and_no_text() -> None:
    assert refused(changed('gains = "paper"', "noise_variance = -1")).endswith("allowed is a number >= 0")
    assert says(refused(changed('gains = "paper"', 'mass = "heavy"')), "'heavy'")
    check_against(parse_campaign(changed('gains = "paper"', "mass = -1e9").encode(), "c.toml"), SPEC, "c.toml")


def test_every_fault_against_the_system_has_a_line() -> None:
    text = (
        changed("\nx = {", "\nz = {")
        .replace('gains = "paper"', 'gaims = "paper"')
        .replace("horizon = 15", "horizon = 150")
    )
    lines = refused(text).splitlines()
    assert [line.split(": ")[1] for line in lines] == ["space.z", "space.x", "system.gaims", "horizon"]
    assert says(lines[2], "unknown 'gains'")


def test_a_parameter_is_meant() -> None:
    renamed = SPEC.model_copy(
        update={"parameters": tuple(p.model_copy(update={"name": f"gap_{p.name}"}) for p in SPEC.parameters)}
    )
    with pytest.raises(CampaignError) as caught:
        check_against(parse_campaign(changed("\nx = {", "\ngapx = {").encode(), "c.toml"), renamed, "c.toml")
    assert caught.value.lines[:3] == (
        "c.toml: space.gapx: unknown parameter; did you mean 'gap_x'? segway has gap_x, gap_y",
        "c.toml: space.y: unknown parameter; segway has gap_x, gap_y",
        "c.toml: space.gap_y: this parameter of segway is required",
    )


def test_a_column_is_named_where_it_stands() -> None:
    assert says(refused(changed('column = "phi"', 'column = "roll"')), "^c.toml: gap.column: 'roll'")
    inner = changed('sense = "max"', 'gap = { column = "yaw" }')
    assert says(refused(inner), "^c.toml: problems.sim_gap.gap.column: 'yaw'")


# Round trip


numbers = st.floats(min_value=1e-6, max_value=1e6)
lengths = st.one_of(numbers, st.dictionaries(st.text(min_size=1), numbers, min_size=1))
kernels = st.fixed_dictionaries({"nu": st.floats(min_value=0.1, max_value=50), "length_scale": lengths})
gaps = st.fixed_dictionaries({"column": st.text(min_size=1)}, optional={"lipschitz": numbers})
ranges = st.tuples(st.floats(-1e6, 1e6), st.floats(0.5, 1e6)).map(
    lambda pair: {"low": pair[0], "high": pair[0] + pair[1]}
)


def problems(name: str) -> st.SearchStrategy[dict[str, Any]]:
    needed: dict[str, Any] = {
        "name": st.just(name),
        "method": st.just("paper"),
        "delta": st.floats(min_value=1e-9, max_value=0.999),
        "alpha": numbers,
        "c": numbers,
        "rkhs_norm": numbers,
        "noise_scale": numbers,
        "kernel": kernels,
        "replicates": st.integers(2, 50),
    }
    optional: dict[str, Any] = {
        "sense": st.just(OBJECTIVES[name].sense),  # type: ignore[index]
        "prior_mean": st.floats(-1e6, 1e6),
        "regulariser": st.one_of(st.just("1+eta"), numbers),
        "sigma": st.sampled_from(["variance", "std"]),
        "tail": st.sampled_from(["gaussian", "sub-gaussian"]),
        "resolution": st.integers(2, 40),
        "max_tests": st.integers(2, 10_000),
        "gap": gaps,
    }
    if name == "maximum":
        needed["column"] = st.text(min_size=1)
    return st.fixed_dictionaries(needed, optional=optional)


@st.composite
def campaigns(draw: st.DrawFn) -> dict[str, Any]:
    composition = draw(st.sampled_from(["product", "sum", "single"]))
    names = ["nominal_robustness", "sim_gap"] if composition != "single" else [draw(st.sampled_from(CLAIMS))]
    needed: dict[str, Any] = {
        "name": st.from_regex(r"[a-z0-9][a-z0-9_-]{0,63}", fullmatch=True),
        "seed": st.integers(0, 2**53 - 1),
        "composition": st.just(composition),
        "specification": st.text(),
        "clip": st.tuples(st.floats(-10, -0.1), st.floats(0.1, 10)),
        "horizon": numbers,
        "gap": gaps,
        "system": st.dictionaries(st.from_regex(r"[a-z]{1,5}", fullmatch=True), st.text() | numbers).map(
            lambda options: {**options, "name": "segway"}
        ),
        "space": st.dictionaries(st.text(), ranges, min_size=1, max_size=3),
        "problems": st.tuples(*(problems(name) for name in names)),
    }
    optional: dict[str, Any] = {"risk_weight": numbers, "visual": st.sampled_from(["all", "none"])}
    return draw(st.fixed_dictionaries(needed, optional=optional))


@pytest.mark.rest
@given(campaigns())
def test_a_campaign_survives_the_way_through_json(values: dict[str, Any]) -> None:
    one = CampaignConfig.model_validate_json(json.dumps(values))
    two = CampaignConfig.model_validate_json(one.model_dump_json())
    assert two == one
    assert two.digest == one.digest
    assert two.system.options == one.system.options
    assert CampaignConfig.model_validate_json(json.dumps(one.model_dump(mode="json"))) == one


@given(st.binary() | st.text().map(str.encode))
def test_any_bytes_are_a_campaign_or_one_fault(data: bytes) -> None:
    with pytest.raises(CampaignError, match=r"^c\.toml: "):
        parse_campaign(data, "c.toml")


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("-2.0", "-2.0 > 0"),
        ("{}", "> 0"),
        ("[1.0, 2.0]", "[1.0, 2.0] > 0"),
        ("{ x = 1.0 }", "has x segway: x y"),
        ("{ x = 1.0, v = 2.0 }", "has x v segway: x y"),
    ],
)
def test_a_length_scale_that_is_none(value: str, reason: str) -> None:
    text = changed("length_scale = 2.0", f"length_scale = {value}")
    assert says(refused(text), f"^c.toml: problems.nominal_robustness.kernel.length_scale: {reason}")


def test_a_wrong_length_scale_of_one_parameter_is_named() -> None:
    (fault,) = faults_of(changed("length_scale = 2.0", "length_scale = { x = 0.0, y = 1.0 }"))
    assert says(fault, "^problems.nominal_robustness.kernel.length_scale.x: 0.0 > 0")


def test_a_length_scale_per_parameter_in_any_order() -> None:
    one, other = (
        parse_campaign(changed("length_scale = 2.0", f"length_scale = {value}").encode(), "c.toml")
        for value in ("{ x = 1, y = 2.5 }", "{ y = 2.5, x = 1.0 }")
    )
    assert one == other
    assert one.digest == other.digest
    problem = one.problems[0]
    assert problem.method == "paper"
    assert problem.kernel.described == "1 (x), 2.5 (y)"
    assert problem.kernel.scaled(0.5).length_scale == {"x": 0.5, "y": 1.25}


# Method sample


def of_method_sample(key: str) -> str:
    claims = 'claims = [{ quantity = "mean" }]'
    return f'specification = "v >= 0"\n{key} = 3\nsystem.name = "a"\nspace.x = [0, 1]\n{claims}'


@pytest.mark.parametrize(
    ("key", "owners"),
    [
        ("alpha", "'paper' 'rigorous' 'scenario'"),
        ("rkhs_norm", "'paper' 'rigorous' 'kriging'"),
        ("sigma", "'paper'"),
    ],
)
def test_a_key_of_another_method_is_no_unknown_key(key: str, owners: str) -> None:
    assert says(fault_of(of_method_sample(key)), f"^{key}: {owners} 'sample'")


@pytest.mark.parametrize("key", ["c = 0.1", 'sigma = "std"', 'tail = "gaussian"', "refine = true"])
def test_a_key_of_method_paper_in_method_rigorous_names_its_method(key: str) -> None:
    text = ONE_PROBLEM.replace("alpha = 0.05", f"alpha = 0.05\n{key}")
    name = key.partition(" ")[0]
    beside = WRITTEN_OUT.replace("alpha = 0.05", f"alpha = 0.05\n{key}")
    for found, full in ((faults_of(text), name), (faults_of(beside), f"problems.robustness.{name}")):
        (fault,) = found
        assert says(fault, f"^{full}: 'paper' 'rigorous'")


@pytest.mark.parametrize(
    "draws",
    [
        'space.x = [0, 1]\n[[claims]]\nquantity = "failure_probability"',
        'space.x = { low = 0, high = 1, distribution = "normal", mean = 0.5, sd = 1 }',
        'space.x = [0, 1]\nmethod = "sample"',
        "space.table = [[1], [2]]",
    ],
)
def test_a_campaign_of_a_program_that_draws_describes_the_program_too(draws: str) -> None:
    text = f'system.program = ["./one"]\nsystem.columns = {{ v = "m" }}\n{draws}'
    (problem,) = parse_campaign(text.encode(), "c.toml", whole=False).problems
    assert problem.method == "sample"


# Length scales that a file leaves out


@pytest.mark.parametrize("kernel", ["", "kernel = { }\n", "kernel = { nu = 2.5 }\n"])
def test_a_file_without_length_scales_has_half_of_each_range(kernel: str) -> None:
    written = ONE_PROBLEM.replace("length_scale = 1.0", "length_scale = { z = 2.5 }")
    without = ONE_PROBLEM.replace("kernel = { length_scale = 1.0 }\n", kernel)
    assert without != ONE_PROBLEM or not kernel
    found = parse_campaign(without.encode(), "c.toml")
    assert found == parse_campaign(written.encode(), "c.toml")
    assert found.digest == parse_campaign(written.encode(), "c.toml").digest


def test_many_parameters_have_length_scales_of_whole_ranges() -> None:
    more = "".join(f"space.v{k} = [0, {k + 1}]\n" for k in range(3))
    text = "resolution = 3\n" + ONE_PROBLEM.replace("kernel = { length_scale = 1.0 }\n", "") + more
    (problem,) = parse_campaign(text.encode(), "c.toml").problems
    assert problem.model_dump()["kernel"]["length_scale"] == {"z": 5.0, "v0": 1.0, "v1": 2.0, "v2": 3.0}


def test_a_fault_of_a_range_is_reported_and_no_missing_kernel() -> None:
    text = ONE_PROBLEM.replace("kernel = { length_scale = 1.0 }\n", "").replace("high = 5.0", "high = -5.0")
    (fault,) = faults_of(text)
    assert fault.startswith("space.z")


@pytest.mark.parametrize("method", ["paper", "scenario"])
def test_no_other_method_derives_a_kernel(method: str) -> None:
    text = ONE_PROBLEM.replace("kernel = { length_scale = 1.0 }\n", f'method = "{method}"\n')
    assert "kernel" in fault_of(text) if method == "paper" else fault_of(text)


DRAFT = """horizon = 1
specification = "value >= 0"
system.name = "test-function"
space.z1 = [0, 1]
space.z2 = [0, 1]
"""


def test_a_draft_is_told_where_its_constants_come_from() -> None:
    with pytest.raises(CampaignError) as caught:
        parse_campaign(DRAFT.encode(), "c.toml")
    assert says(caught.value.lines[-1], "^c.toml: kernel: `perfbound calibrate c.toml`")


SLIPS = [
    ("horizon = 1\nspecification = always (y <= 2)\n", "line 2 put text in quotes"),
    ("specification = \u201calways (y <= 2)\u201d\n", "line 1 straight quotes"),
    ('horizon = 1\n[system]\npython = "C:\\Users\\me\\base.py:f"\n', "line 3 write a path with /"),
    ("horizon = 1,5\n", "line 1 with a point, as 1.5"),
    ("horizon = 10 s\n", "line 1 without its unit"),
    ("horizon: 1\n", "line 1 write KEY = VALUE"),
    ("horizon = 1\nhorizon = 2\n", "Cannot overwrite a value"),
]
"""Lines of a careless user that are no TOML, and what the error says."""


@pytest.mark.parametrize(("text", "words"), SLIPS)
def test_a_line_that_is_no_toml_says_what_to_write(text: str, words: str) -> None:
    assert says(fault_of(text), f"^not TOML: {words}")


OWN = (
    'horizon = 1\nspecification = "always (y <= 2)"\nHEAD\n[system]\npython = "cars.py:cars"\nSYSTEM\n[space]\nSPACE\n'
)
CARELESS = [
    ("falsify = {}", "", "x = { min = 0, max = 1 }", "space.x.min: did you mean 'low'"),
    ("falsify = {}", "", "Tank.level0 = [0, 1]", "space.Tank.level0: no dot write tank_level0"),
    ("falsify = true", "", "x = [0, 1]", "falsify: True a table falsify = {}"),
    ("claims = { quantity = 'failure_probability' }", "", "x = [0, 1]", "claims: a list of tables: [{ quantity ="),
    ("claims = ['failure_probability']", "", "x = [0, 1]", "claims.0: a table: { quantity ="),
    ("falsify = {}", "fmu = 'Tank.fmu'", "x = [0, 1]", "system.name: python and fmu several systems; give one of"),
    ("falsify = { scale = 'auto' }", "", "x = [0, 1]", "falsify.scale: 'auto' a table perfbound init writes pilot"),
    ("falsify = { scale = { y = 0 } }", "", "x = [0, 1]", "falsify.scale.y: 0"),
    ("falsify = {}\nrequired_at_most = 5", "", "x = [0, 1]", "required_at_most: 5 between 0 and 1; 5 % is 0.05"),
    ("falsify = {}\nrequired_at_most = 0", "", "x = [0, 1]", "required_at_most: 0 between 0 and 1"),
]
"""Further keys, below `[system]`, the space, and what the error says."""


def careless(head: str, system: str, space: str) -> str:
    return OWN.replace("HEAD", head).replace("SYSTEM", system).replace("SPACE", space)


@pytest.mark.parametrize(("head", "system", "space", "words"), CARELESS)
def test_a_careless_value_says_what_to_write(head: str, system: str, space: str, words: str) -> None:
    assert says(fault_of(careless(head, system, space)), f"^{words}")


def test_a_key_of_the_campaign_below_the_system_is_sent_to_its_place() -> None:
    file = parse_campaign(careless("falsify = {}", "deadline = 3\ngain = 2", "x = [0, 1]").encode(), "c.toml")
    spec = SystemSpec(
        name="cars",
        doc="",
        parameters=(Parameter(name="x", unit="", low=0, high=1),),
        columns=(Column(name="t", unit="s"), Column(name="y", unit="m")),
        max_horizon=9,
    )
    with pytest.raises(CampaignError) as caught:
        check_against(file, spec, "c.toml")
    key, option = caught.value.lines
    assert says(key, "^c.toml: system.deadline: above the first [table]")
    assert says(option, "^c.toml: system.gain: cars has no options")


def test_a_misspelt_key_is_the_only_fault_of_what_follows_from_it() -> None:
    table = 'horizon = 20\nspecification = "always x <= 1"\nfalsfy = {}\nmax_tests = 9\nsystem.name = "a"\n'
    with pytest.raises(CampaignError) as caught:
        parse_campaign(f"{table}space.x = [0, 1]\n".encode(), "c.toml")
    assert caught.value.lines == ("c.toml: falsfy: unknown key; did you mean 'falsify'?",)
