"""`perfbound verify`: every check, in an order in which nothing is read before it is known to be what it claims.

The signature covers the certificate, the certificate names campaign, system and manifest, the manifest the files. The
campaign is then decided again from the files alone, and compared with the certificate and with the database.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

from ....schemas.certificate import Certificate
from ....schemas.errors import JournalError
from ....schemas.facts import Header, ObservationFact, ProposalFact
from ....schemas.ids import RolloutId
from ...campaign.checks import check
from ...campaign.software import here
from ...store import files as evidence
from ...store.untrusted import UntrustedFacts, read_untrusted, read_untrusted_header
from .. import files
from ..issue import manifest, question, subject
from . import compare
from .checks import FailedError, Table
from .input import VerificationInput, parsed, signed_text
from .manifest import Entry, check_files, parse, sha256_of
from .reissue import reissued
from .rerun import Rerun
from .resimulate import resimulate, sentence

Tell = Callable[[str, int, int], None]
"""Hears a stage, how much of it is done, and how much there is."""


def verify(path: Path, *, key: Path | None, again: int, tell: Tell) -> tuple[Table, Certificate | None]:
    """Return the checks, and the certificate if it could be read; `again` rollouts are simulated again.

    Raises:
        PerfboundError: there is nothing to verify, or the key cannot be read.

    """
    found, table, certificate = VerificationInput.of(path), Table(), None
    try:
        certificate = parsed(signed_text(found, key, table), table)
        _evidence(found.directory, certificate, table, again, tell)
    except FailedError as failed:
        table.failed(failed.name, str(failed))
    return table, certificate


def _evidence(directory: Path, certificate: Certificate, table: Table, again: int, tell: Tell) -> None:
    with table.making("header"):
        header = _header(directory, certificate, table)
    with table.making("manifest"):
        text, entries = _manifest(directory, certificate, table)
    check_files(directory, entries, lambda done: tell("digests", done, len(entries)))
    table.passed("files", _count(len(entries), "file"))
    with table.making("observations"):
        rerun = Rerun(directory, header, entries)
        rerun.play(lambda done: tell("campaign", done, len(entries)))
    _campaign(rerun, text, certificate, table)
    same_software = _software(header, table)
    there = _stored(directory, table)
    if there is not None:
        with table.making("database"):
            _database(rerun, there, table)
    _chain(rerun, there, certificate, table, same_software=same_software)
    with table.making("problems"):
        for name, fault, detail in reissued(rerun, certificate):
            table.judge(name, fault, detail)
    with table.making("resimulation"):
        _again(directory, entries, again, table, tell)


def _header(directory: Path, certificate: Certificate, table: Table) -> Header:
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
    fault = compare.difference(ours, {key: theirs[key] for key in ours}, same=compare.identical)
    if fault:
        raise FailedError("header", fault)
    check(config, header.spec, "the campaign")
    table.passed("header", f"{config.name}, seed {config.seed}, sha256 {header.config_sha256[:16]}...")
    return header


def _manifest(directory: Path, certificate: Certificate, table: Table) -> tuple[str, Mapping[RolloutId, Entry]]:
    data = evidence.contents(directory / files.MANIFEST, files.MAX_MANIFEST)
    found = sha256_of(data)
    if certificate.predicate.evidence.manifest_sha256 != found or certificate.subject != (subject(found),):
        raise FailedError("manifest", f"its sha256 is {found[:16]}..., which is not what the certificate is about")
    text = data.decode()
    entries = parse(text)
    table.passed("manifest", f"{_count(len(entries), 'file')}, sha256 {found[:16]}...")
    return text, entries


def _campaign(rerun: Rerun, text: str, certificate: Certificate, table: Table) -> None:
    tests = sum(isinstance(fact, ObservationFact) for fact in rerun.facts)
    accounts = rerun.ledger.accounts
    ends = ", ".join(f"{name}: {a.last_bound.stopped_by}" for name, a in accounts.items() if a.last_bound)
    count = sum(sum(account.counts.values()) for account in accounts.values())
    table.passed("requests", _count(count, "rollout"))
    table.passed("trajectories", _count(count, "file"))
    ties = f", {rerun.ties} of them one of several within 1e-9" if rerun.ties else ""
    table.passed("proposals", f"{_count(tests, 'test')}{ties}")
    table.passed("observations", _count(tests, "test"))
    table.passed("stop", ends)
    table.judge("evidence", _complete(rerun, text, certificate), _count(count, "rollout"))


def _complete(rerun: Rerun, text: str, certificate: Certificate) -> str | None:
    ours, named = manifest(rerun.observed()), certificate.predicate.evidence.rollouts
    if ours.manifest != text:
        return "its lines are not in their order"
    return None if ours.rollouts == named else f"the certificate counts {named} rollouts, there are {ours.rollouts}"


def _stored(directory: Path, table: Table) -> UntrustedFacts | None:
    try:
        return read_untrusted(directory)
    except JournalError as error:
        table.failed("database", str(error))
        return None


def _database(rerun: Rerun, there: UntrustedFacts, table: Table) -> None:
    fault, detail = compare.tables(there.header, rerun.facts, there)
    if fault is None and not (there.proposals or there.rollouts or there.observations or there.bounds):
        table.skipped("database", "its tables are empty; everything above follows from the evidence alone")
    else:
        table.judge("database", fault, detail)


def _chain(
    rerun: Rerun, there: UntrustedFacts | None, certificate: Certificate, table: Table, *, same_software: bool
) -> None:
    proposals = there.proposals if there else ()
    header, named = rerun.ledger.header, certificate.predicate.evidence.chain_head
    head = compare.chain_head(header, rerun.facts, proposals)
    complete = len(proposals) >= sum(isinstance(fact, ProposalFact) for fact in rerun.facts)
    if head == named:
        table.passed("chain", f"{head[:16]}...")
    elif complete or same_software:
        table.failed("chain", f"its head is {head[:16]}..., in the certificate {named[:16]}...")
    else:
        table.skipped("chain", "without the table tests it can be compared only where the last digits are the same")


def _software(header: Header, table: Table) -> bool:
    """Compare the versions; return whether they are the same."""
    now = here(header.spec)
    pairs = [(name, then, now.get(name)) for name, then in header.software.items()]
    other = [f"{name} {then}, here {found or 'none'}" for name, then, found in pairs if found != then]
    if other:
        table.skipped("software", f"{', '.join(other)}: numbers were compared to {compare.ROUND_OFF:g}")
    else:
        table.passed("software", ", ".join(f"{name} {version}" for name, version in header.software.items()))
    return not other


def _again(directory: Path, entries: Mapping[RolloutId, Entry], count: int, table: Table, tell: Tell) -> None:
    """Simulate again; what was asked for and cannot be done is a failure: whoever forges could see to it."""
    if not count:
        table.skipped("resimulation", "ask for it with --resimulate K; workers_honest stays assumed")
        return
    found = resimulate(directory, entries, count, lambda done: tell("simulation", done, min(count, len(entries))))
    table.passed("resimulation", sentence(found, len(entries)))


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
