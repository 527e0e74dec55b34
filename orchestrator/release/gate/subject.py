"""What the gate knows of one run directory: its certificate, its verification, its verdict, its age, its signatures."""

import time
from dataclasses import dataclass, field
from pathlib import Path

from ....schemas.errors import PerfboundError, one_line
from ....schemas.result.certificate import Predicate
from ....schemas.result.facts import Header
from ....schemas.result.known import CampaignVerdict
from ...certificate import files
from ...certificate.signing import keys, sign
from ...certificate.verify.run import Verification, verify_certificate
from ...certificate.verify.stages import Report
from ...run.directory import finished_certificate
from ...run.known import verdict_of
from ...store.files import contents
from ...store.read import last_outcome, stored_header
from .policy import Policy

NEEDED = {"database": "the verdict counts the violations in these tables"}
"""Checks that may be skipped for a certificate, and not for a gate, and why."""
FOR_AGE = {"attempts": "the age is that of the last attempt in this record"}


@dataclass(frozen=True, slots=True)
class Campaign:
    """The finished campaign in a run directory, as its files say."""

    header: Header
    predicate: Predicate
    verdict: CampaignVerdict
    age: float | None
    """Seconds since the last rollout; None where none was simulated."""


@dataclass(frozen=True, slots=True)
class Subject:
    """One run directory; without `campaign` it cannot be judged, and `fault` or `failed_checks` say why."""

    directory: Path
    campaign: Campaign | None
    fault: str = ""
    """Why it cannot be read."""
    checks: int = 0
    """That passed."""
    failed_checks: tuple[str, ...] = ()
    unsigned: dict[str, str] = field(default_factory=dict)
    """By public key, why its signature does not count."""
    resimulated: str = ""
    """What was simulated again."""

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
        certificate, verified = finished_certificate(directory), None
        if policy.verifies:
            verified = verify_certificate(directory, key=None, again=policy.resimulated, report=report, system=system)
            if failed := _failed_checks(verified, policy):
                return Subject(directory, None, failed_checks=failed)
            # The file may have changed since; what was verified is judged.
            certificate = verified.certificate or certificate
        header = stored_header(directory)
        verdict = verdict_of(directory, header, certificate, repeatable=False)
        ended = last_outcome(directory)
        age = None if ended is None else time.time() - ended
        return Subject(
            directory,
            Campaign(header, certificate.predicate, verdict, age),
            checks=0 if verified is None else sum(each.status == "passed" for each in verified.checks.lines()),
            unsigned={key: why for key in policy.signed_by if (why := _unsigned(directory, Path(key)))},
            resimulated=verified.checks.found["resimulation"].detail if verified and policy.resimulated else "",
        )
    except (PerfboundError, OSError) as error:
        return Subject(directory, None, one_line(str(error)))


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


def _unsigned(directory: Path, key: Path) -> str:
    """Return why the certificate in a directory does not count as signed by a key; empty where it does.

    Raises:
        PerfboundError: the key cannot be read.

    """
    public = keys.load_public(key)
    envelope = directory / files.ENVELOPE
    if not envelope.exists():
        return "it is not signed"
    try:
        payload = sign.signed_payload(contents(envelope, sign.MAX_ENVELOPE), public)
    except PerfboundError as error:
        return one_line(str(error))
    same = payload == contents(directory / files.CERTIFICATE, files.MAX_CERTIFICATE)
    return "" if same else f"{files.CERTIFICATE} is not the signed certificate"
