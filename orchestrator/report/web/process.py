"""The process that serves the page of a run: `python -m perfbound...report.web.process SOCKET HOST:PORT DIRECTORY`.

Its stdin is a socket on which the orchestrator sends what guards the page, then again and again the state of the run.
At the end of that feed the page shows the final state of the campaign and the process ends. The orchestrator prints the
lines of its stderr.
"""

import os
import signal
import socket
import sys
import threading
from pathlib import Path

from ....schemas.errors import one_line
from ...run.page.address import Address
from ...run.page.page_access import PageAccess
from ...run.page.page_feed import read_message
from .run_feed import RunFeed
from .server import Server

NICENESS = 10
"""Added to that of the orchestrator: the page must not slow the campaign down."""
DEADLINE = 2
"""Seconds after the end of the feed in which the kernel ends this process."""
LONGEST = 1024 * 1024
"""Bytes of a message."""


def serve_run(arguments: list[str]) -> None:
    """Serve until the feed ends."""
    descriptor, address, directory = arguments
    feed = socket.socket(fileno=0)
    access = PageAccess.from_json(feed.recv(LONGEST))
    server = Server(Path(directory), Address.parse(address), _print_line, access, RunFeed())
    threading.Thread(target=_follow, args=(feed, server), daemon=True).start()
    os.nice(NICENESS)  # after the imports: on a busy machine the page would appear late
    server.run([socket.socket(fileno=int(descriptor))])


def _follow(feed: socket.socket, server: Server) -> None:
    """Receive the state of the run until the feed ends, which it does with the orchestrator, also on kill -9."""
    while message := feed.recv(LONGEST):
        figures = read_message(message)
        server.snapshots.live, server.snapshots.link = figures.workers, figures.link
        server.feed.take(figures)
    signal.alarm(DEADLINE)  # the default action of SIGALRM ends the process even if its threads hang
    # Without the orchestrator the state of the workers and of its link is unknown.
    server.snapshots.live, server.snapshots.link = {}, None
    server.snapshots.abandon()
    server.should_exit = True


def _print_line(line: str) -> None:
    sys.stderr.write(one_line(line) + "\n")


if __name__ == "__main__":
    serve_run(sys.argv[1:])
