"""The process that serves the page of a run: `python -m perfbound...report.web.process SOCKET HOST:PORT DIRECTORY`.

Its stdin is the feed of the orchestrator, and what it lives on: at its end the page shows how the campaign stands, and
ends too. What it says on stderr, the orchestrator says.
"""

import json
import os
import signal
import socket
import sys
import threading
from pathlib import Path

from ....schemas.errors import one_line
from ...run.address import Address
from ..workers import LiveState
from .server import Server, server

POLITE = 10
"""Added to the niceness: a page waits for the campaign, and not the other way round."""
LAST = 6
"""Seconds after the end of the feed in which the kernel ends us, whatever we do."""
MOST = 1024 * 1024
"""Bytes of a message."""


def main(arguments: list[str]) -> None:
    """Serve until the feed ends."""
    descriptor, address, directory = arguments
    page = server(Path(directory), Address.parse(address), _say)
    threading.Thread(target=_follow, args=(socket.socket(fileno=0), page), daemon=True).start()
    os.nice(POLITE)  # not before: on a busy machine the page would come late
    page.run([socket.socket(fileno=int(descriptor))])


def _follow(feed: socket.socket, page: Server) -> None:
    """Take what the orchestrator says about its workers, until it ends."""
    while message := feed.recv(MOST):
        page.looks.live = {name: LiveState(*known) for name, known in json.loads(message).items()}
    signal.alarm(LAST)  # SIGALRM kills; no thread of ours is needed for that
    page.looks.live = {}
    page.should_exit = True


def _say(line: str) -> None:
    sys.stderr.write(one_line(line) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
