"""The page on failure probabilities as a user follows it: its file, its command, a crash on the way, the check."""

import json
import re
import shutil
import signal
from pathlib import Path

from tests.end_to_end.processes import Processes, of_run, wait_for

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "how-to"
PAGE = (PAGES / "failure-probability.md").read_text()


def write(folder: Path, more: str = "", page: str = PAGE, lines: int = 12) -> Path:
    """Write the file of a page by the name in its command, and the system that it names."""
    shutil.copy(ROOT / "deploy" / "examples" / "cars" / "cars.py", folder)
    found = re.search(r"```toml\n(.*?)```", page, re.DOTALL)
    assert found is not None
    assert len(found[1].strip().splitlines()) <= lines
    name = re.search(r"perfbound run (\S+\.toml)", page)
    assert name is not None
    path = folder / name[1]
    path.write_text(found[1] + more)
    return path


def test_the_file_of_the_page_gives_the_claim_of_the_page(started: Processes, tmp_path: Path) -> None:
    run = tmp_path / "run"
    found = started.run("perfbound", "run", write(tmp_path), "--out", run)
    assert found.code == 0, found.err
    printed = re.search(r"```text\n(CLAIM.*?)```", PAGE, re.DOTALL)
    assert printed is not None
    assert printed[1].strip() in found.out
    verified = started.run("perfbound", "verify", run, "--resimulate", "5", "--system", f"{tmp_path / 'cars.py'}:cars")
    assert verified.code == 0, verified.err
    assert (run / "report.html").exists()


def test_the_file_of_the_page_on_requirements_gives_its_claims(started: Processes, tmp_path: Path) -> None:
    page, worst = (PAGES / "requirements.md").read_text().split("## The worst start of each requirement")
    found = started.run("perfbound", "run", write(tmp_path, page=page), "--out", tmp_path / "run")
    assert found.code == 0, found.err
    printed = re.search(r"```text\n(.*?)```", page, re.DOTALL)
    assert printed is not None
    lines = [line for line in printed[1].splitlines() if line]
    assert len(lines) == 3
    assert set(lines) <= set(found.out.splitlines())
    run = tmp_path / "worst"
    found = started.run("perfbound", "run", write(tmp_path, page=worst, lines=15), "--out", run)
    assert found.code == 0, found.err
    printed = re.search(r"```text\n(.*?)```", worst, re.DOTALL)
    assert printed is not None
    assert {line for line in printed[1].splitlines() if line} <= set(found.out.splitlines())
    verified = started.run("perfbound", "verify", run, "--resimulate", "5", "--system", f"{tmp_path / 'cars.py'}:cars")
    assert verified.code == 0, verified.err


def test_a_kill_in_between_changes_no_byte(started: Processes, tmp_path: Path) -> None:
    campaign = write(tmp_path, '[[claims]]\nquantity = "quantile"\nlevel = 0.05\n')
    calm, cut = tmp_path / "calm", tmp_path / "cut"
    assert started.run("perfbound", "run", campaign, "--workers", "1", "--out", calm).code == 0
    process = started.start("perfbound", "run", campaign, "--out", cut)
    wait_for(lambda: len(list(cut.rglob("*.mcap"))) >= 30)
    process.popen.kill()
    assert process.wait().code == -signal.SIGKILL
    wait_for(lambda: not of_run(cut))
    resumed = started.run("perfbound", "resume", cut)
    assert resumed.code == 0, resumed.err
    assert (cut / "certificate.json").read_bytes() == (calm / "certificate.json").read_bytes()
    claims = json.loads((cut / "certificate.json").read_text())["predicate"]["claims"]
    assert [each["quantity"] for each in claims] == ["failure_probability", "quantile"]
