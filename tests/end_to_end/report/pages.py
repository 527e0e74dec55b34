"""The campaign files of the page of the questions, run as a user would who follows the page."""

import json
import re
import shutil
import signal
from pathlib import Path
from typing import Any, NamedTuple

from tests.end_to_end.processes import Ended, Processes, of_run, wait_for

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "questions.md").read_text()
LEFT_OUT = "..."
"""A line that stands for lines of the output that the page leaves out."""
EXAMPLE = re.compile(
    r"`([a-z]+\.toml)`:\n\n```toml\n(.*?)```\n\n    perfbound run ([a-z.]+)\n\n```text\n(.*?)```", re.DOTALL
)
HEAD = re.compile(r"^(?:CLAIM|also|COUNTEREXAMPLE)  .*$", re.MULTILINE)


class Example(NamedTuple):
    """A campaign file of the page, the name in its command, and what the page says that it prints."""

    name: str
    file: str
    command: str
    printed: str

    def write(self, folder: Path, more: str = "") -> Path:
        """Write the file, with more at its end, and the systems that the page names; return its path."""
        shutil.copytree(ROOT / "deploy" / "examples" / "cars", folder, dirs_exist_ok=True)
        path = folder / self.name
        path.write_text(self.file + more)
        return path

    def run(self, started: Processes, folder: Path) -> Ended:
        """Run the file into `folder / "run"`."""
        return started.run("perfbound", "run", self.write(folder), "--out", folder / "run")

    def check(self, found: Ended) -> None:
        """Assert that a run printed the claims of the page, to the last digit and in their order, and all its lines."""
        assert found.code == 0, found.err
        claims = HEAD.findall(self.printed)
        assert claims
        assert [each for each in HEAD.findall(found.out) if each in claims] == claims
        assert set(self.printed.splitlines()) - {LEFT_OUT} <= set(found.out.splitlines())

    def verify(self, started: Processes, folder: Path) -> None:
        """Assert that the run in `folder / "run"` is verified, and has a report."""
        system = f"{folder / 'cars.py'}:cars"
        verified = started.run("perfbound", "verify", folder / "run", "--resimulate", "5", "--system", system)
        assert verified.code == 0, verified.err
        assert (folder / "run" / "report.html").exists()


EXAMPLES = {each[0]: Example(*each) for each in EXAMPLE.findall(PAGE)}
"""By the name of the file."""


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
