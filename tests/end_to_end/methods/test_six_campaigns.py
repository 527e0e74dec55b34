"""Six campaigns, one for each way to end: every place that shows the verdict shows the same, right one."""

import json
import shutil
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.end_to_end.methods.six_campaigns import CASES, Case, write
from tests.end_to_end.processes import Processes, processes
from tests.end_to_end.report import browser as chromium
from tests.end_to_end.report.test_index import serve

browser = chromium.browser
SCREEN = 900
"""Height of the first screen in pixels."""
PARTS = {"SHOWN": "How sure", "VIOLATED": "Repeat the worst", "NOT SHOWN": "What to do next"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("six")
    write(found)
    with processes(found / "logs") as started:
        for case in CASES:
            ended = started.run("perfbound", "run", found / f"{case.name}.toml", "--out", found / "runs" / case.name)
            assert ended.code == 0, ended.err
            assert ended.out.splitlines()[0].partition(",")[0] == f"VERDICT  {case.verdict}", case.name
    return found


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_every_command_gives_the_verdict(started: Processes, folder: Path, case: Case) -> None:
    run = folder / "runs" / case.name
    for command in ("show", "status"):
        assert f"VERDICT  {case.verdict}" in started.run("perfbound", command, run).out
    (listed,) = (
        found
        for line in started.run("perfbound", "list", folder / "runs", "--json").out.splitlines()
        if (found := json.loads(line))["name"] == case.name
    )
    assert listed["verdict"] == case.verdict
    card = json.loads(started.run("perfbound", "report", run, "--json").out)["verdict"]
    assert card["word"] == case.verdict
    assert case.words in " ".join(card["reasons"])
    assert bool(card["advice"]) == (case.verdict == "NOT SHOWN")
    assert bool(card["command"]) == (case.verdict == "VIOLATED"), "only a violation has a rollout to repeat"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_first_screen_answers_the_question(
    browser: Browser, folder: Path, case: Case, scheme: chromium.Scheme
) -> None:
    with chromium.watched(browser, scheme=scheme) as watch:
        page = folder / "runs" / case.name / "report.html"
        assert page.stat().st_size <= 2_000_000
        watch.page.goto(page.as_uri())
        watch.shown()
        card = watch.page.locator("#answer")
        assert card.get_attribute("data-verdict") == case.verdict
        text = card.inner_text()
        assert text.startswith(case.verdict)
        for part in ("How sure", "What it rests on", "What to do next", PARTS[case.verdict]):
            assert part in text
        box = card.bounding_box()
        assert box is not None
        assert box["y"] + box["height"] <= SCREEN, "the whole card is on the first screen"
        assert (watch.errors, watch.requests) == ([], [page.as_uri()])


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_phone_shows_the_verdict_without_scrolling_sideways(browser: Browser, folder: Path, case: Case) -> None:
    with chromium.watched(browser, width=360) as watch:
        watch.page.goto((folder / "runs" / case.name / "report.html").as_uri())
        watch.shown()
        assert watch.overflow() <= 0
        box = watch.page.locator("#answer .answer").bounding_box()
        assert box is not None
        assert box["y"] + box["height"] <= SCREEN


def test_the_index_has_all_six_and_their_verdicts(started: Processes, browser: Browser, folder: Path) -> None:
    _, address = serve(started, folder / "runs")
    with chromium.watched(browser) as watch:
        watch.page.goto(address)
        # A row is there before its database has been read.
        watch.page.wait_for_selector("html[data-unread='0'] tbody tr")
        rows = {row.locator("a").first.inner_text(): row.inner_text() for row in watch.page.locator("tbody tr").all()}
        for case in CASES:
            assert case.verdict in rows[case.name]
            assert case.verdict != "SHOWN" or "NOT SHOWN" not in rows[case.name]
        assert watch.errors == []


def test_every_word_that_is_a_link_has_a_meaning(browser: Browser, folder: Path) -> None:
    with chromium.watched(browser) as watch:
        watch.page.goto((folder / "runs" / "standing" / "report.html").as_uri())
        watch.shown()
        links = watch.page.locator("a.term")
        assert links.count() >= 8
        links.get_by_text("Stop threshold alpha").first.click()
        watch.page.wait_for_selector("#glossary details[open]")
        targets = links.evaluate_all(
            "all => all.map((each) => document.querySelector(each.getAttribute('href')) !== null)"
        )
        assert all(targets)


def test_the_formula_is_mathematics(browser: Browser, folder: Path) -> None:
    with chromium.watched(browser) as watch:
        watch.page.goto((folder / "runs" / "standing" / "report.html").as_uri())
        watch.shown()
        (formula,) = watch.page.locator(".formula math").all()
        assert formula.evaluate("node => node.textContent").startswith("P[mind∈DE[ρ(d)]≥8.2")
        drawn = formula.bounding_box()
        assert drawn is not None
        assert drawn["height"] > 20, "the set of starts stands below the minimum"


def test_a_moved_report_names_commands_for_its_own_folder(started: Processes, folder: Path, tmp_path: Path) -> None:
    moved = tmp_path / "elsewhere"
    shutil.copytree(folder / "runs" / "budget", moved)
    assert started.run("perfbound", "report", moved).code == 0
    assert "perfbound resume . --max-tests" in (moved / "report.html").read_text()


def test_the_report_says_where_the_evidence_comes_from(browser: Browser, folder: Path) -> None:
    with chromium.watched(browser) as watch:
        watch.page.goto((folder / "runs" / "standing" / "report.html").as_uri())
        watch.shown()
        text = watch.page.locator("#about").inner_text()
        for part in (
            "Run by",
            "Time",
            "Machine of the orchestrator",
            "for the bound",
            "of the spot check",
            "Campaign file",
        ):
            assert part in text
        file = watch.page.locator("#about pre").evaluate("node => node.textContent")
        assert 'specification = "always (distance >= 2)"' in file
