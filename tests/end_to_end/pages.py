"""The campaign file of a page of the documentation, run as a user would who follows the page."""

import json
import re
import shutil
import signal
from pathlib import Path
from typing import Any

from tests.end_to_end.processes import Ended, Processes, of_run, wait_for

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "how-to"


def write(folder: Path, page: str, more: str = "", lines: int = 12) -> Path:
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


def run_page(started: Processes, folder: Path, page: str) -> Ended:
    """Run the file of a page, into `folder / "run"`."""
    return started.run("perfbound", "run", write(folder, page), "--out", folder / "run")


def check_claim(started: Processes, folder: Path, page: str, found: Ended) -> None:
    """Assert that a run of the file of a page gave the claim of the page, in a campaign that is verified."""
    run = folder / "run"
    assert found.code == 0, found.err
    printed = re.search(r"```text\n(CLAIM.*?)```", page, re.DOTALL)
    assert printed is not None
    assert printed[1].strip() in found.out
    verified = started.run("perfbound", "verify", run, "--resimulate", "5", "--system", f"{folder / 'cars.py'}:cars")
    assert verified.code == 0, verified.err
    assert (run / "report.html").exists()


def claims_after_a_kill(started: Processes, campaign: Path, calm: Path, *, after: int) -> list[dict[str, Any]]:
    """Return the claims of a campaign that was killed after so many rollouts, with one worker.

    Its certificate is that of the run in `calm`, with two workers.
    """
    cut = campaign.parent / "cut"
    process = started.start("perfbound", "run", campaign, "--workers", "1", "--out", cut)
    wait_for(lambda: len(list(cut.rglob("*.mcap"))) >= after)
    process.popen.kill()
    assert process.wait().code == -signal.SIGKILL
    wait_for(lambda: not of_run(cut))
    resumed = started.run("perfbound", "resume", cut)
    assert resumed.code == 0, resumed.err
    assert (cut / "certificate.json").read_bytes() == (calm / "certificate.json").read_bytes()
    claims: list[dict[str, Any]] = json.loads((cut / "certificate.json").read_text())["predicate"]["claims"]
    return claims
