"""Every command line, variable and port in the deployment files, beside the real commands."""

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import click
import pytest

from tests.unit.deploy.files import (
    DEPLOY,
    ROOT,
    SCRIPT,
    Started,
    compose_started,
    everything,
    kubernetes_started,
    parsed,
    systemd_started,
)

STARTED = {each.place: each for each in everything()}
FILES = sorted(
    path
    for path in DEPLOY.rglob("*")
    if path.is_file() and (path.parent.name in ("kubernetes", "systemd") or path.parent == DEPLOY)
)


def port(endpoint: str) -> str:
    return endpoint.rpartition(":")[2]


@pytest.mark.parametrize("place", STARTED)
def test_a_command_line_is_one_of_the_real_command(place: str) -> None:
    for command in STARTED[place].commands():
        assert parsed(command)


def test_a_wrong_option_would_be_found() -> None:
    with pytest.raises(click.NoSuchOption):
        parsed(("perfbound", "resume", "runs/a", "--conect=tcp/127.0.0.1:7447"))
    with pytest.raises(click.MissingParameter):
        parsed(("perfbound", "orchestrate"))
    with pytest.raises(click.BadParameter):
        parsed(("perfbound", "resume", "runs/a", "--workers", "many"))


@pytest.mark.parametrize("started", [compose_started, kubernetes_started, systemd_started])
def test_all_connect_to_the_port_of_the_router(started: Callable[[], dict[str, Started]]) -> None:
    """And the router lets in those names that the others have in their certificates."""
    found = {each.place: each.options() for each in started().values()}
    (router,) = [options for options in found.values() if "allow_orchestrator" in options]
    ports = {port(each) for options in found.values() for each in options.get("connect", ())}
    assert ports == {port(each) for each in router["listen"]}
    assert tuple(router["allow"]) == ("worker",)
    assert tuple(router["allow_orchestrator"]) == ("orchestrator",)


@pytest.mark.parametrize("place", STARTED)
def test_a_link_has_certificates(place: str) -> None:
    options = STARTED[place].options()
    assert {"tls_ca", "tls_certificate", "tls_key"} <= set(options)
    assert "insecure" not in options
    assert all(each.startswith("tls/") for each in [*options.get("listen", ()), *options.get("connect", ())])


@pytest.mark.parametrize("place", [place for place in STARTED if "worker" in place])
def test_a_worker_ends_before_it_is_killed(place: str) -> None:
    assert STARTED[place].options()["stop_within"] < STARTED[place].grace


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_variables_are_known_to_the_code(path: Path) -> None:
    sources = (each for folder in ("schemas", "orchestrator", "workers") for each in (ROOT / folder).rglob("*.py"))
    code = "".join(each.read_text() for each in sources)
    for name in re.findall(r"PERFBOUND_\w+", path.read_text()):
        assert f'"{name}"' in code, name


@pytest.mark.integration
@pytest.mark.parametrize("exists", [False, True])
def test_a_campaign_is_begun_once_and_then_continued(tmp_path: Path, exists: bool) -> None:
    program = tmp_path / "perfbound"
    program.write_text('#!/bin/sh\nprintf "%s\\n" perfbound "$@"\n')
    program.chmod(0o755)
    directory = tmp_path / "a run; true"
    directory.mkdir()
    if exists:
        (directory / "campaign.db").touch()
    words = ("the campaign.toml", str(directory), "--connect=tls/router:7447", "--drain")
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    ended = subprocess.run([DEPLOY / SCRIPT, *words], env=environment, capture_output=True, text=True, check=True)
    assert tuple(ended.stdout.splitlines()) == Started("", (SCRIPT, *words), 0).commands()[exists]
