"""Importance of parameters: Sobol indices against functions of which they are known."""

import math

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.importance import (
    lattice_effect,
    lattice_indices,
    sample_effect,
    sample_indices,
)

A, B = 7.0, 0.1
"""Constants of the function of Ishigami."""


def ishigami(x: np.ndarray) -> np.ndarray:
    """Return the function of Ishigami and Homma 1990 at x (n, 3), each in [-pi, pi]."""
    return np.asarray(np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0]))


def ishigami_indices() -> tuple[list[float], list[float]]:
    """Return its first-order and total indices in closed form."""
    v1, v2 = 0.5 * (1 + B * math.pi**4 / 5) ** 2, A**2 / 8
    v13 = B**2 * math.pi**8 * (1 / 18 - 1 / 50)
    variance = v1 + v2 + v13
    return [v1 / variance, v2 / variance, 0.0], [(v1 + v13) / variance, v2 / variance, v13 / variance]


def on_lattice(nodes: int) -> np.ndarray:
    axis = np.linspace(-math.pi, math.pi, nodes)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return ishigami(grid.reshape(-1, 3)).reshape((nodes,) * 3)


def test_the_indices_of_ishigami() -> None:
    first, total = ishigami_indices()
    found = lattice_indices(on_lattice(61))
    assert found is not None
    assert found.first == pytest.approx(first, abs=2e-3)
    assert found.total == pytest.approx(total, abs=2e-3)


def test_what_the_lattice_adds_vanishes_with_its_cells() -> None:
    first, _ = ishigami_indices()
    errors = []
    for nodes in (11, 21, 41):
        found = lattice_indices(on_lattice(nodes))
        assert found is not None
        errors.append(float(np.max(np.abs(found.first - first))))
    assert errors[1] < errors[0] / 3
    assert errors[2] < errors[1] / 3


def test_an_additive_function_has_no_interactions() -> None:
    x, y, z = np.meshgrid(*[np.linspace(0, 1, 9)] * 3, indexing="ij")
    found = lattice_indices(3 * x + np.exp(y) + 0 * z)
    assert found is not None
    assert found.first == pytest.approx(found.total)
    assert found.first.sum() == pytest.approx(1.0)
    assert found.first[2] == pytest.approx(0.0, abs=1e-12)


def test_a_pure_interaction_has_no_main_effect() -> None:
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9), indexing="ij")
    found = lattice_indices(x * y)
    assert found is not None
    assert found.first == pytest.approx([0.0, 0.0], abs=1e-12)
    assert found.total == pytest.approx([1.0, 1.0])
    assert lattice_effect(x * y, 0) == pytest.approx(np.zeros(9), abs=1e-12)


def test_indices_change_neither_with_the_scale_nor_with_an_offset() -> None:
    values = np.random.default_rng(3).normal(size=(5, 7))
    one, other = lattice_indices(values), lattice_indices(1e3 - 250 * values)
    assert one is not None
    assert other is not None
    assert one.first == pytest.approx(other.first)
    assert one.total == pytest.approx(other.total)


def test_a_constant_has_no_importance() -> None:
    assert lattice_indices(np.full((4, 4), 0.1 + 0.2)) is None
    assert sample_indices(np.random.default_rng(1).uniform(size=(100, 2)), np.full(100, 0.3)) is None


def test_a_missing_value_is_refused() -> None:
    with pytest.raises(ValueError, match="not finite"):
        lattice_indices(np.array([[0.0, 1.0], [math.nan, 2.0]]))


def test_the_estimate_from_one_sample_comes_near() -> None:
    """Its standard deviation is below 1 / sqrt(n) = 0.005, for noise that explains nothing as well."""
    x = np.random.default_rng(7).uniform(-math.pi, math.pi, size=(40_000, 3))
    found = sample_indices(x, ishigami(x))
    assert found is not None
    assert found == pytest.approx(ishigami_indices()[0], abs=0.03)


def test_a_main_effect_of_a_sample_follows_its_parameter() -> None:
    x = np.random.default_rng(5).uniform(size=2000)
    at, mean = sample_effect(x, 2 * x, 10)
    assert len(at) == 10
    assert mean == pytest.approx(2 * at)
    assert np.all(np.diff(at) > 0)
