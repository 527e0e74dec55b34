"""The sentence on what declared disturbances are worth: the gain, and the largest part."""

import pytest

from perfbound.orchestrator.certificate.words.control_text import control_line, control_sentence
from perfbound.schemas.file.objectives import ProblemName
from perfbound.schemas.result.certificate import ControlOfDisturbance, ControlResult, ProblemResult, Rollouts
from tests.unit.certificate.test_sensitivity import a_claim


def a_result(parts: dict[str, float], name: ProblemName = "robustness", explained: float = 0.976) -> ProblemResult:
    """Return a problem with a control whose parts have these standard deviations; without parts none."""
    control = ControlResult(
        explained=explained,
        standard_deviation=0.01,
        before_fit=32,
        disturbances=tuple(
            ControlOfDisturbance(name=each, standard_deviation=deviation, knots=(-3.0, 3.0), levels=((0.0, 1.0),))
            for each, deviation in parts.items()
        ),
    )
    return ProblemResult(
        name=name, objective="", method="kriging", sense="min", bound=0.5, partner=None, probability=0.95,
        probabilities={"bound": 0.95}, tests=9, rollouts=Rollouts(nominal=9, true=0), stopped_by="budget",
        parameters={}, last_F=None, control=control if parts else None,
    )  # fmt: skip


GUST = {"gust": 0.1}
BOTH = {"gust": 0.1, "mass": 0.05}
THREE = {"gust": 0.1, "mass": 0.09, "load": 0.09}


@pytest.mark.parametrize(
    ("values", "without", "parts", "sentence"),
    [
        ({}, 0.48, BOTH, "The declared disturbances raise the bound from 0.4800 to 0.5000: they explain 97.6 % of the "
                         "variance of a rollout, most of it gust."),
        ({"sense": "<=", "by_clip": 1.0}, 0.52, THREE, "The declared disturbances lower the bound from 0.5200 to "
         "0.5000: they explain 97.6 % of the variance of a rollout, gust the largest part."),
        ({}, 0.48, GUST, "The disturbance gust raises the bound from 0.4800 to 0.5000: it explains 97.6 % of the "
                         "variance of a rollout."),
        ({}, 0.5, GUST, "The disturbance gust explains 97.6 % of the variance of a rollout; with and without a "
                        "control the bound is 0.5000: few rollouts lose to the range."),
        ({}, 0.51, {"gust": 0.0, "mass": 0.0}, "The declared disturbances explain 97.6 % of the variance of a "
         "rollout; without a control the bound of the same tests would be 0.5100."),
        ({}, None, BOTH, "The declared disturbances explain 97.6 % of the variance of a rollout, most of it gust; "
                         "without a control the same tests prove nothing."),
        ({}, -0.06, GUST, "The disturbance gust explains 97.6 % of the variance of a rollout; without a control the "
                          "same tests prove nothing."),
        ({}, 0.5, {}, "No control by the declared disturbances: they explain too little, or it would widen the range "
                      "too much."),
    ],
)  # fmt: skip
def test_the_sentence_on_a_control(
    values: dict[str, object], without: float | None, parts: dict[str, float], sentence: str
) -> None:
    assert control_sentence(a_claim(**values).claims[0], without, [a_result(parts)]) == sentence


def test_several_problems_are_named() -> None:
    results = [
        a_result(BOTH, "nominal_robustness", 0.5),
        a_result({"gust": 0.0, "mass": 0.1}, "sim_gap", 0.25),
        a_result({}, "maximum"),
    ]
    found = control_sentence(a_claim().claims[0], 0.4, results)
    assert found.endswith(
        "they explain 50 % of the variance of nominal_robustness, most of it gust, and 25 % of the variance of "
        "sim_gap, most of it mass."
    )


def test_a_line_has_the_largest_parts() -> None:
    control = a_result({f"w{k}": 0.01 * k for k in range(8)}).control
    assert control is not None
    assert control_line(control) == (
        "control: the standard deviation that it takes out is 0.07 for w7, 0.06 for w6, 0.05 for w5, 0.04 for w4, "
        "0.03 for w3, 0.02 for w2, less for 2 more; 0.01 is left"
    )
