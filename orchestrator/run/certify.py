"""The end of a run: its certificate, and its manifest."""

from collections.abc import Callable
from pathlib import Path

from ..campaign.ledger import Ledger, observed_discards
from ..certificate import files
from ..certificate.issue import issue, manifest
from ..certificate.regions import campaign_regions
from ..store import read
from ..store.attempt_record import table_digests
from ..store.files import read_evidence
from ..store.so_far import remove_so_far
from . import outbox


def certify(directory: Path, ledger: Ledger, report_end: Callable[[], None] | None = None) -> None:
    """Write the certificate of a campaign that is done, and its manifest; then report that to its workers.

    Raises:
        EvidenceError: the kept file of a discarded rollout is missing or damaged.

    """
    for fact in observed_discards(ledger):
        read_evidence(directory, fact.path, fact.sha256)
    # Before the certificate: the run directory is handed on from then, and the key of the assignments proves results.
    outbox.forget(directory)
    found = manifest(((sha256, path) for _, sha256, path in read.observed(directory)), observed_discards(ledger))
    irreproducible = read.irreproducible(directory)
    differing = read.contradicted(directory)
    regions = campaign_regions(ledger)
    certificate = issue(ledger, found, irreproducible=irreproducible, contradicted=differing, regions=regions)
    table = None if regions is None else regions.csv
    files.write(directory, certificate, found.text, table, table_digests(directory))
    if report_end is not None:
        # After the certificate is on the disk: a worker that gets this message drops all its results.
        report_end()
    remove_so_far(directory)
