"""One run of an orchestrator: everything that is opened, in the order in which faults cost least.

Nothing is created before the campaign file, the system and the endpoint are known to be good.
"""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from rich.console import Console

from orchestrator.certificate import files
from orchestrator.errors import JournalError, PerfboundError
from orchestrator.stl.formula import FormulaError, parse as parse_formula
from orchestrator.store import evidence
from orchestrator.store.journal import Header, Journal, existing
from orchestrator.store.lock import campaign_lock
from orchestrator.transport import ZenohTransport, listen
from orchestrator.versions import software
from schemas.campaign import CampaignConfig, CampaignError, check_against, parse
from schemas.certificate import Certificate
from schemas.link import Tls
from schemas.system import SystemSpec

if TYPE_CHECKING:
    from orchestrator.ledger import Ledger

CHILD_TIMEOUT = 120
"""Seconds that a `workers` child may take to answer."""


@dataclass(frozen=True, slots=True)
class Link:
    """Where to listen for workers, and how guarded."""

    endpoint: str
    tls: Tls | None = None
    insecure: bool = False

    def worker_options(self) -> list[str]:
        """Return what our own workers need to connect."""
        if self.tls is None:
            return []
        return ["--tls-ca", self.tls.ca, "--tls-certificate", self.tls.certificate, "--tls-key", self.tls.key]


def start(path: Path, *, workers: int, out: Path | None, seed: int | None, link: Link, console: Console) -> Path:
    """Run a new campaign to its certificate; return the run directory.

    Raises:
        PerfboundError, CampaignError: what is wrong, in one line.
        Stopped: a signal arrived.

    """
    overrides = {} if seed is None else {"seed": seed}
    config = load(path, **overrides)
    directory = out or Path("runs") / config.name
    _check_vacant(directory)
    spec = system_spec(config.system.name, f"{path}: system.name")
    check_against(config, spec, str(path))
    _check_specification(config, spec, path)
    header = Header.new(config, spec, software(spec))
    with listen(link.endpoint, link.tls, insecure=link.insecure) as transport, _created(directory), ExitStack() as stack:
        stack.enter_context(campaign_lock(directory))
        journal = Journal.create(directory, header)
        stack.callback(journal.close)
        _conduct(directory, journal, transport, workers, link, console, resumed=False)
    return directory


def resume(directory: Path, *, workers: int, link: Link, console: Console) -> Path:
    """Continue a campaign from its database; one that is finished is left as it is. Return the run directory.

    Raises:
        PerfboundError: what is wrong, in one line.
        Stopped: a signal arrived.

    """
    existing(directory)
    if files.read(directory) is not None:
        console.print(f"{directory}: finished already", highlight=False, soft_wrap=True)
        return directory
    with campaign_lock(directory), ExitStack() as stack:
        journal = Journal.open(directory)
        stack.callback(journal.close)
        _check_software(journal.header)
        evidence.sweep(directory)
        transport = stack.enter_context(listen(link.endpoint, link.tls, insecure=link.insecure))
        _conduct(directory, journal, transport, workers, link, console, resumed=True)
    return directory


def load(path: Path, **overrides: int) -> CampaignConfig:
    """Read a campaign file.

    Raises:
        CampaignError: it cannot be read, or is not a campaign.

    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CampaignError(f"{path}: {error.strerror}; name a campaign file, e.g. one of deploy/campaigns") from None
    return parse(data, str(path), **overrides)


def system_specs() -> dict[str, SystemSpec]:
    """Return the installed systems, asked from a `workers` child: no simulator is imported here.

    Raises:
        PerfboundError: the child fails.

    """
    command = [sys.executable, "-m", "workers", "systems"]
    try:
        child = subprocess.run(command, capture_output=True, text=True, timeout=CHILD_TIMEOUT, check=True)
        return {name: SystemSpec.model_validate_json(json.dumps(spec)) for name, spec in json.loads(child.stdout).items()}
    except (subprocess.SubprocessError, ValueError) as error:
        reason = (getattr(error, "stderr", "") or str(error)).strip().splitlines()[-1:]
        raise PerfboundError(f"the installed systems cannot be listed: {' '.join(reason)}; reinstall perfbound") from None


def system_spec(name: str, where: str) -> SystemSpec:
    """Return one installed system.

    Raises:
        CampaignError: it is not installed; the text names those that are.

    """
    specs = system_specs()
    if name not in specs:
        raise CampaignError(f"{where}: {name!r} is not an installed system; allowed are {', '.join(sorted(specs))}")
    return specs[name]


def _check_vacant(directory: Path) -> None:
    if (directory / "campaign.db").exists():
        raise PerfboundError(
            f"{directory}: a campaign is here already; continue it with `perfbound resume {directory}`, "
            "or choose another --out"
        )
    if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
        raise PerfboundError(f"{directory}: exists and is not empty; choose another --out")


def _check_specification(config: CampaignConfig, spec: SystemSpec, path: Path) -> None:
    if config.specification is None:
        return
    try:
        parse_formula(config.specification, [column.name for column in spec.columns])
    except FormulaError as error:
        raise CampaignError(f"{path}: specification: {error}") from None


def _check_software(header: Header) -> None:
    now = software(header.spec)
    for name, then in header.software.items():
        if now.get(name) != then:
            raise JournalError(
                f"this campaign was started with {name} {then}, here is {now.get(name, 'none')}; resume it with the "
                "versions it was started with, or start a new campaign"
            )


@contextmanager
def _created(directory: Path) -> Iterator[None]:
    """Make the run directory; take it back if it stays empty."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PerfboundError(f"{directory}: cannot be created ({error.strerror}); choose another --out") from None
    try:
        yield
    finally:
        (directory / "campaign.db.partial").unlink(missing_ok=True)
        if not any(directory.iterdir()):
            directory.rmdir()


def _conduct(
    directory: Path,
    journal: Journal,
    transport: ZenohTransport,
    workers: int,
    link: Link,
    console: Console,
    *,
    resumed: bool,
) -> None:
    from orchestrator.fleet import Fleet  # noqa: PLC0415

    run = journal.header.run
    with ExitStack() as stack:
        fleet = None
        if workers:
            fleet = Fleet(workers, transport.endpoint, run, link.worker_options())
            stack.callback(fleet.stop)
            fleet.start()
        else:
            console.print(
                f"waiting for workers: perfbound-worker --connect {transport.endpoint}", highlight=False, soft_wrap=True
            )
        # The numerics take seconds to load: only now, while the workers start.
        from orchestrator.ledger import Ledger  # noqa: PLC0415
        from orchestrator.service import Interrupted, Service  # noqa: PLC0415
        from orchestrator.terminal import view  # noqa: PLC0415

        ledger = Ledger(directory, journal)
        ledger.replay()
        if not ledger.done:
            shown = stack.enter_context(view(console))
            service = Service(ledger, journal, transport, fleet, shown, resumed=resumed)
            stack.enter_context(_signals(lambda number: service.inbox.put(Interrupted(number))))
            transport.start(run, service.inbox.put)
            service.run()
    _certify(directory, journal, ledger)


def _certify(directory: Path, journal: Journal, ledger: "Ledger") -> None:
    from orchestrator.certificate.issue import issue, manifest  # noqa: PLC0415

    found = manifest((sha256, path) for _, sha256, path in journal.observed())
    files.write(directory, issue(journal.header, ledger.accounts, found), found.manifest)


@contextmanager
def _signals(put: Callable[[int], None]) -> Iterator[None]:
    def take(number: int, _frame: FrameType | None) -> None:
        put(number)

    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def certificate(directory: Path) -> Certificate:
    """Return the certificate of a finished campaign.

    Raises:
        PerfboundError: there is none, or it is damaged.

    """
    found = files.read(directory)
    if found is None:
        raise PerfboundError(f"{directory}: no certificate yet; `perfbound resume {directory}` continues the campaign")
    return found
