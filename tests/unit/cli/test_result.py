"""The verdict with the disturbances of the worst rollout; the sentences on regions and closing checks after it."""

import io
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from rich.console import Console

from perfbound.orchestrator.campaign.seeds import rollout_seed
from perfbound.orchestrator.cli import result
from perfbound.orchestrator.cli.result import MOST_SENTENCES, first_sentences
from perfbound.orchestrator.report.rollout.disturbances import each_in_words
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.certificate import Certificate
from perfbound.schemas.result.facts import Header
from tests.fakes.simulators import spec
from tests.unit.report.collect.test_disturbances import HEADER

SENTENCES = ("one.", "two.", "three.", "four.", "REFUTED: five.", "six.")


def test_refuted_sentences_come_first_and_the_others_are_counted() -> None:
    found = list(first_sentences(SENTENCES, "runs/cars"))
    assert found == ["REFUTED: five.", "one.", "two.", "three.", "2 further lines: perfbound show runs/cars"]


def test_no_line_replaces_a_single_sentence() -> None:
    few = SENTENCES[: MOST_SENTENCES + 1]
    assert list(first_sentences(few, "runs/cars")) == list(few)


def verdict(header: Header, worst: str | None, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    found = SimpleNamespace(verdict="SHOWN", violations=SimpleNamespace(rollout=worst), repeat="", rests_on="")
    monkeypatch.setattr(result, "verdict_of", lambda *_: found)
    monkeypatch.setattr(result, "verdict_lines", lambda *_, **_others: ["VERDICT  SHOWN", "0 of 9 rollouts."])
    predicate = SimpleNamespace(claims=(SimpleNamespace(vacuous=False),))
    written, certificate = io.StringIO(), cast("Certificate", SimpleNamespace(predicate=predicate))
    result.print_verdict(Path("run"), header, certificate, Console(file=written, width=100))
    return written.getvalue().splitlines()


def test_the_verdict_names_the_disturbances_of_the_worst_rollout(monkeypatch: pytest.MonkeyPatch) -> None:
    worst = RolloutId("robustness", 3, "nominal", 1)
    first, second, _ = each_in_words(HEADER, "nominal", rollout_seed(HEADER, worst))
    assert verdict(HEADER, str(worst), monkeypatch)[-1] == f"         In the worst, {first}, {second}."
    calm = replace(HEADER, spec=spec(noisy=True))
    for header, rollout in ((HEADER, None), (calm, str(worst))):
        assert verdict(header, rollout, monkeypatch)[-1] == "         0 of 9 rollouts."
