"""Controls: a known mean of 0 given the start, a range that holds, and less variance where something explains it."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtri

from perfbound.orchestrator.mathematics.control.basis import choice_basis, normal_basis
from perfbound.orchestrator.mathematics.control.sequence import Control, ControlSequence, first_fit
from perfbound.orchestrator.mathematics.gp.kernels import Floats

Explained = Callable[[Floats, Floats], Floats]
"""From starts and scores to what a value owes to them."""
BASES = (normal_basis(7), choice_basis([0.2, 0.5, 0.3]))


def random_control(rng: np.random.Generator, parameters: int) -> Control:
    levels = tuple(rng.normal(size=(1 + parameters, len(basis.knots))) for basis in BASES)
    return Control(BASES, levels, residual=0.1, before=0.2)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_given_the_start_the_mean_is_0_and_no_value_leaves_the_range(seed: int, parameters: int) -> None:
    rng = np.random.default_rng(seed)
    control, start = random_control(rng, parameters), rng.uniform(-1, 1, size=(1, parameters))
    # The mean over a fine grid of the first disturbance, and over the choices of the second one.
    grid = ndtri((np.arange(20_000) + 0.5) / 20_000)
    total = 0.0
    for choice, share in enumerate((0.2, 0.5, 0.3)):
        scores = np.column_stack([grid, np.full(len(grid), float(choice))])
        g, low, high = control.values(np.repeat(start, len(grid), axis=0), scores)
        assert (g >= low - 1e-12).all()
        assert (g <= high + 1e-12).all()
        total += share * float(g.mean())
    assert total == pytest.approx(0.0, abs=1e-6)


PLACES = np.array([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 1.0)])


def rollouts(rng: np.random.Generator, count: int) -> tuple[Floats, Floats, Floats]:
    starts = rng.uniform(-1, 1, size=(count, 2))
    scores = np.column_stack([rng.normal(size=count), rng.choice(3, p=[0.2, 0.5, 0.3], size=count).astype(float)])
    return starts, scores, rng.normal(0, 0.02, size=count)


def fitted(explained: Explained, *, count: int = 400, seed: int = 1) -> tuple[ControlSequence, float, float]:
    """Return a sequence after `count` rollouts, and the deviations of x and of x - g on fresh ones."""
    rng = np.random.default_rng(seed)
    sequence = ControlSequence(BASES, 2, (-3.0, 3.0), first=32)
    for test in range(count // 8):
        place, scores, noise = rollouts(rng, 8)
        place = np.repeat(PLACES[[test % len(PLACES)]], 8, axis=0)
        x = np.clip(0.3 * place[:, 0] + explained(place, scores) + noise, -3, 3)
        sequence.add(test % len(PLACES), place, scores, x)
    starts, scores, noise = rollouts(rng, 4000)
    fresh = np.clip(explained(starts, scores) + noise, -3, 3)
    g = np.zeros(4000) if sequence.control is None else sequence.control.values(starts, scores)[0]
    return sequence, float(fresh.std()), float((fresh - g).std())


@pytest.mark.parametrize(
    ("explained", "share"),
    [
        (lambda d, t: 0.2 * t[:, 0], 0.15),
        (lambda d, t: -0.3 * np.maximum(t[:, 0], 0) ** 2, 0.35),
        (lambda d, t: 0.3 * (t[:, 1] == 2), 0.2),
        (lambda d, t: 0.2 * t[:, 0] * d[:, 1], 0.3),
        (lambda d, t: 0.2 * t[:, 0] + 0.3 * (t[:, 1] == 0), 0.15),
    ],
)
def test_what_disturbances_explain_is_taken_out(explained: Explained, share: float) -> None:
    sequence, before, after = fitted(explained)
    assert after < share * before
    assert sequence.control is not None
    assert sequence.control.residual == pytest.approx(after, rel=0.6)


def test_what_they_do_not_explain_is_left_as_it_is() -> None:
    for seed in range(5):
        sequence, before, after = fitted(lambda d, t: 0.0 * d[:, 0], seed=seed)
        assert after <= 1.05 * before
        assert sequence.has_begun


def test_a_control_is_a_function_of_the_tests_before_its_fit() -> None:
    rng = np.random.default_rng(3)
    starts, scores, noise = rollouts(rng, 100)
    one, other = (ControlSequence(BASES, 2, (-3.0, 3.0), first=32) for _ in range(2))
    for first in range(0, 96, 8):
        part = slice(first, first + 8)
        before = one.control
        one.add(0, starts[part], scores[part], 0.2 * scores[part, 0] + noise[part])
        if (before is None) != (one.control is None):
            assert first + 8 >= 32
        # From the first fit to the next one, at twice as many rollouts, it stays.
        if 32 < first + 8 < 64:
            assert one.control is before
    for first in range(0, 96, 4):  # tests of another size
        part = slice(first, first + 4)
        other.add(0, starts[part], scores[part], 0.2 * scores[part, 0] + noise[part])
    assert one.control is not None
    assert other.control is not None
    assert [each.tolist() for each in one.control.levels] == [each.tolist() for each in other.control.levels]


def test_a_first_test_of_many_rollouts_has_no_half_left_to_choose_a_penalty_on() -> None:
    rng, sequence = np.random.default_rng(4), ControlSequence(BASES, 2, (-3.0, 3.0), first=32)
    fits = []
    for test in range(2):
        _, scores, noise = rollouts(rng, 64)
        place = np.repeat(PLACES[[test]], 64, axis=0)
        fits.append(sequence.add(test, place, scores, 0.2 * scores[:, 0] + noise))
    assert fits == [False, True]
    assert sequence.control is not None


def test_many_disturbances_have_no_products_with_the_start() -> None:
    sequence = ControlSequence((normal_basis(13),) * 15, 20, (0.0, 1.0), first=16)
    rng = np.random.default_rng(0)
    for _ in range(4):
        scores = rng.normal(size=(8, 15))
        sequence.add(0, np.zeros((8, 20)), scores, np.clip(0.5 + 0.1 * scores[:, 3], 0, 1))
    assert sequence.has_begun
    assert sequence.control is None or {len(each) for each in sequence.control.levels} == {1}


def test_the_first_fit_takes_a_small_share_of_the_budget() -> None:
    assert [first_fit(each) for each in (10, 256, 480, 1000, 10**6)] == [32, 32, 32, 62, 64]
