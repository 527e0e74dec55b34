"""Drawn starts: functions of the campaign, the design and their number; those of the spot check stay what they were."""

import hashlib
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from perfbound.orchestrator.campaign.checks import check
from perfbound.orchestrator.campaign.draws import BLOCK, Draws, check_distributions
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.campaign.seeds import uniform
from perfbound.orchestrator.campaign.spot_check import _uniform_starts
from perfbound.schemas.errors import CampaignError
from perfbound.schemas.file.parameters import signal_shapes
from perfbound.schemas.file.space import Box, Range, Scenarios, Space, StartTable
from perfbound.schemas.result.facts import Header
from perfbound.workers.systems import load_system
from tests.campaigns import config

BOX: Box = {
    "x": Range(low=0.0, high=5.0, distribution="normal", mean=2.0, sd=1.0),
    "y": Range(low=0.0, high=5.0, distribution="weibull", shape=2.0, scale=2.0),
}
TABLE = StartTable(table=((1.0, 2.0), (3.0, 4.0), (1.0, 2.0)))

GOLDEN = [(2.08893159, 2.40542962), (1.50259173, 0.160941863), (1.13925664, 0.61537386)]
GOLDEN_ROWS = [1, 0, 0, 0, 0, 0, 1, 0]


def header(space: Space = BOX, **changes: Any) -> Header:
    """Return the header of the paper's campaign on another space, whatever its method takes."""
    found = config("segway-paper", **changes).model_copy(update={"space": space})
    return Header.new(found, load_system("segway").spec, {}, run="0" * 16)


def fixed(space: Space = BOX) -> Header:
    return replace(header(space), config_sha256="1234" * 16)


def test_starts_of_the_spot_check_stay_what_they_were() -> None:
    # A change here refutes every certificate with a spot check.
    found = replace(header(config("segway-paper").space, spot_check=299), config_sha256="1234" * 16)
    starts = _uniform_starts(found, list(plans(found.config, found.spec).values()), "spot_check")
    assert starts[0] == (3.658339854727783, 1.9530640519583016)
    assert hashlib.sha256(repr(starts).encode()).hexdigest().startswith("a811733fe43480a359842503647e691f")


@given(first=st.integers(0, 2000), count=st.integers(1, 50), width=st.integers(1, 5))
def test_rows_of_a_series_are_those_of_the_whole(first: int, count: int, width: int) -> None:
    found = fixed()
    whole = uniform(found, "spot_check", range(first + count), width)
    assert np.array_equal(uniform(found, "spot_check", range(first, first + count), width), whole[first:])


def test_starts_stay_what_they_were() -> None:
    drawn, listed = Draws(fixed(), "robustness"), Draws(fixed(TABLE), "robustness")
    assert [drawn.start(j) for j in (0, 1, 1000)] == GOLDEN
    assert [TABLE.rows.index(listed.start(j)) for j in range(8)] == GOLDEN_ROWS


@settings(max_examples=20)
@given(numbers=st.lists(st.integers(0, 5 * BLOCK), min_size=1, max_size=20), space=st.sampled_from([BOX, TABLE]))
def test_the_order_in_which_starts_are_asked_for_changes_none(numbers: list[int], space: Space) -> None:
    found = fixed(space)
    one = Draws(found, "robustness")
    assert [one.start(number) for number in numbers] == [Draws(found, "robustness").start(number) for number in numbers]


def test_another_campaign_or_design_has_other_starts() -> None:
    headers = [header(), header(seed=2), header(risk_weight=0.3), header({**BOX, "x": Range(low=0.0, high=4.9)})]
    starts = {Draws(each, design).start(0) for each in headers for design in ("robustness", "risk")}
    assert len(starts) == 2 * len(headers)


def test_parameters_are_in_the_order_of_the_system() -> None:
    assert [Draws(fixed(dict(reversed(BOX.items()))), "a").start(j) for j in range(3)] == [
        Draws(fixed(), "a").start(j) for j in range(3)
    ]


def test_starts_are_inside_and_of_the_declared_distributions() -> None:
    """The seed is fixed; at another one a correct program fails in at most one of 1,000."""
    drawn = Draws(fixed(), "robustness")
    starts = np.array([drawn.start(j) for j in range(10_000)])
    assert starts.min() >= 0.0
    assert starts.max() <= 5.0
    for column, law in enumerate((stats.norm(2.0, 1.0), stats.weibull_min(2.0, scale=2.0))):
        mass = law.cdf(5.0) - law.cdf(0.0)
        found = stats.kstest(starts[:, column], lambda x, law=law, mass=mass: (law.cdf(x) - law.cdf(0.0)) / mass)
        assert found.pvalue > 0.001 / 4
    assert stats.spearmanr(starts[:, 0], starts[:, 1]).pvalue > 0.001 / 4
    assert stats.spearmanr(starts[:-1, 0], starts[1:, 0]).pvalue > 0.001 / 4


def test_no_distribution_is_uniform_on_the_box() -> None:
    space: Space = {"x": Range(low=-20.0, high=25.0), "y": Range(low=1000.0, high=1000.001)}
    drawn = Draws(fixed(space), "robustness")
    starts = np.array([drawn.start(j) for j in range(10_000)])
    assert stats.kstest(starts[:, 0], stats.uniform(-20.0, 45.0).cdf).pvalue > 0.001 / 2
    assert stats.kstest(starts[:, 1], stats.uniform(1000.0, 0.001).cdf).pvalue > 0.001 / 2
    assert len(set(starts[:, 1])) > 9_900, "rounding keeps the values of a narrow range apart"


def test_rows_are_drawn_with_replacement_as_often_as_they_are_there() -> None:
    drawn = Draws(fixed(TABLE), "robustness")
    counts = Counter(drawn.start(j) for j in range(9_000))
    assert counts.keys() == {(1.0, 2.0), (3.0, 4.0)}
    assert stats.binomtest(counts[3.0, 4.0], 9_000, 1 / 3).pvalue > 0.001


def test_the_last_share_is_the_last_row(monkeypatch: pytest.MonkeyPatch) -> None:
    largest = np.full((BLOCK, 1), 1 - 2.0**-53)
    monkeypatch.setattr("perfbound.orchestrator.campaign.draws.uniform", lambda *_: largest)
    assert Draws(fixed(StartTable(table=((0.0, 0.0), (0.0, 1.0), (0.0, 2.0)))), "a").start(0) == (0.0, 2.0)


def counted(given: Range) -> dict[float, int]:
    """Return how often the values of a parameter are drawn, of 9,000."""
    drawn = Draws(fixed({"x": given, "y": Range(low=0.0, high=1.0)}), "robustness")
    return dict(sorted(Counter(drawn.start(j)[0] for j in range(9_000)).items()))


def test_choices_and_steps_are_drawn_alike() -> None:
    choices = counted(Range(low=-1.0, high=7.0, choices=(7.0, -1.0, 0.25)))
    steps = counted(Range(low=0.1, high=0.5, step=0.1))
    assert list(choices) == [-1.0, 0.25, 7.0]
    assert list(steps) == [0.1, 0.2, 0.3, 0.4, 0.5]
    for counts in (choices, steps):
        assert stats.chisquare(list(counts.values())).pvalue > 0.001 / 2


def test_a_step_has_the_probability_of_the_numbers_around_it() -> None:
    counts = counted(Range(low=0.0, high=4.0, step=1.0, distribution="normal", mean=1.0, sd=1.0))
    ends = stats.norm(1.0, 1.0).cdf(np.arange(6) - 0.5)
    expected = np.diff(ends) / (ends[-1] - ends[0])
    assert list(counts) == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert stats.chisquare(list(counts.values()), expected * 9_000).pvalue > 0.001


def test_knots_are_drawn_alike_and_independently() -> None:
    """The seed is fixed; at another one a correct program fails in at most one of 1,000."""
    space: Box = {
        "x": Range(low=0.0, high=5.0, distribution="normal", mean=2.0, sd=1.0, signal="pchip", knots=3),
        "y": Range(low=0.0, high=1.0),
    }
    found = header(space)
    over_time = tuple(each.model_copy(update={"signal": each.name == "x"}) for each in found.spec.parameters)
    spread = found.spec.model_copy(update={"parameters": over_time}).spread(signal_shapes(space))
    drawn = Draws(replace(found, spec=spread, config_sha256="1234" * 16), "robustness")
    starts = np.array([drawn.start(j) for j in range(5_000)])
    assert starts.shape == (5_000, 4)
    law, ends = stats.norm(2.0, 1.0), stats.norm(2.0, 1.0).cdf([0.0, 5.0])
    for knot in starts[:, :3].T:
        assert stats.kstest(knot, lambda x: (law.cdf(x) - ends[0]) / (ends[1] - ends[0])).pvalue > 0.001 / 6
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert stats.spearmanr(starts[:, one], starts[:, other]).pvalue > 0.001 / 6


def test_a_number_below_0_and_a_list_are_refused() -> None:
    with pytest.raises(IndexError, match="start -1 of a design"):
        Draws(fixed(), "a").start(-1)
    with pytest.raises(TypeError, match="list of scenarios"):
        Draws(fixed(Scenarios(scenarios=((1.0, 2.0),))), "a")


def test_a_distribution_of_another_unit_is_refused_before_the_campaign() -> None:
    space: Box = {**BOX, "y": Range(low=0.0, high=5.0, distribution="normal", mean=2000.0, sd=100.0)}
    reason = (
        r"^c\.toml: space\.y\.distribution: almost nothing of 'normal' with mean 2000 and sd 100 is in \[0, 5\]; "
        r"fix the unit or the range$"
    )
    with pytest.raises(CampaignError, match=reason):
        check_distributions(space, "c.toml")
    found = header(space)
    with pytest.raises(CampaignError, match=reason):
        check(found.config, found.spec, "c.toml")
    check(header().config, found.spec, "c.toml")


@pytest.mark.integration
def test_scipy_is_loaded_only_for_distributions() -> None:
    code = "import sys, perfbound.orchestrator.campaign.draws; sys.exit('scipy' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
