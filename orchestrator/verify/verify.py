"""`perfbound verify`: every check, in an order in which nothing is read before it is known to be what it claims.

The signature covers the certificate, the certificate names the manifest, the manifest the files. The campaign is then
decided again from the files alone, and compared with the certificate and with what is left of the database.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from orchestrator.campaign import RolloutId
from orchestrator.certificate import files, sign
from orchestrator.certificate.issue import manifest, question
from orchestrator.errors import JournalError, PerfboundError
from orchestrator.store.journal import Header, ObservationFact, ProposalFact, read_header
from orchestrator.store.queries import reading
from orchestrator.store.stored import Stored, stored
from orchestrator.verify import compare
from orchestrator.verify.checks import FailedError, Table
from orchestrator.verify.issued import issued
from orchestrator.verify.manifest import Entry, check_files, parse, sha256_of
from orchestrator.verify.rerun import Rerun
from orchestrator.verify.resimulate import resimulate, sentence
from orchestrator.versions import software
from schemas.certificate import Certificate

Tell = Callable[[str, int, int], None]
"""Hears a stage, how much of it is done, and how much there is."""


@dataclass(frozen=True, slots=True)
class Subject:
    """What is to be verified: a run directory, and the certificate in it."""

    directory: Path
    certificate: Path
    envelope: Path

    @classmethod
    def of(cls, path: Path) -> "Subject":
        """Take a run directory, a certificate or its envelope.

        Raises:
            PerfboundError: there is nothing to verify.

        """
        directory = path if path.is_dir() else path.parent
        envelope = directory / files.ENVELOPE
        certificate = path if path.is_file() and path.name != envelope.name else directory / files.CERTIFICATE
        if not certificate.is_file() and not envelope.is_file():
            raise PerfboundError(f"{path}: no certificate here; name a run directory whose campaign has finished")
        return cls(directory, certificate, envelope)


def verify(path: Path, *, key: Path | None, again: int, tell: Tell) -> tuple[Table, Certificate | None]:
    """Return the checks, and the certificate if it could be read; `again` rollouts are simulated again.

    Raises:
        PerfboundError: there is nothing to verify, or the key cannot be read.

    """
    subject, table = Subject.of(path), Table()
    certificate = None
    try:
        text = _signature(subject, key, table)
        certificate = _certificate(text, table)
        _evidence(subject.directory, certificate, table, again, tell)
    except FailedError as failed:
        table.failed(failed.name, str(failed))
    return table, certificate


def _signature(subject: Subject, key: Path | None, table: Table) -> bytes:
    """Return the bytes of the certificate; with a key, those that were signed."""
    signed = subject.envelope.is_file()
    if key is None:
        table.skipped("signature", "give the signer's public key with --key" if signed else "it is not signed")
        if not subject.certificate.is_file():
            raise PerfboundError(f"{subject.envelope}: give the signer's public key with --key")
        return subject.certificate.read_bytes()
    public = sign.load_public(key)
    if not signed:
        raise FailedError("signature", f"there is no {files.ENVELOPE}: the certificate is not signed")
    try:
        with subject.envelope.open("rb") as file:
            payload = sign.verify(file.read(sign.MAX_ENVELOPE + 1), public)
    except PerfboundError as error:
        raise FailedError("signature", str(error)) from None
    if subject.certificate.is_file() and subject.certificate.read_bytes() != payload:
        raise FailedError("signature", f"what was signed is not {subject.certificate.name}")
    table.passed("signature", f"Ed25519, key {sign.key_id(public)[:16]}...")
    return payload


def _certificate(text: bytes, table: Table) -> Certificate:
    try:
        found = Certificate.model_validate_json(text)
    except ValueError as error:
        raise FailedError("certificate", f"not a certificate: {str(error).splitlines()[0]}") from None
    if found.to_json().encode() != text:
        raise FailedError("certificate", "it is not written as perfbound writes it: somebody edited it")
    table.passed("certificate", _count(len(found.predicate.claims), "claim"))
    return found


def _evidence(directory: Path, certificate: Certificate, table: Table, again: int, tell: Tell) -> None:
    header = _header(directory, certificate, table)
    text, entries = _manifest(directory, certificate, table)
    check_files(directory, entries, lambda done: tell("digests", done, len(entries)))
    table.passed("files", _count(len(entries), "file"))
    rerun = Rerun(directory, header, entries)
    rerun.play(lambda done: tell("campaign", done, len(entries)))
    _campaign(rerun, text, certificate, table)
    there = _stored(directory, table)
    _database(rerun, there, table)
    _chain(header, rerun, there, certificate, table)
    for name, fault, detail in issued(rerun, certificate):
        table.judge(name, fault, detail)
    _software(header, table)
    _again(directory, entries, again, table, tell)


def _header(directory: Path, certificate: Certificate, table: Table) -> Header:
    try:
        with reading(directory) as connection:
            header = read_header(connection, directory)
    except JournalError as error:
        raise FailedError("header", str(error)) from None
    config, theirs = header.config, certificate.predicate.model_dump(mode="json")
    ours = {
        "campaign": {"name": config.name, "seed": config.seed, "config_sha256": header.config_sha256},
        "software": header.software,
        "question": question(header),
    }
    fault = compare.difference(ours, {key: theirs[key] for key in ours})
    if fault:
        raise FailedError("header", fault)
    table.passed("header", f"{config.name}, seed {config.seed}, sha256 {header.config_sha256[:16]}...")
    return header


def _manifest(directory: Path, certificate: Certificate, table: Table) -> tuple[str, Mapping[RolloutId, Entry]]:
    try:
        data = (directory / files.MANIFEST).read_bytes()
    except OSError as error:
        raise FailedError("manifest", f"{files.MANIFEST}: {error.strerror}") from None
    named = {certificate.predicate.evidence.manifest_sha256, *(s.digest.get("sha256") for s in certificate.subject)}
    found = sha256_of(data)
    if named != {found}:
        raise FailedError("manifest", f"its sha256 is {found[:16]}..., not the one in the certificate")
    text = data.decode(errors="replace")
    entries = parse(text)
    table.passed("manifest", f"{len(entries)} files, sha256 {found[:16]}...")
    return text, entries


def _campaign(rerun: Rerun, text: str, certificate: Certificate, table: Table) -> None:
    tests = sum(isinstance(fact, ObservationFact) for fact in rerun.facts)
    accounts = rerun.ledger.accounts
    ends = ", ".join(f"{name}: {a.last_bound.stopped_by}" for name, a in accounts.items() if a.last_bound)
    count = sum(sum(account.counts.values()) for account in accounts.values())
    table.passed("requests", _count(count, "rollout"))
    table.passed("trajectories", _count(count, "file"))
    ties = f", {rerun.proposer.ties} of them one of several within 1e-9" if rerun.proposer.ties else ""
    table.passed("proposals", f"{tests} tests{ties}")
    table.passed("observations", _count(tests, "test"))
    table.passed("stop", ends)
    table.judge("evidence", _complete(rerun, text, certificate), _count(count, "rollout"))


def _complete(rerun: Rerun, text: str, certificate: Certificate) -> str | None:
    ours, named = manifest(rerun.observed()), certificate.predicate.evidence.rollouts
    if ours.manifest != text:
        return "its lines are not in their order"
    return None if ours.rollouts == named else f"the certificate counts {named} rollouts, there are {ours.rollouts}"


def _stored(directory: Path, table: Table) -> Stored | None:
    try:
        return stored(directory)
    except JournalError as error:
        table.failed("database", str(error))
        return None


def _database(rerun: Rerun, there: Stored | None, table: Table) -> None:
    if there is None:
        return
    fault, detail = compare.tables(rerun.facts, there)
    if fault is None and not (there.proposals or there.rollouts or there.observations or there.bounds):
        table.skipped("database", "its tables are empty; everything above follows from the evidence alone")
    else:
        table.judge("database", fault, detail)


def _chain(header: Header, rerun: Rerun, there: Stored | None, certificate: Certificate, table: Table) -> None:
    proposals = there.proposals if there else ()
    head, named = compare.chain_head(header, rerun.facts, proposals), certificate.predicate.evidence.chain_head
    if head == named:
        table.passed("chain", f"{head[:16]}...")
    elif len(proposals) < sum(isinstance(fact, ProposalFact) for fact in rerun.facts):
        table.skipped(
            "chain",
            "without the table tests it can be compared only where the last digits are the same",
        )
    else:
        table.failed("chain", f"its head is {head[:16]}..., in the certificate {named[:16]}...")


def _software(header: Header, table: Table) -> None:
    here = software(header.spec)
    other = [
        f"{name} {then}, here {here.get(name)}" for name, then in header.software.items() if here.get(name) != then
    ]
    if other:
        table.skipped("software", f"{', '.join(other)}: numbers were compared to {compare.ROUND_OFF:g}")
    else:
        table.passed("software", ", ".join(f"{name} {version}" for name, version in here.items()))


def _again(directory: Path, entries: Mapping[RolloutId, Entry], count: int, table: Table, tell: Tell) -> None:
    if not count:
        table.skipped("resimulation", "ask for it with --resimulate K; workers_honest stays assumed")
        return
    try:
        found = resimulate(directory, entries, count, lambda done: tell("simulation", done, min(count, len(entries))))
    except PerfboundError as error:
        table.skipped("resimulation", f"cannot be simulated here: {error}")
    else:
        table.passed("resimulation", sentence(found, len(entries)))


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
