"""The check of the regions: the recorded boxes against those that follow from the evidence."""

from pathlib import Path

from ....schemas.result.certificate import Certificate, CertifiedRegions
from ...campaign.ledger import Ledger
from ...mathematics.bounds.rigorous.regions import MARGIN, SAFE, STATUSES, UNSAFE, covered
from ...mathematics.gp.lattice import Lattice
from ...store.files import contents
from .. import files
from ..regions import boxes_of, campaign_regions, divided
from .checks import ABSENT
from .compare import ROUND_OFF, difference
from .manifest import sha256_of

SHIFT = 1e-8
"""The most by which round-off moves the bound of a box: a few times the tolerance of every other bound."""
SAME = 1e-9
"""Shares that differ by less are one share: the volumes in the table are products of rounded lengths."""
OF_BOXES = ("safe", "unsafe", "undecided", "boxes", "sha256")
"""Fields of the certificate that follow from the table."""


def compared_regions(directory: Path, ledger: Ledger, certificate: Certificate) -> tuple[str | None, str]:
    """Return the fault, or None, and the detail of the check.

    Raises:
        EvidenceError: there is no `regions.csv` although the certificate names one.
        ValueError: it is no such table.

    """
    found, recorded = campaign_regions(ledger), certificate.predicate.regions
    if found is None or recorded is None:
        one = "the certificate" if recorded else "the evidence" if found else None
        return one and f"{one} alone gives regions", ABSENT["regions"]
    fixed, written = (each.model_dump(exclude=set(OF_BOXES)) for each in (found.document, recorded))
    claimed = [claim.bound for claim in certificate.predicate.claims if claim.quantity == "safe_share"]
    fault = difference(fixed, written, "regions", tolerance=ROUND_OFF) or difference(
        [recorded.safe], claimed, "safe_share", tolerance=0.0
    )
    data = contents(directory / files.REGIONS, files.MAX_REGIONS)
    if sha256_of(data) != recorded.sha256:
        fault = f"the sha256 of {files.REGIONS} is {sha256_of(data)[:16]}..., not the one in the certificate"
    if data == found.csv.encode():
        fault = fault or difference(found.document.model_dump(), recorded.model_dump(), "regions", tolerance=0.0)
        return fault, f"boxes: {recorded.boxes}"
    return fault or _beyond_round_off(
        data.decode(), ledger, recorded
    ), f"boxes: {recorded.boxes}, equal but for round-off"


def _beyond_round_off(text: str, ledger: Ledger, recorded: CertifiedRegions) -> str | None:
    """Return a difference between a table and the evidence that no other CPU explains; None if there is none."""
    (account,) = ledger.accounts.values()
    box = account.plan.candidates
    assert isinstance(box, Lattice)
    boxes, strict, lax = boxes_of(text, box), divided(ledger, MARGIN + SHIFT), divided(ledger, MARGIN - SHIFT)
    assert strict is not None
    assert lax is not None
    if len(boxes.low) != recorded.boxes:
        return f"{files.REGIONS} has {len(boxes.low):,} boxes, the certificate counts {recorded.boxes:,}"
    for status, name in enumerate(STATUSES):
        share, written = boxes.of(status), recorded.model_dump()[name]
        if abs(share - written) > SAME:
            return f"regions.{name} is {written}, the boxes give {share}"
    for status in (SAFE, UNSAFE):
        # A box that counts on one CPU alone is proven with a little less margin, and not with a little more.
        outside = ~covered(boxes, lax, status)
        if outside.any():
            low = boxes.low[boxes.status == status][outside][0].tolist()
            return f"{files.REGIONS}: the box at {low} is not certified {STATUSES[status]} by the evidence"
        if not strict.of(status) - SAME <= boxes.of(status) <= lax.of(status) + SAME:
            return f"regions.{STATUSES[status]} is {boxes.of(status)}, the evidence gives {strict.of(status)}"
    return None
