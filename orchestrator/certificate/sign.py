"""Sign a certificate, and check a signature: Ed25519 over a DSSE envelope, `certificate.dsse.json`.

What is signed is PAE(payload type, payload), the payload being the exact bytes of `certificate.json`: nothing has to
be understood before the signature holds. Ed25519 is deterministic: the same key and certificate give the same bytes.

Deviation from DSSE: an envelope with a field that version 1 does not have is refused, where a reader is told to ignore
the field. Nothing of an accepted envelope is without meaning, so that any flipped bit of it is noticed.
"""

import base64
import hashlib
import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import ValidationError

from ...schemas import atomic
from ...schemas.envelope import MAX_SIGNATURES, PAYLOAD_TYPE, DsseEnvelope, Signature
from ...schemas.errors import EvidenceError, SignatureError
from . import files
from .keys import key_id, load_private, load_public, new_pair

__all__ = [
    "SignatureError",
    "key_id",
    "load_private",
    "load_public",
    "new_pair",
    "pae",
    "sign",
    "sign_certificate",
    "verify",
]

MAX_ENVELOPE = 16 * 1024 * 1024
"""Bytes of an envelope; a certificate with 1000 starts has less than one of them."""


def pae(payload_type: str, payload: bytes) -> bytes:
    """Return what a signature is over: the pre-authentication encoding of DSSE version 1.

    >>> pae("http://example.com/HelloWorld", b"hello world")
    b'DSSEv1 29 http://example.com/HelloWorld 11 hello world'
    """
    kind = payload_type.encode()
    return b"DSSEv1 %d %b %d %b" % (len(kind), kind, len(payload), payload)


def sign(payload: bytes, key: Ed25519PrivateKey, others: Sequence[Signature] = ()) -> bytes:
    """Return the envelope of `payload`, signed with `key` besides the signatures of `others`."""
    own = key_id(key.public_key())
    made = Signature(keyid=own, sig=_encode(key.sign(pae(PAYLOAD_TYPE, payload))))
    signatures = [made if each.keyid == own else each for each in others]  # an older one by this key keeps its place
    envelope = DsseEnvelope(
        payload=_encode(payload),
        payloadType=PAYLOAD_TYPE,
        signatures=tuple(signatures if made in signatures else [*signatures, made]),
    )
    return (json.dumps(envelope.model_dump(mode="json"), indent=1, sort_keys=True) + "\n").encode()


def verify(envelope: bytes, public_key: Ed25519PublicKey) -> bytes:
    """Return the payload of an envelope that `public_key` signed, byte by byte what was signed.

    Raises:
        SignatureError: it is no envelope, not of a certificate, signed by others only, or was changed.

    """
    found = _parse(envelope)
    if found.payloadType != PAYLOAD_TYPE:
        raise SignatureError(f"the envelope holds {found.payloadType!r}, not {PAYLOAD_TYPE}: it is of something else")
    payload, own = _decode(found.payload, "payload"), key_id(public_key)
    claimed = [each for each in found.signatures if each.keyid in ("", own)]
    if not claimed:
        others = ", ".join(f"{each.keyid[:16]}..." for each in found.signatures[:3])
        raise SignatureError(f"no signature by key {own[:16]}..., only by {others}; give the signer's public key")
    message = pae(found.payloadType, payload)
    if not any(_holds(public_key, each, message) for each in claimed):
        raise SignatureError(
            f"the signature by key {own[:16]}... does not fit the certificate in the envelope: one of them was changed"
        )
    return payload


def sign_certificate(directory: Path, key: Ed25519PrivateKey) -> Path:
    """Sign the certificate in `directory`; signatures by other keys stay. Return where the envelope is.

    Raises:
        EvidenceError: there is no certificate, it is damaged, or it is not about the manifest beside it.
        SignatureError: an envelope is there already, of another certificate.
        OSError: the disk is full or the directory cannot be written.

    """
    payload, path = _certificate(directory), directory / files.ENVELOPE
    envelope = sign(payload, key, _others(path, payload))
    if not path.exists() or path.read_bytes() != envelope:
        atomic.write_whole(path, envelope)
    return path


def _certificate(directory: Path) -> bytes:
    """Return the bytes of a certificate that belongs where it stands: nobody signs a mistake."""
    path, manifest = directory / files.CERTIFICATE, directory / files.MANIFEST
    found = files.read(directory)
    if found is None:
        raise EvidenceError(f"{directory}: no {path.name} to sign; finish the campaign with `perfbound resume` first")
    if hashlib.sha256(manifest.read_bytes()).hexdigest() != found.predicate.evidence.manifest_sha256:
        raise EvidenceError(f"{path}: is not about the {manifest.name} beside it; restore both from a copy")
    return path.read_bytes()


def _others(path: Path, payload: bytes) -> tuple[Signature, ...]:
    """Return the signatures that stand in the envelope at `path` already."""
    if not path.exists():
        return ()
    try:
        found = _parse(path.read_bytes())
        same = found.payloadType == PAYLOAD_TYPE and _decode(found.payload, "payload") == payload
    except SignatureError as error:
        raise SignatureError(f"{path}: {error}; remove it to sign anew") from None
    if not same:
        raise SignatureError(f"{path}: holds another certificate than {files.CERTIFICATE}; remove it to sign anew")
    if len(found.signatures) == MAX_SIGNATURES:
        raise SignatureError(f"{path}: has {MAX_SIGNATURES} signatures already; remove it to sign anew")
    return found.signatures


def _holds(public_key: Ed25519PublicKey, signature: Signature, message: bytes) -> bool:
    try:
        public_key.verify(_decode(signature.sig, "a signature"), message)
    except InvalidSignature:
        return False
    return True


def _parse(envelope: bytes) -> DsseEnvelope:
    """Read an envelope, believing nothing."""
    if len(envelope) > MAX_ENVELOPE:
        raise SignatureError(f"more than {MAX_ENVELOPE} bytes; that is no envelope of a certificate")
    try:
        return DsseEnvelope.model_validate(json.loads(envelope.decode(), object_pairs_hook=_once))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise SignatureError(f"not a DSSE envelope ({where or 'text'}: {first['msg']})") from None
    except (ValueError, RecursionError) as error:
        raise SignatureError(f"not a DSSE envelope ({error})") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse a key that stands twice: readers would disagree on which one counts."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key stands in it twice")
    return found


def _encode(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _decode(text: str, name: str) -> bytes:
    """Read base64, standard or URL-safe, that is exactly what an encoder writes."""
    for signs in (b"+/", b"-_"):
        with suppress(ValueError):
            data = base64.b64decode(text, signs, validate=True)
            if base64.b64encode(data, signs).decode() == text:
                return data
    raise SignatureError(f"{name} of the envelope is not base64; it was changed")
