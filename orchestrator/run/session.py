"""One run of an orchestrator: the order in which everything is opened, so that faults cost least.

Nothing is created before the campaign file, the system and the endpoint have been checked.
"""

import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from ...schemas.campaign import CampaignConfig
from ...schemas.campaign_file import differences, parse_campaign
from ...schemas.certificate import Certificate
from ...schemas.errors import CampaignError, JournalError, PerfboundError
from ...schemas.facts import Header
from ...schemas.link import Tls
from ..campaign.checks import check
from ..campaign.software import other_numerics, software
from ..certificate import files
from ..fleet import child
from ..fleet.processes import Fleet
from ..fleet.transport import ZenohTransport, listen
from ..store import read
from ..store.journal import Journal
from ..store.lock import campaign_lock
from ..store.read import read_header
from ..store.rows import DATABASE, existing
from .address import Address
from .format import resume_command
from .live_page import LivePage, live_page
from .systemd import Systemd

if TYPE_CHECKING:
    from ..campaign.ledger import Ledger

MAX_CAMPAIGN_FILE = 1024 * 1024
"""Bytes of a campaign file."""


@dataclass(frozen=True, slots=True)
class Link:
    """The endpoint for workers with its protection, and the address of the live page, if there is one."""

    endpoint: str
    tls: Tls | None = None
    insecure: bool = False
    web: Address | None = None

    def worker_options(self) -> list[str]:
        """Return the options with which local workers connect."""
        if self.tls is None:
            return []
        return ["--tls-ca", self.tls.ca, "--tls-certificate", self.tls.certificate, "--tls-key", self.tls.key]


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


def start_campaign(
    config: CampaignConfig, source: Path, directory: Path, options: RunOptions, console: Console
) -> None:
    """Run a new campaign, read from the file `source`, to its certificate.

    Raises:
        PerfboundError: the system is missing, the directory or the endpoint is in use, or the run fails.
        CampaignError: the campaign does not fit the system.
        Stopped: a signal arrived.

    """
    _check_vacant(directory, config)
    reference = config.system.reference(source.parent)
    spec = child.system_spec(reference, f"{source}: system.{'python' if config.system.python else 'name'}")
    check(config, spec, str(source))
    header, link = Header.new(config, spec, software(spec)), options.link
    with (
        live_page(link.web, directory, console, insecure=link.insecure) as page,
        listen(link.endpoint, link.tls, insecure=link.insecure) as transport,
        _claimed(directory, config),
        ExitStack() as stack,
    ):
        journal = Journal.create(directory, header, reference if child.in_file(reference) else None)
        stack.callback(journal.close)
        page.start()
        found = replace(options, system=reference)
        _conduct(directory, journal, transport, page, options=found, console=console, resumed=False)


def resume_campaign(directory: Path, options: RunOptions, console: Console) -> bool:
    """Continue a campaign from its database; return False for a finished one, which is left as it is.

    Raises:
        PerfboundError: there is no campaign, it is running, its software is another one, or the run fails.
        Stopped: a signal arrived.

    """
    existing(directory)
    if files.read(directory) is not None:
        console.print(Text(f"{directory}: finished already"), soft_wrap=True)
        return False
    link = options.link
    with (
        live_page(link.web, directory, console, insecure=link.insecure) as page,
        campaign_lock(directory),
        ExitStack() as stack,
    ):
        reference = options.system or read.system_reference(directory)
        journal = Journal.open(directory, reference if child.in_file(reference) else None)
        stack.callback(journal.close)
        _check_software(journal.header)
        _check_code(journal.header, reference)
        transport = stack.enter_context(listen(link.endpoint, link.tls, insecure=link.insecure))
        page.start()
        found = replace(options, system=reference)
        _conduct(directory, journal, transport, page, options=found, console=console, resumed=True)
    return True


def load_campaign(path: Path, **overrides: int) -> CampaignConfig:
    """Read a campaign file.

    Raises:
        CampaignError: it cannot be read, or is not a campaign.

    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_CAMPAIGN_FILE + 1)
    except OSError as error:
        raise CampaignError(f"{path}: {error.strerror}; choose a campaign file, e.g. one of deploy/campaigns") from None
    if len(data) > MAX_CAMPAIGN_FILE:
        raise CampaignError(f"{path}: more than {MAX_CAMPAIGN_FILE} bytes; choose a campaign file")
    return parse_campaign(data, str(path), lambda name: (path.parent / name).read_bytes(), **overrides)


def _check_vacant(directory: Path, config: CampaignConfig) -> None:
    if (directory / DATABASE).exists():
        found = stored_differently(directory, config)
        if found:
            raise PerfboundError(
                f"{directory}: the campaign stored here differs from the file: {found}. A campaign never "
                "changes after its start; choose another --out"
            )
        raise PerfboundError(
            f"{directory}: a campaign is here already; continue it with `{resume_command(directory)}`, "
            "or choose another --out"
        )
    if directory.exists() and (not directory.is_dir() or set(directory.iterdir()) - set(_unfinished(directory))):
        raise PerfboundError(f"{directory}: exists and is not empty; choose another --out")


def stored_differently(directory: Path, config: CampaignConfig) -> str:
    """Return where the campaign in `directory` differs from `config`; nothing if it does not, or cannot be read."""
    try:
        with read.reading(directory) as connection:
            stored = read_header(connection, directory).config
    except JournalError:
        return ""
    found = differences(stored, config)
    more = f"; and {len(found) - 3} more" if len(found) > 3 else ""
    return f"{'; '.join(found[:3])}{more}, respectively" if found else ""


def _unfinished(directory: Path) -> list[Path]:
    """Return the files of a database that was never finished: its orchestrator failed, or was killed."""
    return list(directory.glob(f"{DATABASE}.partial*"))


def _check_software(header: Header) -> None:
    for name, then, now in other_numerics(header.software, header.spec):
        raise JournalError(
            f"this campaign was started with {name} {then}, here is {now or 'none'}; resume it with the versions it "
            "was started with, or start a new campaign"
        )


def _check_code(header: Header, reference: str) -> None:
    """Refuse a system in a file that is not the one of the campaign; of an installed one the workers tell."""
    if child.in_file(reference) != bool(header.spec.code):
        wanted = "is in a file: give FILE.py:NAME" if header.spec.code else f"is installed: {header.spec.name}"
        raise JournalError(f"--system {reference}: the system of this campaign {wanted}")
    if not header.spec.code:
        return
    found, campaign = child.system_spec(reference, "--system"), header.spec
    changed = sorted(name for name, _ in found.code.items() ^ campaign.code.items())
    if changed or found.digest_by(header.rules) != header.system_sha256:
        what = (
            f"{', '.join(dict.fromkeys(changed))}: not the code" if changed else f"{reference}: not the specification"
        )
        raise JournalError(
            f"{what} with which this campaign was started; resume it with the files of then (--system FILE.py:NAME if "
            "they are elsewhere), or start a new campaign"
        )


@contextmanager
def _claimed(directory: Path, config: CampaignConfig) -> Iterator[None]:
    """Make the run directory and lock it; remove it if no campaign was started in it."""
    try:
        there = directory.is_dir()
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PerfboundError(f"{directory}: cannot be created ({error.strerror}); choose another --out") from None
    with campaign_lock(directory):
        _check_vacant(directory, config)  # again, under the lock: another orchestrator may have started here
        _remove(_unfinished(directory))
        try:
            yield
        finally:
            _remove(_unfinished(directory))
            if not there and not any(directory.iterdir()):
                directory.rmdir()


def _remove(files: list[Path]) -> None:
    for each in files:
        each.unlink()


def _conduct(
    directory: Path,
    journal: Journal,
    transport: ZenohTransport,
    page: LivePage,
    *,
    options: RunOptions,
    console: Console,
    resumed: bool,
) -> None:
    run, systemd = journal.header.run, Systemd()
    with ExitStack() as stack:
        fleet = None
        if options.workers:
            links = [*options.link.worker_options(), *child.system_options(options.system)]
            fleet = Fleet(options.workers, transport.endpoint, run, links)
            stack.callback(fleet.stop)
            fleet.start()
        else:
            text = f"waiting for workers: perfbound-worker --connect {transport.endpoint}"
            console.print(Text(text), soft_wrap=True)
        # The numerics take seconds to load: only now, while the workers start.
        from ..campaign import closing_checks, consistency, forecast  # noqa: PLC0415
        from ..campaign.ledger import Ledger  # noqa: PLC0415
        from .contradictions import Contradictions  # noqa: PLC0415
        from .progress import SystemdStatus, listener  # noqa: PLC0415
        from .service import Interrupted, Service  # noqa: PLC0415

        ledger = Ledger(directory, journal)
        ledger.replay()
        damaged = ledger.check_files(journal) if resumed else 0
        if not ledger.done:
            terminal = stack.enter_context(listener(console))
            if damaged:
                terminal.print_line(f"{damaged} trajectory files are missing or damaged: simulating them again")
            plans = ledger.plans
            for line in (
                *(() if resumed else closing_checks.cost(ledger.header, plans)),
                *forecast.warnings(plans),
                *consistency.before(plans, ledger.header.spec),
            ):
                terminal.print_line(line)
            contradictions = Contradictions(ledger.accounts, terminal.print_line)
            listeners = (terminal, SystemdStatus(systemd), page, contradictions)
            service = Service(ledger, journal, transport, fleet, listeners, resumed=resumed, drain=options.drain)
            stack.enter_context(_signals(lambda number: service.inbox.put(Interrupted(number))))
            transport.start(run, service.inbox.put)
            systemd.ready(f"workers connect to {transport.endpoint}")
            stack.callback(systemd.stopping)
            service.run()
    _certify(directory, ledger)


def _certify(directory: Path, ledger: "Ledger") -> None:
    from ..certificate.issue import issue, manifest  # noqa: PLC0415

    found = manifest((sha256, path) for _, sha256, path in read.observed(directory))
    irreproducible = read.irreproducible(directory) > 0
    files.write(directory, issue(ledger, found, irreproducible=irreproducible), found.text)


@contextmanager
def _signals(put: Callable[[int], None]) -> Iterator[None]:
    """Hand signals to `put`; after the first one, later ones do not interrupt the shutdown."""
    taken = []

    def take(number: int, _frame: FrameType | None) -> None:
        taken.append(number)
        put(number)

    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, signal.SIG_IGN if taken else old)


def finished_certificate(directory: Path) -> Certificate:
    """Return the certificate of a finished campaign.

    Raises:
        PerfboundError: there is none, or it is damaged.

    """
    found = files.read(directory)
    if found is None:
        raise PerfboundError(f"{directory}: no certificate yet; `{resume_command(directory)}` continues the campaign")
    return found
