"""An environment of Gymnasium as docs/own-system.md has it: from its two files to a certificate that others repeat."""

import json
import re
from pathlib import Path

from tests.end_to_end.processes import Processes

PAGE = Path(__file__).parents[3] / "docs" / "own-system.md"


def written(folder: Path, *, tests: int) -> Path:
    """Write the files of the page; return the campaign file."""
    section = PAGE.read_text(encoding="utf-8").partition("## An environment of Gymnasium\n")[2].partition("\n## ")[0]
    policy, campaign = re.findall(r"```(?:python|toml)\n(.*?)```", section, re.DOTALL)
    (folder / "policy.py").write_text(policy)
    file = folder / "pole.toml"
    file.write_text("recheck = 3\n" + campaign.replace("max_tests = 300", f"max_tests = {tests}"))
    return file


def test_the_page_leads_to_a_counterexample_that_repeats(started: Processes) -> None:
    campaign = written(started.folder, tests=300)
    ended = [
        started.run("perfbound", "run", campaign, "--out", started.folder / name, "--workers", workers)
        for name, workers in (("run", "2"), ("one", "1"))
    ]
    assert [each.code for each in ended] == [0, 0], ended
    assert "VIOLATED" in ended[0].out
    assert "COUNTEREXAMPLE" in ended[0].out
    assert "UserWarning" not in ended[0].err, "that an episode has ended is a column, and no warning"
    one, two = ((started.folder / name / "certificate.json").read_bytes() for name in ("run", "one"))
    assert one == two
    verify = ("perfbound", "verify", started.folder / "run", "--resimulate", "2", "--system", campaign)
    assert started.run(*verify).code == 0
    policy = started.folder / "policy.py"
    policy.write_text(policy.read_text().replace("0.5 * rate", "0.6 * rate"))
    refused = started.run(*verify)
    assert refused.code == 1
    assert "policy.py is another" in " ".join(refused.out.split())


def test_check_system_finds_nothing_and_init_makes_a_campaign_of_a_description(started: Processes) -> None:
    """The file with `[system]` and `[space]` alone."""
    campaign = written(started.folder, tests=20)
    found = json.loads(started.run("perfbound", "check-system", campaign, "--json").out)
    assert {each["status"] for each in found["checks"]} <= {"passed", "skipped"}, found
    description = started.folder / "description.toml"
    description.write_text("[system]" + campaign.read_text().partition("[system]")[2])
    asked = ("--question", "how-often", "--specification", "always (abs(angle) <= 0.2)")
    made = started.run("perfbound", "init", description, "--out", started.folder / "made.toml", *asked)
    assert made.code == 0, made
    text = (started.folder / "made.toml").read_text()
    assert 'system.policy = "policy.py:act"' in text
    assert started.run("perfbound", "run", started.folder / "made.toml", "--out", started.folder / "made").code == 0
