"""Several requirements by methods that choose their tests: one design, and for each requirement a bound of its own."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from pydantic import ValidationError
from rich.console import Console

from perfbound.library.plot import Plot
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.words.text import print_certificate
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.collect.posterior import posterior
from perfbound.orchestrator.run import service
from perfbound.orchestrator.store.export import table_rows
from perfbound.schemas.errors import CampaignError, PerfboundError
from perfbound.schemas.file.against_system import check_against
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.parts import parts_of
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.result.certificate import Certificate
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import facts, says
from tests.fakes.simulators import certificates, noise, predicate, robustness, simulate, spec, statuses, verified

RIGOROUS = {
    "method": "rigorous",
    "alpha": 0.1,
    "rkhs_norm": 2.0,
    "noise_scale": 0.0,
    "kernel": {"nu": 2.5, "length_scale": 0.7},
}
NOISY = RIGOROUS | {"noise_scale": "derived", "alpha": 0.5}
THREE: list[dict[str, Any]] = [
    {"name": "low", "formula": "value >= 0", "id": "REQ-1"},
    {"name": "high", "formula": "1.2 - value >= 0"},
    {"name": "double", "formula": "2 * value >= 0", "alpha": 0.3, "rkhs_norm": 4.0},
]
LEAST = {"low": 0.2, "high": 0.4, "double": 0.4}
"""Of each requirement, for `plane`, whose values are .2 to .8."""


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def plane(request: RolloutRequest) -> float:
    return 0.2 + 0.5 * request.x[0] + 0.1 * request.x[1]


def shaky(request: RolloutRequest) -> float:
    return plane(request) + 0.02 * min(max(noise(request.seed), -3.0), 3.0)


def several(requirements: list[dict[str, Any]] = THREE, **changes: Any) -> CampaignConfig:
    """Return a campaign about the unit square, without checks afterwards."""
    problem = {**RIGOROUS, **changes.pop("problem", {})}
    found = {"specification": None, "specifications": requirements, "recheck": 0, "spot_check": 0}
    return robustness(problem, **found | changes)


def certificate(directory: Path) -> Certificate:
    found = files.read(directory)
    assert found is not None
    return found


@pytest.mark.rest
def test_every_requirement_has_its_claim_after_that_of_all(tmp_path: Path) -> None:
    simulate(tmp_path, several(spot_check=20), plane, noisy=False)
    found = certificate(tmp_path).predicate
    whole, *each = found.claims
    assert (whole.rule, whole.requirement, whole.quantity) == ("every", None, "robustness")
    assert [(claim.rule, claim.requirement) for claim in each] == [("single", name) for name in LEAST]
    alphas = {"low": 0.1, "high": 0.1, "double": 0.3}
    for claim in each:
        assert claim.requirement is not None
        least = LEAST[claim.requirement]
        assert least - alphas[claim.requirement] <= claim.bound <= least
    assert whole.bound == min(claim.bound for claim in each)
    assert {claim.probability for claim in found.claims} == {1.0}, "nothing is random"
    assert [(result.requirement, result.parameters["alpha"]) for result in found.problems] == list(alphas.items())
    assert [result.parameters["rkhs_norm"] for result in found.problems] == [2.0, 2.0, 4.0]
    assert {(result.tests, result.rollouts.nominal) for result in found.problems} == {(found.problems[0].tests,) * 2}
    assert found.spot_check is not None
    assert [(row.requirement, row.status) for row in found.spot_check.problems] == [
        (name, "not refuted") for name in LEAST
    ]
    assert not verified(tmp_path)


def test_a_claim_rests_on_the_assumptions_of_its_requirement(tmp_path: Path) -> None:
    simulate(tmp_path, several(), plane, noisy=False)
    whole, low, *_ = certificate(tmp_path).predicate.claims
    norms = {f"rkhs_norm/robustness/{name}" for name in LEAST}
    assert norms <= set(whole.assumptions)
    assert norms & set(low.assumptions) == {"rkhs_norm/robustness/low"}
    assert "only_campaign" in low.assumptions


def test_each_requirement_is_computed_with_other_constants_from_its_own_values(tmp_path: Path) -> None:
    simulate(tmp_path, several(), plane, noisy=False)
    rows = certificate(tmp_path).predicate.sensitivity
    assert rows is not None
    _, low, high, double = (each.bound for each in rows if (each.constant, each.factor) == ("rkhs_norm", 2.0))
    assert low is not None
    assert high is not None
    # The same tests, the same norm: the bounds differ as the least values do.
    assert high - low == pytest.approx(LEAST["high"] - LEAST["low"], abs=0.1)
    assert double == pytest.approx(2 * low, abs=0.05)


@pytest.mark.rest
def test_a_norm_that_is_too_small_refutes_its_requirement_and_the_whole(tmp_path: Path) -> None:
    requirements = [THREE[0], {**THREE[1], "rkhs_norm": 0.3}]
    text = simulate(tmp_path, several(requirements), plane, noisy=False)
    whole, low, high = predicate(text)["claims"]
    assert whole["refuted"] == high["refuted"]
    assert "rkhs_norm/robustness/high" in high["refuted"]
    assert not low["refuted"]
    assert statuses(text)["rkhs_norm/robustness/low"] == "not refuted"
    assert [row["stopped_by"] for row in predicate(text)["problems"]] == ["converged", "refuted"]
    assert not verified(tmp_path)


@pytest.mark.rest
def test_a_fresh_start_that_violates_one_bound_refutes_that_one(tmp_path: Path) -> None:
    def hole(request: RolloutRequest) -> float:
        x, y = request.x
        return -1.0 if 0.51 < x < 0.61 and 0.51 < y < 0.61 else plane(request)

    text = simulate(tmp_path, several(spot_check=299, max_tests=12, resolution=3), hole, noisy=False)
    spot = {row["requirement"]: row["status"] for row in predicate(text)["spot_check"]["problems"]}
    assert spot == {"low": "refuted", "high": "not refuted", "double": "refuted"}
    assert statuses(text)["rkhs_norm/robustness/low"] == "refuted"
    assert not verified(tmp_path)


@pytest.mark.rest
def test_noisy_requirements_each_have_the_whole_delta(tmp_path: Path) -> None:
    config = several(problem=NOISY, clip=(-1.0, 2.0), replicates=2, max_tests=30, spot_check=20)
    text = simulate(tmp_path, config, shaky, noisy=True)
    found = predicate(text)
    assert [claim["probability"] for claim in found["claims"]] == [0.95] * 4
    assert all(claim["bound"] <= LEAST[claim["requirement"]] for claim in found["claims"][1:])
    assert statuses(text)["one_law_per_start/robustness/low"] == "not refuted"
    assert not verified(tmp_path)


@pytest.mark.rest
def test_scenarios_serve_every_requirement(tmp_path: Path) -> None:
    config = robustness(
        {"method": "scenario", "alpha": 0.2},
        specification=None,
        specifications=[{key: each[key] for key in ("name", "formula")} for each in THREE],
        space={"scenarios": [[0.0, 0.0], [0.5, 0.5], [1.0, 1.0]]},
        clip=(-1.0, 2.0),
        replicates=20,
        max_tests=300,
        recheck=0,
    )
    text = simulate(tmp_path, config, shaky, noisy=True)
    assert all(claim["bound"] <= LEAST[claim["requirement"]] for claim in predicate(text)["claims"][1:])
    assert {row["stopped_by"] for row in predicate(text)["problems"]} == {"converged"}
    assert not verified(tmp_path)


@pytest.mark.rest
def test_workers_and_a_stop_in_between_change_no_byte(tmp_path: Path) -> None:
    config = several(problem=NOISY, clip=(-1.0, 2.0), replicates=2, max_tests=20, window=3, spot_check=10, recheck=2)
    assert len(certificates(tmp_path, config, shaky, noisy=True, cut_after=25)) == 1


def test_a_counterexample_to_any_requirement_ends_the_campaign(tmp_path: Path) -> None:
    requirements = [THREE[0], {"name": "small", "formula": "0.75 - value >= 0"}]
    text = simulate(tmp_path, several(requirements, falsify={}), plane, noisy=False)
    found = predicate(text)
    assert found["counterexample"]["robustness"] < 0
    assert {row["stopped_by"] for row in found["problems"]} == {"counterexample"}
    assert not verified(tmp_path)


def test_the_report_has_a_panel_for_each_requirement(tmp_path: Path) -> None:
    simulate(tmp_path, several(), plane, noisy=False)
    for finished in (True, False):
        if not finished:
            (tmp_path / files.CERTIFICATE).unlink()
        whole, low, high, double = Collector(tmp_path).refresh().problems
        assert [each.requirement for each in (whole, low, high, double)] == [None, *LEAST]
        assert whole.partner is None
        for each in (low, high, double):
            assert each.partner is not None
            assert each.bound is not None
            assert each.requirement is not None
            assert each.bound <= LEAST[each.requirement]
            assert each.surfaces
            assert each.stopped_by == "converged"
            assert each.rollouts == whole.rollouts
        each_y = zip(low.tests.y, high.tests.y, double.tests.y, strict=True)
        assert whole.tests.y == tuple(min(value for value in values if value is not None) for values in each_y)
        assert "of requirement low" in low.objective


def test_the_export_has_every_replicate_of_every_requirement(tmp_path: Path) -> None:
    config = several(problem=NOISY, clip=(-1.0, 2.0), replicates=2, max_tests=3, spot_check=4)
    simulate(tmp_path, config, shaky, noisy=True)
    columns, rows = table_rows(tmp_path, "observations")
    found = [dict(zip((column.name for column in columns), row, strict=True)) for row in rows]
    first = [row for row in found if (row["problem"], row["test"]) == ("robustness", 0)]
    assert [(row["requirement"], row["replicate"]) for row in first] == [(name, k) for name in LEAST for k in (0, 1)]
    values = [cast(float, row["contribution"]) for row in first]
    low, high, double = (values[place : place + 2] for place in (0, 2, 4))
    assert high == pytest.approx([1.2 - value for value in low])
    assert double == pytest.approx([2 * value for value in low])
    means = [sum(each) / 2 for each in (low, high, double)]
    assert [row["observation"] for row in first] == pytest.approx([min(means)] * 6)
    assert {row["requirement"] for row in found if row["problem"] == "spot_check"} == {None}


def test_a_requirement_has_figures_and_a_band_of_its_own(tmp_path: Path) -> None:
    simulate(tmp_path, several(), plane, noisy=False)
    plot = Plot(tmp_path)
    assert plot.map().get_title().startswith("robustness: ")
    assert plot.map("robustness/low").get_title().startswith("robustness, low: ")
    for name in (None, "robustness/high"):
        with pytest.raises(PerfboundError, match="those of several requirements are not stored for each test"):
            plot.decay(name)
    starts = np.array([[0.3, 0.6], [0.9, 0.1]])
    value = 0.2 + starts @ [0.5, 0.1]
    for name, wanted in (("low", value), ("high", 1.2 - value), ("double", 2 * value)):
        _, lower, upper = posterior(tmp_path, f"robustness/{name}", starts)
        assert (lower <= wanted).all()
        assert (wanted <= upper).all()
        assert (upper - lower < 1.0).all(), "a part of what B alone allows"
    with pytest.raises(PerfboundError, match=facts("robustness 81")):
        posterior(tmp_path, None, starts)


def test_the_terminal_names_the_requirement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulate(tmp_path, several(), plane, noisy=False)
    print_certificate(certificate(tmp_path), Console(width=100))
    out = " ".join(capsys.readouterr().out.split())
    assert says(out, "CLAIM every requirement >=")
    assert says(out, "also requirement double >=")


TEXT = """horizon = 5
clip = [-5, 60]
system.name = "cars"
[space]
gap = [5, 60]
speed = [5, 35]
[specifications]
gap = { formula = "always (distance > 0)", alpha = 0.25 }
stop = { formula = "eventually (speed < 1)", rkhs_norm = 9 }
[[problems]]
name = "robustness"
method = "rigorous"
alpha = 1
rkhs_norm = 40
noise_scale = 0
"""


def test_the_constants_of_a_requirement_are_beside_its_formula() -> None:
    found = parse_campaign(TEXT.encode(), "cars.toml")
    assert [part.problems[0].model_dump()["rkhs_norm"] for part in parts_of(found)] == [40.0, 9.0]
    assert [part.specification for part in parts_of(found)] == ["always (distance > 0)", "eventually (speed < 1)"]
    other = parse_campaign(TEXT.replace("rkhs_norm = 9", "rkhs_norm = 8").encode(), "cars.toml")
    assert found.digest != other.digest


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (
            "rkhs_norm = 9",
            "linearised = { centre = 1, spread = 1 }",
            "specifications.stop.linearised: required",
        ),
        ("rkhs_norm = 9", "rkhs_norm = -1", "specifications.stop.rkhs_norm: -1"),
        (
            "rkhs_norm = 9",
            "resolution = 3",
            "specifications.stop.resolution: unknown alpha formula",
        ),
        ("rkhs_norm = 9", "rkhsnorm = 9", "specifications.stop.rkhsnorm: unknown 'rkhs_norm'"),
        ("rkhs_norm = 9", "kernel = { nu = 45, length_scale = 1 }", "specifications.stop.kernel.nu: 45"),
        (
            "alpha = 1\n",
            "alpha = 1\nslack = 0.5\n",
            "specifications.gap: slack: 0.5 most alpha = 0.25",
        ),
        ("stop = {", '"s/p" = {', "specifications.s/p.name: 's/p'"),
        ('name = "robustness"', 'name = "maximum"\ncolumn = "speed"', "specifications: one problem"),
        ("horizon = 5", "horizon = 5\nregions = true", "regions: one specification"),
        ("horizon = 5", 'horizon = 5\nspecification = "speed > 0"', "specification: not allowed beside"),
    ],
)
def test_requirements_that_do_not_go_together(old: str, new: str, reason: str) -> None:
    with pytest.raises(CampaignError, match=facts(reason)) as caught:
        parse_campaign(TEXT.replace(old, new).encode(), "c.toml")
    assert "\n" not in str(caught.value)


def test_no_more_than_fifty() -> None:
    more = "\n".join(f'speed{limit} = "speed < {limit}"' for limit in range(49))
    with pytest.raises(CampaignError, match=facts("specifications: most 50")):
        parse_campaign(TEXT.replace("[[problems]]", f"{more}\n[[problems]]").encode(), "c.toml")


def test_the_constants_of_a_requirement_are_checked_against_the_system() -> None:
    axes = {"kernel": {"nu": 2.5, "length_scale": {"z1": 1.0}}}
    for own, noisy, reason in (
        (axes, False, r"specifications\.high\.kernel\.length_scale: has z1; give one number for each"),
        ({"noise_scale": 0.0}, True, r"specifications\.high\.noise_scale: 0 has no meaning for the nominal variant"),
    ):
        config = several([THREE[0], {**THREE[1], **own}], problem=NOISY, clip=(-1.0, 2.0))
        with pytest.raises(CampaignError, match=reason):
            check_against(config, spec(noisy=noisy), "c.toml")


def test_the_claim_about_every_requirement_has_the_least_of_their_probabilities(tmp_path: Path) -> None:
    requirements = [{**THREE[1], "noise_scale": 0.0}, THREE[0]]
    # More tests than starts: those of the first requirement cannot be repeated.
    changes = {"problem": {"noise_scale": 0.05}, "clip": (-1.0, 2.0), "resolution": 2, "max_tests": 12}
    text = simulate(tmp_path, several(requirements, **changes), plane, noisy=False)
    whole, exact, noisy = predicate(text)["claims"]
    assert (exact["probability"], noisy["probability"]) == (1.0, 0.95)
    assert whole["probability"] == 0.95
    assert (exact["quantity"], whole["quantity"]) == ("robustness", noisy["quantity"])
    assert whole["quantity"] != "robustness"
    assert not verified(tmp_path)


def test_method_paper_and_method_sample_say_why_not() -> None:
    paper = {"method": "paper", "alpha": 0.1, "c": 0.2, "rkhs_norm": 2.0, "noise_scale": 0.1}
    kernel = {"kernel": RIGOROUS["kernel"]}
    config = {"specification": None, "specifications": THREE, "clip": (-1.0, 1.0)}
    with pytest.raises(ValidationError, match=facts("specifications: Algorithm 1")):
        robustness(paper | kernel, **config)
    with pytest.raises(ValidationError, match=facts("specifications.double.alpha: 'sample'")):
        robustness({"method": "sample"}, **config)
