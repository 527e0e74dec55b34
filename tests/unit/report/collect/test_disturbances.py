"""The charts of declared disturbances: shares and curves, the rollouts of the picture, the worst rollout."""

from dataclasses import replace

import numpy as np
import pytest

import perfbound as pb
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.campaign.seeds import Floats, rollout_seed
from perfbound.orchestrator.mathematics.control.basis import choice_basis, normal_basis
from perfbound.orchestrator.mathematics.control.sequence import Control
from perfbound.orchestrator.report.collect.disturbances import (
    MARKED,
    MOST_DOTS,
    MOST_WORST,
    RecordedRollouts,
    disturbance_charts,
    noisy_variant,
)
from perfbound.orchestrator.report.rollout import disturbances
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.facts import Header
from tests.fakes.simulators import robustness, spec

LAWS = (
    pb.Normal(3, 2, unit="m/s").named("gust", "m/s"),
    pb.Uniform(0, 1).named("mass", ""),
    pb.Choice([0, 10], [0.75, 0.25]).named("load", ""),
)
SPEC = spec(noisy=True).model_copy(update={"disturbances": LAWS})
HEADER = Header.new(robustness({"method": "sample"}), SPEC, {}, run="0" * 16)
PLAN = replace(plans(HEADER.config, SPEC)["robustness"], sense="min")
CONTROL = Control(
    (normal_basis(13), normal_basis(13), choice_basis(LAWS[2].shares)),
    (
        np.vstack([0.3 * np.linspace(-3, 3, 13), np.zeros(13)]),
        np.zeros((2, 13)),
        np.array([[1.0, 1.0], [0.0, 0.4]]),
    ),
    residual=0.1,
    before=0.5,
)


def drawn(number: int) -> tuple[RecordedRollouts, Floats]:
    """Return rollouts of two replicates a test whose robustness is about half their gust, and the disturbances."""
    tests, replicates = np.arange(number) // 2, np.arange(number) % 2
    places = zip(tests.tolist(), replicates.tolist(), strict=True)
    seeds = [rollout_seed(HEADER, RolloutId("robustness", test, "nominal", each)) for test, each in places]
    values = np.array(HEADER.template.disturbances("nominal", [(0.0,)] * number, seeds))
    y = 1.0 + 0.5 * (values[:, 0] - 3.0) ** 2 + 0.1 * values[:, 2]
    return RecordedRollouts(tests, replicates, y), values


def test_shares_of_a_control_are_those_of_its_parts() -> None:
    rollouts, _ = drawn(40)
    found = disturbance_charts(HEADER, PLAN, (CONTROL, 32), rollouts, "m")
    assert found is not None
    gust, load, mass = found.shares
    assert [each.place for each in found.shares] == [0, 2, 1]
    # A line over a normal score that is constant beyond 3, and two values .4 apart of probability 1/4 that act with d.
    assert gust.deviation == pytest.approx(0.3, rel=0.01)
    assert load.deviation == pytest.approx(0.4 * np.sqrt(0.25 * 0.75 / 3.0))
    assert found.explained == pytest.approx(0.96)
    assert sum(each.share for each in found.shares) == pytest.approx(0.96)
    assert gust.at[0] == pytest.approx(-3.0)
    assert gust.at[-1] == pytest.approx(9.0)
    assert gust.effect[-1] == pytest.approx(0.9)
    assert load.at == (0.0, 10.0)
    assert (mass.share, mass.deviation) == (0.0, 0.0)
    assert (found.left, found.before_fit, found.sampled, found.chance) == (0.1, 32, 0, None)


def test_a_maximum_has_the_other_sign() -> None:
    found = disturbance_charts(HEADER, replace(PLAN, sense="max"), (CONTROL, 32), None, "m")
    assert found is not None
    assert found.shares[0].effect[-1] == pytest.approx(-0.9)
    assert (found.scatter, found.worst) == (None, None)


def test_without_a_control_groups_of_rollouts_show_a_share_whatever_its_form() -> None:
    rollouts, values = drawn(2000)
    found = disturbance_charts(HEADER, PLAN, None, rollouts, "m")
    assert found is not None
    assert found.chance is not None
    shares = {LAWS[each.place].name: each for each in found.shares}
    variance = np.var(rollouts.robustness)
    assert shares["gust"].share > 0.75, "a parabola, of which a correlation is 0"
    exact = 1.0**2 * 0.25 * 0.75 / variance
    assert shares["load"].share == pytest.approx(exact, abs=found.chance)
    assert shares["mass"].share < found.chance
    assert shares["load"].at == (0.0, 10.0)
    with_load = values[:, 2] == 10.0
    assert shares["load"].effect[1] == pytest.approx(rollouts.robustness[with_load].mean())
    assert len(shares["gust"].at) == 20
    assert found.explained is None


def test_the_picture_has_the_worst_and_an_even_choice_of_the_others() -> None:
    rollouts, values = drawn(6000)
    found = disturbance_charts(HEADER, PLAN, None, rollouts._replace(robustness=rollouts.robustness - 1.01), "m")
    assert found is not None
    scatter = found.scatter
    assert scatter is not None
    assert scatter.axes == (0, 2)
    assert len(scatter.margin) == len(scatter.at[0]) == len(scatter.at[1]) == MOST_DOTS
    y = rollouts.robustness - 1.01
    kept = {float(f"{each:.9g}") for each in scatter.margin}
    assert {float(f"{each:.9g}") for each in np.sort(y)[:MOST_WORST].tolist()} <= kept
    assert (scatter.rollouts, scatter.violations) == (6000, int((y < 0).sum()))
    assert sum(scatter.marked) == min(scatter.violations, MOST_WORST)
    worst = int(np.argmin(y))
    place = scatter.margin.index(float(y[worst]))
    assert scatter.at[0][place] == pytest.approx(values[worst, 0], abs=1e-8)
    assert scatter.test[place] == worst // 2


def test_without_a_violation_the_worst_are_marked() -> None:
    rollouts, values = drawn(60)
    found = disturbance_charts(HEADER, PLAN, None, rollouts, "m")
    assert found is not None
    scatter, worst = found.scatter, found.worst
    assert scatter is not None
    assert worst is not None
    assert (sum(scatter.marked), scatter.violations) == (MARKED, 0)
    place = int(np.argmin(rollouts.robustness))
    assert worst.id == f"robustness.{place // 2}.nominal.{place % 2}"
    assert worst.robustness == rollouts.robustness[place]
    assert {each.place: each.value for each in worst.disturbances} == dict(enumerate(values[place].tolist()))
    gust = next(each for each in worst.disturbances if each.place == 0)
    assert gust.sd == pytest.approx((gust.value - 3.0) / 2.0)


def test_few_rollouts_and_systems_without_disturbances_have_none() -> None:
    rollouts, _ = drawn(49)
    assert disturbance_charts(HEADER, PLAN, None, rollouts, "m") is None
    constant = rollouts._replace(robustness=np.ones(49))
    assert disturbance_charts(HEADER, PLAN, (CONTROL, 32), constant, "m") is not None
    assert noisy_variant(HEADER, PLAN) == "nominal"
    calm = replace(HEADER, spec=spec(noisy=True))
    assert noisy_variant(calm, PLAN) is None
    assert disturbances.drawn_values(calm, "nominal", [7]) == [()]
    assert disturbances.drawn_values(HEADER, "true", [7]) == [()]


def test_the_furthest_out_come_first_and_a_rare_choice_is_far_out() -> None:
    seeds = [rollout_seed(HEADER, RolloutId("robustness", test, "nominal", 0)) for test in range(400)]
    for found in disturbances.drawn_values(HEADER, "nominal", seeds):
        far = [{0.75: 0.3186, 0.25: 1.1503}[each.chance or 0] if each.sd is None else abs(each.sd) for each in found]
        assert far == sorted(far, reverse=True)
    text = disturbances.words(HEADER, "nominal", seeds[0])
    assert "gust = " in text
    assert " m/s (" in text
    assert " sd)" in text
    assert "(probability 0.75)" in text
    assert "more" not in text
    assert disturbances.words(HEADER, "true", seeds[0]) == ""
    many = replace(HEADER, spec=SPEC.model_copy(update={"disturbances": LAWS + LAWS}))
    assert disturbances.words(many, "nominal", seeds[0]).endswith("), and 2 more")
    assert all(len(each) == 1 for each in disturbances.drawn_values(HEADER, "nominal", seeds[:3], most=1))
