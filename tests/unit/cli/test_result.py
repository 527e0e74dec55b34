"""The sentences on regions and closing checks at the end of a run."""

from perfbound.orchestrator.cli.result import MOST_SENTENCES, first_sentences

SENTENCES = ("one.", "two.", "three.", "four.", "REFUTED: five.", "six.")


def test_refuted_sentences_come_first_and_the_others_are_counted() -> None:
    found = list(first_sentences(SENTENCES, "runs/cars"))
    assert found == ["REFUTED: five.", "one.", "two.", "three.", "2 further lines: perfbound show runs/cars"]


def test_no_line_replaces_a_single_sentence() -> None:
    few = SENTENCES[: MOST_SENTENCES + 1]
    assert list(first_sentences(few, "runs/cars")) == list(few)
