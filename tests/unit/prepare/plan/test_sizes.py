"""The size of a campaign in memory: what fits is planned within a bound, what does not is refused with a way out."""

import re
import tracemalloc
from collections.abc import Mapping
from typing import Any

import pytest

from perfbound.orchestrator.campaign.checks import check_new, check_sizes, method_sizes
from perfbound.orchestrator.campaign.consistency import scope
from perfbound.orchestrator.campaign.methods import methods
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.mathematics.bounds.cost import BLOCKS, LARGEST_MEMORY, LARGEST_PLAN
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.disturbance import Normal
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.file.toml_text import toml_file
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.facts import Header
from perfbound.schemas.system import Column, Parameter, SystemSpec
from tests.facts import says

PLANNED = 100_000_000
"""Bytes that any accepted campaign may take before its first test."""
ALL = {
    "name": "robustness",
    "alpha": 0.01,
    "rkhs_norm": 2.0,
    "noise_scale": 0.1,
    "kernel": {"length_scale": 1.0},
    "c": 0.1,
}
KEYS = {
    "paper": ("name", "alpha", "rkhs_norm", "noise_scale", "kernel", "c"),
    "rigorous": ("name", "alpha", "rkhs_norm", "noise_scale", "kernel"),
    "kriging": ("name", "rkhs_norm", "kernel"),
    "scenario": ("name", "alpha"),
    "sample": ("name",),
}


def table(method: str, parameters: int, **changes: Any) -> dict[str, Any]:
    """Return the table of a campaign file; `problem` in the changes is that of its problem."""
    problem = {key: ALL[key] for key in KEYS[method]} | {"method": method} | changes.pop("problem", {})
    found = {"name": "c", "system": {"name": "any"}, "specification": "v >= 0", "clip": [-1, 1], "horizon": 4}
    space = {f"x{k}": [0, 1] for k in range(parameters)}
    if method == "scenario":
        found["candidates"] = 64
    return {**found, "space": space, "problems": [problem], **changes}


def parsed(found: Mapping[str, Any]) -> CampaignConfig:
    return parse_campaign(toml_file(found).encode(), "c.toml")


def spec(parameters: int) -> SystemSpec:
    return SystemSpec(
        name="any",
        doc="",
        parameters=tuple(Parameter(0, 1, name=f"x{k}") for k in range(parameters)),
        columns=(Column(name="t", unit="s"), Column(name="v", unit="m")),
        noisy=("nominal",),
        max_horizon=10.0,
    )


def refusal(found: Mapping[str, Any], parameters: int) -> str | None:
    """Return the line with which a campaign is refused, by its file alone or with its system; None if it is not."""
    try:
        check_new(parsed(found), spec(parameters), "c.toml")
    except CampaignError as error:
        return str(error)
    return None


def remedied(found: Mapping[str, Any], line: str) -> list[dict[str, Any]]:
    """Return the campaigns that follow the remedies of a line, each as it is written."""
    remedy, _, choice = line.rpartition("; ")[2].partition("choose")
    (problem,) = found["problems"]
    ways = [
        {**found, "problems": [{**problem, key: int(value)}]}
        if key in ("points", "max_tests")
        else {**found, key: int(value)}
        for key, value in re.findall(r"(points|max_tests|resolution|candidates) = (\d+)", remedy)
    ]
    for method, _, starts in re.findall(r"'(\w+)'( with candidates = (\d+))?", choice):
        changes: dict[str, Any] = {"problems": [{key: ALL[key] for key in KEYS[method]} | {"method": method}]}
        ways.append({**found, **changes, **({"candidates": int(starts)} if starts else {})})
    if "remove regions" in remedy:
        ways = [{key: each for key, each in way.items() if key != "regions"} for way in ways or [dict(found)]]
    return ways


def planned(config: CampaignConfig, parameters: int) -> int:
    """Return the bytes that a campaign has taken before its first test, at most."""
    header = Header.new(config, spec(parameters), {})
    tracemalloc.start()
    try:
        methods(plans(config, header.spec), header)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("parameters", [2, 3, 4, 5, 6, 8, 12, 40])
@pytest.mark.parametrize("method", KEYS)
def test_every_size_fits_or_has_a_way_out(method: str, parameters: int) -> None:
    for resolution in (None, 2, 10, 22, 10**6):
        found = table(method, parameters, **({} if resolution is None else {"resolution": resolution}))
        line = refusal(found, parameters)
        if line is not None:
            assert says(line, f"^c.toml: problems.robustness. {parameters}")
            others = remedied(found, line)
            assert others
            assert [refusal(each, parameters) for each in others] == [None] * len(others), line
        else:
            (size,) = [size for _, size in method_sizes(parsed(found))]
            assert size.memory + BLOCKS <= LARGEST_MEMORY
            assert size.candidates <= 100_000


@pytest.mark.parametrize("parameters", [6, 12])
@pytest.mark.parametrize("method", KEYS)
def test_what_is_accepted_is_planned_within_a_bound(method: str, parameters: int) -> None:
    found = table(method, parameters)
    line = refusal(found, parameters)
    assert (line is not None) == (method in ("paper", "rigorous") or (method == "kriging" and parameters > 6))
    for each in [found] if line is None else remedied(found, line):
        assert planned(parsed(each), parameters) < PLANNED


def test_a_line_names_key_size_memory_and_every_way_out() -> None:
    line = refusal(table("paper", 6), 6)
    assert line is not None
    assert says(
        line, "^c.toml: problems.robustness.resolution: 21 6 85,766,121 more 100,000 686 MB resolution = 6 'sample'"
    )
    line = refusal(table("rigorous", 40, resolution=2), 40)
    assert line is not None
    assert says(line, "problems.robustness.resolution: 2 40 2^40 more 100,000 candidates = 4096")
    assert "resolution =" not in line  # no lattice of 40 parameters is small enough


def with_regions(parameters: int, resolution: int | None) -> dict[str, Any]:
    return table("rigorous", parameters, regions=True, **({} if resolution is None else {"resolution": resolution}))


@pytest.mark.parametrize(
    ("parameters", "resolution", "facts"),
    [
        (6, None, "resolution: 21 85,766,121 resolution = 6"),
        (6, 7, "resolution: 7 117,649 resolution = 6"),
        (40, None, "resolution: 21 40 remove regions candidates = 4096"),
        (40, 3, "resolution: 3 40 remove regions candidates = 4096"),
    ],
)
def test_regions_have_a_way_out_too(parameters: int, resolution: int | None, facts: str) -> None:
    found = with_regions(parameters, resolution)
    line = refusal(found, parameters)
    assert line is not None
    assert says(line, facts)
    assert ("candidates" in line) <= ("remove regions" in line)  # regions do not take them
    others = remedied(found, line)
    assert others
    assert [refusal(each, parameters) for each in others] == [None] * len(others)


def test_numbers_of_thousands_of_digits_are_one_line() -> None:
    line = refusal(table("paper", 1000, resolution=10**12), 1000)
    assert line is not None
    assert says(line, "problems.robustness.resolution: 1000 100,000 'sample'")
    assert len(line) < 400


# Budgets that memory does not allow, and plans of weights that take hours


LARGE = [
    (table("rigorous", 3, resolution=46, max_tests=100_000), 3, "max_tests: 100,000 97,336 8 GB max_tests resolution"),
    (table("paper", 4, resolution=17, max_tests=50_000), 4, "max_tests: 50,000 83,521 8 GB max_tests resolution"),
    (table("paper", 2, max_tests=10**6, problem={"refine": True}), 2, "max_tests: 1,000,000 441 8 GB max_tests"),
    (table("rigorous", 6, candidates=5000, max_tests=1000), 6, None),
    (table("rigorous", 3, max_tests=10**6), 3, None),
    (table("kriging", 3, problem={"points": 9}), 3, "points: 9 9,261 h points resolution"),
    (table("kriging", 3, problem={"points": 5}), 3, None),
    (table("kriging", 2, resolution=100, problem={"points": 9}), 2, None),
    (table("scenario", 6, candidates=1000, max_tests=10**6), 6, None),
    (table("sample", 40, max_tests=10**6), 40, None),
]


@pytest.mark.parametrize(("found", "parameters", "facts"), LARGE)
def test_a_size_that_takes_too_much_is_refused_with_sizes_that_do_not(
    found: dict[str, Any], parameters: int, facts: str | None
) -> None:
    line = refusal(found, parameters)
    assert (line is None) == (facts is None)
    if line is not None and facts is not None:
        assert says(line, f"^c.toml: problems.robustness.{facts}")
        others = remedied(found, line)
        assert len(others) == 1 + ("resolution" in line.rpartition(";")[2])
        for each in others:
            assert refusal(each, parameters) is None
            (size,) = [size for _, size in method_sizes(parsed(each))]
            assert size.memory + BLOCKS <= LARGEST_MEMORY
            assert size.method != "kriging" or size.operations <= LARGEST_PLAN


def test_the_default_budget_fits_every_lattice_that_is_allowed() -> None:
    for method in ("paper", "rigorous"):
        for parameters, resolution in ((1, 100_000), (2, 316), (3, 46), (4, 17), (5, 10), (6, 6), (8, 4), (16, 2)):
            assert refusal(table(method, parameters, resolution=resolution), parameters) is None


def with_requirements(number: int) -> dict[str, Any]:
    found = table(
        "rigorous", 6, candidates=4096, specifications=dict.fromkeys([f"r{k}" for k in range(number)], "v >= 0")
    )
    del found["specification"]
    return found


def test_requirements_share_the_memory() -> None:
    found = with_requirements(50)
    line = refusal(found, 6)
    assert line is not None
    assert says(line, "max_tests: 2,000 50 requirements 4,096 8 GB max_tests = candidates =")
    for each in remedied(found, line):
        assert refusal(each, 6) is None
    assert len(method_sizes(parsed(found))) == 50


def test_more_tests_for_a_finished_campaign_are_counted_and_its_other_sizes_are_fixed() -> None:
    config = parsed(table("rigorous", 3, resolution=30, max_tests=100))
    check_sizes(config, "c")
    check_sizes(config, "c", {"robustness": 3000})
    with pytest.raises(CampaignError) as error:
        check_sizes(config, "--max-tests 27000", {"robustness": 27_000})
    assert says(str(error.value), "^--max-tests 27000: problems.robustness.max_tests: 27,000 8 GB max_tests =")
    assert "resolution" not in str(error.value)


def test_fixed_starts_in_place_of_a_lattice_are_said_in_a_line() -> None:
    listed, whole = parsed(table("rigorous", 4, candidates=4096)), parsed(table("rigorous", 3))
    (line,) = scope(plans(listed, spec(4)), listed_alone=True)
    assert says(line, "robustness: 4,096 4 parameters 'sample'")
    assert list(scope(plans(whole, spec(3)), listed_alone=True)) == []
    assert len(list(scope(plans(whole, spec(3))))) == 1


def test_a_batch_whose_file_would_be_too_large_is_refused_with_the_largest_one() -> None:
    large = spec(2).model_copy(update={"trajectory_bytes": 2**20})
    config = parsed(table("sample", 2, batch=100))
    check_new(config, spec(2), "c.toml")
    with pytest.raises(CampaignError) as error:
        check_new(config, large, "c.toml")
    assert says(str(error.value), "^c.toml: batch: 100 1.05 MB 105 MB 67.1 MB choose at most 63")
    check_new(config.model_copy(update={"batch": 63}), large, "c.toml")


def test_a_batch_whose_disturbances_a_request_has_no_room_for_is_refused() -> None:
    laws = tuple(Normal(0, 1).named(f"w{k}", "") for k in range(50))
    config, declared = parsed(table("sample", 2, batch=301)), spec(2).model_copy(update={"disturbances": laws})
    with pytest.raises(CampaignError) as error:
        check_new(config, declared, "c.toml")
    assert says(str(error.value), "^c.toml: batch: 301 50 disturbances choose at most 300")
    header = Header.new(config.model_copy(update={"batch": 300}), declared, {}, run="0" * 16)
    check_new(header.config, declared, "c.toml")
    block = plans(header.config, declared)["robustness"].machine.block
    request = header.template.batch(RolloutId("robustness", 0, "nominal", 0), [(0.0, 0.0)] * block, range(block))
    assert len(request.disturbances) == block
