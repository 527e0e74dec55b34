"""The test of declared laws: what it sees, and how rarely it sees what is not there."""

import numpy as np
import pytest
from scipy.special import ndtr

from perfbound.orchestrator.mathematics.bounds.checks.law import LawTest


def test_uniform_numbers_pass_and_pieces_change_nothing() -> None:
    shares = np.random.default_rng(1).random((5000, 2))
    whole, pieces = LawTest(2), LawTest(2)
    whole.observe(shares)
    for first in range(0, 5000, 700):
        pieces.observe(shares[first : first + 700])
    assert whole.finding().status == "not refuted"
    assert whole.finding() == pieces.finding()


@pytest.mark.parametrize(
    ("scale", "shift", "numbers"), [(1.1, 0.0, 4000), (0.9, 0.0, 4000), (2.0, 0.0, 100), (1.0, 0.3, 800)]
)
def test_another_law_is_refuted(scale: float, shift: float, numbers: int) -> None:
    rng = np.random.default_rng(2)
    shares = np.column_stack([rng.random(numbers), ndtr(shift + scale * rng.standard_normal(numbers))])
    test = LawTest(2)
    test.observe(shares)
    finding = test.finding()
    assert (finding.status, finding.values["kind"]) == ("refuted", 1)


def test_a_number_that_the_law_does_not_have_refutes_it() -> None:
    test = LawTest(2)
    test.observe(np.array([[0.5, 0.2], [0.4, np.nan]]))
    found = test.finding()
    assert (found.status, found.values["kind"], found.values["impossible"]) == ("refuted", 1, 1)


def test_before_the_first_number_it_is_assumed() -> None:
    assert LawTest(1).finding().status == "assumed"


def test_few_campaigns_see_what_is_not_there() -> None:
    rng, refuted = np.random.default_rng(3), 0
    for _ in range(400):
        test = LawTest(3, level=0.1)
        test.observe(rng.random((300, 3)))
        refuted += test.finding().status == "refuted"
    # At most 40 expected; 60 are 3.3 standard deviations more.
    assert 0 < refuted < 60
