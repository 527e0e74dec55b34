"""Certificates for tests, made as `perfbound pki` makes them, but at any time."""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

from perfbound.orchestrator.hosts.authority import (
    Signer,
    certificate_bytes,
    checked_order,
    issue_certificate,
    key_bytes,
    new_authority,
)
from perfbound.schemas.link.configuration import Tls
from perfbound.schemas.link.tls_files import Role

DAY = timedelta(days=1)


def now() -> datetime:
    return datetime.now(UTC).replace(microsecond=0)


@dataclass
class Site:
    """A folder with the files of one authority, which is valid from a year ago."""

    folder: Path
    signer: Signer = field(default_factory=lambda: new_authority(now() - 365 * DAY, 730))

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.ca.write_bytes(certificate_bytes(self.signer.certificate))

    @property
    def ca(self) -> Path:
        return self.folder / "ca.pem"

    def tls(self, name: str, role: Role, *hosts: str, at: timedelta = timedelta(), days: int = 30) -> Tls:
        """Issue a certificate at a moment, `at` from now; return its files."""
        certificate, key = issue_certificate(self.signer, checked_order(name, role, hosts), now() + at, days)
        paths = self.folder / f"{name}.pem", self.folder / f"{name}-key.pem"
        paths[0].write_bytes(certificate_bytes(certificate))
        paths[1].touch(mode=0o600)
        paths[1].write_bytes(key_bytes(key))
        return Tls(ca=str(self.ca), certificate=str(paths[0]), key=str(paths[1]))
