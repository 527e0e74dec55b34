"""The rows of the problems are whole, and the variants of a question about one simulator."""

from typing import get_args

import pytest

from perfbound.orchestrator.certificate.words.text import QUANTITIES
from perfbound.schemas.file.drawn_claims import SAMPLED
from perfbound.schemas.file.objectives import (
    CLAIMS,
    OBJECTIVES,
    Measured,
    MethodName,
    ProblemName,
    Quantity,
    rolled_out,
)
from perfbound.schemas.system import Column, Parameter, SystemSpec, Variant


def system(*variants: Variant) -> SystemSpec:
    return SystemSpec(
        name="any",
        doc="",
        parameters=(Parameter(name="x", unit="m", low=0, high=5),),
        columns=(Column(name="t", unit="s"), Column(name="phi", unit="rad")),
        variants=variants,
        max_horizon=1,
    )


def test_every_problem_and_every_quantity_has_its_row() -> None:
    assert tuple(OBJECTIVES) == get_args(ProblemName)
    assert {*QUANTITIES, *SAMPLED} == {*get_args(Quantity)}
    claimed = {each.statement.quantity for each in OBJECTIVES.values()}
    claimed |= {each.exact.quantity for each in OBJECTIVES.values() if each.exact}
    # The share of safe starts is of the regions, whatever the problem is.
    assert {*claimed, *SAMPLED, "safe_share"} == {*get_args(Quantity), None}
    assert claimed.isdisjoint(SAMPLED)


def test_the_rows_are_consistent() -> None:
    for name, row in OBJECTIVES.items():
        assert row.measured in get_args(Measured)
        assert set(row.methods) <= set(get_args(MethodName))
        assert ("{gap}" in row.statement.words) == (row.measured == "gap")
        assert row.statement.words.startswith(f"{row.sense} over d of ")
        assert (name in CLAIMS) == (row.statement.quantity is not None)


@pytest.mark.parametrize(
    ("variants", "expected"), [(("nominal", "true"), "true"), (("nominal",), "nominal"), (("true",), "true")]
)
def test_a_question_about_one_simulator_takes_the_true_variant_or_the_only_one(
    variants: tuple[Variant, ...], expected: str
) -> None:
    assert rolled_out("robustness", system(*variants)) == (expected,)


def test_the_other_questions_name_their_variants() -> None:
    one = system("nominal")
    assert rolled_out("true_risk", one) == rolled_out("maximum", one) == ("true",)
    assert rolled_out("sim_gap", one) == ("nominal", "true")
