"""The mathematics of a calibration: fits of known functions, norms that are lower bounds, and jumps that are found."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.calibration import noise
from perfbound.orchestrator.mathematics.calibration.kernel_fit import KernelFit, fit_kernel
from perfbound.orchestrator.mathematics.calibration.leave_one_out import leave_one_out
from perfbound.orchestrator.mathematics.calibration.norm_growth import needed_norm, norm_growth, refined
from perfbound.orchestrator.mathematics.calibration.sampled import SampledValues, kernel_matrix
from perfbound.orchestrator.mathematics.calibration.steepness import Descent, End, SteepPlace, quotients, steepest
from perfbound.orchestrator.mathematics.calibration.trust import (
    EXACT_MARGIN,
    Choice,
    choose_kernel,
    least_predicted,
    margin,
)
from perfbound.orchestrator.mathematics.calibration.variogram import variogram
from perfbound.orchestrator.mathematics.sobol import sobol_blocks
from tests.studies.coverage.functions import SIDE, Floats, random_function

Values = Callable[[Floats], Floats]
SHARES = (next(sobol_blocks(2))[:256] + 0.3) % 1.0
PLAIN = KernelFit(2.5, np.array([0.5, 0.5]), 1.0, 0.1, 0.0)


def exact(function: Values, count: int = 256) -> SampledValues:
    return SampledValues(SHARES[:count], function(SHARES[:count]), 0.0)


def noisy(function: Values, sd: float, seed: int = 0) -> SampledValues:
    values = function(SHARES) + sd * np.random.default_rng(seed).standard_normal(len(SHARES))
    return SampledValues(SHARES, values, sd**2)


def smooth(u: Floats) -> Floats:
    return np.asarray(np.sin(3 * u[:, 0]) * np.cos(2 * u[:, 1]))


def kinked(u: Floats) -> Floats:
    return np.asarray(np.abs(u[:, 0] + 0.3 * u[:, 1] - 0.6))


def jumping(u: Floats) -> Floats:
    return np.asarray(smooth(u) - 0.5 * (u[:, 0] + u[:, 1] > 1.7))


def descents(function: Values, data: SampledValues, halvings: int = 6) -> tuple[Descent, ...]:
    paths = [[place] for place in steepest(data)]
    for path in paths:
        for _ in range(halvings):
            middle = path[-1].middle
            path.append(path[-1].half(End(middle, float(function(np.array([middle]))[0]), data.variance)))
    return tuple(Descent(tuple(path)) for path in paths)


def chosen(function: Values, data: SampledValues) -> Choice:
    return choose_kernel(data, None, descents(function, data), PLAIN)


# Fit


@pytest.mark.rest
def test_a_longer_function_gets_longer_length_scales() -> None:
    slow = fit_kernel(2.5, exact(lambda u: np.sin(3.0 * u[:, 0]) + u[:, 1]))
    fast = fit_kernel(2.5, exact(lambda u: np.sin(20.0 * u[:, 0]) + u[:, 1]))
    assert fast.lengths[0] < 0.5 * slow.lengths[0]
    assert fast.lengths[0] < fast.lengths[1], "the other parameter changes it slowly"


def test_the_posterior_of_a_fit_is_that_of_the_gaussian_process() -> None:
    data = noisy(smooth, 0.1).first(60)
    fit, points = fit_kernel(2.5, data), np.array([[0.3, 0.4], [0.9, 0.1], SHARES[0]])
    both = np.concatenate([data.shares, points])
    prior = fit.amplitude**2 * kernel_matrix(fit.nu, fit.lengths, both, both)
    gram = prior[:60, :60] + fit.amplitude**2 * fit.ratio * np.eye(60)
    centre = data.values.mean()
    mean = centre + prior[60:, :60] @ np.linalg.solve(gram, data.values - centre)
    covariance = prior[60:, 60:] - prior[60:, :60] @ np.linalg.solve(gram, prior[:60, 60:])
    assert np.allclose(fit.mean(data, points), mean, atol=1e-9)
    assert np.allclose(fit.covariance(data, points), covariance, atol=1e-9)
    assert np.abs(fit.mean(data, points) - smooth(points)).max() < 0.15


@pytest.mark.rest
def test_the_noise_of_a_fit_is_that_of_the_values() -> None:
    data = noisy(smooth, 0.1)
    fit = fit_kernel(2.5, data)
    assert 0.08 < fit.amplitude * math.sqrt(fit.ratio) < 0.12
    assert fit.gain > 50
    assert fit_kernel(2.5, noisy(lambda u: 0 * u[:, 0], 0.1)).gain < 7, "noise alone has no structure"


def test_equal_values_have_no_length_scale() -> None:
    with pytest.raises(ValueError, match="equal"):
        fit_kernel(2.5, exact(lambda u: 0 * u[:, 0] + 3.0))


# Norms


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from([0.5, 1.5, 2.5]), st.integers(8, 200))
def test_exact_values_give_a_lower_bound_of_the_norm(seed: int, nu: float, count: int) -> None:
    known = random_function(np.random.default_rng(seed), 2, nu=nu, length_scale=1.5, norm=2.0)
    fit = KernelFit(nu, np.array([1.5 / SIDE] * 2), 1e-8, 1.0, 0.0)
    data = exact(lambda u: known(SIDE * u), count)
    found = needed_norm(fit, data, 0.0)
    assert found <= 2.0 * (1 + 1e-9)
    assert needed_norm(fit, data.first(count // 2), 0.0) <= found * (1 + 1e-9), "more values need no smaller norm"
    at_centres = refined(data, known.centres / SIDE, known(known.centres))
    assert needed_norm(fit, at_centres, 0.0) == pytest.approx(2.0, rel=1e-3), "at its centres it is the whole norm"


@pytest.mark.parametrize("data", [exact(smooth, 64), noisy(smooth, 0.1).first(64)], ids=["exact", "noisy"])
def test_the_norm_is_that_of_the_distance_from_the_centre(data: SampledValues) -> None:
    raised = SampledValues(data.shares, data.values + 5.0, data.variance)
    assert needed_norm(PLAIN, raised, 5.0) == pytest.approx(needed_norm(PLAIN, data, 0.0))


@pytest.mark.rest
def test_the_norm_levels_off_for_a_smooth_function_and_rises_for_a_jump() -> None:
    for function, rises in ((smooth, False), (jumping, True)):
        data = exact(function)
        growth = norm_growth(fit_kernel(1.5, data), data, float(data.values.mean()))
        assert (growth.last > 1.1) == rises
        assert growth.limit >= growth.norms[-1]
        assert growth.sizes == (32, 64, 128, 256)


# Predictions and variogram


def test_predictions_are_those_of_a_fit_without_the_value() -> None:
    data = noisy(smooth, 0.05).first(20)
    fit = fit_kernel(1.5, data)
    found, centre = leave_one_out(fit, data), float(data.values.mean())
    for k in (0, 7, 19):
        others = SampledValues(np.delete(data.shares, k, 0), np.delete(data.values, k), data.variance)
        row = kernel_matrix(fit.nu, fit.lengths, data.shares[k : k + 1], others.shares)[0]
        assert found.predicted[k] == pytest.approx(centre + row @ fit.weights(others, centre), rel=1e-6)
        lower = fit.factor(others)
        variance = 1 + fit.ratio - float(np.sum(np.linalg.solve(lower, row) ** 2))
        assert found.sd[k] == pytest.approx(math.sqrt(variance), rel=1e-6)


def test_the_variogram_of_noise_is_flat_and_that_of_a_slope_rises() -> None:
    flat, slope = noisy(lambda u: 0 * u[:, 0], 0.1), exact(lambda u: u[:, 0])
    fit = fit_kernel(2.5, slope)
    drawn = variogram(fit, slope)
    assert np.all(np.diff(drawn.halves) > 0)
    assert np.all(np.diff(drawn.distances) > 0)
    assert np.corrcoef(drawn.halves, drawn.fitted)[0, 1] > 0.99
    assert np.allclose(variogram(fit, flat).halves, 0.01, rtol=0.3)


# Jumps


def test_a_jump_keeps_its_difference_and_a_kink_does_not() -> None:
    assert any(each.is_jump for each in descents(jumping, exact(jumping)))
    for function in (smooth, kinked):
        found = descents(function, exact(function))
        assert len(found) == 4
        assert not any(each.is_jump for each in found)
    few = descents(jumping, exact(jumping), halvings=3)
    assert not any(each.is_jump for each in few), "a slope may leave as much after so few halvings"


def test_fresh_rollouts_decide_on_a_suspected_jump() -> None:
    """An end whose one value is far off keeps its difference through every halving; fresh values there show none."""

    def place(distance: float, outlier: float) -> SteepPlace:
        a, b = ((0.0, outlier, 0.01), (distance, 0.0, 0.01))
        return SteepPlace(*(End((u, 0.0), value, variance) for u, value, variance in (a, b)))

    halved = tuple(place(0.1 / 2**k, 2.0) for k in range(5))
    assert Descent(halved).is_jump, "exact values are what they are"
    again = [SteepPlace(End((0.0, 0.0), value, 0.01), End((0.1, 0.0), 0.0, 0.01)) for value in (0.1, 1.9)]
    assert [Descent(halved, fresh).is_jump for fresh in again] == [False, True]
    assert all(Descent(halved, fresh).is_suspected for fresh in again)
    smooth_place = Descent(tuple(place(0.1 / 2**k, 2.0 / 2**k) for k in range(5)), again[1])
    assert not smooth_place.is_jump, "nothing was suspected"


def test_a_difference_within_the_noise_is_no_jump() -> None:
    a, b = (End((u, 0.0), value, 0.01) for u, value in ((0.0, 0.0), (0.1, 0.5)))
    assert SteepPlace(a, b).difference == 0
    assert steepest(noisy(lambda u: 0 * u[:, 0], 0.1)) == []


def test_the_largest_quotient_of_a_jump_grows_with_the_resolution() -> None:
    sizes = (32, 256)
    few, many = quotients(exact(jumping), sizes)
    assert many > 1.5 * few
    few, many = quotients(exact(smooth), sizes)
    assert many < 1.5 * few


@given(st.floats(0.01, 0.99), st.floats(-5, 5), st.floats(0.1, 3))
def test_each_half_of_a_jump_has_the_jump(at: float, base: float, height: float) -> None:
    def value(u: float) -> float:
        return base + height * (u > at)

    place = SteepPlace(End((0.0,), value(0.0), 0.0), End((1.0,), value(1.0), 0.0))
    for _ in range(8):
        place = place.half(End(place.middle, value(place.middle[0]), 0.0))
        assert place.difference == pytest.approx(height)
        assert min(place.a.shares, place.b.shares)[0] <= at <= max(place.a.shares, place.b.shares)[0]


# Noise


def test_the_noisiest_starts_are_where_the_noise_is() -> None:
    rng = np.random.default_rng(3)
    values = rng.standard_normal((256, 2)) * (0.1 + SHARES[:, :1])
    chosen = noise.noisiest(SHARES, values)
    assert len(chosen) == len(set(chosen)) == noise.NOISIEST
    assert SHARES[chosen, 0].mean() > 0.6
    again = rng.standard_normal((len(chosen), 12)) * (0.1 + SHARES[chosen, :1])
    assert noise.noise_scale(values, again) > 1.1, "the largest standard deviation of the box"


# The choice


@pytest.mark.rest
@pytest.mark.parametrize(("function", "smoothest"), [(smooth, 2.5), (kinked, 0.5)])
def test_a_continuous_function_has_a_kernel_whose_norm_suffices(function: Values, smoothest: float) -> None:
    found = chosen(function, exact(function))
    assert found.chosen is not None
    assert found.chosen.fit.nu == smoothest
    axis = np.linspace(0, 1, 25)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    fine = SampledValues(points, function(points), 0.0)
    fit = KernelFit(found.chosen.fit.nu, found.chosen.fit.lengths, 1e-8, 1.0, 0.0)
    assert needed_norm(fit, fine, float(function(SHARES).mean())) <= found.chosen.bound
    assert found.chosen.bound >= EXACT_MARGIN * found.chosen.growth.norms[-1]


@pytest.mark.rest
def test_no_kernel_is_trusted_with_a_jump_a_constant_or_waves_between_the_starts() -> None:
    cases: list[tuple[Values, str]] = [
        (jumping, "jump"),
        (lambda u: 0 * u[:, 0], "equal"),
        (lambda u: np.sin(80 * u[:, 0]) * np.sin(90 * u[:, 1]), "rises"),
    ]
    for function, fault in cases:
        found = chosen(function, exact(function))
        assert found.chosen is None
        assert found.faults[0] == fault
    assert chosen(smooth, exact(smooth, 20)).faults == ("few",)


@pytest.mark.rest
def test_a_jump_is_found_without_halving_as_well() -> None:
    assert "rises" in choose_kernel(exact(jumping), None, (), PLAIN).faults


@pytest.mark.rest
def test_noise_alone_has_the_kernel_of_a_file_without_one() -> None:
    data = noisy(lambda u: 0 * u[:, 0], 0.1)
    found = choose_kernel(data, None, (), PLAIN)
    assert found.plain
    assert found.chosen is not None
    assert np.array_equal(found.chosen.fit.lengths, PLAIN.lengths)
    assert found.chosen.bound >= 0.3, "so much may hide in the noise of one start"


@pytest.mark.rest
def test_a_hole_deeper_than_the_noise_is_an_outlier() -> None:
    def hole(u: Floats) -> Floats:
        return np.asarray(smooth(u) - 1.0 * (np.hypot(u[:, 0] - 0.5, u[:, 1] - 0.5) < 0.05))

    data = noisy(hole, 0.1)
    found = choose_kernel(data, None, (), PLAIN)
    assert found.chosen is None
    inside = np.flatnonzero(np.hypot(*(SHARES - 0.5).T) < 0.05)
    assert set(least_predicted(data)) & set(inside.tolist())
    assert choose_kernel(noisy(smooth, 0.1), None, (), PLAIN).chosen is not None


# Rare falls


@pytest.mark.parametrize("seed", range(5))
def test_only_rare_falls_are_large_deviations(seed: int) -> None:
    """Not noise that differs from start to start, nor noise with heavy but frequent tails."""
    rng = np.random.default_rng(seed)
    plain = rng.standard_normal((256, 2))
    by_start = plain * (0.05 + 2.0 * SHARES[:, :1])
    falls = 0.3 * plain - 25.0 * (rng.random((256, 2)) < 0.01)
    assert noise.largest_deviation(SHARES, plain) < noise.FALLS
    assert noise.largest_deviation(SHARES, by_start) < noise.FALLS
    assert noise.largest_deviation(SHARES, falls) > noise.FALLS
    assert noise.largest_deviation(SHARES, np.ones((256, 2))) == 0.0


@pytest.mark.rest
def test_as_many_starts_are_doubted_as_noise_makes_doubtful() -> None:
    """With rare falls four are too few; the rest would be taken for holes."""
    rng = np.random.default_rng(3)
    falls = 0.1 * rng.standard_normal(256) - 3.0 * (rng.random(256) < 0.04)
    data = SampledValues(SHARES, smooth(SHARES) + falls, 0.04)
    lowest = set(np.argsort(falls)[:6].tolist())
    assert len(least_predicted(data)) <= 12, "at most a twentieth"
    assert lowest <= set(least_predicted(data))


def test_the_more_the_noise_hides_the_larger_is_the_margin_of_the_norm() -> None:
    data = exact(smooth, 100)
    share = float(np.var(data.values))
    factors = [margin(replace(data, variance=noise * share * 100)) for noise in (0.0, 7e-5, 9e-5, 3e-4, 5e-4, 1.0)]
    assert factors == [1.5, 1.5, 2.0, 2.0, 2.5, 2.5]
