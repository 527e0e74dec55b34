"""Campaigns with a search: where tests come from, what enters a claim, and what changes nothing."""

import json
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  (before the limit of threads, which holds for what is loaded)
from pydantic import ValidationError

from perfbound.orchestrator.campaign.checks import check
from perfbound.orchestrator.campaign.methods import methods
from perfbound.orchestrator.campaign.observation import for_search, goal_of_search
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.campaign.proposals import SearchSource, proposal_source
from perfbound.orchestrator.campaign.software import software
from perfbound.orchestrator.campaign.starts import Draws
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.mathematics.bounds.one_law.failures import beta_mixture_upper
from perfbound.orchestrator.mathematics.search import Falsifier
from perfbound.orchestrator.mathematics.search.goal import ALONE, Every, Part
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store import read
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.config import CampaignConfig, campaign_text
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.result.certificate import Certificate
from perfbound.schemas.result.facts import Header, ProposalFact
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import facts
from tests.fakes.simulators import checks, noise, robustness, simulate, spec, verified
from tests.tampering import editing

CLIP = (-1.0, 1.0)
RIGOROUS = {
    "method": "rigorous",
    "alpha": 0.01,
    "rkhs_norm": 4.0,
    "noise_scale": 0.0,
    "kernel": {"length_scale": 0.5},
}
NOISY = RIGOROUS | {"noise_scale": "derived"}
SCENARIOS = {"scenarios": [[x / 10, y / 10] for x in range(11) for y in range(11)]}


def hidden(request: RolloutRequest) -> float:
    """Return a margin below 0 on less than a hundredth of the square, inside of it."""
    return 4.0 * float(np.hypot(request.x[0] - 0.37, request.x[1] - 0.71)) - 0.2


def safe(request: RolloutRequest) -> float:
    return 0.1 + 0.3 * float(np.hypot(request.x[0] - 0.37, request.x[1] - 0.71))


def shifted(request: RolloutRequest) -> float:
    return 0.1 + safe(request)


def shaky(request: RolloutRequest) -> float:
    return safe(request) + 0.01 * noise(request.seed)


def sought(problem: dict[str, Any], **changes: Any) -> CampaignConfig:
    """Return a campaign of 60 tests with a search."""
    defaults = {"max_tests": 60, "clip": CLIP, "recheck": 3, "spot_check": 0, "falsify": {}}
    return robustness(problem, **defaults | changes)


def proposals(directory: Path) -> list[ProposalFact]:
    with read.reading(directory) as connection:
        found = [fact for fact in recorded_facts.read_facts(connection) if isinstance(fact, ProposalFact)]
    return sorted((fact for fact in found if fact.problem == "robustness"), key=lambda fact: fact.test)


def certificate(directory: Path) -> Certificate:
    found = files.read(directory)
    assert found is not None
    return found


def with_parts(directory: Path) -> list[tuple[float, list[float]]]:
    """Return the robustness of each rollout, and that of each part."""
    with sqlite3.connect(directory / "campaign.db") as connection:
        rows = connection.execute("SELECT robustness, parts FROM rollouts WHERE problem = 'robustness'").fetchall()
    return [(value, json.loads(parts)) for value, parts in rows]


def parts_for_any_workers(
    directory: Path, config: CampaignConfig, objective: Callable[[RolloutRequest], float]
) -> list[tuple[float, list[float]]]:
    """Return the rollouts `with_parts` of a resumed campaign, after checking that three workers make the same one."""
    simulate(directory / "one", config, objective, noisy=False, stop=lambda request: request.test > 9)
    simulate(directory / "one", config, objective, noisy=False)
    simulate(directory / "other", config, objective, noisy=False, workers=3)
    assert proposals(directory / "one") == proposals(directory / "other")
    return with_parts(directory / "one")


def check_that_other_parts_are_noticed(directory: Path, parts: list[float]) -> None:
    """Check that `verify` is content, and names the part that another one takes the place of."""
    assert verified(directory) == []
    with editing(directory) as connection:
        connection.execute(
            "UPDATE rollouts SET parts = ? WHERE test = 3 AND problem = 'robustness'", (json.dumps(parts),)
        )
    (failed,) = (each for each in checks(directory) if each.status == "failed")
    assert f"robustness.3.nominal.0: parts[0] is {parts[0]}" in failed.detail


def test_the_file_says_it_in_one_line_and_a_file_without_it_keeps_its_identity() -> None:
    config = sought({"method": "sample"})
    assert config.until_counterexample
    assert config.falsify is not None
    assert config.falsify.random_every == 4
    dumped = config.model_dump_json()
    assert CampaignConfig.model_validate_json(dumped).digest == config.digest
    without = robustness({"method": "sample"}, clip=CLIP, until_counterexample=True)
    assert "falsify" not in json.loads(without.model_dump_json())
    assert without.digest != config.digest


@pytest.mark.parametrize(
    ("problem", "changes", "message"),
    [
        ({"method": "sample"}, {"falsify": {"random_every": 0}}, "random_every"),
        ({"method": "sample"}, {"clip": (0.0, 1.0)}, "hides every violation"),
        (RIGOROUS | {"method": "paper", "noise_scale": 0.1, "c": 0.1}, {}, "method 'paper'"),
    ],
)
def test_what_contradicts_a_search_is_refused(problem: dict[str, Any], changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        sought(problem, **changes)


@pytest.mark.parametrize(
    ("problem", "changes", "noisy"),
    [
        ({"method": "sample"}, {}, False),
        ({"method": "sample"}, {"window": 5}, False),
        # The cone has a kink, which tests close to it show to be steeper than a smaller norm allows.
        (RIGOROUS | {"rkhs_norm": 40.0}, {"resolution": 41}, False),
        (NOISY, {"resolution": 41, "replicates": 2}, True),
        ({"method": "scenario", "alpha": 0.01}, {"space": SCENARIOS}, True),
    ],
)
def test_a_search_finds_a_hidden_failure_with_every_method_and_the_certificate_verifies(
    tmp_path: Path, problem: dict[str, Any], changes: dict[str, Any], noisy: bool
) -> None:
    simulate(tmp_path, sought(problem, **changes), hidden, noisy=noisy)
    predicate = certificate(tmp_path).predicate
    assert predicate.counterexample is not None
    assert predicate.problems[0].stopped_by == "counterexample"
    assert verified(tmp_path) == []
    assert len(Collector(tmp_path).refresh().problems[0].tests.y) < 60


def test_the_parts_of_a_specification_are_recorded_and_verified(tmp_path: Path) -> None:
    config = sought({"method": "sample"}, specification="value >= 0 and value <= 5 - 3 * value", max_tests=20)
    rows = parts_for_any_workers(tmp_path, config, safe)
    assert len(rows) == 20
    for value, parts in rows:
        assert parts == pytest.approx([value, 5 - 4 * value])
    check_that_other_parts_are_noticed(tmp_path / "one", [1.0, 2.0])


def test_of_equally_bad_rollouts_the_order_of_arrival_changes_no_start(tmp_path: Path) -> None:
    # The clip makes the rollouts of a test equal, whose parts are not.
    config = sought({"method": "sample"}, specification="value >= -2 and value <= 9", replicates=2, max_tests=24)
    for name in ("kept", "swapped"):
        simulate(tmp_path / name, config, shaky, noisy=True, stop=lambda request: request.test > 9)
        if name == "swapped":
            with editing(tmp_path / name) as connection:
                rows = connection.execute("SELECT MIN(seq), MAX(seq) FROM rollouts GROUP BY test").fetchall()
                for first, last in [each for each in rows if each[0] < each[1]]:
                    for old, new in ((first, -1), (last, first), (-1, last)):
                        connection.execute("UPDATE rollouts SET seq = ? WHERE seq = ?", (new, old))
        simulate(tmp_path / name, config, shaky, noisy=True)
    with sqlite3.connect(tmp_path / "kept" / "campaign.db") as connection:
        values = connection.execute("SELECT COUNT(DISTINCT robustness), COUNT(DISTINCT parts) FROM rollouts").fetchone()
    assert values == (1, 48)
    assert proposals(tmp_path / "kept") == proposals(tmp_path / "swapped")
    assert verified(tmp_path / "swapped") == []


SCALED = {
    "specification": "always (value <= -1 or 1000 * value >= 200)",
    "falsify": {"scale": {"value": 50.0}},
    "max_tests": 16,
}


def test_a_scale_is_of_the_search_alone_and_its_parts_are_recorded_and_verified(tmp_path: Path) -> None:
    config = sought({"method": "sample"}, clip=(-1000.0, 1000.0), **SCALED)
    rows = parts_for_any_workers(tmp_path, config, shifted)
    assert len(rows) == 16
    for value, parts in rows:
        assert parts == pytest.approx([value / 50]), "one part, in shares of the scale"
    check_that_other_parts_are_noticed(tmp_path / "one", [1.0])


def test_a_search_with_a_scale_observes_the_scaled_parts_and_their_whole() -> None:
    several = Every((Part(0), Part(1)))
    assert for_search(ALONE, 3.0, (), has_scale=False) == (3.0, ())
    assert for_search(ALONE, 3.0, (0.5,), has_scale=True) == (0.5, ())
    assert for_search(several, 3.0, (3.0, 4.0), has_scale=False) == (3.0, (3.0, 4.0))
    assert for_search(several, 3.0, (0.5, 0.25), has_scale=True) == (0.25, (0.5, 0.25))


def test_a_scale_is_part_of_the_campaign_and_no_scale_changes_nothing() -> None:
    plain, scaled = sought({"method": "sample"}), sought({"method": "sample"}, falsify={"scale": {"value": 2.0}})
    assert plain.digest != scaled.digest
    assert "scale" not in campaign_text(plain)
    assert "scale = { value = 2.0 }" in campaign_text(scaled)


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        ({"valu": 2.0}, "falsify.scale.valu: no predicate reads this column; did you mean 'value'?"),
        ({"t": 2.0}, "falsify.scale: `value >= 0` has none; give that of value"),
    ],
)
def test_a_scale_that_does_not_fit_the_specification_is_refused(scale: dict[str, float], words: str) -> None:
    config = sought({"method": "sample"}, specification="value >= 0 or t <= 1", falsify={"scale": scale})
    with pytest.raises(CampaignError, match=facts(words)):
        check(config, spec(noisy=False), "a.toml")


@pytest.mark.parametrize("scale", ["auto", {}, {"value": 0.0}, {"value": -1.0}, {"value": "m"}, 2.0])
def test_a_scale_is_a_number_above_0_for_each_column(scale: object) -> None:
    with pytest.raises(ValidationError, match="scale"):
        sought({"method": "sample"}, falsify={"scale": scale})


def test_a_scale_needs_the_parts_of_each_rollout() -> None:
    with pytest.raises(ValidationError, match=r"falsify\.scale: not with batch"):
        sought({"method": "sample"}, falsify={"scale": {"value": 2.0}}, batch=4)


def test_a_part_that_decides_nothing_alone_has_the_value_of_the_whole(tmp_path: Path) -> None:
    config = sought({"method": "sample"}, specification="value >= 0 or once[5, 6] value >= 0", max_tests=4)
    simulate(tmp_path, config, safe, noisy=False)
    with sqlite3.connect(tmp_path / "campaign.db") as connection:
        rows = connection.execute("SELECT robustness, parts FROM rollouts WHERE problem = 'robustness'").fetchall()
    assert [json.loads(parts) for _, parts in rows] == [[value, value] for value, _ in rows]


def test_where_rollouts_are_recorded_together_the_search_has_one_model() -> None:
    config = sought({"method": "sample"}, specification="value >= 0 and value <= 5")
    system = spec(noisy=False)
    assert len(goal_of_search(config, system)[1]) == 2
    assert goal_of_search(config.model_copy(update={"batch": 4}), system) == (ALONE, ())
    assert goal_of_search(config.model_copy(update={"falsify": None}), system) == (ALONE, ())


def test_the_search_knows_which_parameters_are_knots_of_one_input() -> None:
    box = {"low": 0.0, "high": 1.0}
    space = {"z1": box, "z2": box | {"signal": "linear", "knots": 3}}
    config = sought({"method": "sample"}, space=space, horizon=1.0)
    z1, z2 = spec(noisy=False).parameters
    system = spec(noisy=False).model_copy(update={"parameters": (z1, z2.model_copy(update={"signal": True}))})
    header = Header.new(config, system, {})
    found = plans(config, header.spec)
    source = proposal_source(found["robustness"], methods(found, header)["robustness"], header)
    assert isinstance(source, SearchSource)
    assert source._search._inputs._follows.tolist() == [False, False, True, True]


@pytest.mark.rest
def test_samples_are_the_drawn_starts_alone(tmp_path: Path) -> None:
    config = sought({"method": "sample"})
    simulate(tmp_path, config, safe, noisy=False)
    predicate = certificate(tmp_path).predicate
    assert predicate.counterexample is None
    assert predicate.claims[0].bound == pytest.approx(beta_mixture_upper(0, 15, 0.05), abs=2e-9)
    found = proposals(tmp_path)
    draws = Draws(Header.new(config, spec(noisy=False), software(spec(noisy=False))), "robustness")
    assert [each.proposal.x for each in found[3::4]] == [draws.start(number) for number in range(15)]
    assert all(each.proposal.node < 0 for each in found if each.test % 4 != 3)
    assumptions = {each.id: each for each in predicate.assumptions}
    assert (assumptions["drawn_starts/robustness"].values or {})["samples"] == 15
    histogram = Collector(tmp_path).refresh().problems[0].drawn
    assert histogram is not None
    assert sum(histogram.counts) == 15
    assert histogram.worst % 4 == 3, "the number of a test, and not of a sample"
    assert verified(tmp_path) == []


@pytest.mark.parametrize("noisy", [False, True])
def test_a_counterexample_before_the_first_sample_ends_the_campaign_with_the_bound_of_none(
    tmp_path: Path, noisy: bool
) -> None:
    simulate(tmp_path, sought({"method": "sample"}), lambda _: -0.5, noisy=noisy)
    predicate = certificate(tmp_path).predicate
    assert predicate.problems[0].tests == 1
    assert predicate.claims[0].bound == 1.0
    assert Collector(tmp_path).refresh().problems[0].drawn is None
    assert verified(tmp_path) == []


@pytest.mark.rest
@pytest.mark.parametrize("problem", [{"method": "sample"}, NOISY])
def test_a_stop_and_the_number_of_workers_change_no_byte(tmp_path: Path, problem: dict[str, Any]) -> None:
    config = sought(problem, window=3, resolution=31, max_tests=24)

    def stop() -> Callable[[RolloutRequest], bool]:
        left = iter([False] * 11 + [True])
        return lambda _: next(left, False)

    whole = simulate(tmp_path / "whole", config, shaky, noisy=True, workers=1)
    assert simulate(tmp_path / "cut", config, shaky, noisy=True, workers=3, stop=stop()) is None
    assert simulate(tmp_path / "cut", config, shaky, noisy=True, workers=2) is not None
    assert proposals(tmp_path / "whole") == proposals(tmp_path / "cut")
    first, second = (certificate(tmp_path / name).predicate for name in ("whole", "cut"))
    assert whole is not None
    assert first.claims == second.claims


def test_without_noise_no_start_is_tested_twice(tmp_path: Path) -> None:
    simulate(tmp_path, sought(RIGOROUS | {"alpha": 1e-6}, resolution=5), safe, noisy=False)
    nodes = [each.proposal.node for each in proposals(tmp_path)]
    assert len(nodes) == len(set(nodes)) > 10


@pytest.mark.rest
@pytest.mark.parametrize(
    "space",
    [
        {"z1": {"low": 0.0, "high": 1.0, "step": 0.125}, "z2": {"choices": [0.0, 0.5, 0.75], "low": 0.0, "high": 0.75}},
        {"table": [[0.1, 0.1], [0.9, 0.2], [0.4, 0.7], [0.3, 0.9], [1.0, 1.0], [0.0, 0.6]]},
        {
            "z1": {"low": 0.0, "high": 1.0, "distribution": "normal", "mean": 0.2, "sd": 0.1},
            "z2": {"low": 0, "high": 1},
        },
    ],
)
def test_a_searched_start_is_one_of_the_space(tmp_path: Path, space: dict[str, Any]) -> None:
    simulate(tmp_path, sought({"method": "sample"}, space=space, max_tests=24), safe, noisy=False)
    starts = [each.proposal.x for each in proposals(tmp_path)]
    for first, second in starts:
        if "table" in space:
            assert [first, second] in space["table"]
        elif "step" in space["z1"]:
            assert (8 * first) % 1 == 0
            assert second in space["z2"]["choices"]
    assert len(set(starts)) >= 6
    assert verified(tmp_path) == []


@pytest.mark.rest
@pytest.mark.parametrize("problem", [{"method": "sample"}, NOISY])
def test_tests_of_another_machine_are_followed_and_those_of_nobody_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, problem: dict[str, Any]
) -> None:
    propose = Falsifier.propose

    def rounded(search: Falsifier, pending: Sequence[tuple[float, ...]] = ()) -> tuple[float, ...]:
        point = propose(search, pending)
        test = search.observations + len(pending)
        if search._without_model(test) is not None:
            return point
        return tuple(min(value + 1e-6, 1.0) for value in point)

    def chosen(search: Falsifier, pending: Sequence[tuple[float, ...]] = ()) -> tuple[float, ...]:
        test = search.observations + len(pending)
        return (1.0, 1.0) if test == 20 else propose(search, pending)

    config = sought(problem, max_tests=24, resolution=21)
    for name, other, failed in (("rounded", rounded, []), ("chosen", chosen, ["proposals"])):
        with monkeypatch.context() as patched:
            patched.setattr(Falsifier, "propose", other)
            simulate(tmp_path / name, config, shaky, noisy=True)
        assert verified(tmp_path / name)[:1] == failed


@pytest.mark.parametrize(
    ("keys", "method"),
    [("", "sample"), ("alpha = 1.0\nrkhs_norm = 3\nnoise_scale = 0\nkernel.length_scale = 9", "rigorous")],
)
def test_a_file_that_seeks_needs_no_constants_and_twelve_lines(keys: str, method: str) -> None:
    text = f'specification = "always(distance > 0)"\nhorizon = 5\nfalsify = {{}}\nsystem.name = "cars"\n{keys}\n'
    found = parse_campaign(f"{text}[space]\ngap = [5, 60]\n".encode(), "braking.toml")
    assert [problem.method for problem in found.problems] == [method]
    assert found.until_counterexample


@pytest.mark.rest
def test_a_searched_start_is_in_the_region(tmp_path: Path) -> None:
    where = "z1 + z2 <= 0.4"  # without the middle of the box
    simulate(tmp_path, sought({"method": "sample"}, where=where, max_tests=24), safe, noisy=False)
    starts = [each.proposal.x for each in proposals(tmp_path)]
    assert len(set(starts)) >= 20
    assert all(first + second <= 0.4 for first, second in starts)
    assert verified(tmp_path) == []
