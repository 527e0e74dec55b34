"""Names and units in the sentences on a start."""

import pytest

from perfbound.orchestrator.certificate.assumptions.sentences import assumption
from perfbound.orchestrator.certificate.words.bound_text import with_named_start


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
