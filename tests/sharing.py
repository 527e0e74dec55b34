"""What tests of several processes share: folders that one of them makes, and ports that only one of them uses."""

import fcntl
import itertools
import os
import shutil
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PORTS = range(20_000, 32_000)
"""Below those that the kernel gives to a process that asks for any port, so that no connection takes one of them."""
SHARE = 500
"""Ports of one process of the tests."""


def shared_folder(factory: pytest.TempPathFactory) -> Path:
    """Return a folder of all processes of this test run; the only process has one too."""
    base = factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


def made_once(folder: Path, make: Callable[[Path], object]) -> Path:
    """Return `folder` as `make` has filled it, in the process that comes first; the others wait for it.

    What fails in one process is tried again by the next one.
    """
    with folder.with_name(f"{folder.name}.lock").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        made = folder.with_name(f"{folder.name}.made")
        if not made.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            made.touch()
    return folder


def own_ports(process: int, start: int) -> Iterator[int]:
    """Return the ports of a numbered process over and over, from one of them on: another test run may use the first."""
    own = PORTS[process * SHARE % len(PORTS) :][:SHARE]
    return itertools.cycle([*own[start % SHARE :], *own[: start % SHARE]])


_PORTS = own_ports(int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")), os.getpid())


def free_port() -> int:
    """Return a port of the loopback on which nothing listens, and which no other process of the tests gets."""
    for port in _PORTS:
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError("the ports never end")
