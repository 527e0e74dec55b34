"""The input of a verification: a run directory with its certificate, and the signature of the certificate."""

from dataclasses import dataclass
from pathlib import Path

from ....schemas.amounts import counted
from ....schemas.errors import PerfboundError
from ....schemas.result.certificate import Certificate
from ...store import files as evidence
from .. import files
from ..signing import keys, sign
from .checks import CheckFailed, Checks


@dataclass(frozen=True, slots=True)
class VerificationInput:
    """The paths of a verification; of certificate and envelope, one may be missing."""

    directory: Path
    certificate: Path
    envelope: Path

    @classmethod
    def of(cls, path: Path) -> "VerificationInput":
        """Return the input that `path` names: a run directory, a certificate or its envelope.

        Raises:
            PerfboundError: there is no certificate.

        """
        directory = path if path.is_dir() else path.parent
        envelope = directory / files.ENVELOPE
        certificate = path if not path.is_dir() and path.name != envelope.name else directory / files.CERTIFICATE
        if not certificate.exists() and not envelope.exists():
            raise PerfboundError(f"{path}: no certificate here; choose a run directory whose campaign has finished")
        return cls(directory, certificate, envelope)


def signed_text(subject: VerificationInput, key: Path | None, checks: Checks) -> bytes:
    """Return the bytes of the certificate; with a key, the signed ones, before any parser reads them.

    Raises:
        CheckFailed: there is no signature by this key, or it does not fit.
        PerfboundError: the key cannot be read, or an envelope without certificate needs one.

    """
    signed = subject.envelope.exists()
    if key is None:
        # Without a key nothing proves the origin of an envelope: its payload is worth no more than any text.
        if not subject.certificate.exists():
            raise PerfboundError(
                f"{subject.envelope}: no certificate beside it; give the signer's public key with --key"
            )
        checks.skipped("signature", "give the signer's public key with --key" if signed else "it is not signed")
        with checks.making("certificate"):
            return evidence.contents(subject.certificate, files.MAX_CERTIFICATE)
    public = keys.load_public(key)
    if not signed:
        raise CheckFailed("signature", f"there is no {files.ENVELOPE}: the certificate is not signed")
    with checks.making("signature"):
        payload = sign.signed_certificate(subject.envelope, subject.certificate, public)
    checks.passed("signature", f"Ed25519, key {keys.key_id(public)[:16]}...")
    return payload


def parsed(text: bytes, checks: Checks) -> Certificate:
    """Return the certificate.

    Raises:
        CheckFailed: the text is none, or was edited.

    """
    with checks.making("certificate"):
        try:
            found = Certificate.model_validate_json(text)
        except ValueError as error:
            raise CheckFailed("certificate", f"not a certificate: {str(error).splitlines()[0]}") from None
        # One text per certificate: a duplicate key or another spelling could show other readers another number.
        if found.to_json().encode() != text:
            raise CheckFailed("certificate", "its bytes are not those that perfbound writes: it was edited")
    claims = len(found.predicate.claims)
    checks.passed("certificate", counted(claims, "claim"))
    return found
