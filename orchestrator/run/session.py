"""One run of an orchestrator: the order in which everything is opened, so that faults cost least.

Nothing is created before the campaign file, the system and the endpoint have been checked.
"""

import shlex
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from ...schemas.errors import PerfboundError
from ...schemas.file.config import CampaignConfig
from ...schemas.link.secret import VARIABLE
from ...schemas.result.facts import Header
from ...schemas.rollout import RolloutRequest
from ...schemas.stop_signals import stop_signals
from ...schemas.system import SystemSpec
from ..campaign.checks import check_new
from ..campaign.software import software
from ..certificate import files
from ..fleet.children import child
from ..fleet.children.processes import Fleet
from ..fleet.link.transport import Transport
from ..store.journal import Journal, Origin
from ..store.rows import existing
from .collision import COLLISION, PoisonedError, is_collision
from .directory import check_vacant, claimed
from .display.systemd import Systemd, with_a_loop
from .first_rollouts import check_first_rollouts, is_own_system
from .options import RunOptions, check_own, check_platform, check_workers, reopened
from .page.live_page import LivePage, live_page
from .trust import doubted

if TYPE_CHECKING:
    from ..campaign.ledger import Ledger
import queue
import time

from ...schemas.link.configuration import LOCAL
from ...schemas.link.messages import RunFinished
from ..certificate.words.format import duration
from ..fleet.link.transport import Heartbeat, Inbound
from ..store.lock import is_held
from ..store.read import stored_header
from .link import Link


def start_campaign(
    config: CampaignConfig, source: Path, directory: Path, options: RunOptions, console: Console
) -> None:
    """Run a new campaign, read from the file `source`, to its certificate.

    Raises:
        PerfboundError: the system is missing, the directory or the endpoint is in use, or the run fails.
        CampaignError: the campaign does not fit the system.
        Stopped: a signal arrived.

    """
    reference = options.system or config.system.reference(source)
    spec = options.own.spec if options.own else system_of(config, source, reference)
    check_new(config, spec, str(source))
    check_workers(spec, options.own, source, options.workers)
    # After the file: a copied one with a typo is at fault itself, and not the directory of its name.
    check_vacant(directory, config)
    header, link = Header.new(config, spec, software(spec)), options.link
    with (
        live_page(link.web, directory, console, insecure=link.insecure) as page,
        _transport(options, console) as transport,
    ):
        if options.workers and options.own is None and is_own_system(reference):
            where = f"{source}: {config.system.place}"
            check_first_rollouts(header, reference, where, lambda line: console.print(Text(line), soft_wrap=True))
        with created(directory, header, options.origin(reference)) as journal:
            page.announce()
            found = replace(options, system=reference)
            _conduct(directory, journal, transport, page, options=found, console=console, resumed=False)
            page.end()


def system_of(config: CampaignConfig, source: Path, reference: str) -> SystemSpec:
    """Return the system of a campaign file or of a run directory, as a worker finds it now.

    Raises:
        CampaignError: it is missing, or cannot be used here.

    """
    return child.system_spec(reference, f"{source}: {config.system.place}", config.horizon)


def resume_campaign(directory: Path, options: RunOptions, console: Console, max_tests: int | None = None) -> bool:
    """Continue a campaign from its database; return False for a finished one, which is left as it is.

    Workers that may wait for a finished one at the link get a report of its end.

    With `max_tests` a finished campaign that ended by its budget gets this larger one, and continues.

    Raises:
        PerfboundError: there is no campaign, it is running, its software is another one, or the run fails; or it cannot
            be extended.
        Stopped: a signal arrived.

    """
    existing(directory)
    if max_tests is not None:
        from .extend import give_budget  # noqa: PLC0415  (loads the numerics, and few resumes need it)

        give_budget(directory, options, console, max_tests)
    if files.read(directory) is not None:
        console.print(Text(f"{directory}: finished already"), soft_wrap=True)
        Systemd().ready("finished already")  # else the service would have failed, and be started again and again
        report_finished(directory, options.link, lambda line: console.print(Text(line), soft_wrap=True))
        return False
    link = options.link
    with (
        live_page(link.web, directory, console, insecure=link.insecure) as page,
        reopened(directory, options) as (journal, reference),
    ):
        check_workers(journal.header.spec, options.own, directory, options.workers)
        if options.own is not None:
            check_own(journal.header, options.own.spec)
        page.announce()
        with _transport(options, console) as transport:
            found = replace(options, system=reference)
            _conduct(directory, journal, transport, page, options=found, console=console, resumed=True)
            page.end()
    return True


@contextmanager
def created(directory: Path, header: Header, origin: Origin) -> Iterator[Journal]:
    """Lock a run directory and make the journal of a new campaign.

    Raises:
        PerfboundError: the directory is in use or cannot be made.

    """
    with (
        claimed(directory, header.config) as held,
        closing(Journal.create(directory, header, origin, held)) as new,
    ):
        yield new


def _transport(options: RunOptions, console: Console) -> AbstractContextManager[Transport]:
    if options.own:
        return options.own.transport()
    return options.link.opened(
        local_workers=options.workers > 0, print_line=lambda line: console.print(Text(line), soft_wrap=True)
    )


def _shared(options: RunOptions) -> dict[str, str]:
    """Return the environment with which local workers know the secret; other processes of this user see no value."""
    secret = options.link.secret()
    return {} if secret is None else {VARIABLE: secret.decode()}


def _conduct(
    directory: Path,
    journal: Journal,
    transport: Transport,
    page: LivePage,
    *,
    options: RunOptions,
    console: Console,
    resumed: bool,
) -> None:
    try:
        ledger, report_end = _served(
            directory, journal, transport, page, options=options, console=console, resumed=resumed
        )
    except PoisonedError as fault:
        # Of a batch that fails as a whole nobody knows which rollout to repeat.
        if fault.request is not None and _collides(fault.request, journal, options):
            raise PerfboundError(f"{fault}. {fault.request.rollout}: {COLLISION}") from None
        raise
    recheck = ledger.closing.recheck
    differing = recheck.first_differing if recheck else None
    if differing and _collides(differing, journal, options):
        console.print(Text(f"{differing.rollout}: {COLLISION}"), soft_wrap=True)
    journal.check_place()
    from .certify import certify  # noqa: PLC0415

    with_a_loop().ready("issuing the certificate")
    certify(directory, ledger, report_end)


def _served(
    directory: Path,
    journal: Journal,
    transport: Transport,
    page: LivePage,
    *,
    options: RunOptions,
    console: Console,
    resumed: bool,
) -> "tuple[Ledger, Callable[[], None] | None]":
    """Have the workers simulate until the campaign is over; return it, and what tells them of its end."""
    run, systemd, link = journal.header.run, with_a_loop(), options.link
    report_end: Callable[[], None] | None = None
    with ExitStack() as stack:
        fleet = None
        if options.own or options.workers:
            check_platform(journal.platform, directory)
            own, more = options.own, [*link.worker_options(), *child.system_options(options.system)]
            ways = link.ways(transport.endpoint)
            fleet = own.fleet() if own else Fleet(options.workers, ways, run, more, _shared(options))
            stack.callback(_report_left, fleet, console)
            stack.callback(fleet.stop)
            fleet.start()
        else:
            line = [part for way in link.ways(transport.endpoint) for part in ("--connect", way)]
            line = ["perfbound-worker", *line, *link.options_elsewhere(), *child.system_options(options.system)]
            line += ["--manual", "logs"] if journal.header.spec.repeated == "nowhere" else []
            console.print(Text(f"waiting for workers: {shlex.join(line)}"), soft_wrap=True)
        # The numerics take seconds to load: only now, while the workers start.
        from ..campaign.ledger import Ledger  # noqa: PLC0415
        from .display.progress import SystemdStatus, listener  # noqa: PLC0415
        from .display.so_far import Contradictions, EvidenceSize, SoFarListener  # noqa: PLC0415
        from .service import Interrupted, Listener, Service, StopRequests  # noqa: PLC0415

        ledger = Ledger(directory, journal)
        ledger.replay()
        damaged = ledger.check_files(journal, whole=ledger.done) if resumed else 0
        if ledger.done and not any(doubted(journal)):
            console.print(
                Text("every test is done; computing the claims, their audit and the certificate"), soft_wrap=True
            )
            stack.close()  # its workers end now: they would only report that they wait for an orchestrator
        else:
            terminal = stack.enter_context(listener(console))
            if damaged:
                terminal.print_line(f"{damaged} trajectory files are missing or damaged: simulating them again")
            for sentence in _beforehand(ledger, resumed=resumed):
                terminal.print_line(sentence)
            contradictions = Contradictions(ledger.accounts, ledger.methods, terminal.print_line)
            requests = StopRequests(directory, terminal.print_line)
            so_far = SoFarListener(directory, ledger, terminal)
            listeners: list[Listener] = [so_far, terminal, SystemdStatus(systemd), page, contradictions, requests]
            if not resumed:
                listeners.append(EvidenceSize(ledger, terminal.print_line))
            service = Service(ledger, journal, transport, fleet, listeners, resumed=resumed, drain=options.drain)
            requests.put = service.inbox.put
            stack.enter_context(_signals(lambda number: service.inbox.put(Interrupted(number))))
            transport.start(run, service.inbox.put)
            systemd.ready(f"workers connect to {transport.endpoint}")
            service.run()
            # Whatever happened to the files meanwhile: the certificate names what is there when it is issued.
            while lost := ledger.check_files(journal, whole=True):
                terminal.print_line(f"{lost} trajectory files were removed or changed: simulating them again")
                service.run()
            report_end = service.report_end
    return ledger, report_end


def _beforehand(ledger: "Ledger", *, resumed: bool) -> Iterator[str]:
    """Yield what is known of a campaign before its next test: its scope and cost, and what will not come out."""
    from ..campaign import consistency  # noqa: PLC0415
    from ..campaign.closing import checks  # noqa: PLC0415
    from ..forecast import remaining  # noqa: PLC0415
    from ..mathematics.stl.units import mixed_units  # noqa: PLC0415

    plans = ledger.plans
    if not resumed:
        yield from consistency.scope(plans)
        config = ledger.config
        one = {} if config.formula is None else {"specification": config.formula}
        formulas = {each.name: each.formula for each in config.specifications} or one
        yield from mixed_units(formulas, ledger.header.spec.units)
        yield from checks.cost(ledger.header, plans)
    budgets = {name: replace(each, budget=ledger.accounts[name].budget) for name, each in plans.items()}
    yield from remaining.warnings(budgets)
    yield from consistency.before(plans, ledger.header.spec)


def _report_left(fleet: Fleet, console: Console) -> None:
    if fleet.left:
        line = (
            f"{fleet.left} processes that rollouts had started were still there after their worker, and were ended; "
            "`perfbound check-system` says what leaves them"
        )
        console.print(Text(line), soft_wrap=True)


def _collides(request: RolloutRequest, journal: Journal, options: RunOptions) -> bool:
    """Whether a rollout repeats alone that did not beside those of other local workers, which have ended."""
    if options.own or options.workers < 2 or options.system is None:
        return False
    header = journal.header
    return is_collision(request, header.spec, options.system, limit=header.config.deadline)


@contextmanager
def _signals(put: Callable[[int], None]) -> Iterator[None]:
    """Hand signals to `put`; after the first one, later ones do not interrupt the shutdown."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may take signals
        return
    taken = []

    def take(number: int, _frame: FrameType | None) -> None:
        taken.append(number)
        put(number)

    before = {number: signal.signal(number, take) for number in stop_signals()}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, signal.SIG_IGN if taken else old)


# Workers whose campaign is finished, and whose orchestrator was killed before it could tell them

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
