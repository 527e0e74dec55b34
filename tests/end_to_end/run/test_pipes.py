"""Outputs whose reader ends first, through real pipes of a shell."""

import subprocess
from pathlib import Path

import pytest

from tests.campaigns import with_few_checks
from tests.end_to_end.processes import BIN, Ended, contents
from tests.patience import PATIENCE


def piped(folder: Path, line: str) -> Ended:
    """Run a line of bash; the exit code is that of the first command of the pipe."""
    script = f'{BIN}/{line}\nexit "${{PIPESTATUS[0]}}"'
    ended = subprocess.run(
        ["bash", "-c", script], cwd=folder, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    return Ended(ended.returncode, ended.stdout, ended.stderr)


@pytest.mark.journey
def test_a_run_without_a_reader_ends_with_all_its_files(tmp_path: Path) -> None:
    with_few_checks(tmp_path / "c.toml", "test-function")
    for name, line, code in (
        ("nobody", "2>&1 | true", 141),
        # A refuted assumption has its exit code, whoever reads.
        ("strict", "--strict 2>err | head -n 1", 3),
    ):
        ended = piped(tmp_path, f"perfbound run c.toml --out {name} {line}")
        assert ended.code == code, ended
        made = {each.name for each in (tmp_path / name).iterdir()}
        assert made >= {"certificate.json", "report.html", "manifest.sha256"}
    assert ended.out.count("\n") == 1
    assert "pipe" not in (tmp_path / "err").read_text()
    for command in ("status strict", "export strict rollouts --out -"):
        unread = piped(tmp_path, f"perfbound {command} | true")
        assert (unread.code, unread.err) == (141, ""), command
    assert "CLAIM" in piped(tmp_path, "perfbound status strict | cat").out


def test_files_are_whole_although_nobody_reads_their_names(tmp_path: Path) -> None:
    for name, pipe in (("read", "cat"), ("unread", "true")):
        (tmp_path / name).mkdir()
        ended = piped(tmp_path / name, f"perfbound new-system robot 2>&1 | {pipe}")
        assert ended.code == (141 if pipe == "true" else 0)
    read, unread = (contents(tmp_path / name / "robot") for name in ("read", "unread"))
    assert {name: data for name, (data, _) in read.items()} == {name: data for name, (data, _) in unread.items()}


def test_a_full_disk_at_stdout_is_one_line(tmp_path: Path) -> None:
    ended = piped(tmp_path, "perfbound --help > /dev/full | cat")
    assert (ended.code, ended.err) == (1, "perfbound: stdout: No space left on device\n")


def test_a_full_disk_at_stderr_loses_lines_alone(tmp_path: Path) -> None:
    """As that of the log of a job: the run directory is elsewhere."""
    with_few_checks(tmp_path / "c.toml", "test-function")
    ended = piped(tmp_path, "perfbound run c.toml --out run 2>/dev/full | cat")
    assert ended.code == 0
    assert "VERDICT" in ended.out
    assert {"certificate.json", "report.html"} <= {each.name for each in (tmp_path / "run").iterdir()}


def test_without_a_stdout_the_files_of_a_campaign_are_whole(tmp_path: Path) -> None:
    """Closed from the start, as some daemons start a program."""
    with_few_checks(tmp_path / "c.toml", "test-function")
    ended = piped(tmp_path, "perfbound run c.toml --out run --on-finish 'touch finished' >&- | cat")
    assert (ended.code, "Traceback" in ended.err) == (0, False), ended.err
    assert {"certificate.json", "report.html"} <= {each.name for each in (tmp_path / "run").iterdir()}
    assert (tmp_path / "finished").exists()
