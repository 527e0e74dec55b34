"""What a worker says whose link has ended, or whose name is not the one of its certificate, while it serves a run."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import pytest

from perfbound.schemas.errors import LinkError
from perfbound.workers import serving
from perfbound.workers.serving import LinkOptions, _link_checks
from perfbound.workers.transport import ZenohUplink
from tests.facts import says
from tests.fakes.certificates import DAY, Site
from tests.sharing import free_port


@dataclass
class Uplink:
    """An uplink in memory."""

    linked: bool = True
    strict: bool = False

    strangers: bool = False
    runs: tuple[str, ...] = ("r",)

    def orchestrators(self) -> list[tuple[str, str]]:
        return [("o", run) for run in self.runs]

    def by_certificate(self, _orchestrator: str) -> bool:
        return self.strict


@pytest.fixture
def options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LinkOptions:
    for name in ("CERTIFICATE_PERIOD", "UNLINKED", "UNSERVED"):
        monkeypatch.setattr(serving, name, 0.0)
    tls = Site(tmp_path).tls("node-1", "worker", at=-9 * DAY, days=1)
    return LinkOptions((f"tls/127.0.0.1:{free_port()}",), tls, None, "node-1")


def check_of(options: LinkOptions, uplink: Uplink, name: str | None = "node-1") -> Callable[[], None]:
    return _link_checks(options, cast("ZenohUplink", uplink), "o", "r", name)


def test_a_worker_without_link_names_its_certificate_if_that_has_ended(options: LinkOptions) -> None:
    uplink = Uplink()
    check = check_of(options, uplink)
    check()
    uplink.linked = False
    with pytest.raises(LinkError, match=r"node-1\.pem: this certificate ended at "):
        check()


def test_a_worker_without_link_says_why(
    options: LinkOptions, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    valid = options._replace(tls=Site(tmp_path / "valid").tls("node-1", "worker"))
    uplink = Uplink(linked=False)
    check = check_of(valid, uplink)
    check()
    assert says(capsys.readouterr().err, f"^perfbound-worker: link {options.endpoints[0]} yet")
    uplink.linked = True
    for _ in range(2):
        check()
    assert capsys.readouterr().err == f"perfbound-worker: connected to {options.endpoints[0]}\n"


def test_a_worker_that_the_router_lets_in_no_more_says_what_to_look_for(
    options: LinkOptions, capsys: pytest.CaptureFixture[str]
) -> None:
    uplink = Uplink(runs=("another",))
    check = check_of(options, uplink)
    check()
    said = capsys.readouterr().err
    assert says(said, f"^perfbound-worker: {options.endpoints[0]} waiting orchestrator")
    assert says(said, "router --allow 'node-1'")
    uplink.runs = ("another", "r")
    for _ in range(2):
        check()
    assert says(capsys.readouterr().err, "^perfbound-worker: orchestrator")


def test_the_token_of_a_router_may_come_late(options: LinkOptions, capsys: pytest.CaptureFixture[str]) -> None:
    uplink = Uplink()
    check = check_of(options, uplink, "node-2")
    check()
    uplink.strict = True
    with pytest.raises(SystemExit):
        check()
    assert "--name node-2: tls/127.0.0.1" in capsys.readouterr().err
    for name in ("node-1", None):
        check_of(options, uplink, name)()
