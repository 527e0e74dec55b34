"""The formula of every kind of claim, as a browser has it."""

from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from perfbound.schemas.file.objectives import Quantity
from tests.end_to_end.report import browser as chromium
from tests.end_to_end.report import example_reports
from tests.end_to_end.report.test_page import opened

browser = chromium.browser
STATED = "≥0.1743]≥0.8544"
FORMULAS: dict[Quantity, str] = {
    "rho_star": f"P[ρ*=mind∈D(E[ρ(d)]−rsd[ρ(d)]){STATED}",
    "robustness": f"P[mind∈Dρ(d){STATED}",
    "expected_robustness": f"P[mind∈DE[ρ(d)]{STATED}",
    "J_star": f"P[J*=maxd∈DE[J(d)]{STATED}",
    "failure_probability": f"P[P[ρ<0]{STATED}",
    "mean": f"P[E[ρ]{STATED}",
    "risk": f"P[E[ρ]−rsd[ρ]{STATED}",
    "quantile": f"P[q0.05(ρ){STATED}",
    "cvar": f"P[CVaR0.05(ρ){STATED}",
}


@pytest.mark.parametrize("quantity", FORMULAS)
def test_each_quantity_has_its_formula(browser: Browser, tmp_path: Path, quantity: Quantity) -> None:
    report = example_reports.small()
    claim = replace(report.claims[0], quantity=quantity, level=0.05)
    with opened(browser, tmp_path, replace(report, claims=(claim,))) as watch:
        text = watch.page.locator(".formula math").evaluate("node => node.textContent")
        assert text == FORMULAS[quantity]


def test_a_certain_claim_a_list_of_starts_and_a_requirement(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.small()
    claim = replace(report.claims[0], quantity="robustness", probability=1.0, starts=25, requirement="stop")
    with opened(browser, tmp_path, replace(report, claims=(claim,))) as watch:
        text = watch.page.locator(".formula math").evaluate("node => node.textContent")
        assert text == "mind∈{d1…d25}ρstop(d)≥0.1743"


def test_what_words_say_better_has_no_formula(browser: Browser, tmp_path: Path) -> None:
    report = example_reports.small()
    for claim in (
        replace(report.claims[0], quantity="next_rollout"),
        replace(report.claims[0], quantity="mean", factor=2.0),
        replace(report.claims[0], quantity="rho_star", rule="every"),
    ):
        with opened(browser, tmp_path, replace(report, claims=(claim,))) as watch:
            assert watch.page.locator(".formula").count() == 0
