"""The signature of a certificate: Ed25519 over a DSSE envelope, `certificate.dsse.json`.

The signature covers PAE(payload type, payload), where the payload is the exact bytes of `certificate.json`: no parser
reads them before the signature is verified. Ed25519 is deterministic: the same key and certificate give the same bytes.

Deviation from DSSE: the protocol has readers ignore unknown fields; here an envelope with one is refused. Every byte of
an accepted envelope has a meaning, so any flipped bit of it is detected.
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

from ....schemas import atomic
from ....schemas.errors import EvidenceError, SignatureError
from ....schemas.result.attempt_record import MAX_RECORD
from ....schemas.result.certificate import MAX_SIGNATURES, PAYLOAD_TYPE, DsseEnvelope, Signature
from ...store.files import contents
from .. import files
from .keys import key_id

MAX_ENVELOPE = 16 * 1024 * 1024
"""Bytes of an envelope; a certificate with 1000 starts has less than one of them."""


def pae(payload_type: str, payload: bytes) -> bytes:
    """Return the bytes that are signed: the pre-authentication encoding (PAE) of DSSE version 1.

    >>> pae("http://example.com/HelloWorld", b"hello world")
    b'DSSEv1 29 http://example.com/HelloWorld 11 hello world'
    """
    kind = payload_type.encode()
    return b"DSSEv1 %d %b %d %b" % (len(kind), kind, len(payload), payload)


def sign(payload: bytes, key: Ed25519PrivateKey, others: Sequence[Signature] = ()) -> bytes:
    """Return the envelope of `payload`, signed with `key` besides the signatures of `others`."""
    # An older signature by the same key is replaced in its place: signing twice gives the same bytes.
    own = key_id(key.public_key())
    made = Signature(keyid=own, sig=_encode(key.sign(pae(PAYLOAD_TYPE, payload))))
    signatures = [made if each.keyid == own else each for each in others]
    envelope = DsseEnvelope(
        payload=_encode(payload),
        payloadType=PAYLOAD_TYPE,
        signatures=tuple(signatures if made in signatures else [*signatures, made]),
    )
    return (json.dumps(envelope.model_dump(mode="json"), indent=1, sort_keys=True) + "\n").encode()


def signed_payload(envelope: bytes, public_key: Ed25519PublicKey) -> bytes:
    """Return the payload of an envelope, byte by byte as `public_key` signed it.

    Raises:
        SignatureError: it is no envelope, not of a certificate, only signed by other keys, or was changed.

    """
    found = _parse(envelope)
    # The type is signed as well, so a signature over other content of this key proves nothing here.
    if found.payloadType != PAYLOAD_TYPE:
        raise SignatureError(f"the envelope contains {found.payloadType!r}, not {PAYLOAD_TYPE}; give a certificate's")
    payload, own = _decode(found.payload, "payload"), key_id(public_key)
    # DSSE: a key id is an unauthenticated hint. It may be empty, and only the signature itself decides.
    claimed = [each for each in found.signatures if each.keyid in ("", own)]
    if not claimed:
        others = ", ".join(f"{each.keyid[:16]}..." for each in found.signatures[:3])
        raise SignatureError(f"no signature by key {own[:16]}..., only by {others}; give the signer's public key")
    message = pae(found.payloadType, payload)
    if not any(_is_signature(public_key, each, message) for each in claimed):
        raise SignatureError(
            f"the signature by key {own[:16]}... does not fit the certificate in the envelope: one of them was "
            "changed; ask the signer for the original"
        )
    return payload


def signed_certificate(envelope: Path, certificate: Path, public_key: Ed25519PublicKey) -> bytes:
    """Return the bytes of a certificate as `public_key` signed it; its file may be missing.

    Raises:
        SignatureError: the signature does not fit, or the file has other bytes.
        EvidenceError: a file cannot be read.

    """
    payload = signed_payload(contents(envelope, MAX_ENVELOPE), public_key)
    # Readers open the certificate, not the envelope: it must be the signed one.
    if certificate.exists() and contents(certificate, files.MAX_CERTIFICATE) != payload:
        raise SignatureError(f"{certificate.name} is not the signed certificate")
    return payload


def unsigned(directory: Path, public_key: Ed25519PublicKey) -> str:
    """Return why the certificate in a run directory does not count as signed by a key; nothing where it does.

    Raises:
        EvidenceError: a file cannot be read.

    """
    envelope = directory / files.ENVELOPE
    if not envelope.exists():
        return "it is not signed"
    try:
        signed_certificate(envelope, directory / files.CERTIFICATE, public_key)
    except SignatureError as error:
        return str(error)
    return ""


def claimed_signers(directory: Path) -> tuple[str, ...]:
    """Return the ids of the keys that the envelope of a run directory names, none of which is checked.

    Raises:
        SignatureError: it is no envelope.
        EvidenceError: it cannot be read.

    """
    envelope = directory / files.ENVELOPE
    if not envelope.exists():
        return ()
    return tuple(each.keyid for each in _parse(contents(envelope, MAX_ENVELOPE)).signatures)


def sign_certificate(directory: Path, key: Ed25519PrivateKey) -> Path:
    """Sign the certificate in `directory`, and the record of its attempts; return the path of the envelope.

    Signatures by other keys stay.

    Raises:
        EvidenceError: there is no certificate, it is damaged, or it does not match the manifest beside it.
        SignatureError: the directory has an envelope of another certificate.
        OSError: the disk is full or the directory cannot be written.

    """
    payload, record = _certificate(directory), directory / files.ATTEMPTS
    if record.exists():
        _signed(contents(record, MAX_RECORD), files.ATTEMPTS, directory / files.ATTEMPTS_ENVELOPE, key)
    return _signed(payload, files.CERTIFICATE, directory / files.ENVELOPE, key)


def _signed(payload: bytes, name: str, path: Path, key: Ed25519PrivateKey) -> Path:
    """Write the envelope of a payload, whose file has this name."""
    envelope = sign(payload, key, _others(path, payload, name))
    # Ed25519 is deterministic: signing again changes no byte, and so not the file.
    if not path.exists() or contents(path, MAX_ENVELOPE) != envelope:
        atomic.write_whole(path, envelope)
    return path


def _certificate(directory: Path) -> bytes:
    """Return the bytes of the certificate, after checking that it matches the manifest beside it."""
    path, manifest = directory / files.CERTIFICATE, directory / files.MANIFEST
    found = files.read(directory)
    if found is None:
        raise EvidenceError(f"{directory}: no {path.name} to sign; finish the campaign with `perfbound resume` first")
    if hashlib.sha256(contents(manifest, files.MAX_MANIFEST)).hexdigest() != found.predicate.evidence.manifest_sha256:
        raise EvidenceError(f"{path}: does not match the {manifest.name} beside it; restore both from a copy")
    return contents(path, files.MAX_CERTIFICATE)


def _others(path: Path, payload: bytes, name: str) -> tuple[Signature, ...]:
    """Return the signatures of the envelope that is at `path` already."""
    if not path.exists():
        return ()
    try:
        found = _parse(contents(path, MAX_ENVELOPE))
        # Signatures of another certificate would not verify over this one.
        same = found.payloadType == PAYLOAD_TYPE and _decode(found.payload, "payload") == payload
    except SignatureError as error:
        raise SignatureError(f"{path}: {error}; remove it and sign again") from None
    if not same:
        raise SignatureError(f"{path}: is not of {name}; remove it and sign again")
    if len(found.signatures) == MAX_SIGNATURES:
        raise SignatureError(f"{path}: has {MAX_SIGNATURES} signatures already; remove it and sign again")
    return found.signatures


def _is_signature(public_key: Ed25519PublicKey, signature: Signature, message: bytes) -> bool:
    try:
        public_key.verify(_decode(signature.sig, "a signature"), message)
    except InvalidSignature:
        return False
    return True


def _parse(envelope: bytes) -> DsseEnvelope:
    """Read an untrusted envelope."""
    if len(envelope) > MAX_ENVELOPE:
        raise SignatureError(f"not an envelope of a certificate: more than {MAX_ENVELOPE} bytes")
    try:
        return DsseEnvelope.model_validate(json.loads(envelope.decode(), object_pairs_hook=_once))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise SignatureError(f"not a DSSE envelope ({where or 'text'}: {first['msg']})") from None
    except (ValueError, RecursionError) as error:
        raise SignatureError(f"not a DSSE envelope ({error})") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse a repeated key: readers disagree on which one counts."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key is repeated")
    return found


def _encode(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _decode(text: str, name: str) -> bytes:
    """Read base64, standard or URL-safe, that is exactly what an encoder writes."""
    for signs in (b"+/", b"-_"):
        with suppress(ValueError):
            data = base64.b64decode(text, signs, validate=True)
            # Unused bits of the last character must be zero: no second text of one signature.
            if base64.b64encode(data, signs).decode() == text:
                return data
    raise SignatureError(f"{name} of the envelope is not base64; ask the signer for the original")
