"""Campaigns about every disturbance of a set: bounded ones are parameters, and how rare others are is certified."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import gumbel_r, norm

import perfbound as pb
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import notes
from perfbound.orchestrator.report.rollout.load import description, load_recorded
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store.export import table_rows
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.against_system import as_in_campaign, check_against
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.parameters import Range
from perfbound.schemas.file.problem_models import RigorousProblem
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.ranges import LARGEST_BATCH
from perfbound.schemas.requests import RequestTemplate
from perfbound.schemas.result.certificate import Predicate
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Parameter
from tests.facts import says
from tests.fakes.simulators import certificates, robustness, simulate, spec, verified
from tests.unit.campaign.test_kriging import KRIGING

WINDY = spec(noisy=True).model_copy(
    update={
        "disturbances": (pb.Normal(0, 2).named("gust", "m/s"), pb.Uniform(0.9, 1.1).named("mass", "kg")),
        "residual": False,
    }
)
WITHIN = {"low": -3.0, "high": 3.0, "unit": "sd"}
BOX = {"z1": {"low": 0.0, "high": 1.0}, "z2": {"low": 0.0, "high": 0.1}}
BOTH = {"gust": WITHIN, "mass": {"low": 0.9, "high": 1.1}}
EXACT = {
    "method": "rigorous",
    "alpha": 0.05,
    "rkhs_norm": 2.0,
    "noise_scale": "derived",
}
LENGTHS = {"z1": 2.0, "z2": 2.0, "gust": 8.0, "mass": 0.5, "side": 1.0}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def a_campaign(problem: dict[str, Any], bounded: dict[str, Any], **changes: Any) -> CampaignConfig:
    space = {**BOX, **bounded}
    lengths = {name: LENGTHS[name] for name in space if name in LENGTHS}
    found = {"clip": [-0.5, 1.0], "recheck": 3, "spot_check": 8, "space": space}
    return robustness({**problem, "kernel": {"length_scale": lengths}}, **found | changes)


def margin(request: RolloutRequest) -> float:
    gust, mass = request.disturbances
    return 0.5 + 0.1 * request.x[0] - 0.05 * mass * gust


def predicate(directory: Path) -> Predicate:
    found = files.read(directory)
    assert found is not None
    return found.predicate


class TestEveryDisturbanceBounded:
    def test_the_claim_is_for_all_of_them_and_says_what_a_rollout_risks(self, tmp_path: Path) -> None:
        config = a_campaign(EXACT, BOTH, resolution=3, max_tests=40)
        simulate(tmp_path, config, margin, noisy=True, system=WINDY)
        found = predicate(tmp_path)
        (claim,) = found.claims
        worst = 0.5 - 0.05 * 1.1 * 6.0
        assert 0.0 <= claim.bound <= worst
        assert claim.quantity == "robustness", "the value itself: nothing is random"
        assert found.bounded is not None
        gust, mass = found.bounded.disturbances
        assert (gust.name, gust.low, gust.high, gust.values, gust.unit_of_values) == ("gust", -3, 3, (-6, 6), "m/s")
        assert (mass.name, mass.values) == ("mass", (0.9, 1.1))
        outside = 2 * norm.sf(3)
        assert outside <= found.bounded.outside <= outside + 2e-9
        assert found.bounded.failure_probability == found.bounded.outside
        said = notes(found, 0)
        assert any("every gust within 3 sd (-6 to 6 m/s) and every mass from 0.9 to 1.1 kg" in each for each in said)
        assert any(says(each, "at every start a rollout fails with probability at most 0.0027") for each in said)
        assert not verified(tmp_path)

    @pytest.mark.rest
    def test_workers_and_stops_change_no_byte(self, tmp_path: Path) -> None:
        config = a_campaign(EXACT, BOTH, resolution=5, max_tests=20)
        assert len(certificates(tmp_path, config, margin, noisy=True, cut_after=12, system=WINDY)) == 1

    def test_a_forged_probability_is_found(self, tmp_path: Path) -> None:
        simulate(tmp_path, a_campaign(EXACT, BOTH, resolution=3, max_tests=4), margin, noisy=True, system=WINDY)
        path = tmp_path / files.CERTIFICATE
        found = json.loads(path.read_text())
        found["predicate"]["bounded"]["outside"] /= 2
        path.write_text(json.dumps(found, sort_keys=True, indent=1) + "\n")
        assert verified(tmp_path) == ["claims"]

    def test_a_claim_below_0_says_nothing_of_failures(self, tmp_path: Path) -> None:
        def fails(request: RolloutRequest) -> float:
            return margin(request) - 0.3

        simulate(tmp_path, a_campaign(EXACT, BOTH, resolution=3, max_tests=30), fails, noisy=True, system=WINDY)
        found = predicate(tmp_path)
        assert found.claims[0].bound < 0
        assert found.bounded is not None
        assert found.bounded.failure_probability is None


class TestSomeBounded:
    @pytest.mark.rest
    def test_the_others_stay_random_and_alone_are_in_the_control(self, tmp_path: Path) -> None:
        problem = KRIGING
        config = a_campaign(problem, {"mass": BOTH["mass"]}, max_tests=50, replicates=8, resolution=3)
        simulate(tmp_path, config, margin, noisy=True, system=WINDY)
        found = predicate(tmp_path)
        assert found.problems[0].control is not None
        assert [each.name for each in found.problems[0].control.disturbances] == ["gust"]
        assert found.bounded is not None
        assert (found.bounded.outside, found.bounded.failure_probability) == (0.0, None)
        assert not any("Nothing else is random" in each for each in notes(found, 0))
        assert not verified(tmp_path)

    def test_the_plan_knows_what_is_left_to_chance(self) -> None:
        for bounded, noisy, deterministic in ((BOTH, (), True), ({"gust": WITHIN}, ("nominal",), False)):
            config = a_campaign(EXACT, bounded)
            found = as_in_campaign(WINDY, config)
            assert (found.noisy, found.declared) == (noisy, WINDY)
            plan = plans(config, found)["robustness"]
            assert (plan.deterministic, plan.noise == 0, plan.exact) == (deterministic,) * 3
        random = WINDY.model_copy(update={"residual": True})
        assert as_in_campaign(random, a_campaign(EXACT, BOTH)).noisy == ("nominal",)


class TestReaders:
    def test_a_rollout_is_described_and_exported_with_its_values(self, tmp_path: Path) -> None:
        run = tmp_path / "run"
        simulate(run, a_campaign(EXACT, {"gust": WITHIN}, max_tests=3), margin, noisy=True, system=WINDY)
        found = load_recorded(run, "robustness.0.nominal.0")
        assert len(found.request.x) == 2
        gust, mass = found.request.disturbances
        assert abs(gust) <= 6.0
        assert 0.9 <= mass <= 1.1
        assert f"gust = {gust:.4g} m/s" in description(found)
        columns, rows = table_rows(run, "rollouts")
        names = [each.name for each in columns]
        scores, values = (names.index(each) for each in ("gust", "disturbance_gust"))
        assert [(columns[each].unit) for each in (scores, values)] == ["sd", "m/s"]
        assert [row[values] for row in rows] == [pytest.approx(2 * float(row[scores] or 0)) for row in rows]


@pytest.mark.parametrize(
    ("bounded", "line"),
    [
        ({"gsut": WITHIN}, "space.gsut: unknown parameter; did you mean 'gust'?"),
        ({"gust": WITHIN | {"high": 7.0}}, "space.gust: [-3, 7] sd is not allowed: allowed are at most 6 sd"),
        ({"gust": WITHIN | {"unit": "km"}}, "space.gust.unit: 'km' is not allowed"),
        ({"mass": {"low": 0.8, "high": 1.0}}, "space.mass: [0.8, 1] goes beyond the values of its law"),
        ({"side": {"low": 0.0, "high": 1.0}}, "space.side: the law of side has choices"),
    ],
)
def test_one_line_says_what_is_wrong_with_a_range(bounded: dict[str, Any], line: str) -> None:
    side = pb.Choice([0, 1]).named("side", "")
    system = WINDY.model_copy(update={"disturbances": (*WINDY.disturbances, side)})
    with pytest.raises(CampaignError) as error:
        check_against(a_campaign(EXACT, bounded), system, "file")
    (found,) = str(error.value).splitlines()
    assert line in found


FILE = """
specification = "value >= 0"
clip = [-1, 1]
rkhs_norm = 1.0
alpha = 0.1
noise_scale = "derived"
system.name = "any-function"
space = { z1 = [0, 1], z2 = [0, 1], gust = GUST }
"""


def test_the_short_form_of_a_range_is_one_of_scores() -> None:
    config = parse_campaign(FILE.replace("GUST", '"within 2.5 sd"').encode(), "file.toml")
    assert isinstance(config.space, dict)
    assert config.space["gust"] == Range(low=-2.5, high=2.5, unit="sd")
    (problem,) = config.problems
    assert isinstance(problem, RigorousProblem)
    assert problem.kernel.length_scale == {"z1": 0.5, "z2": 0.5, "gust": 2.5}
    assert as_in_campaign(WINDY, config).parameters[2] == Parameter(name="gust", unit="sd", low=-2.5, high=2.5)
    with pytest.raises(CampaignError, match=r'space\.gust: \'within three sd\' is not .* also "within 3 sd"'):
        parse_campaign(FILE.replace("GUST", '"within three sd"').encode(), "file.toml")


def test_a_method_that_draws_disturbances_takes_no_range_of_one() -> None:
    with pytest.raises(CampaignError, match=r"space\.gust: method 'sample' draws disturbances from their laws"):
        check_against(robustness({"method": "sample"}, space={**BOX, "gust": WITHIN}), WINDY, "file")


def test_a_disturbance_that_acts_in_no_rollout_has_no_range() -> None:
    both = WINDY.model_copy(update={"variants": ("nominal", "true"), "noisy": ("nominal",)})
    with pytest.raises(CampaignError, match=r"space\.gust: no variant that is simulated here has disturbances"):
        check_against(a_campaign(EXACT, {"gust": WITHIN}), both, "file")


SCORES = st.floats(-6.0, 6.0)


@given(x=st.tuples(SCORES, SCORES), scores=st.tuples(SCORES, SCORES), seeds=st.tuples(*[st.integers(0, 2**53 - 1)] * 4))
def test_a_start_is_split_into_that_of_the_system_and_its_disturbances(
    x: tuple[float, float], scores: tuple[float, float], seeds: tuple[int, ...]
) -> None:
    laws = [pb.Normal(1, 2), pb.LogNormal(3, 0.5), pb.Law("gumbel_r", loc=0, scale=1)]
    named = tuple(law.named(name, "") for law, name in zip(laws, ("one", "two", "three"), strict=True))
    system = WINDY.model_copy(update={"disturbances": named})
    bounded = {name: Parameter(name=name, unit="sd", low=-6, high=6) for name in ("three", "one")}
    options: dict[str, Any] = {"horizon": 0.0, "visual": False}
    template = RequestTemplate.of(system.spread((), {}, bounded), {}, **options)
    free = RequestTemplate.of(system, {}, **options)
    rollout = RolloutId("robustness", 0, "nominal", 0)
    request = template.request(rollout, (*x, *scores), seeds[0])
    assert (request.x, request.chosen) == (x, (*x, *scores))
    one, two, three = request.disturbances
    assert two == free.request(rollout, x, seeds[0]).disturbances[1], "the others are drawn as without ranges"
    assert one == pytest.approx(1 + 2 * scores[0], abs=1e-7)
    assert norm.ppf(gumbel_r.cdf(three)) == pytest.approx(scores[1], abs=1e-5)
    batch = template.batch(rollout, [(*x, *scores), (*scores, *x)], seeds)
    assert batch.single(0) == request
    assert batch.single(3).disturbances[0] == pytest.approx(1 + 2 * x[0], abs=1e-7)
    # Its own campaign alone knows the start, so that a worker gets no parameter that is none of its system.
    assert RolloutRequest.model_validate_json(request.model_dump_json()) == request


def test_the_largest_batch_has_room_for_its_starts() -> None:
    bounded = {"gust": Parameter(name="gust", unit="sd", low=-3, high=3)}
    template = RequestTemplate.of(WINDY.spread((), {}, bounded), {}, horizon=0.0, visual=False)
    rollout, start = RolloutId("robustness", 0, "nominal", 0), (0.5, 0.5, 2.0)
    found = template.batch(rollout, [start] * LARGEST_BATCH, [7] * LARGEST_BATCH)
    assert found.single(LARGEST_BATCH - 1).disturbances == template.request(rollout, start, 7).disturbances
