"""What a worker says whose link has ended, or whose name is not the one of its certificate, while it serves a run."""

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import pytest

from perfbound.schemas.errors import LinkError
from perfbound.schemas.opening import LinkLines
from perfbound.workers import serving
from perfbound.workers.serving import LinkOptions, _link_checks, _print_line
from perfbound.workers.transport import ZenohUplink
from tests.fakes.certificates import DAY, Site
from tests.sharing import free_port


@dataclass
class Uplink:
    """An uplink in memory."""

    linked: bool = True
    strict: bool = False

    def by_certificate(self, _orchestrator: str) -> bool:
        return self.strict


@pytest.fixture
def options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LinkOptions:
    monkeypatch.setattr(serving, "CERTIFICATE_PERIOD", 0.0)
    tls = Site(tmp_path).tls("node-1", "worker", at=-9 * DAY, days=1)
    return LinkOptions((f"tls/127.0.0.1:{free_port()}",), tls, None, "node-1")


def lines_of(options: LinkOptions) -> LinkLines:
    return LinkLines(options.endpoints, "worker", options.tls, _print_line, first=0.0)


def test_a_worker_without_link_names_its_certificate_if_that_has_ended(options: LinkOptions) -> None:
    uplink = Uplink()
    check = _link_checks(options, lines_of(options), cast("ZenohUplink", uplink), "o", "node-1")
    check()
    uplink.linked = False
    with pytest.raises(LinkError, match=r"node-1\.pem: this certificate ended at "):
        check()


def test_a_worker_without_link_says_why(
    options: LinkOptions, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    valid = options._replace(tls=Site(tmp_path / "valid").tls("node-1", "worker"))
    uplink = Uplink(linked=False)
    check = _link_checks(valid, lines_of(valid), cast("ZenohUplink", uplink), "o", "node-1")
    check()
    assert capsys.readouterr().err.startswith(f"perfbound-worker: no answer from {options.endpoints[0]} yet; ")
    uplink.linked = True
    for _ in range(2):
        check()
    assert capsys.readouterr().err == f"perfbound-worker: connected to {options.endpoints[0]}\n"


def test_the_token_of_a_router_may_come_late(options: LinkOptions, capsys: pytest.CaptureFixture[str]) -> None:
    uplink = Uplink()
    check = _link_checks(options, lines_of(options), cast("ZenohUplink", uplink), "o", "node-2")
    check()
    uplink.strict = True
    with pytest.raises(SystemExit):
        check()
    assert "--name node-2: tls/127.0.0.1" in capsys.readouterr().err
    for name in ("node-1", None):
        _link_checks(options, lines_of(options), cast("ZenohUplink", uplink), "o", name)()
