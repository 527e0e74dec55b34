"""A router as users start it: several campaigns and workers behind it, its lines, and its end."""

import signal
from datetime import timedelta

from tests.campaigns import with_few_checks
from tests.end_to_end.processes import Processes, wait_for
from tests.fakes.certificates import DAY, Site
from tests.sharing import free_port


def test_two_campaigns_share_a_router_and_its_workers(started: Processes) -> None:
    folder = started.folder
    campaign = with_few_checks(folder / "c.toml", "test-function")
    assert started.run("perfbound", "run", campaign, "--out", folder / "local", "--workers", "1").code == 0
    nobody, endpoint = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    ways = ("--connect", nobody, "--connect", endpoint)
    # The campaign is there before its router, and its workers try a router that is not there.
    early = started.start("perfbound", "orchestrate", campaign, "--out", folder / "early", *ways)
    worker = started.start("perfbound-worker", *ways, "--until-done", "--idle-exit", "60")
    wait_for(lambda: f"no answer from {endpoint} yet; check the address, and that the router runs" in early.err)
    router = started.start("perfbound", "router", "--listen", endpoint)
    late = started.start("perfbound", "run", campaign, "--out", folder / "late", "--workers", "1", *ways)
    assert (early.wait().code, late.wait().code) == (0, 0)
    assert worker.wait().code == 0
    assert early.err.count(f"connected to {nobody} or {endpoint}\n") == 1
    names = ("certificate.json", "manifest.sha256")
    calm = [(folder / "local" / name).read_bytes() for name in names]
    for run in ("early", "late"):
        assert [(folder / run / name).read_bytes() for name in names] == calm
    router.popen.send_signal(signal.SIGTERM)
    ended = router.wait()
    assert ended.code == 0
    assert f"router: listening at {endpoint}" in ended.err.splitlines()


def test_a_router_ends_with_its_certificate(started: Processes) -> None:
    """Zenoh closes its links then, but one that opens again in that second stays open."""
    site, endpoint = Site(started.folder / "site"), f"tls/127.0.0.1:{free_port()}"
    tls = site.tls("router", "router", "127.0.0.1", at=timedelta(seconds=25) - DAY, days=1)
    files = ("--tls-ca", tls.ca, "--tls-certificate", tls.certificate, "--tls-key", tls.key)
    ended = started.run("perfbound", "router", "--listen", endpoint, *files)
    assert ended.code == 1
    assert f"router: listening at {endpoint}" in ended.err.splitlines()
    assert "this certificate has ended, and no link opens any more; start again with a new one" in ended.last_line


def test_a_router_of_another_user_is_one_line(started: Processes) -> None:
    """Of this machine, which has another secret."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    campaign = with_few_checks(started.folder / "c.toml", "test-function")
    started.start("perfbound", "router", "--listen", endpoint, PERFBOUND_SECRET="a secret of somebody else")
    refused = started.start(
        "perfbound", "orchestrate", campaign, "--out", started.folder / "run", "--connect", endpoint
    )
    wait_for(lambda: f"something listens at {endpoint}, but refuses this orchestrator: start both as" in refused.err)
    assert not (started.folder / "run").exists(), "nothing is created before the way is open"
