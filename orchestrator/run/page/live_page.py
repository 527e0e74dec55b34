"""The live page of a run: a child process that serves it, and a feed of what the database does not contain.

The page must not affect the campaign: the child has a session and a priority of its own, messages that it does not read
are dropped, and its failure is reported in one line. It ends with its feed, so also after kill -9 of the orchestrator.
"""

import contextlib
import os
import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from ....schemas.errors import PerfboundError
from .address import Address
from .page_access import PageAccess, PagePlace, opened
from .page_feed import message

if TYPE_CHECKING:
    from ..service import RunStatus

PERIOD = 1.0
"""Seconds between two messages to the child."""
GRACE = 1.5
"""Seconds for the child to show the end of the campaign before it is killed, those for the end of the link among them.

With the second of the local workers (`fleet.processes`) these are all waits between the last rollout and the exit.
"""
MOST_OUTPUT = 4096
"""Bytes of the child's output that are read in one turn."""


def page_command(directory: Path) -> str:
    """Return the command that serves the page without the run."""
    return f"`perfbound web {shlex.quote(str(directory))}`"


@contextmanager
def live_page(place: PagePlace | None, directory: Path, console: Console, *, insecure: bool) -> Iterator["LivePage"]:
    """Serve the page from the start, so that a run without its page does not begin; without a place, no page.

    Probes ask whether this process lives before it has a router, and a new campaign its database.

    Raises:
        PerfboundError: the port is taken, or the place cannot be served.

    """
    if place is None:
        yield LivePage(directory, console)
        return
    listening, address, access = opened(place, insecure=insecure)
    with listening:  # from here on the port is the child's alone
        process = _PageProcess(listening, address, access, directory)
    page = LivePage(directory, console, process, tuple(access.lines("live page", address)))
    try:
        yield page
    finally:
        page.stop()


class LivePage:
    """The page of one run."""

    def __init__(
        self, directory: Path, console: Console, process: "_PageProcess | None" = None, lines: tuple[str, ...] = ()
    ) -> None:
        self._directory, self._console, self._child, self._lines = directory, console, process, lines
        self._announced = False
        self._next = 0.0

    def announce(self) -> None:
        """Print the address, if there is a page; the campaign has its database by now."""
        self._announced = True
        for line in self._lines:
            self._print_line(line)

    def print_line(self, line: str) -> None:
        """Drop the line: the page shows the campaign, not its log."""

    def show(self, status: "RunStatus") -> None:
        """Send the state of the run to the child, at most once in `PERIOD` or at its end, and without waiting."""
        now = time.monotonic()
        if self._child is None or (now < self._next and not status.loop.done):
            return
        self._next = now + PERIOD
        try:
            for line in self._child.turn(message(status)):
                self._print_line(line)
        except Exception as error:  # noqa: BLE001  (any: a page must not stop a campaign)
            self._child.stop(grace=0.0)
            self._child = None
            self._print_line(
                f"the live page has ended: {error}. The campaign continues; {page_command(self._directory)} shows it"
            )

    def end(self) -> None:
        """Let the child show the end of the campaign from now on."""
        if self._child is not None:
            self._child.end()

    def stop(self) -> None:
        """End the child; one whose address was printed shows the end of the campaign first."""
        if self._child is None:
            return
        self._child.stop(GRACE if self._announced else 0.0)
        if self._announced:
            self._print_line(f"the live page has ended with the run; {page_command(self._directory)} shows it again")

    def _print_line(self, line: str) -> None:
        self._console.print(Text(line), soft_wrap=True)


class _PageProcess:
    """The process that serves the page, with a socket to its stdin that keeps messages apart."""

    def __init__(self, listening: socket.socket, address: Address, access: PageAccess, directory: Path) -> None:
        self._ended = 0.0
        self._feed, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._feed.setblocking(False)
        with theirs:
            self._process = subprocess.Popen(
                [
                    # -P: a module of the current directory must not replace an installed one.
                    *(sys.executable, "-P", "-m", "perfbound.orchestrator.report.web.process"),
                    *(str(listening.fileno()), str(address), str(directory)),
                ],
                bufsize=0,
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                pass_fds=[listening.fileno()],
                start_new_session=True,  # Ctrl-C in the terminal is for the orchestrator
            )
        # The first message: on a command line, or in an environment, other processes could read the token.
        with contextlib.suppress(ConnectionError):  # it has ended, see `turn`
            self._feed.send(access.to_json())
        assert self._process.stderr is not None, "a pipe was asked for"
        self._stderr = self._process.stderr
        os.set_blocking(self._stderr.fileno(), False)

    def turn(self, message: bytes) -> list[str]:
        """Send a message if there is room, and return the lines that the child has printed.

        Raises:
            PerfboundError: it has ended.

        """
        output = (self._stderr.read(MOST_OUTPUT) or b"").decode(errors="replace").split("\n")
        lines = [f"live page: {line.strip()}" for line in output if line.strip()]
        if (code := self._process.poll()) is not None:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            raise PerfboundError("; ".join([how, *lines[-1:]]))
        with contextlib.suppress(BlockingIOError, ConnectionError):  # full: dropped; closed: it has ended, see above
            self._feed.send(message)
        return lines

    def end(self) -> None:
        """Close the feed, at whose end the child ends."""
        self._feed.close()
        self._ended = self._ended or time.monotonic()

    def stop(self, grace: float) -> None:
        """Wait for the child until `grace` s after the end of its feed, then kill it."""
        self.end()
        try:
            self._process.wait(max(0.0, self._ended + grace - time.monotonic()))
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._stderr.close()
