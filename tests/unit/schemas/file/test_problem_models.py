"""The models of the problems: what no value may be."""

from typing import Any

import pytest
from pydantic import ValidationError

from perfbound.schemas.file.defaults import completed
from perfbound.schemas.file.problem_models import Falsify, PaperProblem, RigorousProblem

KERNEL: dict[str, Any] = {"name": "robustness", "rkhs_norm": 1.0, "alpha": 0.1, "kernel": {"length_scale": 1.0}}


MODELS: list[tuple[type[PaperProblem | RigorousProblem], dict[str, Any]]] = [
    (PaperProblem, {"method": "paper", "c": 0.1}),
    (RigorousProblem, {"method": "rigorous"}),
]


@pytest.mark.parametrize(("model", "keys"), MODELS)
def test_the_scale_of_noise_is_not_negative(model: type[PaperProblem | RigorousProblem], keys: dict[str, Any]) -> None:
    assert model.model_validate({**KERNEL, **keys, "noise_scale": 0.5}).noise_scale == 0.5
    with pytest.raises(ValidationError, match="noise_scale"):
        model.model_validate({**KERNEL, **keys, "noise_scale": -0.5})


def test_a_rig_repeats_no_failure_on_its_own() -> None:
    rig = {"system": {"rig": "bench"}}
    assert completed({**rig, "falsify": {}})["falsify"] == {"simplest_tests": 0}
    assert completed({**rig, "falsify": {"simplest_tests": 5}})["falsify"] == {"simplest_tests": 5}
    assert "falsify" not in completed(rig)


@pytest.mark.parametrize(
    ("until", "clusters", "most"), [("counterexample", None, 50), ("3 clusters", 3, 150), ("budget", None, 1000)]
)
def test_what_ends_a_search_says_how_many_failures_are_simplified(until: str, clusters: int | None, most: int) -> None:
    falsify = Falsify(until=until)
    assert (falsify.clusters, falsify.most_simplifying_tests) == (clusters, most)
