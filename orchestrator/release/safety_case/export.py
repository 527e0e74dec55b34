"""The safety case of a run directory as files in a folder, as a bundle, or both."""

import shlex
from dataclasses import dataclass
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from ....schemas.amounts import counted
from ....schemas.errors import EvidenceError
from ...certificate.signing.sign import unsigned
from ...certificate.verify.run import verify_certificate
from ...certificate.verify.stages import Report
from ...run.directory import finished_certificate
from ...store.export import whole
from .bundle import Content, write_bundle
from .case import safety_case
from .files import case_files


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is exported."""

    folder: Path | None
    """Of the document, the drawing and the argument; None where they are not asked for."""
    bundle: Path | None
    signers: tuple[Path, ...]
    """Public keys of those who have signed the certificate."""
    key: Ed25519PrivateKey | None
    """With which the list of the bundle is signed."""
    trajectories: bool
    """Whether they are in the bundle."""


def export_case(directory: Path, wanted: Wanted, report: Report) -> list[str]:
    """Verify a finished campaign and write its safety case; return the answer, and a line on each file.

    Raises:
        EvidenceError: a check fails, a signature is missing, or the list of the bundle is to be signed by another key.
        PerfboundError: there is no certificate, or nothing can be written.
        Stopped: a signal arrived.

    """
    key = wanted.key
    if key is not None and (fault := unsigned(directory, key.public_key())):
        signed = f"perfbound sign {shlex.quote(str(directory))} --key KEY"
        raise EvidenceError(f"{directory}: not signed by the key of --sign: {fault}; first: {signed}")
    certificate = finished_certificate(directory)  # else the verification would say that there is nothing to verify
    verified = verify_certificate(directory, key=None, again=0, report=report)
    checks = verified.checks.lines()
    case = safety_case(directory, wanted.signers, verified.certificate or certificate, checks)
    lines = [case.answer]
    if wanted.folder is not None:
        made = {wanted.folder / name: data for name, data in case_files(case).items()}
        with whole(directory, list(made)) as written:
            for file, data in zip(written, made.values(), strict=True):
                file.write(data)
        lines += map(str, made)
    if wanted.bundle is not None:
        content = Content(directory, case, checks, wanted.signers, wanted.trajectories)
        number = write_bundle(wanted.bundle, content, key, report)
        command = f"perfbound verify {shlex.quote(str(wanted.bundle))}"
        if key is not None and wanted.signers:
            command += f" --key {shlex.quote(str(wanted.signers[0]))}"
        lines.append(f"{wanted.bundle}  {counted(number, 'file')}; to check it anywhere: {command}")
        if key is None:
            lines.append("Its list is not signed, so that its report could be changed: --sign KEY signs it.")
    return lines
