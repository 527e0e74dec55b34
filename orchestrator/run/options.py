"""The settings of a run, and whether a campaign, its system and this machine allow it."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from ...schemas.errors import CampaignError, JournalError
from ...schemas.platforms import ANY, platform_class
from ...schemas.result.facts import Header
from ...schemas.system import SystemSpec, differences
from ..campaign.software import other_numerics
from ..fleet.children import child
from ..fleet.children.processes import Fleet
from ..fleet.link.transport import Transport
from ..store import read
from ..store.journal import Journal, Origin
from ..store.lock import campaign_lock
from .directory import revision
from .link import Link


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


@contextmanager
def reopened(directory: Path, options: RunOptions) -> Iterator[tuple[Journal, str]]:
    """Lock a run directory and open its journal, with the system as a worker finds it.

    Raises:
        PerfboundError: there is no campaign, it is running, or its software or its system is another one.

    """
    with campaign_lock(directory) as held:
        reference = options.system or read.system_reference(directory)
        if read.stored_header(directory).spec.repeated != "nowhere":
            reference = child.resolved(reference)
        with closing(Journal.open(directory, options.origin(reference), held)) as journal:
            _check_software(journal.header)
            _check_code(journal.header, reference, options)
            yield journal, reference


def check_workers(spec: SystemSpec, own: OwnSystem | None, place: Path, workers: int) -> None:
    """Refuse a system that no worker can have; of a rig those of persons alone."""
    if spec.repeated == "nowhere" and workers:
        raise CampaignError(
            f"{place}: no simulator makes the rollouts of {spec.name}: `perfbound import` takes logs that exist, and "
            f"`perfbound orchestrate` with `perfbound-worker --manual` one after the other; in Python "
            f"Campaign.ask_tell, or perfbound.open({str(place)!r}).ask_tell() for a campaign that has begun"
        )
    if spec.repeated == "session" and own is None:
        raise CampaignError(
            f"{place}: {spec.name} was defined in an interactive session, so no worker can import it; continue there: "
            f"perfbound.resume({str(place)!r}, system={spec.name.replace('-', '_')})"
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
        others = "; ".join(differences(header.spec, spec))
        raise JournalError(
            f"{spec.name}: not the function with which this campaign was started ({others}); give that one, or start a "
            "new campaign"
        )


def _check_software(header: Header) -> None:
    for name, then, now in other_numerics(header.software, header.spec):
        raise JournalError(
            f"this campaign was started with {name} {then}, here is {now or 'none'}; resume it with the versions it "
            "was started with, or start a new campaign"
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
        others = "; ".join(differences(campaign, found))
        remedy = "with the version of then" if installed else "with the files of then (--system, if they are elsewhere)"
        raise JournalError(
            f"{reference}: not the system with which this campaign was started: {others}; resume it {remedy}, or start "
            "a new campaign"
        )
