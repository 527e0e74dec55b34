"""The numbers of a campaign for programs that watch it: from its database in increments, and from what it has shown."""

from dataclasses import dataclass
from pathlib import Path

from ....schemas.result.certificate import Certificate
from ....schemas.result.facts import Header
from ....schemas.result.known import Expected, SoFar, VerdictWord
from ...certificate import files
from ...run.known import verdict_of
from ...store import lock
from ...store.counts import CampaignCounts, CountReader
from ...store.so_far import read_so_far
from ..data.page import State


@dataclass(frozen=True, slots=True)
class ClaimNow:
    """What the first claim is now, or is in the certificate."""

    verdict: VerdictWord
    bound: float | None
    sense: str
    required: float | None
    refuted: int
    """Assumptions of all claims that the data refute."""


@dataclass(frozen=True, slots=True)
class Watched:
    """The numbers at one moment."""

    counts: CampaignCounts
    state: State
    standing: ClaimNow | None
    """None before a run has shown anything."""
    ahead: Expected | None
    """Of a campaign that runs."""
    tests: int
    """Of all problems together, to which `ahead` belongs."""


class WatchedCampaign:
    """Reads the numbers of one campaign; used by one thread at a time."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._reader = CountReader(directory)
        self._certified: tuple[tuple[int, int, int], ClaimNow] | None = None
        """Of which file: its inode, size, and time of the last change."""

    def read(self) -> Watched:
        """Return the numbers now.

        Raises:
            PerfboundError: there is no campaign, or it cannot be read.
            OSError: the disk fails.

        """
        counts = self._reader.read()
        if (certified := self._certificate(counts.header)) is not None:
            return Watched(counts, "finished", certified, None, 0)
        state: State = "running" if lock.is_held(self._directory) else "stopped"
        found = read_so_far(self._directory)
        if found is None or found.run != counts.header.run:
            return Watched(counts, state, None, None, 0)
        return Watched(counts, state, _so_far(found), found.expected if state == "running" else None, found.tests)

    def _certificate(self, header: Header) -> ClaimNow | None:
        """Return what the certificate says, which is read once; None if there is none."""
        try:
            found = (self._directory / files.CERTIFICATE).stat()
        except FileNotFoundError:
            return None
        key = (found.st_ino, found.st_size, found.st_mtime_ns)
        if self._certified is None or self._certified[0] != key:
            certificate = files.read(self._directory)
            if certificate is None:
                return None
            self._certified = key, self._at_the_end(header, certificate)
        return self._certified[1]

    def _at_the_end(self, header: Header, certificate: Certificate) -> ClaimNow:
        verdict = verdict_of(self._directory, header, certificate, repeatable=False)
        refuted = sum(each.status == "refuted" for each in certificate.predicate.assumptions)
        return ClaimNow(verdict.verdict, verdict.bound, verdict.sense, verdict.required, refuted)


def _so_far(found: SoFar) -> ClaimNow:
    refuted = sum(each.status == "refuted" for each in found.assumptions)
    return ClaimNow(found.verdict, found.bound, found.sense, found.required, refuted)
