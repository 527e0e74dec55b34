"""The files of the certificate and its manifest in the run directory."""

from pathlib import Path

from ...schemas import atomic
from ...schemas.certificate import MAX_CERTIFICATE, Certificate
from ...schemas.errors import EvidenceError
from ..store import files

__all__ = [
    "CERTIFICATE",
    "ENVELOPE",
    "MANIFEST",
    "MAX_CERTIFICATE",
    "MAX_MANIFEST",
    "MAX_REGIONS",
    "REGIONS",
    "read",
    "withdraw",
    "write",
]

CERTIFICATE = "certificate.json"
ENVELOPE = "certificate.dsse.json"
"""The certificate with its signatures."""
MAX_MANIFEST = 2**28
"""Bytes; a rollout takes 130 of a manifest."""
REGIONS = "regions.csv"
"""The boxes of a campaign with `regions`."""
MAX_REGIONS = 2**26
"""Bytes; a box takes up to 250 of them in six dimensions."""
MANIFEST = "manifest.sha256"
"""`sha256sum --check manifest.sha256` in the run directory checks every trajectory file."""


OF_CERTIFICATE = (CERTIFICATE, ENVELOPE, MANIFEST, REGIONS, "report.html")
"""What a certificate consists of, or shows."""


def write(directory: Path, certificate: Certificate, manifest: str, regions: str | None = None) -> None:
    """Write the manifest, the table of regions if there is one, then the certificate, each whole or not at all.

    Raises:
        OSError: the disk is full or the directory cannot be written.

    """
    # In this order: a certificate that is there has what it names beside it, whenever the machine crashes.
    atomic.write_whole(directory / MANIFEST, manifest.encode())
    if regions is not None:
        atomic.write_whole(directory / REGIONS, regions.encode())
    atomic.write_whole(directory / CERTIFICATE, certificate.to_json().encode())


def withdraw(directory: Path, number: int) -> None:
    """Keep the certificate and what belongs to it as `certificate-NUMBER.json` and so on, and take it away.

    Raises:
        OSError: the disk is full or the directory cannot be written.

    """
    there = [path for name in OF_CERTIFICATE if (path := directory / name).is_file()]
    # First every copy, then the certificate: whenever the machine crashes, the campaign is finished or can be resumed.
    for path in there:
        stem, _, rest = path.name.partition(".")
        atomic.write_whole(path.with_name(f"{stem}-{number}.{rest}"), path.read_bytes())
    for path in there:
        path.unlink()


def read(directory: Path) -> Certificate | None:
    """Return the certificate of a finished campaign, or None.

    Raises:
        EvidenceError: there is one, but it is damaged.

    """
    path = directory / CERTIFICATE
    if not path.exists():
        return None
    try:
        return Certificate.model_validate_json(files.contents(path, MAX_CERTIFICATE))
    except ValueError as error:
        raise EvidenceError(
            f"{path}: not a certificate ({str(error).splitlines()[0]}); delete it, then resume the campaign"
        ) from None
