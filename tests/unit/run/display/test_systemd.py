"""Messages to systemd, on a socket of the test."""

import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.orchestrator.run.display.systemd import Systemd
from tests.end_to_end.processes import wait_for


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(tmp_path / "notify"))
        sock.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield sock


def notified(manager: socket.socket) -> list[str]:
    messages = []
    while True:
        try:
            messages.append(manager.recv(4096).decode())
        except BlockingIOError:
            return messages


def test_ready_alive_and_stopping(manager: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "20000000")
    clock = iter([100.0, 101.0, 110.5])
    monkeypatch.setattr("perfbound.orchestrator.run.display.systemd.time.monotonic", lambda: next(clock))
    systemd = Systemd()
    systemd.ready("serving")
    systemd.alive("1 of 5 tests")
    systemd.alive("1 of 5 tests")
    systemd.alive("2 of 5 tests")
    systemd.stopping()
    assert notified(manager) == [
        "READY=1\nSTATUS=serving",
        "WATCHDOG=1",
        "STATUS=1 of 5 tests",
        "WATCHDOG=1",
        "STATUS=2 of 5 tests",
        "STOPPING=1",
    ]


@pytest.mark.integration
def test_alive_outside_the_loop_until_it_turns_again(manager: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "20000")
    systemd = Systemd()
    for _ in range(2):
        systemd.outside_loop()
        systemd.outside_loop()  # as well, and by one thread
        assert [each.name for each in threading.enumerate()].count("watchdog") == 1
        wait_for(lambda: notified(manager).count("WATCHDOG=1") >= 1)
        systemd.alive("")
        wait_for(lambda: "watchdog" not in {each.name for each in threading.enumerate()})


def test_a_watchdog_of_another_process_is_not_ours(manager: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "20000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid() + 1))
    Systemd().alive("")
    Systemd().outside_loop()
    assert notified(manager) == []


def test_an_abstract_address(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(f"\0perfbound-{os.getpid()}")
        monkeypatch.setenv("NOTIFY_SOCKET", f"@perfbound-{os.getpid()}")
        Systemd().stopping()
        assert sock.recv(100) == b"STOPPING=1"


def test_without_systemd_nothing_happens(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    Systemd().ready("serving")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "no-socket"))
    Systemd().ready("serving")
