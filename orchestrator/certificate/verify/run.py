"""The verification of a certificate: all checks, in an order in which no content is read before its digest is checked.

The signature covers the certificate, the certificate names campaign, system and manifest, the manifest the files. The
campaign is then decided again from the files alone, and compared with the certificate and with the database.
"""

import html
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ....schemas import __version__
from ....schemas.amounts import counted
from ....schemas.batch import BatchRequest
from ....schemas.errors import JournalError, Stopped
from ....schemas.file.against_system import as_in_campaign
from ....schemas.ids import FileId, RolloutId
from ....schemas.result.block_facts import BlockProposalFact
from ....schemas.result.certificate import Assumption, Certificate
from ....schemas.result.facts import ExtensionFact, Header, ProposalFact
from ....schemas.rollout import RolloutRequest
from ...campaign.checks import check
from ...campaign.ledger import failed_attempts, observed_discards, observed_rollouts
from ...campaign.software import other_numerics
from ...fleet.children.simulate import simulate_to
from ...store import files as evidence
from ...store.read import contradicted, irreproducible
from ...store.untrusted import UntrustedFacts, read_untrusted, read_untrusted_header
from .. import files
from ..assumptions.audit import EXTENDED
from ..assumptions.opinions import admitted_rollouts
from ..issue import manifest, question, subject
from . import compare
from .attempts import check_attempts
from .checks import CheckFailed, Checks
from .discards import discarded
from .input import VerificationInput, parsed, signed_text
from .manifest import Entry, check_files, parse_manifest, sha256_of, split_manifest
from .regions import compared_regions
from .reissue import compared, reissue
from .rerun import Rerun
from .resimulate import Repetition, finding, resimulate
from .stages import Report

NOT_REPEATED = {
    "session": "{name} was defined in an interactive session, and no process can simulate it again",
    "nowhere": "the rollouts of {name} were handed in, and nothing can simulate them again",
}
"""Why there is nothing to simulate, by `repeated` of the system; the certificate lists it as an assumption."""


@dataclass(frozen=True, slots=True)
class Verification:
    """The checks, the certificate if it was readable, and the reissued one if the evidence gives one."""

    checks: Checks
    certificate: Certificate | None
    reissued: Certificate | None
    header: Header | None = None
    """Of the campaign, if it was readable."""

    def __repr__(self) -> str:
        """Return the result, and the number of checks of each status."""
        found = Counter(each.status for each in self.checks.lines())
        counts = ", ".join(f"{count} {status}" for status, count in found.items())
        return f"<Verification: {'VERIFIED' if self.checks.good else 'FAILED'}, {counts}>"

    def _repr_html_(self) -> str:
        """Return the checks as a table; every text is escaped, because the run directory may be untrusted."""
        rows = "".join(
            f"<tr><td>{html.escape(each.name)}</td><td>{each.status}</td><td>{html.escape(each.detail)}</td></tr>"
            for each in self.checks.lines()
        )
        return f"<p>{html.escape(repr(self))}</p><table>{rows}</table>"


@dataclass(frozen=True, slots=True)
class Again:
    """How many rollouts or batches are simulated again; `system` is FILE.py:NAME of one that no certificate names."""

    rollouts: int
    system: str | None = None


def verify_certificate(
    path: Path,
    *,
    key: Path | None,
    again: int,
    report: Report,
    system: str | None = None,
    trajectories: bool = True,
) -> Verification:
    """Verify the certificate in `path`; `again` rollouts or batches are simulated again, by `system` if it is a file's.

    Without `trajectories` only their digests are here: what follows from them is skipped.

    Raises:
        PerfboundError: there is no certificate, or the key cannot be read.
        Stopped: a signal arrived; with the checks so far.

    """
    given, checks, certificate, reissued, header = VerificationInput.of(path), Checks(), None, None, None
    at = ""

    def reported(stage: str, done: int, total: int) -> None:
        nonlocal at
        at = f"{stage} at {done:,} of {total:,}{'' if stage == 'simulation' else ' files'}"
        report(stage, done, total)

    try:
        text = signed_text(given, key, checks)
        certificate = parsed(text, checks)
        if not trajectories:
            header = _digests_alone(given.directory, certificate, checks)
            return Verification(checks, certificate, None, header)
        reissued, header = _evidence(given.directory, certificate, checks, Again(again, system), reported)
        with checks.making("attempts"):
            if checks.found["database"].status == "passed":  # else its tables are another program's, or empty
                check_attempts(given.directory, text, key, checks)
            else:
                checks.skipped("attempts", "the tables of the database are empty, or failed their own check")
    except CheckFailed as failed:
        checks.failed(failed.name, str(failed))
    except Stopped as stop:
        raise Stopped(stop.signal, f"nothing is verified: {_so_far(checks, at)}") from None
    return Verification(checks, certificate, reissued, header)


def _so_far(checks: Checks, at: str) -> str:
    """Return which checks have been made and which have not, and how far the last stage was."""
    by_status: dict[str, list[str]] = {}
    for each in checks.lines():
        status = each.status if each.name in checks.found else "not reached"
        by_status.setdefault(status, []).append(each.name)
    missed = by_status.pop("not reached", [])
    parts = [f"{status} {', '.join(names)}" for status, names in by_status.items()]
    return "; ".join([*parts, *filter(None, [at]), f"not reached {', '.join(missed) or 'none'}"])


def _evidence(
    directory: Path, certificate: Certificate, checks: Checks, again: Again, report: Report
) -> tuple[Certificate, Header]:
    """Make the checks of the evidence; return the reissued certificate, and the header of the campaign."""
    with checks.making("header"):
        header = _header(directory, certificate, checks)
    with checks.making("manifest"):
        text, entries, kept = _manifest(directory, certificate, checks)
        discards = discarded(certificate, kept)
    # Digests before contents: from here on every file is the one that the certificate names.
    every = [*entries.values(), *(entry for _, entry in kept)]
    check_files(directory, every, lambda done: report("digests", done, len(every)))
    checks.passed("files", counted(len(every), "file"))
    with checks.making("observations"):
        rerun = Rerun(directory, header, entries, discards, extended(certificate))
        rerun.play(lambda done: report("campaign", done, len(entries)))
    # The rerun reached its end, so the checks inside it passed.
    _campaign(rerun, text, len(entries), certificate, checks)
    same_numerics = _software(header, checks)
    stored = _stored(directory, checks)
    if stored is not None:
        with checks.making("database"):
            _database(rerun, stored, checks)
    _chain(rerun, stored, certificate, checks, same_numerics=same_numerics)
    with checks.making("problems"):
        reissued = reissue(
            rerun,
            irreproducible=_irreproducible(directory, certificate, failed_attempts(rerun.ledger)),
            contradicted=_contradicted(directory, certificate),
        )
        for name, fault, detail in compared(header, reissued, certificate):
            checks.judge(name, fault, detail)
    with checks.making("regions"):
        checks.judge("regions", *compared_regions(directory, rerun.ledger, certificate))
    with checks.making("resimulation"):
        if again.rollouts and header.spec.repeated != "anywhere":
            checks.skipped("resimulation", NOT_REPEATED[header.spec.repeated].format(name=header.spec.name))
        else:
            simulate = partial(_simulate, header, again.system)
            repetition = Repetition(directory, entries, simulate, rerun.ledger.observer)
            _resimulation(repetition, again.rollouts, checks=checks, report=report)
    return reissued, header


def _digests_alone(directory: Path, certificate: Certificate, checks: Checks) -> Header:
    """Make the checks that need no trajectory; return the header of the campaign."""
    with checks.making("header"):
        header = _header(directory, certificate, checks)
    with checks.making("manifest"):
        _manifest(directory, certificate, checks)
    for each in checks.lines():
        if each.name not in checks.found:
            checks.skipped(each.name, "the trajectories are not here, only their digests")
    return header


def _header(directory: Path, certificate: Certificate, checks: Checks) -> Header:
    """Return the header of the database, whose texts have the digests in the certificate."""
    header = read_untrusted_header(directory)
    config, recorded = header.config, certificate.predicate.model_dump(mode="json")
    campaign = {
        "name": config.name,
        "seed": config.seed,
        "config_sha256": header.config_sha256,
        "system_sha256": header.system_sha256,
    }
    expected = {
        "campaign": campaign,
        "software": header.software,
        "question": question(header),
        "rules": header.rules,
    }
    fault = compare.difference(expected, {key: recorded[key] for key in expected}, tolerance=0.0)
    if fault:
        raise CheckFailed("header", fault)
    # The pair is untrusted, and its digests fit: refuse it as a run would, before the mathematics reads it.
    check(config, header.spec, "the campaign")
    # The identity of a system depends neither on knots nor on laws that the file gives: they are those of the file.
    if header.spec != as_in_campaign(header.spec.declared, config):
        raise CheckFailed("header", "the stored system has other inputs or disturbances than the campaign file")
    checks.passed("header", f"{config.name}, seed {config.seed}, sha256 {header.config_sha256[:16]}..." + _of(header))
    return header


def _of(header: Header) -> str:
    """Return what a campaign of another version does without."""
    if (theirs := header.software.get("perfbound")) != __version__:
        return f"; of perfbound {theirs}, this one is {__version__}: its sentences are not compared"
    return ""


def _manifest(
    directory: Path, certificate: Certificate, checks: Checks
) -> tuple[str, Mapping[FileId, Entry], list[tuple[RolloutId, Entry]]]:
    data = evidence.contents(directory / files.MANIFEST, files.MAX_MANIFEST)
    found = sha256_of(data)
    if certificate.predicate.evidence.manifest_sha256 != found or certificate.subject != (subject(found),):
        raise CheckFailed("manifest", f"its sha256 is {found[:16]}..., not the one in the certificate")
    text = data.decode()
    observed, kept = split_manifest(text)
    entries = parse_manifest(observed)
    checks.passed("manifest", f"{counted(len(entries) + len(kept), 'file')}, sha256 {found[:16]}...")
    return text, entries, kept


def _campaign(rerun: Rerun, text: str, files_read: int, certificate: Certificate, checks: Checks) -> None:
    tests = sum(len(each.observations) for each in rerun.ledger.series.values())
    accounts = rerun.ledger.series
    ends = ", ".join(f"{name}: {a.last_bound.stopped_by}" for name, a in accounts.items() if a.last_bound)
    ends += "".join(f"; extended to {max(tests for _, tests in each.budgets):,}" for each in rerun.ledger.extensions)
    count = sum(sum(account.counts.values()) for account in accounts.values())
    checks.passed("requests", counted(count, "rollout"))
    checks.passed("trajectories", counted(files_read, "file"))
    ties = f", {rerun.ties:,} of them as good as another start but for rounding" if rerun.ties else ""
    checks.passed("proposals", f"{counted(tests, 'test')}{ties}")
    problems = rerun.ledger.accounts.values()
    bare = sum(sum(each.counts.values()) - each.kept.number for each in problems)
    taken = f"; the robustness of {counted(bare, 'rollout')} without samples is taken as recorded" if bare else ""
    checks.passed("observations", f"{counted(tests, 'test')}{taken}")
    checks.passed("stop", ends)
    checks.judge("evidence", _complete(rerun, text, certificate), counted(count, "rollout"))


def _complete(rerun: Rerun, text: str, certificate: Certificate) -> str | None:
    expected = manifest(rerun.observed(), observed_discards(rerun.ledger))
    listed = certificate.predicate.evidence.rollouts
    if expected.text != text:
        return "the lines of the manifest are not in the order of problems, tests and rollouts"
    rollouts = observed_rollouts(rerun.ledger)
    return None if rollouts == listed else f"the certificate counts {listed:,} rollouts, the evidence has {rollouts:,}"


def _stored(directory: Path, checks: Checks) -> UntrustedFacts | None:
    try:
        return read_untrusted(directory)
    except JournalError as error:
        checks.failed("database", str(error))
        return None


def _database(rerun: Rerun, stored: UntrustedFacts, checks: Checks) -> None:
    fault, detail = compare.tables(stored.header, rerun.facts, stored)
    if fault is None and not (stored.proposals or stored.rollouts or stored.observations or stored.bounds):
        checks.skipped("database", "its tables are empty; every other check needs the evidence alone")
    else:
        checks.judge("database", fault, detail)


def _irreproducible(directory: Path, certificate: Certificate, evident: int) -> int:
    """Return the rollouts and batches that were recorded after the system had failed in an attempt.

    That no trajectory file shows, unlike the `evident` failed attempts.
    """
    # The database may be cut down, so a certificate that admits more than the database shows is believed.
    admitted = [each for each in certificate.predicate.assumptions if each.id == "reproducible_rollouts"]
    failed = [number for each in admitted if isinstance(number := each.values.get("failed"), int)]
    return max(irreproducible(directory), *(number - evident for number in failed), 0)


def _contradicted(directory: Path, certificate: Certificate) -> list[str]:
    """Return rollouts of outvoted workers that differ; those that a certificate admits, if the database has none."""
    return contradicted(directory) or admitted_rollouts(certificate.predicate)


def _chain(
    rerun: Rerun, stored: UntrustedFacts | None, certificate: Certificate, checks: Checks, *, same_numerics: bool
) -> None:
    proposals = stored.proposals if stored else ()
    header, recorded = rerun.ledger.header, certificate.predicate.evidence.chain_head
    head = compare.chain_head(header, rerun.facts, proposals)
    wanted = sum(isinstance(fact, ProposalFact | BlockProposalFact) for fact in rerun.facts)
    complete = len(proposals) >= wanted
    if head == recorded:
        checks.passed("chain", f"{head[:16]}...")
    elif complete or same_numerics:
        checks.failed("chain", f"its head is {head[:16]}..., in the certificate {recorded[:16]}...")
    else:
        # The last digits of a proposal depend on the CPU and enter the chain; only the table `tests` has them.
        checks.skipped("chain", "not comparable on this machine without the table `tests`: the last digits may differ")


def _software(header: Header, checks: Checks) -> bool:
    """Compare the versions; return whether they must give the same numbers."""
    differing = other_numerics(header.software, header.spec)
    other = [f"{each.name} {each.recorded}, here {each.installed or 'none'}" for each in differing]
    if other:
        checks.skipped("software", f"{', '.join(other)}: numbers were compared to {compare.ROUND_OFF:g}")
    else:
        code = header.spec.code
        numerics = ", ".join(f"{name} {each}" for name, each in header.software.items() if name not in code)
        # Nothing here looks at the sources of the system: they are where it is simulated.
        unseen = f"; the sources of {header.spec.name} are compared with --resimulate alone" if code else ""
        checks.passed("software", numerics + unseen)
    return not other


def _simulate(header: Header, system: str | None, path: Path, request: RolloutRequest | BatchRequest) -> None:
    limit = header.config.deadline * (len(request) if isinstance(request, BatchRequest) else 1)
    simulate_to(path, request, header.spec, system, limit=limit)


def _resimulation(wanted: Repetition, rollouts: int, *, checks: Checks, report: Report) -> None:
    """Simulate rollouts again, if requested."""
    if not rollouts:
        checks.skipped("resimulation", "request it with --resimulate K; workers_honest stays assumed")
        return
    # An impossible simulation fails the check: a forger could cause it.
    count = min(rollouts, len(wanted.entries))
    found = resimulate(wanted, count, lambda done: report("simulation", done, count))
    checks.passed("resimulation", finding(found, len(wanted.entries)))


def extended(certificate: Certificate) -> tuple[ExtensionFact, ...]:
    """Return the extensions that a certificate lists; whether the campaign allows them the rerun decides.

    Raises:
        CheckFailed: they are not numbered from 1, or name no budget.

    """
    budgets: dict[int, dict[str, int]] = {}
    for each in certificate.predicate.assumptions:
        if each.id.startswith(EXTENDED):
            number, problem, tests = _of_line(each)
            budgets.setdefault(number, {})[problem] = tests  # one line for each requirement of the problem
    if list(budgets) != list(range(1, len(budgets) + 1)):
        raise CheckFailed("stop", "its extensions are not numbered from 1 in their order")
    return tuple(ExtensionFact(number, tuple(listed.items())) for number, listed in budgets.items())


def _of_line(found: Assumption) -> tuple[int, str, int]:
    number, values = found.id.removeprefix(EXTENDED).partition("/")[0], found.values
    problem, tests = values.get("problem"), values.get("max_tests")
    if not number.isdecimal() or not isinstance(problem, str) or not isinstance(tests, int):
        raise CheckFailed("stop", f"{found.id[:80]} names no budget")
    return int(number), problem, tests
