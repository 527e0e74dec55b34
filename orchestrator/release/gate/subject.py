"""The facts on one run directory that rules judge: certificate, verification, verdict, age, signatures."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

from ....schemas.errors import PerfboundError, one_line
from ...certificate import files
from ...certificate.signing.keys import load_public
from ...certificate.signing.sign import unsigned
from ...certificate.verify.run import Verification, verify_certificate
from ...certificate.verify.stages import Report
from ...run.directory import finished_certificate
from ...run.known import Finished, finished
from ...store.files import contents
from .policy import Policy

NEEDED = {"database": "the verdict counts the violations in these tables"}
"""Checks that may be skipped for a certificate, and not for a gate, and why."""
FOR_AGE = {"attempts": "the age is that of the last attempt in this record"}


@dataclass(frozen=True, slots=True)
class Subject:
    """One run directory; without `campaign` it cannot be judged, and `fault` or `failed_checks` say why."""

    directory: Path
    campaign: Finished | None
    fault: str = ""
    """Why it cannot be read."""
    checks: int = 0
    """That passed."""
    failed_checks: tuple[str, ...] = ()
    unsigned: dict[str, str] = field(default_factory=dict)
    """By public key, why its signature does not count."""
    resimulated: str = ""
    """What was simulated again."""
    sha256: str = ""
    """Of the certificate."""

    @property
    def name(self) -> str:
        """The directory, as it was given, in one line."""
        return one_line(str(self.directory))


def read_subject(directory: Path, policy: Policy, system: str | None, report: Report) -> Subject:
    """Read and verify the campaign in a run directory, as far as the policy asks.

    Raises:
        Stopped: a signal arrived.

    """
    try:
        certificate, verified, sha256 = finished_certificate(directory), None, _sha256(directory)
        if policy.verifies:
            verified = verify_certificate(directory, key=None, again=policy.resimulated, report=report, system=system)
            if failed := _failed_checks(verified, policy):
                return Subject(directory, None, failed_checks=failed, sha256=sha256)
            # The file may have changed since; what was verified is judged.
            certificate = verified.certificate or certificate
        if _sha256(directory) != sha256:
            return Subject(directory, None, "the certificate was changed while it was judged; judge it again")
        return Subject(
            directory,
            finished(directory, certificate),
            checks=0 if verified is None else sum(each.status == "passed" for each in verified.checks.lines()),
            unsigned={key: why for key in policy.signed_by if (why := unsigned(directory, load_public(Path(key))))},
            resimulated=verified.checks.found["resimulation"].detail if verified and policy.resimulated else "",
            sha256=sha256,
        )
    except (PerfboundError, OSError) as error:
        return Subject(directory, None, one_line(str(error)))


def _sha256(directory: Path) -> str:
    return hashlib.sha256(contents(directory / files.CERTIFICATE, files.MAX_CERTIFICATE)).hexdigest()


def _failed_checks(verified: Verification, policy: Policy) -> tuple[str, ...]:
    """Return the checks that failed, or else those that the policy cannot do without and that were skipped."""
    lines = {each.name: each for each in verified.checks.lines()}
    failed = tuple(f"{each.name}: {each.detail}" for each in lines.values() if each.status == "failed")
    needed = NEEDED | (FOR_AGE if policy.max_age is not None else {})
    needed |= {"resimulation": "the policy asks for it"} if policy.resimulated else {}
    skipped = (
        f"{name}: {lines[name].detail}; {why}" for name, why in needed.items() if lines[name].status == "skipped"
    )
    return failed or tuple(skipped)
