"""Hosts for tests: network namespaces that reach one of them, the hub, and no other; each has a home folder."""

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.end_to_end.processes import Ended, Process, Processes

HUB = "10.78.0.1"
"""The address of the hub, from every host."""
NAMES = Path("/etc/netns")
"""Of each namespace, the files that its processes find in /etc."""


@cache
def no_namespaces() -> str:
    """Return why this machine has no network namespaces; empty if it has."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        return "needs root and ip (iproute2)"
    name = f"pbprobe{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode:
        return f"needs network namespaces: {made.stderr.strip()}"
    ip("netns", "del", name)
    return ""


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


@dataclass
class Host:
    """A network namespace and a home folder, in which its commands run."""

    namespace: str
    home: Path
    processes: Processes

    def start(self, *words: str | Path, **environment: str) -> Process:
        """Start a command, as it is typed on this host."""
        program, *arguments = words
        prefix = ("ip", "netns", "exec", self.namespace, "env", "-u", "XDG_STATE_HOME", "--chdir", str(self.home))
        environment = {"HOME": str(self.home), **environment}
        return self.processes.start(str(program), *arguments, prefix=prefix, **environment)

    def run(self, *words: str | Path, **environment: str) -> Ended:
        return self.start(*words, **environment).wait()


@contextmanager
def hosts(processes: Processes, hub: str, *others: str) -> Iterator[dict[str, Host]]:
    """Make hosts that do not outlive this block; each of `others` has a cable to the hub, which forwards nothing.

    All of them know the name of the hub.
    """
    made: dict[str, Host] = {}
    try:
        for number, name in enumerate((hub, *others)):
            space, home = f"pb{os.getpid() % 10**7}{number}", processes.folder / name
            ip("netns", "add", space)
            made[name] = Host(space, home, processes)
            home.mkdir()
            (NAMES / space).mkdir(parents=True)
            (NAMES / space / "hosts").write_text(f"127.0.0.1 localhost\n{HUB} {hub}\n")
            ip("-n", space, "link", "set", "lo", "up")
        centre = made[hub].namespace
        ip("-n", centre, "address", "add", f"{HUB}/32", "dev", "lo")
        for number, name in enumerate(others, 1):
            _lay_cable(centre, made[name].namespace, number)
        yield made
    finally:
        processes.end()
        for host in made.values():
            ip("netns", "del", host.namespace)
            shutil.rmtree(NAMES / host.namespace, ignore_errors=True)


def _lay_cable(centre: str, space: str, number: int) -> None:
    ends: Sequence[tuple[str, str, str]] = (
        (centre, f"{space}h", f"10.78.{number}.1/24"),
        (space, space, f"10.78.{number}.2/24"),
    )
    ip("link", "add", ends[0][1], "netns", centre, "type", "veth", "peer", "name", space, "netns", space)
    for there, device, address in ends:
        ip("-n", there, "address", "add", address, "dev", device)
        ip("-n", there, "link", "set", device, "up")
    ip("-n", space, "route", "add", HUB, "via", f"10.78.{number}.1")
