"""Verification: every check, in an order in which nothing is read before its digest is known to be right.

The signature covers the certificate, the certificate names campaign, system and manifest, the manifest the files. The
campaign is then decided again from the files alone, and compared with the certificate and with the database.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ....schemas.certificate import Certificate
from ....schemas.errors import JournalError
from ....schemas.facts import Header, ObservationFact, ProposalFact
from ....schemas.ids import RolloutId
from ...campaign.checks import check
from ...campaign.software import other_numerics
from ...store import files as evidence
from ...store.untrusted import UntrustedFacts, read_untrusted, read_untrusted_header
from .. import files
from ..issue import manifest, question, subject
from . import compare
from .checks import CheckFailed, Checks
from .input import VerificationInput, parsed, signed_text
from .manifest import Entry, check_files, parse_manifest, sha256_of
from .reissue import compared, reissued
from .rerun import Rerun
from .resimulate import resimulate, spot_check

Report = Callable[[str, int, int], None]
"""Progress callback: stage, completed, total."""


@dataclass(frozen=True, slots=True)
class Verification:
    """The checks, the certificate if it could be read, and the one that follows from the evidence, if it does."""

    checks: Checks
    certificate: Certificate | None
    reissued: Certificate | None


def verify(path: Path, *, key: Path | None, again: int, report: Report) -> Verification:
    """Verify the certificate in `path`; `again` rollouts are simulated again.

    Raises:
        PerfboundError: there is nothing to verify, or the key cannot be read.

    """
    found, checks, certificate, own = VerificationInput.of(path), Checks(), None, None
    try:
        certificate = parsed(signed_text(found, key, checks), checks)
        own = _evidence(found.directory, certificate, checks, again, report)
    except CheckFailed as failed:
        checks.failed(failed.name, str(failed))
    return Verification(checks, certificate, own)


def _evidence(directory: Path, certificate: Certificate, checks: Checks, again: int, report: Report) -> Certificate:
    with checks.making("header"):
        header = _header(directory, certificate, checks)
    with checks.making("manifest"):
        text, entries = _manifest(directory, certificate, checks)
    check_files(directory, entries, lambda done: report("digests", done, len(entries)))
    checks.passed("files", _plural(len(entries), "file"))
    with checks.making("observations"):
        rerun = Rerun(directory, header, entries)
        rerun.play(lambda done: report("campaign", done, len(entries)))
    _campaign(rerun, text, certificate, checks)
    same_numerics = _software(header, checks)
    stored = _stored(directory, checks)
    if stored is not None:
        with checks.making("database"):
            _database(rerun, stored, checks)
    _chain(rerun, stored, certificate, checks, same_numerics=same_numerics)
    with checks.making("problems"):
        own = reissued(rerun)
        for name, fault, detail in compared(header, own, certificate):
            checks.judge(name, fault, detail)
    with checks.making("resimulation"):
        _resimulation(directory, entries, again, checks, report)
    return own


def _header(directory: Path, certificate: Certificate, checks: Checks) -> Header:
    """Return the first fact; the certificate has the digests of its texts."""
    header = read_untrusted_header(directory)
    config, theirs = header.config, certificate.predicate.model_dump(mode="json")
    named = {
        "name": config.name,
        "seed": config.seed,
        "config_sha256": header.config_sha256,
        "system_sha256": header.system_sha256,
    }
    if certificate.predicate.campaign.system_sha256 is None:  # an older one; the requests and the chain have it
        named["system_sha256"] = None
    ours = {"campaign": named, "software": header.software, "question": question(header)}
    if theirs["rules"] is not None or header.rules != 1:  # an older certificate names no rules: it follows rules 1
        ours["rules"] = header.rules
    fault = compare.difference(ours, {key: theirs[key] for key in ours}, same=compare.identical)
    if fault:
        raise CheckFailed("header", fault)
    check(config, header.spec, "the campaign")
    checks.passed("header", f"{config.name}, seed {config.seed}, sha256 {header.config_sha256[:16]}...")
    return header


def _manifest(directory: Path, certificate: Certificate, checks: Checks) -> tuple[str, Mapping[RolloutId, Entry]]:
    data = evidence.contents(directory / files.MANIFEST, files.MAX_MANIFEST)
    found = sha256_of(data)
    if certificate.predicate.evidence.manifest_sha256 != found or certificate.subject != (subject(found),):
        raise CheckFailed("manifest", f"its sha256 is {found[:16]}..., not the one in the certificate")
    text = data.decode()
    entries = parse_manifest(text)
    checks.passed("manifest", f"{_plural(len(entries), 'file')}, sha256 {found[:16]}...")
    return text, entries


def _campaign(rerun: Rerun, text: str, certificate: Certificate, checks: Checks) -> None:
    tests = sum(isinstance(fact, ObservationFact) for fact in rerun.facts)
    accounts = rerun.ledger.accounts
    ends = ", ".join(f"{name}: {a.last_bound.stopped_by}" for name, a in accounts.items() if a.last_bound)
    count = sum(sum(account.counts.values()) for account in accounts.values())
    checks.passed("requests", _plural(count, "rollout"))
    checks.passed("trajectories", _plural(count, "file"))
    ties = f", {rerun.ties} of them one of several within 1e-9" if rerun.ties else ""
    checks.passed("proposals", f"{_plural(tests, 'test')}{ties}")
    checks.passed("observations", _plural(tests, "test"))
    checks.passed("stop", ends)
    checks.judge("evidence", _complete(rerun, text, certificate), _plural(count, "rollout"))


def _complete(rerun: Rerun, text: str, certificate: Certificate) -> str | None:
    ours, named = manifest(rerun.observed()), certificate.predicate.evidence.rollouts
    if ours.manifest != text:
        return "its lines are not in their order"
    return None if ours.rollouts == named else f"the certificate counts {named} rollouts, there are {ours.rollouts}"


def _stored(directory: Path, checks: Checks) -> UntrustedFacts | None:
    try:
        return read_untrusted(directory)
    except JournalError as error:
        checks.failed("database", str(error))
        return None


def _database(rerun: Rerun, stored: UntrustedFacts, checks: Checks) -> None:
    fault, detail = compare.tables(stored.header, rerun.facts, stored)
    if fault is None and not (stored.proposals or stored.rollouts or stored.observations or stored.bounds):
        checks.skipped("database", "its tables are empty; everything above follows from the evidence alone")
    else:
        checks.judge("database", fault, detail)


def _chain(
    rerun: Rerun, stored: UntrustedFacts | None, certificate: Certificate, checks: Checks, *, same_numerics: bool
) -> None:
    proposals = stored.proposals if stored else ()
    header, named = rerun.ledger.header, certificate.predicate.evidence.chain_head
    head = compare.chain_head(header, rerun.facts, proposals)
    complete = len(proposals) >= sum(isinstance(fact, ProposalFact) for fact in rerun.facts)
    if head == named:
        checks.passed("chain", f"{head[:16]}...")
    elif complete or same_numerics:
        checks.failed("chain", f"its head is {head[:16]}..., in the certificate {named[:16]}...")
    else:
        # The last digits of a proposal depend on the CPU and enter the chain; only the table `tests` has them.
        checks.skipped("chain", "without the table tests it can be compared only where the last digits are the same")


def _software(header: Header, checks: Checks) -> bool:
    """Compare the versions; return whether the same numbers are to be expected."""
    other = [f"{name} {then}, here {now or 'none'}" for name, then, now in other_numerics(header.software, header.spec)]
    if other:
        checks.skipped("software", f"{', '.join(other)}: numbers were compared to {compare.ROUND_OFF:g}")
    else:
        checks.passed("software", ", ".join(f"{name} {version}" for name, version in header.software.items()))
    return not other


def _resimulation(
    directory: Path, entries: Mapping[RolloutId, Entry], count: int, checks: Checks, report: Report
) -> None:
    """Simulate again; a simulation that was requested and is impossible is a failure: a forger could cause it."""
    if not count:
        checks.skipped("resimulation", "request it with --resimulate K; workers_honest stays assumed")
        return
    found = resimulate(directory, entries, count, lambda done: report("simulation", done, min(count, len(entries))))
    checks.passed("resimulation", spot_check(found, len(entries)))


def _plural(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
