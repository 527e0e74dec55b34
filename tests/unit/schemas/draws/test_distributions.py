"""Truncated distributions: in the range, of the declared law, exact in the tails; rounding to digits."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import stats

from perfbound.schemas.draws.distributions import LEAST, to_digits, truncated
from perfbound.schemas.file.distributed import DISTRIBUTIONS
from perfbound.schemas.values import DistributionName

LAWS: list[tuple[DistributionName, dict[str, float], float, float, Any]] = [
    ("uniform", {}, -3.0, 4.0, stats.uniform(-3.0, 7.0)),
    ("normal", {"mean": 20.0, "sd": 5.0}, 5.0, 60.0, stats.norm(20.0, 5.0)),
    ("normal", {"mean": 0.0, "sd": 1.0}, 4.0, 9.0, stats.norm(0.0, 1.0)),
    ("normal", {"mean": 0.0, "sd": 1.0}, -9.0, -4.0, stats.norm(0.0, 1.0)),
    ("lognormal", {"median": 2.0, "sigma": 0.5}, 0.0, 10.0, stats.lognorm(0.5, scale=2.0)),
    ("lognormal", {"median": 1e-3, "sigma": 2.0}, 1e-6, 1e6, stats.lognorm(2.0, scale=1e-3)),
    ("triangular", {"mode": 0.0}, 0.0, 5.0, stats.triang(0.0, 0.0, 5.0)),
    ("triangular", {"mode": 4.0}, -1.0, 5.0, stats.triang(5 / 6, -1.0, 6.0)),
    ("weibull", {"shape": 2.0, "scale": 8.0}, 0.0, 25.0, stats.weibull_min(2.0, scale=8.0)),
    ("weibull", {"shape": 0.7, "scale": 1.0}, 1.0, 3.0, stats.weibull_min(0.7, scale=1.0)),
]
ERROR = 1e-3 / len(LAWS)
"""Of each test at another seed: all of them together fail a correct program in at most one of 1,000 seeds."""


def test_every_distribution_is_tested() -> None:
    assert {name for name, *_ in LAWS} == DISTRIBUTIONS.keys()


@pytest.mark.parametrize(("name", "keys", "low", "high", "law"), LAWS)
def test_values_follow_the_truncated_law(
    name: DistributionName, keys: dict[str, float], low: float, high: float, law: Any
) -> None:
    values = truncated(name, keys, low, high)(np.random.default_rng(20).random(20_000))
    assert low <= values.min() <= values.max() <= high
    # The larger tail cancels: 1 - 1e-5 has five digits less than 1e-5.
    upper = law.cdf(low) > 0.5
    mass = law.sf(low) - law.sf(high) if upper else law.cdf(high) - law.cdf(low)

    def below(x: Any) -> Any:
        return ((law.sf(low) - law.sf(x)) if upper else (law.cdf(x) - law.cdf(low))) / mass

    assert stats.kstest(values, below).pvalue > ERROR
    # Another law is found out: the same values, one standard deviation of 20,000 shares times eight to the side.
    assert stats.kstest(values, lambda x: np.clip(below(x) + 8 * 0.5 / 20_000**0.5, 0, 1)).pvalue < 1e-6


@pytest.mark.parametrize(("name", "keys", "low", "high", "law"), LAWS)
def test_a_larger_share_is_no_smaller_value(
    name: DistributionName, keys: dict[str, float], low: float, high: float, law: Any
) -> None:
    shares = np.concatenate([[0.0, 2.0**-53], np.linspace(0, 1, 1001)[1:-1], [1 - 2.0**-53]])
    values = truncated(name, keys, low, high)(shares)
    assert np.all(np.diff(values) >= 0)
    assert values[0] == pytest.approx(low, abs=1e-9 * (high - low))
    assert values[0] >= low
    assert values[-1] <= high


def test_a_tail_keeps_its_digits() -> None:
    # 1 - cdf(5) has nine digits left.
    median = float(truncated("normal", {"mean": 0.0, "sd": 1.0}, 5.0, 8.0)(np.array([0.5]))[0])
    assert stats.norm.sf(median) == pytest.approx((stats.norm.sf(5.0) + stats.norm.sf(8.0)) / 2, rel=1e-13)


@pytest.mark.parametrize(
    ("keys", "low", "high"),
    [
        ({"mean": 0.0, "sd": 1.0}, 10.0, 20.0),
        ({"mean": 0.0, "sd": 1.0}, -20.0, -10.0),
        ({"mean": 0.0, "sd": 1.0}, 50.0, 60.0),
        ({"mean": 1e6, "sd": 1.0}, 0.0, 1.0),
        ({"mean": 0.0, "sd": 1e12}, 0.0, 1.0),
    ],
)
def test_a_range_that_holds_almost_nothing_is_refused(keys: dict[str, float], low: float, high: float) -> None:
    with pytest.raises(ValueError, match=f"less than {LEAST:g} of the distribution"):
        truncated("normal", keys, low, high)


@given(
    low=st.floats(-1e9, 1e9),
    width=st.floats(1e-3, 1e9),
    share=st.floats(0, 1),
    digits=st.integers(3, 12),
)
def test_rounding_stays_inside_and_near(low: float, width: float, share: float, digits: int) -> None:
    high = low + width
    value = min(max(low + share * width, low), high)
    (found,) = to_digits(np.array([value]), low, high, digits)
    assert low <= found <= high
    assert abs(found - value) <= 10.0 ** (1 - digits) * min(abs(value), width) + 1e-15 * abs(value)
    assert to_digits(np.array([found]), low, high, digits) == [pytest.approx(found, rel=1e-15)]


@given(
    power=st.integers(-300, 300),
    times=st.integers(-3, 3),
    shares=st.lists(st.floats(0, 1), min_size=1),
    digits=st.integers(1, 12),
)
@example(power=-6, times=1, shares=[0.123456789], digits=4)  # the float 1e-6 is below 1e-6
def test_the_digits_are_those_of_the_decimal_text(power: int, times: int, shares: list[float], digits: int) -> None:
    ten = float(f"1e{power}")
    low, high = times * ten, times * ten + ten
    near = [low, high, math.nextafter(low, high), math.nextafter(high, low)]
    values = [min(max(each, low), high) for each in (*near, *(low + share * ten for share in shares))]

    def rounded(value: float) -> float:
        exponent = int(f"{min(abs(value), high - low):.16e}".partition("e")[2])
        return min(max(round(value, digits - 1 - exponent), low), high) if value else value

    assert to_digits(np.array(values), low, high, digits) == list(map(rounded, values))


@given(value=st.floats(0.01, 100), steps=st.integers(-4, 4))
def test_a_difference_of_the_last_bits_is_rounded_away(value: float, steps: int) -> None:
    # Where no limit between two roundings is near: the value is one of nine digits.
    value = float(f"{value:.8e}")
    other = value
    for _ in range(abs(steps)):
        other = float(np.nextafter(other, 200.0 if steps > 0 else -200.0))
    assert to_digits(np.array([value, other]), 0.0, 200.0, 9) == [value, value]
