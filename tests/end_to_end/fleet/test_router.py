"""A router as users start it: several campaigns and workers behind it, its lines, and its end."""

import signal
from datetime import timedelta

import pytest

from tests.campaigns import with_few_checks
from tests.end_to_end.processes import Processes, wait_for
from tests.fakes.certificates import DAY, Site
from tests.sharing import free_port


@pytest.mark.journey
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


OTHER = """
import perfbound as pb

@pb.system(parameters={"z": pb.Parameter(0, 1)}, columns={"v": ""})
def other(z):
    return 1.0 + z
"""
ITS_CAMPAIGN = """
specification = "v >= 0"
max_tests = 8
alpha = 0.001
noise_scale = 0.0
rkhs_norm = 4.0
spot_check = 0
kernel = { length_scale = 0.5 }
[system]
python = "other.py:other"
[space]
z = { low = 0, high = 1 }
"""


@pytest.mark.parametrize("waits", [True, False])
def test_a_worker_without_the_system_of_one_campaign_serves_the_other_one(started: Processes, *, waits: bool) -> None:
    folder, endpoint = started.folder, f"tcp/127.0.0.1:{free_port()}"
    (folder / "other.py").write_text(OTHER)
    (folder / "other.toml").write_text(ITS_CAMPAIGN)
    campaign = with_few_checks(folder / "c.toml", "test-function")
    started.start("perfbound", "router", "--listen", endpoint)
    older = started.start(
        "perfbound", "orchestrate", folder / "other.toml", "--out", folder / "other", "--connect", endpoint
    )
    wait_for(lambda: "waiting for workers" in older.err)
    worker = started.start("perfbound-worker", "--connect", endpoint, *(["--until-done"] if waits else []))
    if not waits:
        ended = worker.wait()
        assert (ended.code, "has no system 'other'" in ended.err) == (1, True), ended.err
        return
    wait_for(lambda: "; waits for another run" in worker.err)
    own = started.start("perfbound", "orchestrate", campaign, "--out", folder / "own", "--connect", endpoint)
    assert own.wait().code == 0, own.err
    assert worker.wait().code == 0, worker.err
    assert older.running


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
