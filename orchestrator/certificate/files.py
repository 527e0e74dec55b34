"""The files of the certificate and its manifest in the run directory."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

from ...schemas import atomic
from ...schemas.errors import EvidenceError
from ...schemas.result.attempt_record import AttemptRecord, TableDigest
from ...schemas.result.certificate import MAX_CERTIFICATE, Certificate, Subject
from ..store import files
from .assumptions.sentences import in_own_words

__all__ = [
    "ATTEMPTS",
    "ATTEMPTS_ENVELOPE",
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
ATTEMPTS = "attempts.json"
"""The record of the attempts behind the certificate."""
ATTEMPTS_ENVELOPE = "attempts.dsse.json"
"""That record with its signatures."""
MAX_MANIFEST = 2**28
"""Bytes; a rollout takes 130 of a manifest."""
REGIONS = "regions.csv"
"""The boxes of a campaign with `regions`."""
MAX_REGIONS = 2**26
"""Bytes; a box takes up to 250 of them in six dimensions."""
MANIFEST = "manifest.sha256"
"""`sha256sum --check manifest.sha256` in the run directory checks every trajectory file."""


OF_CERTIFICATE = (CERTIFICATE, ENVELOPE, MANIFEST, REGIONS, ATTEMPTS, ATTEMPTS_ENVELOPE, "report.html")
"""What a certificate consists of, or shows."""


def write(
    directory: Path,
    certificate: Certificate,
    manifest: str,
    regions: str | None = None,
    attempts: Mapping[str, TableDigest] | None = None,
) -> None:
    """Write the manifest, the table of regions and the record of attempts if there are any, then the certificate.

    Each whole or not at all.

    Raises:
        OSError: the disk is full or the directory cannot be written.

    """
    # In this order: a certificate that is there has what it names beside it, whenever the machine crashes.
    atomic.write_whole(directory / MANIFEST, manifest.encode())
    if regions is not None:
        atomic.write_whole(directory / REGIONS, regions.encode())
    text = certificate.to_json().encode()
    if attempts is not None:
        subject = Subject(name=CERTIFICATE, digest={"sha256": hashlib.sha256(text).hexdigest()})
        record = AttemptRecord(subject=(subject,), predicate=dict(attempts))
        atomic.write_whole(directory / ATTEMPTS, record.to_json().encode())
    atomic.write_whole(directory / CERTIFICATE, text)


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
    """Return the certificate of a finished campaign, or None; its sentences are those of its forms and values.

    Raises:
        EvidenceError: there is one, but it is damaged.

    """
    path = directory / CERTIFICATE
    if not path.exists():
        return None
    try:
        return in_own_words(Certificate.model_validate_json(files.contents(path, MAX_CERTIFICATE)))
    except ValueError as error:
        raise EvidenceError(
            f"{path}: not a certificate ({str(error).splitlines()[0]}); delete it, then resume the campaign"
        ) from None
