"""Programs beside a campaign file, from nothing to verified certificates, and what a bad one does to a campaign."""

import json
import shutil
import subprocess
from pathlib import Path

import psutil
import pytest

from perfbound.orchestrator.certificate.verify.checks import ABSENT
from perfbound.schemas.file.reader import load_campaign
from perfbound.schemas.result.certificate import Certificate
from tests.end_to_end.processes import Ended, Processes, processes, recorded, wait_for
from tests.facts import says

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "pendulum"
CHECKS = "spot_check = 6\nspot_check_followups = 4\nrecheck = 3\n"

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler: apt install gcc")


def copied(folder: Path) -> Path:
    """Copy and build the example, with short checks and few tests; return its folder."""
    shutil.copytree(EXAMPLE, folder)
    for name in ("pendulum.toml", "shell.toml"):
        lines = (folder / name).read_text().splitlines()
        kept = [line for line in lines if not line.startswith(("max_tests", "spot_check"))]
        (folder / name).write_text(CHECKS + "max_tests = 8\n" + "\n".join(kept) + "\n")
    (command,) = [line.strip() for line in (EXAMPLE / "README.md").read_text().splitlines() if "  cc " in line]
    subprocess.run(command.split(), cwd=folder, check=True)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copied(tmp_path_factory.mktemp("own") / "pendulum")


@pytest.fixture(scope="module")
def ended(folder: Path) -> Ended:
    """A run without trouble, in the folder `run`."""
    with processes(folder / "logs") as found:
        return found.run("perfbound", "run", folder / "pendulum.toml", "--out", folder / "run")


def certificate(directory: Path) -> bytes:
    return (directory / "certificate.json").read_bytes()


def test_the_certificate_names_the_program(ended: Ended, folder: Path) -> None:
    assert ended.code == 0, ended.err
    found = Certificate.model_validate_json(certificate(folder / "run")).predicate
    assert found.question["system"]["program"] == ["./pendulum"]  # type: ignore[index]
    assert len(found.software["./pendulum"].removeprefix("sha256 ")) == 64
    left = [each for each in psutil.process_iter(["cwd", "name"]) if each.info["name"] == "pendulum"]
    assert [each for each in left if each.info["cwd"] == str(folder)] == []


@pytest.mark.usefixtures("ended")
@pytest.mark.parametrize("workers", [1, 3])
def test_the_number_of_workers_changes_no_byte(started: Processes, folder: Path, tmp_path: Path, workers: int) -> None:
    run = started.run(
        "perfbound", "run", folder / "pendulum.toml", "--out", tmp_path / "run", "--workers", str(workers)
    )
    assert run.code == 0, run.err
    assert certificate(tmp_path / "run") == certificate(folder / "run")


@pytest.mark.journey
@pytest.mark.usefixtures("ended")
def test_killed_it_resumes_and_verifies(started: Processes, folder: Path, tmp_path: Path) -> None:
    directory = tmp_path / "run"
    first = started.start("perfbound", "run", folder / "pendulum.toml", "--out", directory, "--workers", "1")
    wait_for(lambda: recorded(directory) >= 5)
    assert first.running, "the kill has to come in mid-run"
    first.popen.kill()
    first.wait()
    # From another folder: the journal names the campaign file.
    resumed = started.run("perfbound", "resume", directory)
    assert resumed.code == 0, resumed.err
    assert certificate(directory) == certificate(folder / "run")
    verify = ("perfbound", "verify", directory, "--resimulate", "3", "--json")
    verified = started.run(*verify, "--system", folder / "pendulum.toml")
    found = {each["check"]: each["status"] for each in json.loads(verified.out)["checks"]}
    assert {check for check, status in found.items() if status != "passed"} - set(ABSENT) == {"signature"}
    alone = started.run(*verify)
    failed = [each for each in json.loads(alone.out)["checks"] if each["status"] == "failed"]
    assert [each["check"] for each in failed] == ["resimulation"], "a certificate names no program that is run"


def test_a_shell_script_with_a_worker_elsewhere(started: Processes, folder: Path, tmp_path: Path) -> None:
    server = started.start("perfbound", "orchestrate", folder / "shell.toml", "--out", tmp_path / "run")
    wait_for(lambda: "waiting for workers" in server.err)
    endpoint = server.err.split("--connect ")[1].split()[0]
    worker = started.start("perfbound-worker", "--connect", endpoint, "--system", folder / "shell.toml")
    assert server.wait().code == 0
    worker.popen.terminate()
    alone = started.run("perfbound", "run", folder / "shell.toml", "--out", tmp_path / "alone")
    assert alone.code == 0, alone.err
    assert certificate(tmp_path / "run") == certificate(tmp_path / "alone")


def test_another_build_does_not_resume(started: Processes, tmp_path: Path) -> None:
    folder, directory = copied(tmp_path / "pendulum"), tmp_path / "run"
    first = started.start("perfbound", "run", folder / "pendulum.toml", "--out", directory, "--workers", "1")
    wait_for(lambda: recorded(directory) >= 3)
    first.popen.kill()
    first.wait()
    source = folder / "pendulum.c"
    source.write_text(source.read_text().replace("-25.0", "-20.0"))
    subprocess.run(["cc", "-O2", "-o", "pendulum", "pendulum.c", "-lm"], cwd=folder, check=True)
    refused = started.run("perfbound", "resume", directory)
    assert refused.code == 1
    assert "campaign was started: ./pendulum is another one here; resume" in refused.last_line


def test_references_of_all_kinds(started: Processes, folder: Path, tmp_path: Path) -> None:
    described = started.run("perfbound", "systems", folder / "pendulum.toml")
    assert "pendulum: the program ./pendulum" in described.out, described.err
    installed = Path(__file__).parents[3] / "deploy" / "campaigns" / "test-function.toml"
    assert started.run("perfbound", "systems", installed).out.startswith("test-function:")
    function = Path(__file__).parents[3] / "deploy" / "examples" / "cars" / "cars.toml"
    assert started.run("perfbound", "systems", function).out.startswith("cars:")
    simulated = started.run(
        *(
            "perfbound",
            "simulate",
            folder / "pendulum.toml",
            "--x=0.1,0",
            "--horizon",
            "1",
            "--out",
            tmp_path / "1.mcap",
        )
    )
    assert "101 samples" in simulated.out, simulated.err
    assert "No such file" in started.run("perfbound", "systems", tmp_path / "no.toml").fault


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ('"./pendulum"', '"./no-such"'),
            "system.program: there is no program './no-such'; build it, or give",
        ),
        (('["./pendulum"]', '"./pendulum"'), "system.program: './pendulum' is not allowed: allowed is a list of texts"),
        (('columns = { angle = "rad", rate = "rad/s" }\n', ""), "system.columns: required by a program"),
        (
            ("step = 0.01", 'samples = "xls"'),
            "system.samples: 'xls' is not allowed: allowed is 'csv', 'f64'",
        ),
        (("step = 0.01", "limits = { ram = 4 }"), "system.limits.ram: unknown key; allowed are cpu, memory"),
        (
            ('program = ["./pendulum"]', 'name = "segway"'),
            "system.columns: this key is for a program, an environment",
        ),
        (("abs(angle)", "abs(angel)"), "angel"),
    ],
)
def test_a_program_that_cannot_be_used_is_one_line(
    started: Processes, folder: Path, tmp_path: Path, change: tuple[str, str], words: str
) -> None:
    text = (folder / "pendulum.toml").read_text()
    assert change[0] in text
    (folder / "wrong.toml").write_text(text.replace(*change))
    refused = started.run("perfbound", "run", folder / "wrong.toml", "--out", tmp_path / "run")
    assert refused.code == 1
    assert words in refused.fault
    assert not (tmp_path / "run").exists()


BAD = """#!/bin/sh
# Bad in its second rollout and good in all others; the workers share the count.
while read -r line; do
  path=$(printf '%s' "$line" | sed 's/.*"path": "//; s/".*//')
  if mkdir "$(dirname "$0")/once" 2>/dev/null; then :; elif mkdir "$(dirname "$0")/bad" 2>/dev/null; then BODY; fi
  printf '0,0.1,0\\n3,0.1,0\\n' > "$path"
  echo '{"done": true}'
done
"""


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("echo 'no licence' >&2; exit 7", "ended with exit code 7 and no answer; its last words: no licence"),
        ("echo garbage", "answered 'garbage'; its stdout takes one line a rollout"),
        ("sleep 60 & sleep 60", "no answer within the deadline"),
        ("kill -SEGV $$", "was ended by SIGSEGV"),
    ],
)
def test_a_bad_rollout_is_one_line_and_the_campaign_goes_on(
    started: Processes, folder: Path, tmp_path: Path, body: str, words: str
) -> None:
    shutil.copy(folder / "shell.toml", tmp_path / "bad.toml")
    text = (tmp_path / "bad.toml").read_text()
    (tmp_path / "bad.toml").write_text("deadline = 2.0\n" + text.replace("./pendulum.sh", "./bad.sh"))
    (tmp_path / "bad.sh").write_text(BAD.replace("BODY", body))
    (tmp_path / "bad.sh").chmod(0o755)
    run = started.run("perfbound", "run", tmp_path / "bad.toml", "--out", tmp_path / "run", "--log", "json")
    assert run.code == 0, run.err
    failures = [line for line in run.err.splitlines() if " failure: " in line or "deadline" in line]
    assert len(failures) == 1, run.err
    if "deadline" not in words:
        assert words in failures[0]


def test_a_campaign_file_of_a_program_leads_to_another_one(started: Processes, folder: Path, tmp_path: Path) -> None:
    """With constants for another question; `perfbound init` pilots the program as it is described there."""
    init = ("perfbound", "init", folder / "pendulum.toml", "--specification", "always (abs(angle) <= 0.4)")
    refused = started.run(*init, "--out", tmp_path / "second.toml")
    assert "its system belongs to the folder of the file that describes it; choose --out beside " in refused.fault
    second = folder / "second.toml"
    written = started.run(*init, "--out", second)
    assert (written.code, written.err) == (0, "")
    assert says(written.out, "200 rollouts constants second.toml: constants proposed from 200 rollouts")
    first, other = (load_campaign(file) for file in (folder / "pendulum.toml", second))
    assert other.system == first.system
    assert (other.space, other.horizon) == (first.space, first.horizon)
    second.write_text(CHECKS + second.read_text().replace("max_tests = 60", "max_tests = 4"))
    ended = started.run("perfbound", "run", second, "--out", tmp_path / "run")
    assert ended.code == 0, ended.err


def test_a_program_without_a_campaign_is_described_checked_and_gets_one(
    started: Processes, folder: Path, tmp_path: Path
) -> None:
    """The first steps of somebody with a program and nothing else: what it is, and its ranges."""
    text = (folder / "pendulum.toml").read_text()
    (folder / "program.toml").write_text(text[text.index("[system]") :])
    assert started.run("perfbound", "systems", folder / "program.toml").out.startswith("pendulum: the program ./pend")
    refused = started.run("perfbound", "run", folder / "program.toml", "--out", tmp_path / "run")
    assert "program.toml: alpha: this key is required" in refused.fault
    assert "perfbound init" in refused.fault
    out = folder / "made.toml"
    wish = ("--specification", "always (abs(angle) <= 0.5)", "--horizon", "3", "--out", out)
    written = started.run("perfbound", "init", folder / "program.toml", *wish)
    assert (written.code, written.err) == (0, ""), written.err
    made = load_campaign(out)
    assert (made.name, made.horizon, made.specification) == ("made", 3.0, "always (abs(angle) <= 0.5)")
    out.write_text(CHECKS + out.read_text().replace("max_tests = 60", "max_tests = 4"))
    ended = started.run("perfbound", "run", out, "--out", tmp_path / "run")
    assert ended.code == 0, ended.err
    assert "cannot be expected to reach alpha" not in ended.err or "4 tests" in ended.err
