"""Bad input: one line of error before any file is made, and no loss."""

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.orchestrator import cli
from perfbound.orchestrator.cli import entry
from perfbound.orchestrator.fleet.children import child
from perfbound.orchestrator.store.rows import SCHEMA_VERSION
from perfbound.schemas.stop_signals import stop_signals
from perfbound.schemas.system import SystemSpec
from tests.campaigns import FOLDER
from tests.end_to_end.processes import (
    ROLLOUTS,
    Ended,
    Process,
    Processes,
    contents,
    processes,
    query,
    recorded,
    under_way,
    wait_for,
    write_campaign,
)

PAPER = (FOLDER / "segway-paper.toml").read_text()
NOMINAL = "problems.nominal_robustness"


class Here:
    """The real `main` of the command line in this process, in a folder of its own."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
        self.folder = folder
        self._monkeypatch, self._capfd = monkeypatch, capfd

    def run(self, *arguments: str) -> Ended:
        self._monkeypatch.setattr(sys, "argv", ["perfbound", *arguments])
        # It would end the process of the tests with its own exit code, whatever they found.
        self._monkeypatch.setattr(entry, "process_end", contextlib.nullcontext)
        self._monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
        before = {number: signal.getsignal(number) for number in stop_signals()}
        try:
            with pytest.raises(SystemExit) as caught:
                cli.main()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        out, err = self._capfd.readouterr()
        assert isinstance(caught.value.code, int)
        return Ended(caught.value.code, out, err)

    def run_file(self, data: bytes | str, *arguments: str) -> str:
        """Run a campaign file that cannot be run; return the first line, with the first reason."""
        file = self.folder / "c.toml"
        file.write_bytes(data.encode() if isinstance(data, str) else data)
        ended = self.run("run", "c.toml", "--out", "made", *arguments)
        assert ended.code == 1
        assert ended.out == ""
        assert sorted(self.folder.iterdir()) == [file], "nothing was made"
        assert ended.last_line
        lines = ended.err.splitlines()
        assert all(line.startswith("perfbound: c.toml: ") for line in lines), "each names the file"
        return lines[0].removeprefix("perfbound: c.toml: ")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Iterator[Here]:
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    yield Here(folder, monkeypatch, capfd)
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def installed() -> dict[str, SystemSpec | str]:
    """Return the output of the `workers` child; started once for all tests of this file."""
    return child.installed_systems()


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, installed: dict[str, SystemSpec | str]) -> None:
    """The child has been asked."""
    monkeypatch.setattr(child, "installed_systems", lambda: installed)


def changed(old: str, new: str) -> str:
    assert old in PAPER
    return PAPER.replace(old, new, 1)


# Faults of the file alone: key and allowed values


@pytest.mark.journey
@pytest.mark.parametrize(
    ("old", "new", "key", "allowed"),
    [
        (
            "horizon = 15.0",
            "horizont = 15.0",
            "horizont",
            "did you mean 'horizon'?",
        ),
        ("alpha = 0.05", "alhpa = 0.05", f"{NOMINAL}.alhpa", "did you mean 'alpha'? allowed are alpha"),
        ("nu = 10.0", "mu = 10.0", f"{NOMINAL}.kernel.mu", "allowed are length_scale, nu"),
        ("[space]", "[spaces]", "spaces", "did you mean 'space'?"),
        ('"nominal_robustness"', '"nominal_robustnes"', "problems.0.name", "'nominal_robustness', 'sim_gap'"),
        ("low = 0.0", "low = 5.0", "space.x.low", "5 must be less than high = 5"),
        ("low = 0.0", "low = nan", "space.x.low", "nan is not allowed: allowed is a number"),
        ("high = 5.0", "high = inf", "space.x.high", "inf is not allowed: allowed is a number"),
        ("delta = 0.05", "delta = 0.0", f"{NOMINAL}.delta", "a number > 0 and < 1"),
        ("delta = 0.05", "delta = 1", f"{NOMINAL}.delta", "a number > 0 and < 1"),
        ("delta = 0.05", "delta = nan", f"{NOMINAL}.delta", "a number > 0 and < 1"),
        ("delta = 0.05", "delta = true", f"{NOMINAL}.delta", "True is not allowed: allowed is a number"),
        ("alpha = 0.05", "alpha = 0.0", f"{NOMINAL}.alpha", "a number > 0"),
        ("alpha = 0.01", "alpha = -1.0", "problems.sim_gap.alpha", "a number > 0"),
        ("nu = 10.0", "nu = 0.0", f"{NOMINAL}.kernel.nu", "a number > 0 and <= 50"),
        ("length_scale = 2.0", "length_scale = -2.0", f"{NOMINAL}.kernel.length_scale", "a number > 0"),
        ("rkhs_norm = 0.2", "rkhs_norm = -0.2", f"{NOMINAL}.rkhs_norm", "a number > 0"),
        ("noise_scale = 0.1", "noise_scale = -0.1", f"{NOMINAL}.noise_scale", "a number >= 0"),
        ("noise_scale = 0.1", "noise_scale = 0.0", f"{NOMINAL}.noise_scale", "no meaning in method 'paper'"),
        ('regulariser = "1+eta"', "regulariser = 0.0", f"{NOMINAL}.regulariser", "'1+eta' or a number > 0"),
        ('sense = "min"', 'sense = "max"', f"{NOMINAL}.sense", "must be 'min'"),
        ("seed = 1", "seed = 2001-02-03", "seed", "a date or time, which no key takes"),
        ('gains = "paper"', "gains = 12:00:00", "system.gains", "a date or time, which no key takes"),
        ("seed = 1", "seed = 9007199254740992", "seed", "a whole number >= 0 and < 9007199254740992"),
        ("clip = [-0.05, 0.75]", "clip = [0.75, -0.05]", "clip", "low < high"),
        ("resolution = 21", "resolution = 1000", f"{NOMINAL}.resolution", "more than the 100,000 allowed"),
        ('name = "segway-paper"', 'name = "../../etc/passwd"', "name", "1 to 64 of a-z, 0-9, '-' and '_'"),
        ('name = "segway-paper"', 'name = "-rf"', "name", "the first a letter or digit"),
        ('name = "segway-paper"', 'name = "a\\nb"', "name", r"'a\nb' is not allowed"),
        ("seed = 1\n", 'seed = 1\n"\\n\\u001b[2J" = 1\n', r"\n\x1b[2J", "unknown key"),
        ('column = "phi"', 'column = "x"', "gap.column", 'the specification reads phi; use kind = "predicate_sup"'),
        ('column = "phi"', 'column = "t"', "gap.column", "does not bound the robustness"),
        ('composition = "product"', "", "composition", "'single' is for one problem; allowed here: 'product', 'sum'"),
    ],
)
def test_a_wrong_key_is_named_with_what_is_allowed(here: Here, old: str, new: str, key: str, allowed: str) -> None:
    fault = here.run_file(changed(old, new))
    assert fault.startswith(f"{key}: ")
    assert allowed in fault


@pytest.mark.journey
@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "the file is empty"),
        (b"# only a comment\n", "the file is empty"),
        (PAPER.encode("utf-16"), "not UTF-8 (byte 0)"),
        (b'name = "\xe9t\xe9"', "not UTF-8 (byte 8)"),
        (b"name = segway", "not TOML: Invalid value (at line 1, column 8)"),
        (b"name = 'a'\nname = 'b'", "not TOML: Cannot overwrite a value"),
        (PAPER.replace("[[problems]]", "[problems]").encode(), "not TOML: Cannot"),
        (b"seed = " + b"[" * 5000 + b"]" * 5000, "not TOML"),
        (b"seed = " + b"9" * 5000, "not TOML"),
        (b"#" * 2_000_000, "more than 1048576 bytes"),
    ],
)
def test_a_file_that_is_no_campaign(here: Here, data: bytes, reason: str) -> None:
    assert reason in here.run_file(data)


@pytest.mark.journey
@pytest.mark.usefixtures("asked")
def test_every_fault_of_a_file_is_a_line_of_its_own(here: Here) -> None:
    file = here.folder / "c.toml"
    text = changed("horizon = 15.0", "horizont = 15.0").replace("seed = 1", "seed = 1.5")
    file.write_text(text.replace("nu = 10.0", "nu = 0.0"))
    ended = here.run("run", "c.toml", "--out", "made")
    assert ended.code == 1
    lines = [line.removeprefix("perfbound: c.toml: ") for line in ended.err.splitlines()]
    keys = [line.partition(":")[0] for line in lines]
    assert keys == ["horizont", "seed", f"{NOMINAL}.kernel.nu", "problems.sim_gap.kernel.nu"]
    text = changed("abs(phi)", "abs(phy)").replace('gains = "paper"', 'gaims = "paper"')
    file.write_text(text.replace("horizon = 15.0", "horizon = 150.0").replace("high = 5.0", "high = 500.0"))
    ended = here.run("run", "c.toml", "--out", "made")
    lines = [line.removeprefix("perfbound: c.toml: ") for line in ended.err.splitlines()]
    keys = [line.partition(":")[0] for line in lines]
    assert keys == ["space.x", "space.y", "system.gaims", "horizon", "specification"]
    assert "unknown column 'phy'; did you mean 'phi'?" in lines[-1]


def test_every_fault_of_a_file_is_a_json_object_of_its_own(started: Processes) -> None:
    (started.folder / "c.toml").write_text(changed("nu = 10.0", "nu = 0.0").replace("seed = 1", "seed = 1.5"))
    ended = started.run("perfbound", "run", "c.toml", "--log", "json")
    lines = [json.loads(line) for line in ended.err.splitlines()]
    assert (ended.code, len(lines)) == (1, 2)
    assert all(line["level"] == "error" and line["message"].startswith("perfbound: c.toml: ") for line in lines)
    for words in (("run", "missing.toml"), ("resume", "missing")):
        (line,) = started.run("perfbound", *words, "--log", "json").err.splitlines()
        assert json.loads(line)["message"].startswith(f"perfbound: {words[1]}: ")


def test_a_file_with_a_byte_order_mark_is_read(here: Here) -> None:
    assert here.run_file(b"\xef\xbb\xbf" + changed("seed = 1", "seed = -1").encode()).startswith("seed: ")


def test_a_missing_file_and_one_that_is_a_folder(here: Here) -> None:
    for name, reason in (("missing.toml", "No such file"), (".", "Is a directory")):
        ended = here.run("run", name)
        assert ended.code == 1
        assert ended.fault.startswith(f"perfbound: {name}: {reason}")
        assert not any(here.folder.iterdir())


# Faults that only the system under test can detect

LAWS = 'gains = "paper"\n[disturbances]\n'
NORMAL = '{ distribution = "normal", mean = 0.0, sd = 0.1 }'


@pytest.mark.parametrize(
    ("old", "new", "key", "allowed"),
    [
        ('gains = "paper"', 'gains = "papers"', "system.gains", "choose from paper, aggressive"),
        ('gains = "paper"', "noise = 0.05", "system.noise", "allowed for segway are name, gains"),
        ('gains = "paper"', f"{LAWS}phi_eror = {NORMAL}", "disturbances.phi_eror", "did you mean 'phi_error'?"),
        (
            'gains = "paper"',
            f"{LAWS}x_error.unit = 'rad'\nx_error.scipy = 't'",
            "disturbances.x_error.unit",
            "takes 'm'",
        ),
        ('gains = "paper"', f"{LAWS}x_error.scipy = 't'", "disturbances.x_error", "scipy: t takes df, loc, scale"),
        ("high = 5.0", "high = 500.0", "space.x", "the range of segway"),
        ('unit = "m"', 'unit = "km"', "space.x.unit", "segway takes 'm'"),
        ("\nx = {", "\nz = {", "space.z", "segway has x, y"),
        ("horizon = 15.0", "horizon = 1e6", "horizon", "more than the 120 s"),
        ('column = "phi"', 'column = "roll"', "gap.column", "segway has t, x, y"),
        ("abs(phi)", "abs(roll)", "specification", "roll"),
        ("always (abs(phi) <= 0.95)", "always (abs(phi <= 0.95", "specification", "')' expected"),
        ("always (abs(phi) <= 0.95)", "", "specification", "the formula"),
    ],
)
@pytest.mark.usefixtures("asked")
def test_a_fault_that_the_system_tells(here: Here, old: str, new: str, key: str, allowed: str) -> None:
    fault = here.run_file(changed(old, new))
    assert fault.startswith(f"{key}: ")
    assert allowed in fault


def test_an_unknown_system_and_an_unknown_gain_set(started: Processes) -> None:
    for old, new, reason in (
        (
            'name = "segway"',
            'name = "hovercraft"',
            "system.name: 'hovercraft' is not an installed system; allowed are",
        ),
        ('gains = "paper"', 'gains = "wild"', "system.gains: 'wild' is not allowed: choose from paper, aggressive"),
    ):
        (started.folder / "c.toml").write_text(changed(old, new))
        ended = started.run("perfbound", "run", "c.toml")
        assert ended.code == 1
        assert reason in ended.fault
        assert not (started.folder / "runs").exists()


# Run directories and endpoints


def test_a_run_directory_that_exists_or_cannot_be_made(here: Here, calm: Path) -> None:
    write_campaign(here.folder / "c.toml")
    ended = here.run("run", "c.toml", "--out", str(calm))
    assert ended.code == 1
    assert f"a finished campaign is here; `perfbound show {calm}` prints it" in ended.fault
    (here.folder / "full").mkdir()
    (here.folder / "full" / "mine").write_text("keep")
    for out, reason in (
        ("full", "full: exists and is not empty; choose another --out"),
        ("c.toml/below", "c.toml/below: cannot be created (Not a directory)"),
        ("/proc/perfbound", "/proc/perfbound: cannot be created"),
        ("x" * 300, "File name too long"),
    ):
        ended = here.run("run", "c.toml", "--out", out)
        assert ended.code == 1
        assert reason in ended.fault
    assert here.run("run", "c.toml", "--out", "c.toml").code == 2
    assert sorted(path.name for path in here.folder.rglob("*")) == ["c.toml", "full", "mine"]


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("horizon = 20.0", "horizont = 20.0", "horizont: unknown key"),
        ('gains = "paper"', 'gains = "papers"', "system.gains: 'papers' is not allowed"),
        ("\nx = {", "\nz = {", "space."),
        ("abs(phi)", "abs(roll)", "specification: character 13: unknown column 'roll'"),
    ],
)
@pytest.mark.usefixtures("asked")
def test_the_file_is_checked_before_the_directory_of_its_name(
    here: Here, calm: Path, old: str, new: str, key: str
) -> None:
    text = write_campaign(here.folder / "c.toml").read_text()
    assert old in text
    (here.folder / "c.toml").write_text(text.replace(old, new, 1))
    ended = here.run("run", "c.toml", "--out", str(calm))
    assert ended.code == 1
    assert ended.err.startswith(f"perfbound: c.toml: {key}")
    assert str(calm) not in ended.err


@pytest.mark.usefixtures("asked")
def test_endpoints_that_cannot_be_used(here: Here) -> None:
    write_campaign(here.folder / "c.toml")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        used = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        for arguments, reason in (
            ([used], f"--listen {used}: this endpoint is in use; choose another port"),
            (["tcp/0.0.0.0:0"], "--listen tcp/0.0.0.0:0: anyone who reaches this address could feed the campaign"),
            (["tcp/203.0.113.7:0", "--insecure"], "--listen tcp/203.0.113.7:0: cannot listen there"),
            (["tcp/::1:0"], "--listen 'tcp/::1:0' is not an endpoint"),
            (["tcp/127.0.0.1:²"], "--listen 'tcp/127.0.0.1:²' is not an endpoint"),
            (["tcp/127.0.0.1:70000"], "PORT at most 65535"),
            (["tls/127.0.0.1:0"], "tls needs --tls-ca, --tls-certificate and --tls-key"),
            (
                ["tcp/127.0.0.1:0", "--tls-ca", "a", "--tls-key", "b", "--tls-certificate", "c"],
                "tcp does not encrypt",
            ),
            (["tcp/127.0.0.1:0", "--allow", "w1"], "--allow: needs a tls/ endpoint"),
            (
                ["tls/127.0.0.1:0", "--tls-ca", "a", "--tls-key", "b", "--tls-certificate", "c"],
                ": no such file; the TLS options name PEM files",
            ),
        ):
            ended = here.run("run", "c.toml", "--listen", *arguments)
            assert ended.code == 1
            assert reason in ended.fault
            if "--allow" not in arguments:
                assert reason in here.run("router", "--listen", *arguments).fault
    ended = here.run("run", "c.toml", "--tls-ca", "a")
    assert (ended.code, "belong together" in ended.err) == (2, True)
    ended = here.run("run", "c.toml", "--listen", "tcp/127.0.0.1:0", "--connect", "tcp/127.0.0.1:1")
    assert (ended.code, "--listen and --connect exclude each other" in ended.err) == (2, True)
    for arguments, reason in (
        (["tcp/127.0.0.1"], "--connect 'tcp/127.0.0.1' is not an endpoint"),
        (["tls/127.0.0.1:1"], "--connect tls/127.0.0.1:1: tls needs --tls-ca"),
        (["tcp/127.0.0.1:1", "--allow", "w1"], "--allow: the router alone sees the certificates of workers"),
    ):
        assert reason in here.run("run", "c.toml", "--connect", *arguments).fault
    for option in ("--allow", "--allow-orchestrator", "--allow-router"):
        ended = here.run("router", "--listen", "tcp/127.0.0.1:0", option, "w1")
        assert "--allow: needs tls/ endpoints" in ended.fault
    assert [path.name for path in here.folder.iterdir()] == ["c.toml"]


def test_resume_and_status_where_there_is_no_campaign(here: Here) -> None:
    for command in ("resume", "status"):
        for directory in (".", "nowhere"):
            ended = here.run(command, directory)
            assert ended.code == 1
            assert f"{directory}: no campaign here (no campaign.db)" in ended.fault
    assert not any(here.folder.iterdir())


def test_resume_of_a_finished_campaign_prints_it_and_changes_nothing(here: Here, calm: Path) -> None:
    before = contents(calm)
    ended = here.run("resume", str(calm))
    assert (ended.code, ended.fault) == (0, f"{calm}: finished already")
    claim = r"CLAIM  rho\* \(robustness risk, clipped to \[.*\], of the true system at its worst start\)\s+>= -"
    assert re.search(claim, ended.out)
    assert contents(calm) == before


# One rollout


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--x", "nan,0"], "--x nan,0: x = nan is not in [-20, 25] m"),
        (["--x", "0,inf"], "--x 0,inf: y = inf is not in [-20, 25] m"),
        (["--x", "0"], "--x 0: segway takes 2 numbers: x,y"),
        (["--x", "a,b"], "--x a,b: segway takes 2 numbers: x,y"),
        (["--x", "0,0", "--horizon", "nan"], "--horizon nan: segway takes 0 to 120 s"),
        (["--x", "0,0", "--horizon", "121"], "--horizon 121: segway takes 0 to 120 s"),
        (["--x", "0,0", "--option", "gains=wild"], "--option gains=wild: allowed are paper, aggressive"),
        (["--x", "0,0", "--disturbance", "x_error=nan"], "--disturbance x_error=nan: 'nan' is not a finite number"),
        (
            ["--x", "0,0", "--disturbance", "wind=1"],
            "--disturbance wind=1: segway has the disturbances x_error, y_error",
        ),
        (["--x", "0,0", "--option", "wind=1"], "--option wind=1: segway has the options gains"),
    ],
)
@pytest.mark.usefixtures("asked")
def test_a_rollout_that_cannot_be_run(here: Here, arguments: list[str], reason: str) -> None:
    ended = here.run("simulate", "segway", *arguments, "--out", "o.mcap")
    assert ended.code == 1
    assert reason in ended.fault
    assert not any(here.folder.iterdir())


def test_a_rollout_that_only_the_simulator_refuses(started: Processes) -> None:
    base = ["simulate", "test-function", "--x", "0,0"]
    ended = started.run("perfbound", *base, "--option", "noise_sd=7", "--out", "o.mcap")
    assert ended.code == 1
    assert "noise_sd is a number in [0.0, 1.0], not 7.0" in ended.fault
    ended = started.run("perfbound", *base, "--option", "noise_sd=nan", "--out", "o.mcap")
    assert "--option noise_sd=nan: 'nan' is not a finite number" in ended.fault
    ended = started.run("perfbound", *base, "--out", "no/where.mcap")
    assert ended.code == 1
    assert "no/where.mcap: No such file or directory" in ended.fault
    assert not list(started.folder.rglob("*.mcap*"))


# While a campaign runs


@pytest.fixture(scope="module")
def busy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Process]:
    """A campaign of many tests that has begun, in `busy.folder / "../run"`."""
    folder = tmp_path_factory.mktemp("busy")
    with processes(folder) as started:
        process = started.start(
            "perfbound", "run", write_campaign(folder / "c.toml", max_tests="2000"), "--out", "run", "--workers", "1"
        )
        wait_for(lambda: recorded(folder / "run") >= 1)
        yield process


def test_two_orchestrators_on_one_campaign(busy: Process, here: Here) -> None:
    directory = busy.folder.parent / "run"
    for command, reason in (
        (["resume", str(directory)], "another orchestrator is running this campaign; watch it with `perfbound status"),
        (["run", str(directory.parent / "c.toml"), "--out", str(directory)], "a campaign is here already"),
    ):
        ended = here.run(*command)
        assert ended.code == 1
        assert ended.fault.startswith(f"perfbound: {directory}: {reason}")
    assert busy.running


def test_a_database_of_a_newer_schema(busy: Process, here: Here) -> None:
    directory = here.folder / "newer"
    directory.mkdir()
    with sqlite3.connect(busy.folder.parent / "run" / "campaign.db") as source:
        source.execute("VACUUM INTO ?", (str(directory / "campaign.db"),))
    source.close()
    newer = sqlite3.connect(directory / "campaign.db")
    newer.executescript(f"DROP TRIGGER schema_no_update; UPDATE schema SET version = {SCHEMA_VERSION + 1}")
    newer.close()
    for command in ("resume", "status"):
        ended = here.run(command, "newer")
        assert ended.code == 1
        assert f"schema version {SCHEMA_VERSION + 1}, this perfbound reads {SCHEMA_VERSION};" in ended.fault
        assert "newer/campaign.db" in ended.fault
    (directory / "campaign.db").write_bytes(b"no database " * 100)
    for command in ("resume", "status"):
        ended = here.run(command, "newer")
        assert ended.code == 1
        assert "newer/campaign.db: " in ended.fault


def test_a_worker_of_another_version_is_told_so(started: Processes) -> None:
    fake = started.folder / "fake"
    fake.mkdir()
    (fake / "sitecustomize.py").write_text("import perfbound.schemas\nperfbound.schemas.__version__ = '9.9.9'\n")
    campaign = write_campaign(started.folder / "c.toml")
    orchestrator = started.start("perfbound", "orchestrate", campaign, "--out", "run")
    wait_for(lambda: "--connect" in orchestrator.err)
    endpoint = orchestrator.err.split("--connect ")[1].split()[0]
    ended = started.run("perfbound-worker", "--connect", endpoint, PYTHONPATH=str(fake))
    assert ended.code == 1
    # On a busy machine the worker says before that it waits.
    assert ended.last_line.startswith("perfbound-worker: the worker is perfbound 9.9.9 (protocol ")
    assert "install the same version on both" in ended.last_line
    assert orchestrator.running
    assert not under_way(started.folder / "run"), "it got nothing to do"
    assert "refused worker worker-" in orchestrator.err


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--connect", "127.0.0.1:7447"], "--connect '127.0.0.1:7447' is not an endpoint: write tcp/HOST:PORT"),
        (["--connect", "tls/127.0.0.1:7447"], "--connect tls/127.0.0.1:7447: tls needs --tls-ca"),
        (["--connect", "tcp/127.0.0.1:7447", "--name", "a/b"], "the name 'a/b' is not allowed"),
    ],
)
def test_a_worker_that_cannot_start(started: Processes, arguments: list[str], reason: str) -> None:
    ended = started.run("perfbound-worker", *arguments)
    assert ended.code == 1
    assert ended.fault.startswith(f"perfbound-worker: {reason}")


# The disk


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=2m", "perfbound-test", disk], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"no file system can be mounted here: {mounted.stderr.decode().strip()}")
    try:
        yield disk
    finally:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("mount") is None, reason="only root can mount a file system")
def test_a_disk_that_is_full_in_mid_run(small_disk: Path, tmp_path: Path, calm: Path) -> None:
    directory = small_disk / "run"
    with processes(tmp_path / "logs") as started:
        campaign = write_campaign(tmp_path / "c.toml")
        ended = started.run("perfbound", "run", campaign, "--out", directory)
        assert ended.code == 1
        assert 1 <= recorded(directory) < ROLLOUTS, "in mid-run"
        assert "No space left on device" in ended.last_line or "database or disk is full" in ended.last_line
        assert f"fix this, then continue with: perfbound resume {directory}" in ended.last_line
        assert str(directory) in ended.last_line
        files = {row[0] for row in query(directory, "SELECT path FROM rollouts")}
        assert files <= set(contents(directory)), "what the database has is there"
        assert not [name for name in contents(directory) if name.endswith(".partial")]
        subprocess.run(["mount", "-o", "remount,size=64m", small_disk], check=True)
        resumed = started.run("perfbound", "resume", directory)
    assert resumed.code == 0, resumed.err
    assert (directory / "certificate.json").read_bytes() == (calm / "certificate.json").read_bytes()


@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("mount") is None, reason="only root can mount a file system")
def test_a_disk_that_is_full_from_the_start(small_disk: Path, tmp_path: Path) -> None:
    (small_disk / "ballast").write_bytes(bytes(2 * 1024 * 1024 - 16 * 1024))
    with processes(tmp_path / "logs") as started:
        ended = started.run("perfbound", "run", write_campaign(tmp_path / "c.toml"), "--out", small_disk / "run")
    assert ended.code == 1
    assert "full" in ended.fault
    assert ended.fault.endswith("nothing was started")
    assert [path.name for path in small_disk.iterdir()] == ["ballast"]
