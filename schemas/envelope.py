"""The model of the DSSE envelope of a signed certificate (https://github.com/secure-systems-lab/dsse, version 1)."""

from pydantic import Field

from .base import Model

PAYLOAD_TYPE = "application/vnd.in-toto+json"
MAX_SIGNATURES = 100


class Signature(Model):
    """One signature; `keyid` is a hint for the choice of a key, and is not signed."""

    keyid: str = Field(default="", max_length=200, description="empty: unknown")
    sig: str = Field(max_length=1000, description="base64; 64 bytes for Ed25519")


class DsseEnvelope(Model):
    """A payload, its type, and its signatures."""

    payload: str = Field(description="base64 of the exact bytes of certificate.json")
    payloadType: str = Field(max_length=200)  # noqa: N815  (the name in the specification)
    # Not strict: JSON has lists and no tuples.
    signatures: tuple[Signature, ...] = Field(strict=False, min_length=1, max_length=MAX_SIGNATURES)
