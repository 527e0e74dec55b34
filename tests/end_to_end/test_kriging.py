"""Method `kriging` in real campaigns: the page and its file, a kill in between, the gap and the risk of two systems."""

import json
import re
import shutil
import signal
from pathlib import Path

from tests.end_to_end.processes import Processes, of_run, wait_for

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "kriging.md").read_text()


def write(folder: Path) -> Path:
    """Write the campaign file of the page and its system, and return the file's path."""
    shutil.copy(ROOT / "deploy" / "examples" / "cars" / "cars.py", folder)
    found, name = re.search(r"```toml\n(.*?)```", PAGE, re.DOTALL), re.search(r"perfbound run (\S+\.toml)", PAGE)
    assert found is not None
    assert name is not None
    path = folder / name[1]
    path.write_text(found[1])
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


def test_a_kill_in_between_changes_no_byte(started: Processes, tmp_path: Path) -> None:
    campaign = write(tmp_path)
    calm, cut = tmp_path / "calm", tmp_path / "cut"
    assert started.run("perfbound", "run", campaign, "--workers", "1", "--out", calm).code == 0
    process = started.start("perfbound", "run", campaign, "--out", cut)
    wait_for(lambda: len(list(cut.rglob("*.mcap"))) >= 300)
    process.popen.kill()
    assert process.wait().code == -signal.SIGKILL
    wait_for(lambda: not of_run(cut))
    resumed = started.run("perfbound", "resume", cut)
    assert resumed.code == 0, resumed.err
    assert (cut / "certificate.json").read_bytes() == (calm / "certificate.json").read_bytes()
    (claim,) = json.loads((cut / "certificate.json").read_text())["predicate"]["claims"]
    assert claim["method"] == "kriging"
    assert claim["refuted"] == []
