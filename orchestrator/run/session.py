"""One run of an orchestrator: the order in which everything is opened, so that faults cost least.

Nothing is created before the campaign file, the system and the endpoint have been checked.
"""

import shlex
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Protocol

from rich.console import Console
from rich.text import Text

from ...schemas.errors import CampaignError, JournalError, PerfboundError
from ...schemas.file.config import CampaignConfig
from ...schemas.link.secret import VARIABLE
from ...schemas.platforms import ANY, platform_class
from ...schemas.result.facts import Header
from ...schemas.rollout import RolloutRequest
from ...schemas.stop_signals import stop_signals
from ...schemas.system import SystemSpec
from ..campaign.checks import check_new
from ..campaign.software import other_numerics, software
from ..certificate import files
from ..fleet.children import child
from ..fleet.children.processes import Fleet
from ..fleet.link.transport import Transport
from ..store import read
from ..store.journal import Journal, Origin
from ..store.lock import campaign_lock
from ..store.rows import existing
from .collision import COLLISION, PoisonedError, is_collision
from .directory import check_vacant, claimed, revision
from .display.systemd import Systemd, with_a_loop
from .link import Link
from .page.live_page import LivePage, live_page
from .report_finished import report_finished
from .trust import doubted

if TYPE_CHECKING:
    from ..campaign.ledger import Ledger

from ..store import stop_request
from .service import Interrupted, RunStatus


class OwnSystem(Protocol):
    """A system that no other process can import: its workers are made of this process, and need no network."""

    @property
    def spec(self) -> SystemSpec:
        """Its specification."""
        ...

    def transport(self) -> AbstractContextManager[Transport]:
        """Open the way to its workers."""
        ...

    def fleet(self) -> Fleet:
        """Return the workers, not started yet."""
        ...


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Settings of a run; none of them changes the certificate.

    With `drain`, the first signal lets the rollouts under way end; the second one stops at once.
    """

    workers: int
    """Local worker processes."""
    link: Link
    drain: bool = False
    system: str | None = None
    """The system as a worker finds it, its name or FILE.py:NAME; None for the one of the campaign file or database."""
    own: OwnSystem | None = None
    """The system where this process alone has it; `workers`, `link` and `system` are then not used."""

    @property
    def resume_options(self) -> list[str]:
        """The options with which `perfbound resume` waits for the same workers; none where all are local."""
        ways = self.link.options
        return ["--workers", str(self.workers), *ways] if ways else []

    def origin(self, reference: str) -> Origin:
        """Return what a later resume needs to find the workers, and a system that no name finds.

        Raises:
            LinkError: an endpoint is malformed, or does not fit the TLS options.

        """
        options = tuple(replace(self, link=self.link.elsewhere()).resume_options)
        if not child.in_file(reference):
            return Origin(options=options)
        return Origin(reference, revision(Path(reference.rpartition(":")[0] or reference).parent), options)


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
    where = f"{source}: system.{config.system.kind}"
    spec = options.own.spec if options.own else child.system_spec(reference, where)
    check_new(config, spec, str(source))
    # After the file: a copied one with a typo is at fault itself, and not the directory of its name.
    check_vacant(directory, config)
    header, link = Header.new(config, spec, software(spec)), options.link
    with (
        live_page(link.web, directory, console, insecure=link.insecure) as page,
        _transport(options, console) as transport,
        created(directory, header, options.origin(reference)) as journal,
    ):
        page.announce()
        found = replace(options, system=reference)
        _conduct(directory, journal, transport, page, options=found, console=console, resumed=False)
        page.end()


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
        check_workers(journal.header.spec, options.own, directory)
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


@contextmanager
def reopened(directory: Path, options: RunOptions) -> Iterator[tuple[Journal, str]]:
    """Lock a run directory and open its journal, with the system as a worker finds it.

    Raises:
        PerfboundError: there is no campaign, it is running, or its software or its system is another one.

    """
    with campaign_lock(directory) as held:
        reference = child.resolved(options.system or read.system_reference(directory))
        with closing(Journal.open(directory, options.origin(reference), held)) as journal:
            _check_software(journal.header)
            _check_code(journal.header, reference, options)
            yield journal, reference


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


def check_workers(spec: SystemSpec, own: OwnSystem | None, place: Path) -> None:
    """Refuse a system that no worker can have."""
    if spec.repeated == "nowhere":
        raise CampaignError(
            f"{place}: no simulator makes the rollouts of {spec.name}; hand them in: Campaign.ask_tell, or "
            f"perfbound.open({str(place)!r}).ask_tell() for a campaign that has begun"
        )
    if spec.repeated == "session" and own is None:
        raise CampaignError(
            f"{place}: {spec.name} was defined in an interactive session, so no worker can import it; continue there: "
            f"perfbound.resume({str(place)!r}, system={spec.name.replace('-', '_')})"
        )


def _check_software(header: Header) -> None:
    for name, then, now in other_numerics(header.software, header.spec):
        raise JournalError(
            f"this campaign was started with {name} {then}, here is {now or 'none'}; resume it with the versions it "
            "was started with, or start a new campaign"
        )


def check_platform(platform: str, place: Path) -> None:
    """Refuse local workers of a campaign for machines of another class.

    Raises:
        JournalError: this machine is of another class.

    """
    if platform not in (ANY, here := platform_class()):
        raise JournalError(
            f"{place}: this campaign is for the platform {platform}, this machine is {here}; run it there, or with "
            "--workers 0 and workers of that platform"
        )


def check_own(header: Header, spec: SystemSpec) -> None:
    """Refuse another system of this process than the campaign's.

    Raises:
        JournalError: it is another one.

    """
    if spec.digest != header.system_sha256:
        others = "; ".join(header.spec.differences(spec))
        raise JournalError(
            f"{spec.name}: not the function with which this campaign was started ({others}); give that one, or start a "
            "new campaign"
        )


def _check_code(header: Header, reference: str, options: RunOptions) -> None:
    """Refuse a system with other sources than those of the campaign."""
    campaign, installed = header.spec, header.config.system.kind == "name"
    if campaign.repeated != "anywhere":  # no process but one has it, and nothing here could be compared
        return
    if child.in_file(reference) == installed:
        wanted = f"is installed: {campaign.name}" if installed else "is in a file: give FILE.py:NAME or CAMPAIGN.toml"
        raise JournalError(f"--system {reference}: the system of this campaign {wanted}")
    if installed and not options.workers:
        return  # the workers have it, and are compared when they arrive
    found = child.system_spec(reference, "--system")
    if found.digest != header.system_sha256:
        others = "; ".join(campaign.differences(found))
        remedy = "with the version of then" if installed else "with the files of then (--system, if they are elsewhere)"
        raise JournalError(
            f"{reference}: not the system with which this campaign was started: {others}; resume it {remedy}, or start "
            "a new campaign"
        )


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
        if _collides(fault.request, journal, options):
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
            console.print(Text(f"waiting for workers: {shlex.join(line)}"), soft_wrap=True)
        # The numerics take seconds to load: only now, while the workers start.
        from ..campaign.ledger import Ledger  # noqa: PLC0415
        from .display.progress import SystemdStatus, listener  # noqa: PLC0415
        from .display.so_far import Contradictions, SoFarListener  # noqa: PLC0415
        from .service import Interrupted, Service  # noqa: PLC0415

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
            listeners = (so_far, terminal, SystemdStatus(systemd), page, contradictions, requests)
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

    plans = ledger.plans
    if not resumed:
        yield from consistency.scope(plans)
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


class StopRequests:
    """A listener that examines the run directory at every tick, and hands a request to `put`, the loop's own inbox."""

    def __init__(self, directory: Path, print_line: Callable[[str], None]) -> None:
        self.put: Callable[[Interrupted], None] | None = None
        self._directory, self._print_line = directory, print_line

    def print_line(self, line: str) -> None:
        """Drop the line: another listener prints it."""

    def show(self, status: RunStatus) -> None:  # noqa: ARG002
        """Take a request, if there is one."""
        manner = stop_request.take_request(self._directory)
        if manner is None or self.put is None:
            return
        self._print_line("`perfbound stop` has asked for the end of this run")
        # As Ctrl-C: a library gets its KeyboardInterrupt, and a command ends with 130.
        self.put(Interrupted(signal.SIGINT, drain=manner == "drain"))
