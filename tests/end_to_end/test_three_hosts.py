"""Router, orchestrator and workers on three hosts with the certificates of `perfbound pki`, by its printed commands."""

import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.orchestrator.fleet.authority import Order, certificate_bytes, issue_certificate, key_bytes
from perfbound.orchestrator.run.pki import load_signer
from tests.end_to_end.hosts import HUB, Host, hosts, no_namespaces
from tests.end_to_end.processes import Process, Processes, query, wait_for
from tests.fakes.certificates import DAY, now

pytestmark = pytest.mark.skipif(bool(no_namespaces()), reason=no_namespaces())
CAMPAIGN = """
name = "three-hosts"
seed = 1
composition = "single"
resolution = 21
max_tests = 12
visual = "none"
spot_check = 0
recheck = 4

[system]
name = "test-function"
noise_sd = 0.001

[space]
z1 = { low = 0.0, high = 5.0, unit = "1" }
z2 = { low = 0.0, high = 5.0, unit = "1" }

[[problems]]
name = "maximum"
column = "value"
method = "rigorous"
sense = "max"
delta = 0.05
alpha = 0.001
rkhs_norm = 2.0
noise_scale = 0.005
kernel = { nu = 10.0, length_scale = 1.0 }
"""
ENDPOINT = f"tls/{HUB}:7447"


class Office:
    """The machine of the authority; what it issues is copied to a host as the output says."""

    def __init__(self, started: Processes, name: str) -> None:
        self._started, self.folder = started, started.folder / name

    def pki(self, *words: str | Path) -> str:
        ended = self._started.run("perfbound", "pki", *words, "--folder", self.folder)
        assert ended.code == 0, ended.err
        return ended.out

    def issue(self, host: Host, *words: str) -> list[str]:
        """Issue a certificate, copy its files, and return the command of the host."""
        lines = [shlex.split(line) for line in self.pki("issue", *words).splitlines() if line.startswith("    ")]
        copy, *commands = lines
        assert copy[:2] == ["scp", "-rp"]
        assert copy[3:] == ["HOST:"]
        shutil.copytree(copy[2], host.home / Path(copy[2]).name)
        return commands[0]


@pytest.fixture
def site(started: Processes) -> Iterator[dict[str, Host]]:
    with hosts(started, "router", "orchestrator", "workers") as made:
        yield made


def answered(process: Process, line: str) -> None:
    """Wait for a line on stderr of a process that goes on trying."""
    wait_for(lambda: line in process.err or not process.running)
    assert line in process.err


def options(name: str, ca: str) -> list[str]:
    return ["--tls-ca", ca, "--tls-certificate", f"{name}/{name}.pem", "--tls-key", f"{name}/{name}-key.pem"]


def test_three_hosts(started: Processes, site: dict[str, Host]) -> None:
    (started.folder / "c.toml").write_text(CAMPAIGN)
    local = started.run("perfbound", "run", "c.toml", "--out", "local")
    assert local.code == 0, local.err

    office = Office(started, "pki")
    office.pki("init")
    workers = site["workers"]
    one, two = (office.issue(workers, name, "--worker") for name in ("node-1", "node-2"))
    orchestrate = office.issue(site["orchestrator"], "main", "--orchestrator")
    route = office.issue(site["router"], "gate", "--router", "--host", HUB)
    assert route[-6:] == ["--allow-orchestrator", "main", "--allow", "node-1", "--allow", "node-2"]

    def filled(command: list[str]) -> list[str]:
        values = {"tls/ROUTER:7447": ENDPOINT, "CAMPAIGN.toml": str(started.folder / "c.toml")}
        return [values.get(word, word) for word in command]

    router = site["router"].start(*route)
    wait_for(lambda: "router: listening at " in router.err)
    main = site["orchestrator"].start(*filled(orchestrate), "--out", "run")
    wait_for(lambda: "waiting for workers" in main.err)
    refused(started, office, workers, filled(one), filled(two))
    assert not query(site["orchestrator"].home / "run", "SELECT * FROM attempts")

    good = [workers.start(*filled(command)) for command in (one, two)]
    ended = main.wait()
    assert ended.code == 0, ended.err
    certificates = [
        folder / "certificate.json" for folder in (site["orchestrator"].home / "run", started.folder / "local")
    ]
    assert certificates[0].read_bytes() == certificates[1].read_bytes()
    names = {str(name).rpartition("-")[0] for (name,) in query(certificates[0].parent, "SELECT worker FROM attempts")}
    assert names <= {"node-1", "node-2"}
    assert names
    assert all(each.running for each in (router, *good))
    router.popen.terminate()
    assert router.wait().code == 0


def refused(started: Processes, office: Office, host: Host, one: list[str], two: list[str]) -> None:
    """Everything that must not get in, with its sentence, while an orchestrator waits for workers."""
    worker, connect = one[0], one[1:3]
    assert connect == ["--connect", ENDPOINT]
    others = Office(started, "others")
    others.pki("init")
    foreign = others.issue(host, "node-9", "--worker")[3:]
    stranger = office.issue(host, "node-3", "--worker")[3:]
    office.issue(host, "second", "--orchestrator")
    expire(office, host)

    plain = ENDPOINT.replace("tls/", "tcp/")
    waiting = [
        (host.start(worker, *connect, *foreign), f"the certificate of {HUB}:7447 is not signed by node-9/ca.pem; "),
        (host.start(worker, "--connect", plain), f"{plain} is encrypted; write tls/HOST:PORT"),
        (host.start(worker, *connect, *stranger), "must list 'node-3'"),
    ]
    other_role = f"{one[6]}: this is the certificate of the worker 'node-1'; "
    mixed, old, second = (options(name, "node-1/ca.pem") for name in ("node-9", "old", "second"))
    campaign = started.folder / "c.toml"
    for command, line in (
        ([worker, *connect], f"--connect {ENDPOINT}: tls needs --tls-ca, --tls-certificate and --tls-key"),
        ([worker, *connect, *mixed], "which has not signed it; fix the TLS options"),
        ([worker, *connect, *old], "old/old.pem: this certificate ended at "),
        (
            [*two, "--name", "node-1"],
            f"--name node-1: {ENDPOINT} was started with --allow, so a worker ",
        ),
        ([worker, *connect, *second], "second/second.pem: this is the certificate of the orchestrator 'second'; "),
        (
            ["perfbound", "orchestrate", campaign, *one[1:]],
            other_role,
        ),
        (
            ["perfbound", "router", "--listen", "tls/0.0.0.0:7447", *one[3:]],
            other_role,
        ),
    ):
        ended = host.run(*command)
        assert ended.code == 1
        assert line in ended.fault
    for process, line in waiting:
        answered(process, line)
        process.end()


def expire(office: Office, host: Host) -> None:
    """Put a certificate that has ended on a host, of the same authority."""
    signer = load_signer(office.folder)
    certificate, key = issue_certificate(signer, Order("old", "worker"), now() - 9 * DAY, 1)
    (host.home / "old").mkdir()
    (host.home / "old" / "old.pem").write_bytes(certificate_bytes(certificate))
    (host.home / "old" / "old-key.pem").touch(mode=0o600)
    (host.home / "old" / "old-key.pem").write_bytes(key_bytes(key))
