"""What is wrong in a campaign file."""

import functools
from pathlib import Path
from typing import Any, get_args

import pytest

from perfbound.orchestrator.campaign import consistency
from perfbound.orchestrator.campaign.checks import check, check_new
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.campaign.region import condition
from perfbound.orchestrator.campaign.starts import check_where
from perfbound.schemas.file.against_system import check_against
from perfbound.schemas.file.method_spaces import SPACES
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.file.space import SpaceKind
from tests.fakes.simulators import robustness, spec
from tests.texts import Cases, refusal, refusals, rows
from tests.unit.campaign import (
    test_composed_claims,
    test_consistency,
    test_kriging,
    test_methods,
    test_region,
    test_regions,
    test_requirements,
    test_robustness,
    test_sample,
    test_starts,
)
from tests.unit.prepare.plan import test_sizes
from tests.unit.schemas.file import test_reader, test_signal_forms, test_signal_spaces, test_space


def campaign_file(_folder: Path) -> Cases:
    """Yield the refusals of keys, of a space and of problems, and of what does not suit the system."""
    yield from _keys()
    yield from _slips()
    yield from _spaces()
    yield from _regions()
    yield from _problems()
    yield from _requirements()


def constants(_folder: Path) -> Cases:
    """Yield what is said of constants that contradict each other, and of what a claim is about."""
    of_plan, plan = consistency.of_plan, test_consistency.a_plan
    short = plan(kernel={"nu": 2.5, "length_scale": 0.1})
    yield "a length scale below the spacing", "\n".join(of_plan(short, test_consistency.spec()))
    two = test_consistency.spec("m", "rad")
    yield "one length for two units", "\n".join(of_plan(plan(), two))
    each = plan(kernel={"nu": 2.5, "length_scale": {"x": 3.0, "y": 0.1}})
    yield "a length scale for each parameter", "\n".join(of_plan(each, two))
    guessed = plan(noise_scale=0.1, replicates=1)
    yield "a noise scale without replicates", "\n".join(of_plan(guessed, test_consistency.spec()))
    for name, found in {
        "a norm below the data": consistency.of_tests(plan(number=0), [-0.5], [], []),
        "a clip above everything": consistency.of_tests(plan(), [], [], [0.75] * 10),
        "a clip below everything": consistency.of_tests(plan(), [], [], [-0.05] * 10),
        "a noise scale far above the spread": consistency.of_tests(plan(), [0.05] * 10, [(0.05, 0.05)] * 10, []),
    }.items():
        yield name, "\n".join(found.values())
    for name, changes in {"a box": {}, "candidates": {"candidates": 4096}}.items():
        about = plans(robustness(test_starts.EXACT, **changes), spec(noisy=False))
        yield f"the claim is about {name}", "\n".join(consistency.scope(about))


def _slips() -> Cases:
    for text, _ in test_reader.SLIPS:
        yield f"no TOML: {text}", test_reader.fault_of(text)
    for head, system, space, _ in test_reader.CARELESS:
        yield f"careless: {head} {system} {space}", test_reader.fault_of(test_reader.careless(head, system, space))


def _keys() -> Cases:
    file, faults = test_reader, test_reader.fault_of
    yield "an empty file", faults("", seed=7)
    yield "an option of the command line", faults(file.PAPER, seed=-1)
    at_the_top = file.test_a_fault_of_the_only_problem_is_named_where_it_is
    yield from refusals("one problem", at_the_top, lambda old, new: faults(file.ONE_PROBLEM.replace(old, new)))
    below = file.ONE_PROBLEM.replace("alpha = 0.05\n", "").replace("space.z =", "[space]\nalpha = 0.05\nz =")
    yield "a key of the campaign below a table", faults(below)
    yield "a key of a problem at the top", faults("alpha = 1.0\n" + file.WRITTEN_OUT)
    yield "no name", refusal(lambda: parse_campaign(file.ONE_PROBLEM.encode(), "\u00fc.toml"))
    for number, (whole, _) in enumerate(rows(file.test_the_fault_is_named)):
        new = [line for line in whole.splitlines() if line not in file.PAPER.splitlines()]
        yield f"a file of two problems {number}: {' / '.join(new) or 'a line is left out'}", faults(whole)
    yield "more than 20 faults", file.faults_of("".join(f"wrong{k} = 1\n" for k in range(30)) + file.PAPER)[-1]
    for option in ("noise_variance = -1", 'mass = "heavy"'):
        yield f"an option of the system: {option}", file.refused(file.changed('gains = "paper"', option))
    other = file.changed("\nx = {", "\nz = {").replace('gains = "paper"', 'gaims = "paper"')
    yield "faults against the system", file.refused(other.replace("horizon = 15", "horizon = 150"))
    yield "no such column", file.refused(file.changed('column = "phi"', 'column = "roll"'))
    for value, _ in rows(file.test_a_length_scale_that_is_none):
        scaled = file.changed("length_scale = 2.0", f"length_scale = {value}")
        yield f"length_scale = {value}", file.refused(scaled)
    one = file.changed("length_scale = 2.0", "length_scale = { x = 0.0, y = 1.0 }")
    yield "length_scale = { x = 0.0, y = 1.0 }", faults(one)
    for key, *_ in rows(file.test_a_key_of_another_method_is_no_unknown_key):
        yield f"{key} in method sample", faults(file.of_method_sample(key))
    for key in rows(file.test_a_key_of_method_paper_in_method_rigorous_names_its_method):
        yield f"{key} in method rigorous", faults(file.ONE_PROBLEM.replace("alpha = 0.05", f"alpha = 0.05\n{key}"))
    yield "a draft without constants", refusal(lambda: parse_campaign(file.DRAFT.encode(), "c.toml"))


def _spaces() -> Cases:
    space = test_space
    yield from refusals("space.gap", space.test_a_range_that_is_none, lambda value: space.fault(f"gap = {value}"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(SPACES, "rigorous", get_args(SpaceKind))  # one that draws
        yield from refusals("space", space.test_a_distribution_that_is_none, space.fault)
        yield from refusals("space", space.test_a_table_that_is_none, space.fault)
        for row in ("[[1, 2, 3]]", "[[1, 2], [3, 400]]"):
            parsed = space.parsed(f"table = {row}")
            yield f"space of another system: table = {row}", refusal(functools.partial(_of_another, parsed))
        listed = f'method = "rigorous"\n{space.HEAD}table = "a.csv"'.encode()
        exchanged = parse_campaign(listed, "c.toml", lambda _: b"speed,gap\n1,2\n")
        yield "space: a header that exchanges parameters", refusal(lambda: _of_another(exchanged))
    for name, text in {
        "a distribution": space.ranged("normal", "mean = 20, sd = 5"),
        "steps": "gap = { low = 0, high = 4, step = 1 }",
        "choices": "gap = { choices = [1, 2] }",
        "a table": "table = [[1, 2]]",
    }.items():
        yield f"space: {name} where nothing is drawn", space.fault(text)
    yield from refusals("input signal", test_signal_spaces.test_what_is_refused, test_signal_spaces.fault_of_space)
    yield from refusals("input signal", test_signal_forms.test_what_is_refused, test_signal_forms.parsed)
    without = test_signal_spaces.HEAD.replace("LENGTH", "1.0").replace("horizon = 4\n", "") + test_signal_spaces.SIGNAL
    yield "input signal: no horizon", refusal(lambda: parse_campaign(f"{without}gap = [0, 9]".encode(), "c.toml"))


def _of_another(config: Any) -> None:
    check_against(config, test_space.SPEC, "c.toml")


def _regions() -> Cases:
    region = test_region
    yield from refusals("where", region.test_where_a_region_is_refused, region.refused)
    for text in ("log_ <= 0", *rows(region.test_a_start_has_no_time)):
        yield f"where: {text}", refusal(functools.partial(condition, text, ("x", "y")))
    for text in ("x > 0.999", "z > 1"):
        yield f"where: {text} (share)", refusal(functools.partial(check_where, region.BOX, text, "c.toml"))
    starts = test_starts
    yield from refusals("candidates", starts.test_what_is_refused, _parsed)
    sizes = test_sizes
    for method, parameters, changes in (("paper", 6, {}), ("paper", 12, {}), ("rigorous", 40, {"resolution": 2})):
        line = sizes.refusal(sizes.table(method, parameters, **changes), parameters)
        yield f"a lattice of {parameters} parameters, method {method}", line or ""
    for parameters, resolution, _ in rows(sizes.test_regions_have_a_way_out_too):
        line = sizes.refusal(sizes.with_regions(parameters, resolution), parameters)
        yield f"regions of {parameters} parameters, resolution {resolution}", line or ""
    for number, (found, parameters, _) in enumerate(sizes.LARGE):
        yield f"what a campaign takes {number}", sizes.refusal(found, parameters) or "accepted"
    yield "what 50 requirements take", sizes.refusal(sizes.with_requirements(50), 6) or ""


def _parsed(text: str) -> None:
    parse_campaign(text.encode(), "c.toml")


def _problems() -> Cases:
    two, one = test_methods, test_robustness
    rigorous, scenario = (
        two.test_a_wrong_key_of_a_rigorous_campaign_is_named,
        two.test_a_wrong_key_of_a_scenario_campaign_is_named,
    )
    yield from refusals("rigorous", rigorous, functools.partial(two.fault, two.RIGOROUS))
    yield from refusals("scenario", scenario, functools.partial(two.fault, two.SCENARIO))
    for content, _ in rows(two.test_a_broken_csv_file_is_one_line):
        yield f"scenarios in a file: {content!r}", refusal(functools.partial(_with_csv, content))
    elsewhere = two.from_csv(two.CSV, "../cells.csv").encode()
    yield "scenarios in a file elsewhere", refusal(lambda: parse_campaign(elsewhere, "c.toml", lambda _: two.CSV))
    yield from refusals("robustness", one.test_a_wrong_key_is_named_with_its_remedy, one.fault)
    yield "noise_scale = 0 of a noisy system", one.fault("noise_scale = 0.0", "noise_scale = 0", one.NOISY)
    sample = test_sample
    claims = sample.test_what_cannot_be_claimed_is_refused
    yield from refusals("method sample", claims, lambda changes: sample.sampled(**changes))
    noisy, levels = spec(noisy=True), sample.LEVELS[3:4]
    unclipped = sample.sampled(clip=None, claims=levels)
    yield "method sample: most starts without a clip", refusal(lambda: check(unclipped, noisy, "c.toml"))
    huge = sample.sampled(clip=(-1e308, 1e308))
    yield "a clip beyond every number", refusal(lambda: check_new(huge, noisy, "c.toml"))
    kriging = test_kriging.test_what_it_cannot_do_is_refused_with_a_remedy
    yield from refusals("method kriging", kriging, lambda problem, changes: test_kriging.a_campaign(problem, **changes))
    regions = test_regions.TestFile.test_what_has_no_regions_is_refused
    yield from refusals("regions", regions, lambda problem, changes: robustness(problem, regions=True, **changes))
    composed = test_composed_claims
    yield from refusals(
        "claims", composed.test_claims_that_cannot_be, lambda claims, changes: composed.asked(*claims, **changes)
    )
    margin = {"clip": [-1.0, 0.5], "required_margin": 0.5}
    yield "required_margin = 0.5 with clip = [-1, 0.5]", refusal(lambda: robustness(test_starts.EXACT, **margin))


def _with_csv(content: bytes) -> None:
    parse_campaign(test_methods.from_csv(content).encode(), "c.toml", lambda _: content)


def _requirements() -> Cases:
    several = test_requirements
    yield from refusals(
        "requirements",
        several.test_requirements_that_do_not_go_together,
        lambda old, new: _parsed(several.TEXT.replace(old, new)),
    )
    more = "\n".join(f'speed{limit} = "speed < {limit}"' for limit in range(49))
    too_many = several.TEXT.replace("[[problems]]", f"{more}\n[[problems]]")
    yield "requirements: more than 50", refusal(lambda: _parsed(too_many)).partition("[")[0]
    wrong = [{"name": "first", "formula": "value > 0"}, {"name": "second", "formula": "speed > 0"}]
    unknown = test_sample.several(specifications=wrong)
    yield "requirements: an unknown column", refusal(lambda: check(unknown, spec(noisy=True), "c.toml"))
