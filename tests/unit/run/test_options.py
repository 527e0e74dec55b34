"""The options that a stopped run names for its continuation."""

from typing import Any

import click
import pytest

from perfbound.orchestrator.cli.link_options import link_of, link_options
from perfbound.orchestrator.run.link import Link
from perfbound.orchestrator.run.options import RunOptions
from perfbound.schemas.link.configuration import LOCAL, Tls

TLS = Tls(ca="ca.pem", certificate="main.pem", key="main-key.pem")


@click.command()
@link_options
def takes_link(**options: Any) -> Link:
    """Return the link of the options that every command has which opens one."""
    return link_of(**options)


def test_local_workers_need_no_options() -> None:
    assert RunOptions(3, Link(LOCAL)).resume_options == []


@pytest.mark.parametrize(
    "link",
    [
        Link(LOCAL, routers=("tcp/one:7447", "tcp/two:7447")),
        Link(LOCAL, TLS, routers=("tls/gate:7447",), grace=90.5),
        Link("tls/0.0.0.0:7447", TLS, allow=("node-1", "node-2")),
        Link("tcp/0.0.0.0:7447", insecure=True),
    ],
)
def test_the_command_that_continues_waits_for_the_same_workers(link: Link) -> None:
    options = RunOptions(0, link).resume_options
    assert options[:2] == ["--workers", "0"]
    assert takes_link.main(options[2:], standalone_mode=False) == link
