"""The page on failure probabilities as a user follows it: its file, its command, a crash on the way, the check."""

import re
from pathlib import Path

import pytest

from tests.end_to_end.pages import PAGES, check_claim, claims_after_a_kill, run_page, write
from tests.end_to_end.processes import Processes

PAGE = (PAGES / "failure-probability.md").read_text()


@pytest.mark.journey
def test_the_file_of_the_page_gives_the_claim_of_the_page(started: Processes, tmp_path: Path) -> None:
    check_claim(started, tmp_path, PAGE, run_page(started, tmp_path, PAGE))


def test_the_file_of_the_page_on_requirements_gives_its_claims(started: Processes, tmp_path: Path) -> None:
    page, worst = (PAGES / "requirements.md").read_text().split("## The worst start of each requirement")
    found = started.run("perfbound", "run", write(tmp_path, page), "--out", tmp_path / "run")
    assert found.code == 0, found.err
    printed = re.search(r"```text\n(.*?)```", page, re.DOTALL)
    assert printed is not None
    lines = [line for line in printed[1].splitlines() if line]
    assert len(lines) == 5
    assert set(lines) <= set(found.out.splitlines())
    run = tmp_path / "worst"
    found = started.run("perfbound", "run", write(tmp_path, worst, lines=15), "--out", run)
    assert found.code == 0, found.err
    printed = re.search(r"```text\n(.*?)```", worst, re.DOTALL)
    assert printed is not None
    assert {line for line in printed[1].splitlines() if line} <= set(found.out.splitlines())
    verified = started.run("perfbound", "verify", run, "--resimulate", "5", "--system", f"{tmp_path / 'cars.py'}:cars")
    assert verified.code == 0, verified.err


def test_a_kill_in_between_changes_no_byte(started: Processes, tmp_path: Path) -> None:
    campaign = write(tmp_path, PAGE, '[[claims]]\nquantity = "quantile"\nlevel = 0.05\n')
    calm = tmp_path / "calm"
    assert started.run("perfbound", "run", campaign, "--out", calm).code == 0
    claims = claims_after_a_kill(started, campaign, calm, after=30)
    assert [each["quantity"] for each in claims] == ["failure_probability", "quantile"]
