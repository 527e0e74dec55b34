"""The life of a worker process: one campaign after the other, until the worker ends."""

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import click

from ..schemas.errors import RefusedError
from ..schemas.link import key_expressions
from ..schemas.link.configuration import Tls
from ..schemas.link.reminder import Reminder, StateLines
from ..schemas.link.tls_files import check_valid
from ..schemas.link.unanswered import UNLINKED, no_link, no_orchestrator
from .ends import EndOptions, gone_since, is_abandoned
from .failing import fail
from .stopping import STOPPED, Stopping
from .transport import ZenohUplink, connect
from .worker import POLL, WorkerProcess

UNSERVED = 10.0
"""Seconds without an orchestrator until the first line."""
CERTIFICATE_PERIOD = 10.0
"""Seconds between two readings of the own certificate, while there is no link or no orchestrator."""
LOOK = 0.02
"""Seconds between two looks for an orchestrator."""


class LinkOptions(NamedTuple):
    """Where an orchestrator is expected, and what this worker shows there."""

    endpoints: tuple[str, ...]
    tls: Tls | None
    secret: bytes | None
    common_name: str
    """Of the certificate of this worker, if it has one."""

    @property
    def connected(self) -> str:
        """The line that the link is there."""
        return f"connected to {' or '.join(self.endpoints)}"


class Life:
    """The times of this process by which it ends, and the signal that ends it."""

    def __init__(self, ends: EndOptions, stopping: Stopping) -> None:
        self.ends, self.stopping = ends, stopping
        self._started = self.last_campaign = time.monotonic()
        self.served = False
        """Whether there has been a campaign."""

    @property
    def is_over(self) -> bool:
        """Whether it takes no new rollout."""
        return self.stopping.asked or self.ends.is_over(time.monotonic() - self._started)

    @property
    def is_idle_for_too_long(self) -> bool:
        """Whether it has been without a campaign for too long."""
        return self.ends.is_idle_for_too_long(time.monotonic() - self.last_campaign)

    def check(self) -> None:
        """End the process if it is time, while it serves no campaign."""
        if self.is_over:
            if not self.stopping.asked:
                click.echo("perfbound-worker: the time of --max-hours is over", err=True)
            sys.exit(STOPPED if self.stopping.asked else 0)
        if self.is_idle_for_too_long:
            if not self.served:
                fail(f"no campaign within {self.ends.idle_exit:g} s; check that its orchestrator runs (--idle-exit)")
            sys.exit(0)


def serve_campaigns(link: LinkOptions, life: Life, name: str, *, run: str | None, identity: str | None) -> int:
    """Serve campaigns, only that of `run` if it is given; return the exit code.

    Raises:
        LinkError: the endpoint is malformed, or a TLS file is missing or no longer valid.

    """
    started, finished = (
        identity or key_expressions.fresh_id(name),
        set[str](),
    )  # orchestrators that need this worker no more
    # What a local worker does, its orchestrator shows.
    print_news = _print_line if identity is None else _print_nothing
    lines = StateLines(
        partial(no_link, link.endpoints, "worker", link.tls), link.connected, _print_line, first=UNLINKED
    )

    def waiting() -> None:
        life.check()
        lines.see(lasts=True)

    with connect(link.endpoints, link.tls, waiting, link.secret) as uplink:
        lines.see(lasts=False)
        while True:
            served = life.served
            orchestrator, chosen = _choose(uplink, run, link, life, finished)
            check = _link_checks(link, uplink, orchestrator, chosen, None if identity else name)
            check()
            print_news(f"serves run {chosen}")
            worker = WorkerProcess(started, uplink)
            life.stopping.attend(worker)
            uplink.join(chosen, worker.name, worker.receive)
            try:
                end = worker.serve(_abandoned(uplink, chosen, worker, life, check, pinned=run is not None))
            except RefusedError as error:
                finished |= _of_run(uplink, chosen)
                # A router may have campaigns of other systems: the one that this worker is for may still be announced.
                if run is not None or (life.ends.idle_exit is None and not _to_serve(uplink, run, finished)):
                    fail(str(error))
                _print_line(f"{error}; waits for another run")
                life.served, end = served, "left"
            uplink.leave()
            if end == "finished":
                print_news(f"run {chosen} is finished")
                # Its token may stay for a while; a new orchestrator of this run has another name.
                finished |= _of_run(uplink, chosen)
                if life.ends.until_done and not _to_serve(uplink, run, finished):
                    return 0
            # A fresh name for each run: with that of the orchestrator it is the nonce of all seals.
            started = key_expressions.fresh_id(name)


def _link_checks(
    link: LinkOptions, uplink: ZenohUplink, orchestrator: str, run: str, name: str | None
) -> Callable[[], None]:
    """Return what a worker examines while it serves a run: its name, its link, its orchestrator."""
    check_certificate = _certificate_check(link.tls)

    def reason() -> str:
        return f"the link is down; {no_link(link.endpoints, 'worker', link.tls)}"

    def absence() -> str:
        return no_orchestrator(link.endpoints, run, strangers=uplink.strangers, common_name=link.common_name)

    down = StateLines(reason, link.connected, _print_line, first=UNLINKED)
    absent = StateLines(absence, f"found the orchestrator of run {run}", _print_line, first=UNSERVED)

    def check() -> None:
        # Not only before it joins: the token of a router may come after that of the orchestrator behind it.
        if name not in (None, link.common_name) and uplink.by_certificate(orchestrator):
            fail(
                f"--name {name}: {' or '.join(link.endpoints)} was started with --allow, so a worker has the common "
                f"name of its certificate, here {link.common_name!r}; leave --name out"
            )
        linked = uplink.linked
        if not linked:
            check_certificate()
        down.see(lasts=not linked)
        absent.see(lasts=linked and all(found != run for _, found in uplink.orchestrators()))

    return check


def _certificate_check(tls: Tls | None) -> Callable[[], None]:
    """Return what ends a worker whose certificate has ended, since its link is closed then; for frequent calls."""
    rhythm = Reminder(CERTIFICATE_PERIOD, now=time.monotonic(), most=CERTIFICATE_PERIOD)

    def check() -> None:
        if tls is not None and rhythm.is_due(time.monotonic()):
            check_valid(tls.certificate)

    return check


def _print_line(line: str) -> None:
    click.echo(f"perfbound-worker: {line}", err=True)


def _print_nothing(_line: str) -> None:
    """Take a line that nobody needs."""


def _to_serve(uplink: ZenohUplink, run: str | None, finished: set[str]) -> list[tuple[str, str]]:
    """Return (orchestrator, run) of those that may be served, the oldest first."""
    return [(name, found) for name, found in uplink.orchestrators() if run in (None, found) and name not in finished]


def _of_run(uplink: ZenohUplink, run: str) -> set[str]:
    """Return the orchestrators that are announced for a run."""
    return {name for name, found in uplink.orchestrators() if found == run}


def _choose(uplink: ZenohUplink, run: str | None, link: LinkOptions, life: Life, finished: set[str]) -> tuple[str, str]:
    reminder, check_certificate = Reminder(UNSERVED, now=time.monotonic()), _certificate_check(link.tls)
    while not (found := _to_serve(uplink, run, finished)):
        life.check()
        check_certificate()
        if reminder.is_due(time.monotonic()):
            _print_line(no_orchestrator(link.endpoints, run, strangers=uplink.strangers, common_name=link.common_name))
        time.sleep(LOOK)
    life.check()
    life.served = True
    # The oldest, so that workers without --run serve one campaign after the other, and not each another one.
    return found[0]


def _abandoned(
    uplink: ZenohUplink, chosen: str, worker: WorkerProcess, life: Life, check: Callable[[], None], *, pinned: bool
) -> Callable[[bool], bool]:
    """Return what the worker asks between two rollouts: whether the run goes on without it, or it without the run."""
    gone = asked = life.last_campaign = time.monotonic()
    # Of a link to the orchestrator itself, its end is that of the orchestrator.
    routed = False

    def abandoned(outbox_empty: bool) -> bool:
        nonlocal gone, asked, routed
        now, linked = time.monotonic(), uplink.linked
        routed = uplink.routed if linked else routed
        present = any(run == chosen for _, run in uplink.orchestrators())
        if life.is_over:
            worker.leave()
        if present or now - asked > 3 * POLL:  # a rollout has just ended
            life.last_campaign = now
        check()
        asked = time.monotonic()  # after the check, which may take seconds
        gone = gone_since(gone, now, present=present or pinned, linked=linked or not routed)
        return life.is_idle_for_too_long or is_abandoned(now - gone, outbox_empty=outbox_empty)

    return abandoned
