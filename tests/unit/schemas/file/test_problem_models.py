"""The models of the problems: what no value may be."""

from typing import Any

import pytest
from pydantic import ValidationError

from perfbound.schemas.file.problem_models import PaperProblem, RigorousProblem

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
