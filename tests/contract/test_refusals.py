"""The lines of a side that a real Zenoh node refuses, or that refuses it: each names the certificate at fault."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from datetime import timedelta
from pathlib import Path

import pytest
import zenoh

from perfbound.orchestrator.hosts.authority import certificate_bytes
from perfbound.schemas.link import configuration
from perfbound.schemas.link.configuration import Tls
from perfbound.schemas.link.unanswered import no_link
from tests.facts import says
from tests.fakes.certificates import DAY, Site
from tests.sharing import free_port

Listening = Callable[[Tls | None], AbstractContextManager[str]]


@pytest.fixture
def listening(monkeypatch: pytest.MonkeyPatch) -> Listening:
    """Open a node without the checks of its own files, as one on a host with another clock."""
    monkeypatch.setattr(configuration, "check_link_files", lambda *_, **__: None)
    monkeypatch.setattr(configuration, "check_host", lambda *_: None)

    @contextmanager
    def opened(tls: Tls | None) -> Iterator[str]:
        endpoint = f"{'tls' if tls else 'tcp'}/127.0.0.1:{free_port()}"
        session = zenoh.open(zenoh.Config.from_json5(configuration.listen_config(endpoint, tls, insecure=False)))
        try:
            yield endpoint
        finally:
            session.close()  # type: ignore[no-untyped-call]

    return opened


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def with_ca(tls: Tls, ca: Path) -> Tls:
    return tls.model_copy(update={"ca": str(ca)})


@pytest.mark.parametrize(
    ("at", "words"),
    [(-40 * DAY, "clock ended not begun clocks"), (timedelta(), "")],
)
def test_the_other_side_finds_that_a_certificate_has_ended(
    site: Site, listening: Listening, at: timedelta, words: str
) -> None:
    ours = site.tls("node-1", "worker", at=at)
    with listening(site.tls("gate", "router", "127.0.0.1")) as endpoint:
        line = no_link([endpoint], "worker", ours)
        place = endpoint.removeprefix("tls/")
    expected = f"^{place} refuses {ours.certificate} ('node-1'): {words}"
    assert says(line, expected if words else "no certificate PERFBOUND_SECRET")


def test_the_other_side_has_another_authority(site: Site, listening: Listening, tmp_path: Path) -> None:
    other = Site(tmp_path / "other")
    theirs, ours = other.tls("gate", "router", "127.0.0.1"), site.tls("node-1", "worker")
    with listening(theirs) as endpoint:
        place = endpoint.removeprefix("tls/")
        line = no_link([endpoint], "worker", ours)
        assert says(line, f"certificate {place} {site.ca} give both certificates")
        both = tmp_path / "both.pem"
        both.write_bytes(site.ca.read_bytes() + certificate_bytes(other.signer.certificate))
        line = no_link([endpoint], "worker", with_ca(ours, both))
        assert says(line, f"^{place} refuses {ours.certificate} ('node-1'): --tls-ca")


def test_the_certificate_of_the_other_side(site: Site, listening: Listening) -> None:
    ours = site.tls("node-1", "worker")
    for tls, words in (
        (site.tls("old", "router", "127.0.0.1", at=-40 * DAY), "has ended, by the clock of this machine"),
        (site.tls("young", "router", "127.0.0.1", at=3 * DAY), "is not valid yet, by the clock of this machine"),
        (site.tls("gate", "router", "gate.example"), "does not name 127.0.0.1; connect to a host that it names"),
        (site.tls("node-2", "worker"), "is not for a side that listens (no serverAuth), as that of a worker"),
    ):
        with listening(tls) as endpoint:
            line = no_link([endpoint], "orchestrator", ours)
            assert line.startswith(f"the certificate of {endpoint.removeprefix('tls/')} {words}"), line


def test_one_side_encrypts_and_the_other_does_not(site: Site, listening: Listening) -> None:
    with listening(site.tls("gate", "router", "127.0.0.1")) as endpoint:
        plain = endpoint.replace("tls/", "tcp/")
        line = no_link([plain], "worker", None)
        assert says(line, f"^{plain} tls/HOST:PORT --tls-ca --tls-certificate --tls-key")
    ours = site.tls("node-1", "worker")
    with listening(None) as endpoint:
        line = no_link([endpoint.replace("tcp/", "tls/")], "worker", ours)
        place = endpoint.removeprefix("tcp/")
        assert says(line, f"^{place} takes TLS 1 s tls/")
    assert no_link([endpoint], "worker", None).startswith(f"no answer from {endpoint} yet; ")
