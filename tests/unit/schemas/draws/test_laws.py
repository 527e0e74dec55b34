"""Values of disturbances: each from the seed of its rollout alone and with its law, and the laws that have none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import perfbound as pb
from perfbound.schemas.draws.counter import open_shares, uniform
from perfbound.schemas.draws.laws import Laws, ReportedLaw, check_law
from perfbound.schemas.errors import DefinitionError
from perfbound.schemas.file.disturbance import Disturbance

LAWS = [
    (pb.Normal(1, 2), stats.norm(1, 2)),
    (pb.Normal(0, 1, low=-0.5, high=2), stats.truncnorm(-0.5, 2)),
    (pb.Normal(3, 2, low=0), stats.truncnorm(-1.5, np.inf, loc=3, scale=2)),
    (pb.Uniform(-1, 3), stats.uniform(-1, 4)),
    (pb.LogNormal(2, 0.3), stats.lognorm(0.3, scale=2)),
    (pb.Triangular(0, 1, 4), stats.triang(0.25, 0, 4)),
    (pb.Weibull(2, 3), stats.weibull_min(2, scale=3)),
    (pb.Law("gumbel_r", loc=1, scale=2), stats.gumbel_r(1, 2)),
    (pb.Law("t", df=3), stats.t(3)),
]
SEEDS = np.arange(20_000, dtype=np.uint64) * 977


@pytest.mark.parametrize(("law", "wanted"), LAWS)
def test_values_have_the_declared_law(law: Disturbance, wanted: "stats.rv_frozen") -> None:
    values = Laws([law]).values(SEEDS)[:, 0]
    assert stats.kstest(values, wanted.cdf).pvalue > 0.001
    assert Laws([law]).middles[0] == pytest.approx(wanted.median(), rel=1e-8)


def test_choices_have_their_probabilities() -> None:
    values = Laws([pb.Choice([5, 7, 6], [0.2, 0.5, 0.3])]).values(SEEDS)[:, 0]
    found, counts = np.unique(values, return_counts=True)
    assert found.tolist() == [5, 6, 7]
    assert stats.chisquare(counts, len(SEEDS) * np.array([0.2, 0.3, 0.5])).pvalue > 0.001


def test_disturbances_are_independent_of_one_another_and_of_what_a_simulator_draws() -> None:
    values = Laws([pb.Uniform(0, 1)] * 4).values(SEEDS)
    own = uniform(SEEDS, 4)
    assert np.abs(np.corrcoef(np.hstack([values, own]).T) - np.eye(8)).max() < 0.03
    assert not np.isclose(values, own, atol=1e-8).any()


@given(st.lists(st.integers(0, 2**53 - 1), min_size=1, max_size=6), st.integers(1, 5))
def test_a_row_follows_from_its_seed_alone(seeds: list[int], count: int) -> None:
    laws = Laws([pb.Normal(0, 1), pb.Choice([1, 2, 3]), pb.Uniform(0, 1)][:count])
    every = laws.values(seeds)
    assert [laws.values([seed])[0].tolist() for seed in seeds] == every.tolist()
    shares = open_shares(seeds, count)
    assert ((shares > 0.0) & (shares < 1.0)).all()


def test_shares_are_never_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = np.array([[0.0, 1.0 - 2.0**-53]])
    monkeypatch.setattr("perfbound.schemas.draws.counter._drawn", lambda *_: ends)
    low, high = open_shares([1], 2)[0].tolist()
    assert (low, high) == (2.0**-53, 1.0 - 2.0**-53)


def test_values_stay_what_they_were() -> None:
    # A change here changes the evidence of every campaign with declared disturbances.
    laws = Laws([pb.Normal(0, 1), pb.Uniform(0, 1), pb.Choice([1, 2, 3])])
    assert laws.values([1, 2**53 - 1]).tolist() == GOLDEN


GOLDEN = [[-1.18881884, 0.0399353854, 2.0], [0.819544467, 0.897496523, 2.0]]

WITHOUT_VALUES = [
    (pb.Law("nope"), "'nope' is no continuous distribution of scipy.stats"),
    (pb.Law("poisson", mu=3), "'poisson' is no continuous distribution"),
    (pb.Law("gamma"), "gamma takes a, loc, scale, not no numbers"),
    (pb.Law("gumbel_r", a=3), "gumbel_r takes loc, scale, not a"),
    (pb.Law("gamma", a=-1), "gamma takes no such numbers"),
    (pb.Normal(0, 1, low=50, high=60), "less than 1e-09 of the distribution"),
    (pb.Normal(0, 1e99, low=1e99, high=1e100), ""),
]


@pytest.mark.parametrize(("law", "fault"), WITHOUT_VALUES)
def test_a_law_without_values_is_refused(law: Disturbance, fault: str) -> None:
    if not fault:
        check_law(law)
        return
    with pytest.raises(DefinitionError) as caught:
        check_law(law.named("gust", ""))
    assert str(caught.value).startswith("gust: ")
    assert fault in str(caught.value)


@pytest.mark.parametrize(
    "law",
    [
        pb.Normal(3, 2),
        pb.Normal(0, 1, low=-1, high=2),
        pb.LogNormal(2, 0.4),
        pb.Uniform(-1, 3),
        pb.Triangular(0, 1, 4),
        pb.Weibull(2, 3),
        pb.Law("gumbel_r", loc=0, scale=1),
        pb.Choice([5, -1, 2], [0.2, 0.5, 0.3]),
    ],
)
def test_reported_values_have_the_scores_that_they_were_drawn_from(law: Disturbance) -> None:
    laws, seeds, known = Laws([law.named("w", "")]), range(500), ReportedLaw(law)
    values = laws.values(seeds)[:, 0]
    assert known.scores(values) == pytest.approx(laws.scores(seeds)[:, 0], abs=1e-6)
    shares = known.shares(values, np.random.default_rng(1).random(500))
    assert stats.kstest(shares, "uniform").pvalue > 0.01
    if law.choices is not None or law.low is not None:
        assert np.isnan(known.shares([9.0, 5.0001], [0.5, 0.5])).all()
        assert np.isfinite(known.scores([9.0])).all()
