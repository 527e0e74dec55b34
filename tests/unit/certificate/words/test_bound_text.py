"""Bounds as text, beside what is required of them; names and units in the sentences on a start."""

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.certificate.assumptions.sentences import assumption
from perfbound.orchestrator.certificate.words.bound_text import as_required, outward, with_named_start


@pytest.mark.parametrize(
    ("limit", "start", "units", "words"),
    [
        (0.41, "0.4", {"gap": "m"}, "keeps the bound 0.41 at every start (most clearly at gap = 0.4 m):"),
        (0.4, "one of its starts", {"gap": "m"}, "(most clearly at one of its starts):"),
        (0.4, "0.4, 2", {"gap": "m", "mass": "1"}, "bound 0.4 at every start (most clearly at gap = 0.4 m, mass = 2):"),
    ],
)
def test_a_start_has_its_names_and_nothing_else_is_changed(
    limit: float, start: str, units: dict[str, str], words: str
) -> None:
    found = assumption("rkhs_norm/a", "refuted", {"limit": limit, "start": start}, form="norm_noisy_start")
    named = with_named_start(found, units)
    assert words in named.detail
    assert (named.id, named.status, named.values) == (found.id, found.status, found.values)


SMALL = st.floats(1e-9, 1e-3)


@given(bound=st.floats(-10, 10) | SMALL | SMALL.map(lambda small: -small) | SMALL.map(lambda small: 1.0 - small))
@pytest.mark.parametrize("sense", ["<=", ">="])
def test_what_is_printed_is_no_stronger_than_the_bound_and_close_to_it(bound: float, sense: str) -> None:
    weaker = float(Decimal(outward(bound, sense)) - Decimal(bound)) * (1 if sense == "<=" else -1)
    distance = min(abs(bound), abs(1.0 - bound))
    assert -1e-10 <= weaker <= (1e-4 if distance >= 1e-3 else max(1.01e-2 * distance, 1.01e-10))


@pytest.mark.parametrize("limit", [1e-5, 2.5e-7, 0.00042, 0.02, 0.99999])
def test_a_bound_that_just_reaches_what_is_required_has_the_same_digits(limit: float) -> None:
    for sense in ("<=", ">="):
        assert float(outward(limit, sense)) == float(as_required(limit)) == limit
    assert outward(limit, "<=").rstrip("0") == as_required(limit)
