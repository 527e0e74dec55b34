"""Three hosts over TLS by docs/hosts.md, in network namespaces: router, orchestrator and workers with certificates."""

import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.orchestrator.hosts.authority import Order, certificate_bytes, issue_certificate, key_bytes
from perfbound.orchestrator.hosts.pki import load_signer
from tests.end_to_end.fleet.hosts import Host, hosts, no_namespaces
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
ROUTER, MAIN, NODE, OTHER = "router.example", "main.example", "node-1.example", "node-2.example"
ENDPOINT = f"tls/{ROUTER}:7447"
PAGE = Path(__file__).parents[3] / "docs" / "hosts.md"
Command = list[str]


def of_page(section: str) -> list[Command]:
    """Return the commands of a section, as a shell takes them apart."""
    text = PAGE.read_text().partition(f"\n### {section}\n")[2].partition("\n##")[0].replace("\\\n", " ")
    found = [shlex.split(line) for line in text.splitlines() if line.startswith("    ")]
    assert found, section
    return found


class Site:
    """The hosts of the page, and the machine of its reader."""

    def __init__(self, started: Processes, made: dict[str, Host]) -> None:
        self._started, self.hosts, self.home = started, made, started.folder / "reader"
        self.home.mkdir()

    def run(self, command: Command) -> str:
        """Run a command on the reader's machine; what `scp` would copy is copied."""
        words = [word.replace("~", str(self.home), 1) if word.startswith("~/") else word for word in command]
        if words[0] == "scp":
            _, _, source, host = words
            shutil.copytree(source, self.hosts[host.removesuffix(":")].home / Path(source).name)
            return ""
        # As in a shell without XDG_STATE_HOME: the page names the folder that is then taken.
        ended = self._started.run(*words, HOME=str(self.home), XDG_STATE_HOME="")
        assert ended.code == 0, ended.err
        return ended.out

    def start(self, host: str, command: Command) -> Process:
        return self.hosts[host].start(*command)

    def route(self, command: Command) -> Process:
        router = self.start(ROUTER, command)
        wait_for(lambda: "router: listening at " in router.err)
        return router


@pytest.fixture
def site(started: Processes) -> Iterator[Site]:
    with hosts(started, ROUTER, MAIN, NODE, OTHER) as made:
        yield Site(started, made)


def test_the_page_from_nothing_to_three_hosts(started: Processes, site: Site) -> None:
    """Every command of the page; the certificate is that of a local run, byte by byte."""
    (started.folder / "c.toml").write_text(CAMPAIGN)
    local = started.run("perfbound", "run", "c.toml", "--out", "local")
    assert local.code == 0, local.err
    (site.hosts[MAIN].home / "campaign.toml").write_text(CAMPAIGN)
    printed = "".join(site.run(command) for command in of_page("Certificates"))
    (route,), (orchestrate,), (serve,) = (of_page(section) for section in ("Router", "Orchestrator", "Worker"))
    for command in (route, orchestrate, serve):
        assert sorted(command) in as_printed(printed)

    router = site.route(route)
    campaign = site.start(MAIN, orchestrate)
    wait_for(lambda: "waiting for workers" in campaign.err)
    run = site.hosts[MAIN].home / "runs" / "three-hosts"
    refuse_strangers(site, serve)
    assert not query(run, "SELECT * FROM attempts")

    router = with_another_host(site, router, route)
    renewed, copy, _ = of_page("Renewal")
    site.run(renewed)
    site.run(copy)
    workers = [
        site.start(NODE, serve),
        site.start(NODE, [word.replace("node-1/", "node-1-next/") for word in serve]),
        site.start(OTHER, [word.replace("node-1", "node-2") for word in serve]),
    ]
    ended = campaign.wait()
    assert ended.code == 0, ended.err
    assert (run / "certificate.json").read_bytes() == (started.folder / "local" / "certificate.json").read_bytes()
    names = {str(name).rpartition("-")[0] for (name,) in query(run, "SELECT worker FROM attempts")}
    assert names
    assert names <= {"node-1", "node-2"}
    assert all(each.running for each in (router, *workers))
    router.popen.terminate()
    assert router.wait().code == 0


def as_printed(text: str) -> list[Command]:
    """Return the commands that `pki issue` prints, with the names of this page; their options in any order."""
    named = {"tls/ROUTER:7447": ENDPOINT, "CAMPAIGN.toml": "campaign.toml"}
    lines = [shlex.split(line) for line in text.splitlines() if line.startswith("    ")]
    return [sorted(named.get(word, word) for word in line) for line in lines]


def with_another_host(site: Site, router: Process, route: Command) -> Process:
    """Follow the page for one more host; return the router that has been started again."""
    issue, copy, listing = of_page("Another host")
    site.run(issue)
    site.run(copy)
    allowed = shlex.split(site.run(listing).splitlines()[-1].partition("options of the router gate: ")[2])
    names = set(zip(allowed[::2], allowed[1::2], strict=True))
    assert {("--allow-orchestrator", "main"), ("--allow", "node-1"), ("--allow", "node-2")} <= names
    router.popen.terminate()
    assert router.wait().code == 0
    return site.route([*route[: route.index("--allow-orchestrator")], *allowed])


def refuse_strangers(site: Site, serve: Command) -> None:
    """Try what must not get in, while an orchestrator waits for workers: each has its sentence."""
    host, connect, own = site.hosts[NODE], serve[:3], serve[3:]
    foreign = site.hosts[NODE].home / "foreign"
    for words in (["init"], ["issue", "node-9", "--worker", "--out", str(foreign)]):
        site.run(["perfbound", "pki", *words, "--folder", str(site.home / "others")])
    for name, role in (("node-3", "worker"), ("second", "orchestrator")):
        site.run(["perfbound", "pki", "issue", name, f"--{role}", "--out", str(host.home / name)])
    with_ended_certificate(site, host.home / "old")
    plain = ENDPOINT.replace("tls/", "tcp/")
    waiting = [
        (
            host.start(*connect, *options("foreign", "node-9")),
            f"certificate of {ENDPOINT[4:]} is not signed by foreign/",
        ),
        (host.start(*connect, *options("node-3", "node-3")), "must list 'node-3'"),
        (host.start(*connect[:2], plain), f"{plain} is encrypted; write tls/HOST:PORT"),
    ]
    of_worker = f"{own[3]}: this is the certificate of the worker 'node-1'; choose one of the "
    (host.home / "c.toml").write_text(CAMPAIGN)
    for command, line in (
        (connect, f"--connect {ENDPOINT}: tls needs --tls-ca, --tls-certificate and --tls-key"),
        ([*connect, *own[:2], *options("foreign", "node-9")[2:]], "which has not signed it; fix the TLS options"),
        ([*connect, *options("old", "old")], "old/old.pem: this certificate ended at "),
        ([*serve, "--name", "node-2"], f"--name node-2: {ENDPOINT} was started with --allow, so a worker has the "),
        ([*connect, *options("second", "second")], "second/second.pem: this is the certificate of the orchestrator "),
        (["perfbound", "orchestrate", "c.toml", *serve[1:]], f"{of_worker}orchestrator"),
        (["perfbound", "router", "--listen", "tls/0.0.0.0:7447", *own], f"{of_worker}router"),
    ):
        ended = host.run(*command)
        assert ended.code == 1
        assert line in ended.last_line  # a wrong --name shows once the worker sees the router
    for process, line in waiting:
        wait_for(lambda process=process, line=line: line in process.err or not process.running)  # type: ignore[misc]
        assert line in process.err
        process.end()


def options(folder: str, name: str) -> Command:
    files = (f"{folder}/{file}" for file in ("ca.pem", f"{name}.pem", f"{name}-key.pem"))
    return [part for pair in zip(("--tls-ca", "--tls-certificate", "--tls-key"), files, strict=True) for part in pair]


def with_ended_certificate(site: Site, folder: Path) -> None:
    """Write what a host has whose certificate was not renewed."""
    authority = site.home / ".local" / "state" / "perfbound" / "pki"
    certificate, key = issue_certificate(load_signer(authority), Order("old", "worker"), now() - 9 * DAY, 1)
    folder.mkdir()
    shutil.copy(authority / "ca.pem", folder)
    (folder / "old.pem").write_bytes(certificate_bytes(certificate))
    (folder / "old-key.pem").touch(mode=0o600)
    (folder / "old-key.pem").write_bytes(key_bytes(key))
