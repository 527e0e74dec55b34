"""The check of the record of attempts: which failed, which were compared, and who made them."""

from pathlib import Path

from ....schemas.amounts import counted
from ....schemas.errors import SignatureError
from ....schemas.result.attempt_record import MAX_RECORD, TABLES, AttemptRecord
from ...store.attempt_record import table_digests
from ...store.files import contents
from .. import files
from ..signing import keys, sign
from .checks import CheckFailed, Checks
from .manifest import sha256_of

CHECK = "attempts"


def check_attempts(directory: Path, certificate: bytes, key: Path | None, checks: Checks) -> None:
    """Compare the tables of attempts with their record; with a key, the record that was signed with it.

    `certificate` are the verified bytes.

    Raises:
        CheckFailed: something differs, or what should be signed is not.

    """
    text = _text(directory, key)
    if text is None:
        checks.skipped(CHECK, f"there is no {files.ATTEMPTS}: attempts that failed may have been removed")
        return
    record = AttemptRecord.model_validate_json(text)
    if record.to_json().encode() != text:
        raise CheckFailed(CHECK, f"the bytes of {files.ATTEMPTS} are not those that perfbound writes: it was edited")
    # Else the record of a campaign without failures could stand beside this certificate.
    if record.subject[0].digest.get("sha256") != sha256_of(certificate):
        raise CheckFailed(CHECK, f"{files.ATTEMPTS} belongs to another certificate")
    wanted = record.predicate
    found = table_digests(directory, {name: each.rows for name, each in wanted.items()})
    if found.keys() != wanted.keys():
        raise CheckFailed(CHECK, f"the tables of {files.ATTEMPTS} are not those of the database: {', '.join(found)}")
    for name, here in found.items():
        if here.rows < wanted[name].rows:
            raise CheckFailed(CHECK, f"table {name}: {wanted[name].rows - here.rows} of {wanted[name].rows} are gone")
        if here != wanted[name]:
            raise CheckFailed(CHECK, f"table {name}: its rows are not those of {files.ATTEMPTS}")
    checks.passed(CHECK, ", ".join(counted(wanted[name].rows, name.removesuffix("s")) for name in TABLES[:2]))


def _text(directory: Path, key: Path | None) -> bytes | None:
    """Return the bytes of the record, if there is one; with a key, those that were signed."""
    path, envelope = directory / files.ATTEMPTS, directory / files.ATTEMPTS_ENVELOPE
    plain = contents(path, MAX_RECORD) if path.exists() else None
    if key is None:
        return plain
    if not envelope.exists():
        raise CheckFailed(CHECK, f"there is no {envelope.name}: the record of attempts is not signed")
    try:
        signed = sign.signed_payload(contents(envelope, sign.MAX_ENVELOPE), keys.load_public(key))
    except SignatureError as error:
        raise CheckFailed(CHECK, str(error)) from None
    if plain not in (None, signed):
        raise CheckFailed(CHECK, f"{path.name} is not the signed record")
    return signed
