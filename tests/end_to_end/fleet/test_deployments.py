"""The command lines of compose.yaml and of Kubernetes, run as they stand: with certificates of `perfbound pki`.

Only what containers provide is replaced: the files that are mounted, the names of hosts, and the ports.
"""

import re
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.campaigns import with_few_checks
from tests.end_to_end.processes import Process, Processes, processes, wait_for
from tests.unit.deploy.files import Started, compose_started, kubernetes_started

ROLES = {"router": "router", "orchestrator": "orchestrator", "worker": "worker", "workers": "worker"}


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Processes]:
    with processes(tmp_path) as found:
        folder = ("--folder", str(tmp_path / "pki"))
        assert found.run("perfbound", "pki", "init", *folder).code == 0
        for role, more in (("router", ("--host", "localhost")), ("orchestrator", ()), ("worker", ())):
            out = ("--out", str(tmp_path / role))
            assert found.run("perfbound", "pki", "issue", role, f"--{role}", *more, *out, *folder).code == 0
        yield found


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@pytest.mark.parametrize("files", [compose_started, kubernetes_started])
def test_the_commands_run_a_campaign(started: Processes, files: Callable[[], dict[str, Started]]) -> None:
    port, page, folder = free_port(), free_port(), started.folder
    campaign = with_few_checks(folder / "campaign.toml", "test-function")

    def here(name: str, word: str) -> str:
        """Return a word of a command line with the files, hosts and ports of this test."""
        role = ROLES[name]
        kinds = {"ca": "ca", "certificate": role, "tls": role, "key": f"{role}-key", "tls-key": f"{role}-key"}
        option, _, value = word.rpartition("=")
        if value.startswith(("/run/secrets/", "/tls/")):
            kind = Path(value).stem.removeprefix(f"{role}-")
            return f"{option}={folder / role / kinds[kind]}.pem"
        word = re.sub(r"(0\.0\.0\.0|router):7447", f"localhost:{port}", word)
        word = word.replace("127.0.0.1:8080", f"127.0.0.1:{page}").replace("/runs/campaign", str(folder / "run"))
        return re.sub(r"^(/campaign)?/campaign\.toml", str(campaign), word)

    def start(name: str, command: int = 0) -> Process:
        program, *words = files()[name].commands()[command]
        return started.start(program, *(here(name, word) for word in words))

    (workers,) = files().keys() - {"router", "orchestrator"}
    router = start("router")
    wait_for(lambda: "router: listening at" in router.err)
    worker, orchestrator = start(workers), start("orchestrator")
    assert orchestrator.wait().code == 0
    certificate = (folder / "run" / "certificate.json").read_bytes()
    assert worker.wait().code == 0  # --until-done
    assert start("orchestrator", 1).wait().code == 0  # what a container that is started again runs
    assert (folder / "run" / "certificate.json").read_bytes() == certificate
    router.popen.terminate()
    assert router.wait().code == 0
