"""The least distance of two bounds: that of the noise, and none where no noise keeps them apart."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from perfbound.orchestrator.forecast.remaining import least_distance
from perfbound.schemas.file.problem_models import RigorousProblem, ScenarioProblem

RIGOROUS: dict[str, Any] = {"name": "robustness", "method": "rigorous", "alpha": 0.1, "rkhs_norm": 9.0}
RIGOROUS |= {"noise_scale": 2.0, "kernel": {"length_scale": 1.0}, "delta": 0.05}


def plan(problem: object, noise: float, budget: int = 100) -> Any:
    return SimpleNamespace(problem=problem, noise=noise, budget=budget)


def test_noise_keeps_the_bounds_of_a_confidence_set_apart() -> None:
    problem = RigorousProblem.model_validate(RIGOROUS)
    assert least_distance(plan(problem, 2.0)) == pytest.approx(4 * math.sqrt(2 * math.log(20) / 100))
    assert least_distance(plan(problem, 2.0, budget=1)) <= 18.0, "no further apart than without any test"
    assert least_distance(plan(problem, 0.0)) == 0.0


def test_other_methods_have_no_such_distance() -> None:
    problem = ScenarioProblem.model_validate({"name": "robustness", "method": "scenario", "alpha": 0.1})
    assert least_distance(plan(problem, 2.0)) == 0.0
