"""The lines of a worker that finds no orchestrator."""

import socket
from pathlib import Path

import pytest

from perfbound.orchestrator.hosts.authority import Order
from perfbound.orchestrator.hosts.pki import init_folder, issue_files
from perfbound.schemas.link import handshake
from perfbound.schemas.link.configuration import Tls
from perfbound.schemas.link.unanswered import no_link, no_orchestrator
from tests.facts import says


def test_an_orchestrator_that_does_not_know_the_secret_is_named_with_the_remedy() -> None:
    line = no_orchestrator(["tcp/127.0.0.1:7447"], None, strangers=True, common_name="")
    assert says(line, "orchestrator tcp/127.0.0.1:7447 does secret worker: start")


def test_a_port_that_begins_no_handshake_is_not_blamed_on_the_secret(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As that of a router which is flooded with connections: its queue takes more of them."""
    monkeypatch.setattr(handshake, "PATIENCE", 0.2)
    init_folder(tmp_path / "pki", 9)
    issue_files(tmp_path / "pki", Order("node-1", "worker"), 3, tmp_path / "w")
    ca, certificate, key = (str(tmp_path / "w" / name) for name in ("ca.pem", "node-1.pem", "node-1-key.pem"))
    files = Tls(ca=ca, certificate=certificate, key=key)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        line = no_link([f"tls/127.0.0.1:{port}"], "worker", files)
    assert says(line, f"^127.0.0.1:{port} takes TLS 0.2 s")
    assert "PERFBOUND_SECRET" not in line
