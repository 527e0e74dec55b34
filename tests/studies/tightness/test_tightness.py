"""The study's own parts: its record survives a kill, its claims are those of the page, and its page has a place."""

import doctest
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.studies.pages import PageError
from tests.studies.tightness import claims, figure, page
from tests.studies.tightness.claims import OTHERS, other_claims
from tests.studies.tightness.curves import (
    BUDGETS,
    NORMS,
    Budget,
    Curve,
    Worst,
    a_method,
    campaign,
    drawn_tests,
    known,
    observed,
    worst,
)
from tests.studies.tightness.figure import LABELS
from tests.studies.tightness.rollouts import ROOT, Place, Subject, record, subject

PAGE = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
FOUND = {budget.rollouts: [0.5, 0.52, 0.6] for budget in BUDGETS}
CURVES = [Curve(0.2, 0.49, FOUND, 0), Curve(0.2, 0.49, FOUND, 0, controlled=False)]
TRUTH = Worst((5.0, 0.0), 0.661, 0.655, 0.003, 25)


class Counted:
    """Stands in for the simulator: a rollout's value follows from its place, and each one is counted."""

    def __init__(self) -> None:
        self.places: list[Place] = []

    def simulated(self, places: Sequence[Place]) -> Iterator[tuple[Place, float]]:
        for place in places:
            self.places.append(place)
            yield place, value(place)


def value(place: Place) -> float:
    return 0.6 + 0.1 * float(np.random.default_rng(place).uniform(-1, 1))


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    found = Counted()
    monkeypatch.setattr(Subject, "simulated", found.simulated)
    return found


def test_a_cut_record_continues_with_what_is_missing(tmp_path: Path, counted: Counted) -> None:
    segway = subject()
    whole = record(segway, 100, tmp_path)
    assert whole.total == len(counted.places) == len(set(counted.places)) == sum(segway.counts(100).values())
    (file,) = tmp_path.iterdir()
    file.write_text(file.read_text()[:-4])
    again = record(segway, 100, tmp_path)
    assert len(counted.places) == whole.total + 1
    assert counted.places[-1] == counted.places[-2]
    assert {node: each.tolist() for node, each in again.robustness.items()} == {
        node: each.tolist() for node, each in whole.robustness.items()
    }
    assert record(segway, 60, tmp_path).total < whole.total
    assert len(counted.places) == whole.total + 1, "a smaller record is a part of a larger one"


def test_real_rollouts_are_those_of_the_true_system() -> None:
    segway = subject()
    (one,), (again,), (other,) = (list(segway.simulated([place])) for place in ((0, 0), (0, 0), (0, 1)))
    assert one == again
    assert one[1] != other[1]
    low, high = segway.plan.clip
    assert low <= one[1] <= high


def test_every_budget_has_its_starts_in_the_record() -> None:
    recorded = set(subject().counts(1000))
    for budget in BUDGETS:
        assert set(a_method(subject(), 0.2, budget).design.nodes) <= recorded


def test_a_bound_is_between_the_assumption_and_the_mean_of_the_record(tmp_path: Path, counted: Counted) -> None:
    segway, budget = subject(), Budget(100, 8)
    recorded = record(segway, 500, tmp_path)
    values = {node: observed(segway, each) for node, each in recorded.robustness.items()}
    bounds = []
    for seed, controlled in ((0, False), (1, False), (1, True)):
        method = a_method(segway, 0.2, budget)
        tests = drawn_tests(method.design, recorded, budget, (0, seed))
        if controlled:
            method = a_method(segway, 0.2, budget, known(segway, tests))
        bound = campaign(method, values, tests)
        assert bound.upper is not None
        bounds.append(-bound.upper)
    assert bounds[0] != bounds[1]
    assert all(0.69 - 0.2 < each < worst(segway, recorded).observed < worst(segway, recorded).risk for each in bounds)


def test_the_other_claims_are_those_of_the_page() -> None:
    found = other_claims(PAGE)
    assert set(found) == set(OTHERS) == set(LABELS)
    assert all(each.least <= each.bound <= each.greatest < 1 <= each.rollouts for each in found.values())
    assert {name for name, each in found.items() if not each.is_refuted} == {"segway-pair", "segway-scenario"}
    assert found["printed, direct"].rollouts == found["segway-direct"].rollouts


def test_a_page_without_a_claim_or_with_another_form_is_refused() -> None:
    with pytest.raises(PageError, match="no claim of segway-direct; restore"):
        other_claims(PAGE.replace("| `segway-direct` |", "| `segway-other` |"))
    with pytest.raises(PageError, match="fix the table"):
        other_claims(PAGE.replace("| 6,000 |", "| 6,000 or 7,000 |"))


def test_figure_and_table_are_written_beside_the_page(tmp_path: Path) -> None:
    target = tmp_path / "paper.md"
    target.write_text(PAGE, encoding="utf-8")
    (tmp_path / page.FIGURE).parent.mkdir()
    page.write(target, CURVES, TRUTH, 7200, tmp_path / "bounds.json")
    text = target.read_text(encoding="utf-8")
    assert "| 0.2 | on      | 0.490            | 0.520 (0.500 to 0.600)" in text
    assert page.section(json.loads((tmp_path / "bounds.json").read_text())) in text
    assert text.split(page.BEGIN)[0] == PAGE.split(page.BEGIN)[0]
    assert text.split(page.END)[1] == PAGE.split(page.END)[1]
    assert 10_000 < (tmp_path / page.FIGURE).stat().st_size < 300_000
    assert page.FIGURE in PAGE


def test_the_page_has_what_the_generator_writes_from_the_record() -> None:
    text = page.RECORD.read_text()
    numbers = json.loads(text)
    assert page.section(numbers) in PAGE
    assert page.record_text(numbers) == text
    assert [each["norm"] for each in numbers["curves"]] == list(NORMS) * 2
    assert {int(count) for each in numbers["curves"] for count in each["bounds"]} == {
        budget.rollouts for budget in BUDGETS
    }


def test_a_page_without_marks_is_named(tmp_path: Path) -> None:
    target = tmp_path / "page.md"
    for text in (None, "no marks"):
        if text is not None:
            target.write_text(text, encoding="utf-8")
        with pytest.raises(PageError, match=r"page\.md"):
            page.write(target, CURVES, TRUTH, 7200)


@pytest.mark.parametrize("module", [claims, figure, page])
def test_the_doctests_hold(module: object) -> None:
    assert doctest.testmod(module).failed == 0  # type: ignore[arg-type]
