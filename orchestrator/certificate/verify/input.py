"""The input of a verification: a run directory, the certificate in it, and its signature."""

from dataclasses import dataclass
from pathlib import Path

from ....schemas.certificate import Certificate
from ....schemas.errors import PerfboundError
from ...store import files as evidence
from .. import files, sign
from .checks import CheckFailed, Checks


@dataclass(frozen=True, slots=True)
class VerificationInput:
    """A run directory, and the certificate in it."""

    directory: Path
    certificate: Path
    envelope: Path

    @classmethod
    def of(cls, path: Path) -> "VerificationInput":
        """Take a run directory, a certificate or its envelope.

        Raises:
            PerfboundError: there is nothing to verify.

        """
        directory = path if path.is_dir() else path.parent
        envelope = directory / files.ENVELOPE
        certificate = path if not path.is_dir() and path.name != envelope.name else directory / files.CERTIFICATE
        if not certificate.exists() and not envelope.exists():
            raise PerfboundError(f"{path}: no certificate here; name a run directory whose campaign has finished")
        return cls(directory, certificate, envelope)


def signed_text(subject: VerificationInput, key: Path | None, checks: Checks) -> bytes:
    """Return the bytes of the certificate; with a key, those that were signed, before anything reads them.

    Raises:
        CheckFailed: the signature does not hold, or there is none.
        PerfboundError: the key cannot be read, or is needed.

    """
    signed = subject.envelope.exists()
    if key is None:
        if not subject.certificate.exists():
            raise PerfboundError(f"{subject.envelope}: give the signer's public key with --key")
        checks.skipped("signature", "give the signer's public key with --key" if signed else "it is not signed")
        with checks.making("certificate"):
            return evidence.contents(subject.certificate, files.MAX_CERTIFICATE)
    public = sign.load_public(key)
    if not signed:
        raise CheckFailed("signature", f"there is no {files.ENVELOPE}: the certificate is not signed")
    with checks.making("signature"):
        payload = sign.verify(evidence.contents(subject.envelope, sign.MAX_ENVELOPE), public)
        if subject.certificate.exists() and evidence.contents(subject.certificate, files.MAX_CERTIFICATE) != payload:
            raise CheckFailed("signature", f"what was signed is not {subject.certificate.name}")
    checks.passed("signature", f"Ed25519, key {sign.key_id(public)[:16]}...")
    return payload


def parsed(text: bytes, checks: Checks) -> Certificate:
    """Return the certificate.

    Raises:
        CheckFailed: it is none, or was edited by hand.

    """
    with checks.making("certificate"):
        try:
            found = Certificate.model_validate_json(text)
        except ValueError as error:
            raise CheckFailed("certificate", f"not a certificate: {str(error).splitlines()[0]}") from None
        if found.to_json().encode() != text:
            raise CheckFailed("certificate", "it is not written as perfbound writes it: somebody edited it")
    claims = len(found.predicate.claims)
    checks.passed("certificate", f"{claims} claim{'' if claims == 1 else 's'}")
    return found
