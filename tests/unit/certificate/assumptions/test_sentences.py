"""The sentences of the assumptions: one for every status that can occur, with the numbers of the values."""

import string

import pytest

from perfbound.orchestrator.certificate.assumptions.sentences import SENTENCES, assumption
from tests.facts import says

FORMS = [(form, status) for form, sentences in SENTENCES.items() for status in sentences]


@pytest.mark.parametrize(("form", "status"), FORMS)
def test_every_sentence_is_one_sentence_or_two_and_shows_its_numbers(form: str, status: str) -> None:
    template = SENTENCES[form][status]  # type: ignore[index]
    fields = [name for _, name, _, _ in string.Formatter().parse(template) if name]
    found = assumption("name/problem", status, dict.fromkeys(fields, 1.5), form=form)  # type: ignore[arg-type]
    assert found.detail.endswith(".")
    assert found.detail.count(". ") <= 1
    assert ("1.5" in found.detail) == bool(fields)


def test_values_are_rounded_to_what_all_cpus_agree_in() -> None:
    one = assumption("bounds_agree/p", "not refuted", {"upper": 0.1234567891, "lower": 1 / 3})
    other = assumption("bounds_agree/p", "not refuted", {"upper": 0.1234567891 * (1 + 1e-12), "lower": 1 / 3})
    assert one == other
    assert one.values == {"upper": 0.123457, "lower": 0.333333}
    assert says(one.detail, "0.123457 lower 0.333333")
