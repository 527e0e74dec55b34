"""The report to workers that their campaign is finished, where its orchestrator was killed before it could send it."""

import queue
import time
from collections.abc import Callable
from pathlib import Path

from ...schemas.errors import PerfboundError
from ...schemas.link.configuration import LOCAL
from ...schemas.link.messages import RunFinished
from ..fleet.link.transport import Heartbeat, Inbound, Transport
from ..store.lock import is_held
from ..store.read import stored_header
from .format import duration
from .link import Link

RETURN = 10.0
"""Seconds for workers to return: one without a link tries every 2 s, and joins the run before it gets the report."""
ROUTER_PATIENCE = 30.0
"""Seconds for a router: the certificate is there, so nobody waits longer for one."""


def report_finished(directory: Path, link: Link, print_line: Callable[[str], None]) -> None:
    """Report the end of a campaign with a certificate at `link`, if workers on other machines can be there.

    Workers with `--until-done` then end, and others look for another campaign. Where there is no way to them, that is
    a line, and no error: nothing is missing but this report.

    Raises:
        JournalError: the campaign cannot be read.

    """
    # Of a free port of the loopback no worker can know; and an orchestrator that still runs sends the report itself.
    if (link.endpoint == LOCAL and not link.routers) or is_held(directory):
        return
    run = stored_header(directory).run
    try:
        with link.opened(local_workers=False, print_line=print_line, patience=ROUTER_PATIENCE) as transport:
            print_line(f"reporting that to its workers for {duration(RETURN)}")
            tell_workers(transport, run, RETURN)
    except PerfboundError as error:
        print_line(f"its workers get no report of that: {error}")


def tell_workers(transport: Transport, run: str, seconds: float) -> None:
    """Report the end of `run` to every worker that sends a heartbeat within these seconds."""
    inbox: queue.SimpleQueue[Inbound] = queue.SimpleQueue()
    end = time.monotonic() + seconds
    transport.start(run, inbox.put)
    while (left := end - time.monotonic()) > 0:
        try:
            message = inbox.get(timeout=left)
        except queue.Empty:
            return
        # Not at its token: a worker that has not seen this orchestrator yet takes no message of it. And to every
        # heartbeat again: a message may be lost.
        if isinstance(message, Heartbeat):
            transport.send(message.worker, RunFinished())
