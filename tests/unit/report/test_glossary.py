"""The glossary: one source for the page, the documents and the command line."""

import re
from importlib import resources

import pytest
from click.testing import CliRunner

from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.report import html
from perfbound.orchestrator.report.glossary import entries_of, glossary
from perfbound.schemas.errors import PerfboundError
from tests.facts import facts, says

SCRIPT = (resources.files(html.__package__) / "page" / "glossary.js").read_text("utf-8")


def test_every_link_of_the_page_has_its_entry() -> None:
    tables = re.findall(r"new Map\((.*?)\);\n", SCRIPT, re.DOTALL)
    pairs = [pair for table in tables for pair in re.findall(r'"([^"]+)"[:,] "([^"]+)"', table)]
    assert len(pairs) > 25
    assert {entry.encode().decode("unicode_escape") for _, entry in pairs} <= set(glossary())


def test_every_entry_has_an_anchor_of_its_own() -> None:
    anchors = {re.sub(r"[^a-zA-Z]+", "-", entry) for entry in glossary()}
    assert len(anchors) == len(glossary())


@pytest.mark.parametrize(
    ("word", "entries"),
    [
        ("margin", ["margin, robustness, \u03c1"]),
        ("Robustness", ["margin, robustness, \u03c1"]),
        ("b", ["B, norm bound"]),
        ("alpha", ["alpha, stop threshold, \u03b1"]),
        ("\u03b1", ["alpha, stop threshold, \u03b1"]),
        ("norm bound", ["B, norm bound"]),
        ("bound", ["bound, \u2113"]),
        ("prior", ["prior mean m0"]),
        ("worker", ["orchestrator, worker"]),
    ],
)
def test_a_word_finds_its_entries(word: str, entries: list[str]) -> None:
    assert entries_of(word) == entries


def test_an_unknown_word_names_all() -> None:
    with pytest.raises(PerfboundError, match=facts("^rubustness: 'robustness' rollout margin")):
        entries_of("rubustness")


def test_the_command_prints_one_sentence_a_word() -> None:
    one = CliRunner().invoke(cli, ["explain", "risk", "weight", "r"])
    assert (one.exit_code, one.output.count("\n")) == (0, 1)
    assert says(one.output, "^risk robustness risk weight mean margin")
    every = CliRunner().invoke(cli, ["explain"])
    assert [line.partition(": ")[0] for line in every.output.splitlines()] == list(glossary())
