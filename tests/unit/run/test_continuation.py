"""The command that continues a campaign, as every process names it: with the options of its last session."""

import json
import os
import shlex
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from rich.console import Console

from perfbound.orchestrator.cli import stop
from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.cli.status import print_status, status_object
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.write import relocatable
from perfbound.orchestrator.run import session
from perfbound.orchestrator.run.continuation import command_with, continue_command, local_workers
from perfbound.orchestrator.run.link import Link
from perfbound.orchestrator.run.options import RunOptions
from perfbound.orchestrator.store.journal import INSTALLED, Journal, Origin
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import LinkError, PerfboundError
from perfbound.schemas.link.configuration import LOCAL, Tls
from perfbound.schemas.link.secret import VARIABLE
from perfbound.schemas.result.facts import Header
from perfbound.workers.systems import load_system
from tests import campaigns

ROUTER = "tcp/127.0.0.1:7447"
LINKED = RunOptions(0, Link(LOCAL, routers=(ROUTER,)))
OPTIONS = ["--workers", "0", "--connect", ROUTER]


def begun(directory: Path, options: RunOptions = LINKED) -> Path:
    """Begin a campaign with these options, which no process runs now."""
    directory.mkdir(exist_ok=True)
    header = Header.new(campaigns.config("test-function"), load_system("test-function").spec, {})
    Journal.create(directory, header, options.origin("test-function")).close()
    return directory


def again(directory: Path, origin: Origin) -> None:
    Journal.open(directory, origin).close()


def test_every_process_names_the_options_of_the_last_session(tmp_path: Path) -> None:
    directory = begun(tmp_path / "my run; $(x)")
    command = shlex.join(["perfbound", "resume", str(directory), *OPTIONS])
    output = StringIO()
    print_status(directory, Console(file=output, width=400))
    assert f"continue with: {command}\n" in output.getvalue()
    assert status_object(directory)["resume"] == command
    assert stop._end_in_words(directory) == f"stopped; continue with: {command}"
    assert f"continue it with `{command}`" in stop._why_not_running(directory)
    data = Collector(directory).refresh()
    assert data.resume == command
    assert relocatable(data).resume == "perfbound resume .", "a report is for others, who have neither link nor files"


def test_the_last_session_with_workers_counts(tmp_path: Path) -> None:
    directory = begun(tmp_path / "run", RunOptions(2, Link(LOCAL)))
    assert continue_command(directory) == f"perfbound resume {directory}"
    again(directory, RunOptions(3, Link("tcp/0.0.0.0:7447", insecure=True)).origin("test-function"))
    again(directory, INSTALLED)  # as `perfbound discard` opens it
    assert continue_command(directory).endswith("run --workers 3 --listen tcp/0.0.0.0:7447 --insecure")
    again(directory, RunOptions(3, Link(LOCAL)).origin("test-function"))
    assert continue_command(directory) == f"perfbound resume {directory}"


def test_files_are_found_from_every_folder_and_no_secret_is_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, "a secret of sixteen or more")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "key of main.pem").write_text("PRIVATE KEY")
    tls = Tls(ca="ca.pem", certificate="main.pem", key="key of main.pem")
    directory = begun(tmp_path / "run", RunOptions(0, Link(LOCAL, tls, routers=("tls/gate:7447",), grace=90.5)))
    typed = ["--tls-ca", "ca.pem", "--tls-certificate", "main.pem", "--tls-key", "key of main.pem", "--grace", "90.5"]
    assert shlex.split(continue_command(directory))[5:] == ["--connect", "tls/gate:7447", *typed]
    monkeypatch.chdir(directory)
    assert shlex.split(continue_command(directory))[12] == str(tmp_path / "key of main.pem")
    content = (directory / DATABASE).read_bytes()
    assert b"gate:7447" in content
    assert b"a secret of sixteen" not in content
    assert b"PRIVATE KEY" not in content


def test_what_is_no_endpoint_is_not_stored(tmp_path: Path) -> None:
    directory = begun(tmp_path / "run")
    with pytest.raises(LinkError, match="--connect 'tcp/user:password@gate:1' is not an endpoint"):
        again(directory, RunOptions(0, Link(LOCAL, routers=("tcp/user:password@gate:1",))).origin("test-function"))
    assert b"password" not in (directory / DATABASE).read_bytes()


@pytest.mark.parametrize(
    "forged",
    [
        ["--on-finish", "rm -rf ~"],
        ["--connect", "--on-finish", "x"],
        ["--connect"],
        ["--workers", "x", "--connect", ROUTER],
        ["--connect", "tcp/\x1b[31m:1"],
        [7],
        {"--connect": ROUTER},
    ],
)
def test_a_forged_database_brings_no_other_option(forged: Any) -> None:
    for text in (json.dumps(forged), "{", "[" * 100_000):
        assert command_with(Path("run"), text) == "perfbound resume run"


@pytest.mark.parametrize(
    ("last", "workers", "link", "expected"),
    [
        (LINKED, None, ["--connect", ROUTER], 0),
        (RunOptions(5, LINKED.link), None, ["--connect", ROUTER], 5),
        (LINKED, 3, [], 3),
        (LINKED, 4, ["--connect", ROUTER], 4),
        (RunOptions(7, Link(LOCAL)), None, ["--connect", ROUTER], 2),
        (RunOptions(7, Link(LOCAL)), None, [], 2),
    ],
)
def test_the_local_workers_of_a_resume(
    tmp_path: Path, last: RunOptions, workers: int | None, link: list[str], expected: int
) -> None:
    assert local_workers(begun(tmp_path / "run", last), workers, link, extends=False) == expected


def test_a_resume_neither_connects_nor_starts_local_workers_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    began: list[RunOptions] = []
    monkeypatch.setattr(session, "resume_campaign", lambda _directory, options, *_: began.append(options))
    directory = begun(tmp_path / "run")
    refused = CliRunner().invoke(cli, ["resume", str(directory)])
    assert isinstance(refused.exception, PerfboundError)
    assert str(refused.exception) == (
        f"{directory}: was run last with workers that connect from elsewhere; continue so with "
        f"`{shlex.join(['perfbound', 'resume', str(directory), *OPTIONS])}`, or with local workers alone with "
        f"`perfbound resume {directory} --workers 2`"
    )
    assert began == []
    CliRunner().invoke(cli, ["resume", str(directory), "--connect", ROUTER])
    CliRunner().invoke(cli, ["resume", str(directory), "--workers", "2"])
    assert [(each.workers, each.link.routers) for each in began] == [(0, (ROUTER,)), (2, ())]


def test_a_finished_campaign_prints_its_certificate_whatever_its_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = begun(tmp_path / "run")
    monkeypatch.setattr("perfbound.orchestrator.certificate.files.read", lambda _: object())
    assert local_workers(directory, None, [], extends=False) == 2
    with pytest.raises(PerfboundError, match="was run last with workers that connect from elsewhere"):
        local_workers(directory, None, [], extends=True)  # with --max-tests it simulates again


def test_a_directory_without_a_campaign_is_reported_by_the_resume_itself(tmp_path: Path) -> None:
    assert not os.listdir(tmp_path)
    assert continue_command(tmp_path) == f"perfbound resume {tmp_path}"
    assert local_workers(tmp_path, None, [], extends=False) == 2
