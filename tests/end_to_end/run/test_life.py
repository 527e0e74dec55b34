"""The life of an orchestrator process: draining, systemd, log lines for programs, a file that was changed."""

import json
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.end_to_end.processes import Processes, query, recorded, under_way, wait_for, write_campaign
from tests.patience import PATIENCE


def test_draining_loses_no_rollout_that_was_begun(started: Processes, calm: Path) -> None:
    directory = started.folder / "run"
    process = started.start(
        "perfbound", "run", write_campaign(started.folder / "c.toml"), "--out", directory, "--drain"
    )
    wait_for(lambda: recorded(directory) >= 4)
    process.popen.send_signal(signal.SIGTERM)
    ended = process.wait()
    assert ended.code == 128 + signal.SIGTERM
    assert "draining: " in ended.err
    assert ended.err.endswith(f"perfbound: stopped; continue with: perfbound resume {directory}\n")
    assert not under_way(directory)
    assert not query(directory, "SELECT * FROM outcomes WHERE outcome <> 'recorded'")
    assert 4 <= recorded(directory) < 24
    assert started.run("perfbound", "resume", directory).code == 0
    assert (directory / "certificate.json").read_bytes() == (calm / "certificate.json").read_bytes()


def test_log_lines_for_programs(started: Processes) -> None:
    directory = started.folder / "run"
    campaign = write_campaign(started.folder / "c.toml", max_tests="2")
    ended = started.run("perfbound", "run", campaign, "--out", directory, "--log", "json")
    lines = [json.loads(line) for line in ended.err.splitlines()]
    assert {line["problem"]: line["tests"] for line in lines if line["message"] == "problem ended"} == {
        "nominal_robustness": 2,
        "sim_gap": 2,
    }
    assert all(line["time"].endswith("+00:00") for line in lines)
    # The paper's norms are refuted by its first observations.
    warned = {line["assumption"] for line in lines if line["message"] == "refuted"}
    assert "rkhs_norm/nominal_robustness" in warned
    assert all(line["level"] == ("warning" if line["message"] == "refuted" else "info") for line in lines)
    failed = started.run("perfbound", "run", campaign, "--out", directory, "--log", "json")
    (line,) = [json.loads(text) for text in failed.err.splitlines()]
    assert (failed.code, line["level"]) == (1, "error")
    assert "a finished campaign is here; `perfbound show" in line["message"]


def test_systemd_is_told(started: Processes) -> None:
    directory, address = started.folder / "run", started.folder / "notify"
    with service_manager(address) as manager:
        process = started.start(
            "perfbound",
            *("run", write_campaign(started.folder / "c.toml"), "--out", directory),
            NOTIFY_SOCKET=str(address),
            WATCHDOG_USEC="1000000",
        )
        received = up_to(manager, "STOPPING=1")
        assert process.wait().code == 0
    assert "READY=1\nSTATUS=workers connect to tcp/127.0.0.1:" in received
    assert received.count("WATCHDOG=1") >= 1
    assert "STATUS=nominal_robustness 8 tests, sim_gap 8 tests; " in received


SLOW = """
import os, socket, time
from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.cli import campaigns, main
from perfbound.orchestrator.run import certify


def slow(owner, name):
    quick = getattr(owner, name)

    def called(*arguments, **named):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
            manager.connect(os.environ["NOTIFY_SOCKET"])
            manager.send(f"begin {name}".encode())
            time.sleep(3)
            manager.send(f"end {name}".encode())
        return quick(*arguments, **named)

    setattr(owner, name, called)


slow(Ledger, "replay")
slow(Ledger, "check_files")
slow(certify, "certify")
slow(campaigns, "draw")
main()
"""


def test_the_watchdog_is_told_whatever_a_campaign_works_at(started: Processes) -> None:
    """On a slow disk all files are checked for minutes, with no turn of the loop in between."""
    address, campaign = started.folder / "notify", write_campaign(started.folder / "c.toml", max_tests="2")
    with service_manager(address) as manager:
        arguments = ("-c", SLOW, "run", campaign, "--out", "run")
        process = started.start("python", *arguments, NOTIFY_SOCKET=str(address), WATCHDOG_USEC="1000000")
        received = up_to(manager, "STOPPING=1")
        assert process.wait().code == 0, process.err
    for name in ("replay", "check_files", "certify", "draw"):
        _, _, rest = received.partition(f"begin {name}\n")
        during, end, _ = rest.partition(f"end {name}\n")
        assert end
        assert during.count("WATCHDOG=1") >= 2, (name, received)


def test_a_finished_campaign_is_a_service_that_has_started(started: Processes, calm: Path) -> None:
    """As after a reboot: a service that ends without its notification has failed, and is started again without end."""
    with service_manager(started.folder / "notify") as manager:
        ended = started.run("perfbound", "resume", calm, NOTIFY_SOCKET=str(started.folder / "notify"))
        assert ended.code == 0, ended.err
        assert up_to(manager, "READY=1") == "READY=1\nSTATUS=finished already\n"


@contextmanager
def service_manager(address: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(address))
        manager.settimeout(PATIENCE)
        yield manager


def up_to(manager: socket.socket, last: str) -> str:
    """Return all notifications up to one that contains `last`."""
    received = ""
    while last not in received:
        received += manager.recv(4096).decode() + "\n"
    return received


def test_a_changed_file_is_refused_with_the_difference(started: Processes) -> None:
    directory = started.folder / "run"
    campaign = write_campaign(started.folder / "c.toml", max_tests="2")
    assert started.run("perfbound", "run", campaign, "--out", directory).code == 0
    write_campaign(campaign, max_tests="3", risk_weight="0.3")
    ended = started.run("perfbound", "run", campaign, "--out", directory)
    assert ended.code == 1
    assert "max_tests is 2 and 3; risk_weight is 0.2 and 0.3, respectively" in ended.fault
