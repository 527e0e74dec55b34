"""Every assumption has a title in plain words."""

import re
from pathlib import Path

from perfbound.orchestrator.certificate import assumptions
from perfbound.orchestrator.certificate.assumptions.statements import STATEMENTS, statement, title
from tests.facts import says

FOLDER = Path(assumptions.__file__).parent
ID = re.compile(r'\bassumption\(\s*f?"([a-z_]+)|(?:DISCARDED|EXTENDED) = "([a-z]+)_"|^    "([a-z_]+)",$', re.MULTILINE)
"""The beginning of an id where an assumption is made, and the lists of those that no data can test."""


def test_every_assumption_of_a_certificate_has_a_statement() -> None:
    sources = "".join(path.read_text() for path in FOLDER.glob("*.py") if path.name != "sentences.py")
    found = {next(filter(None, each)) for each in ID.findall(sources)}
    assert {"rkhs_norm", "kernel", "workers_honest", "discarded", "extended", "design"} <= found
    assert found <= set(STATEMENTS)


def test_a_clip_bounds_values_whatever_the_rollouts_are() -> None:
    """Rollouts beyond the clip count as its ends, so that none of them may be denied."""
    assert says(statement("bounded_values/true_risk"), "clip bounds every rollout")


def test_statements_are_clauses() -> None:
    for name, words in STATEMENTS.items():
        assert words[0].islower(), name
        assert not words.endswith("."), name
        assert len(words) <= 70, name
    assert len(set(STATEMENTS.values())) == len(STATEMENTS)


def test_an_id_of_another_version_is_its_own_title() -> None:
    assert statement("of_the_future/robustness") == "of_the_future"
    assert says(title("discarded_12"), "discarded rollout again seed")
