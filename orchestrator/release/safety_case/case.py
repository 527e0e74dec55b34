"""The content of a safety case, each number of it that of the certificate."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from ....schemas.amounts import counted, some_of
from ....schemas.errors import EvidenceError, one_line
from ....schemas.file.drawn_claims import is_sampled
from ....schemas.file.objectives import Quantity
from ....schemas.file.parameters import Range
from ....schemas.file.requirements import Requirement
from ....schemas.file.space import Scenarios
from ....schemas.result.certificate import Assumption, Certificate, CertificateClaim, Predicate
from ....schemas.result.facts import Header
from ....schemas.result.known import CampaignVerdict, VerdictWord
from ...certificate import files
from ...certificate.assumptions.statements import title
from ...certificate.counter_evidence import OF_ROLLOUTS, chance_words
from ...certificate.signing.keys import key_id, load_public
from ...certificate.signing.sign import claimed_signers, unsigned
from ...certificate.verify.checks import ABSENT, OF_BUNDLE, Check
from ...certificate.verify.manifest import sha256_of
from ...certificate.words.bound_text import in_unit
from ...certificate.words.known_text import violation_words
from ...certificate.words.refutation_text import refutation_sentence
from ...certificate.words.text import check_sentences, claim_heading, notes, nothing_shown, on_several
from ...report.collect.wording import counterexample_sentences, question_words, typeset
from ...report.glossary import glossary
from ...run.known import finished
from ...store.export_tables import robustness_unit
from ...store.files import contents
from ...store.read import system_revision
from .judges import judge_of

OF_MEANS: tuple[Quantity, ...] = ("expected_robustness", "rho_star", "mean", "risk", "J_star")
"""Quantities of which single rollouts may be worse."""
OF_READER = ("signature", "resimulation", *OF_BUNDLE)
"""Checks that depend on what a reader asks for."""
MOST_OPTIONS = 4
"""Options of the system in the answer."""
MOST_LISTED = 5
"""Starts of a list that are named."""


class Named(NamedTuple):
    """A line of a table: a name, and what is said of it."""

    name: str
    text: str


class ClaimText(NamedTuple):
    """One claim in a sentence, and what stands beside it."""

    requirement: str
    """Its id and name; empty of a claim about the whole specification."""
    method: str
    sentence: str
    notes: tuple[str, ...]
    refuted: bool


class AssumptionText(NamedTuple):
    """One assumption: what it says, what the data show of it, and who can judge it."""

    id: str
    status: str
    title: str
    detail: str
    judge: str


@dataclass(frozen=True, slots=True)
class SafetyCase:
    """What a safety case says; every text is one line."""

    campaign: str
    certificate_sha256: str
    verdict: VerdictWord
    answer: str
    """The verdict with its first reason."""
    reasons: tuple[str, ...]
    """Of the verdict."""
    by_rollouts: bool
    """Whether rollouts alone show it, without a kernel."""
    question: str
    """What the campaign file requires; empty where it requires nothing."""
    requirements: tuple[Named, ...]
    system: tuple[Named, ...]
    domain: tuple[Named, ...]
    """The operational design domain: the ranges of starts, and the laws of disturbances."""
    claims: tuple[ClaimText, ...]
    assumptions: tuple[AssumptionText, ...]
    checks: tuple[str, ...]
    """What the rollouts showed, those at fresh starts and the repeated ones, and the counterexample if there is one."""
    unchecked: tuple[str, ...]
    evidence: tuple[Named, ...]
    words: tuple[Named, ...]
    """What words of the claims mean."""
    verification: str
    rollouts: int
    """Of the evidence."""
    signatures: tuple[str, ...]
    """Who signed; what is not checked says so."""
    signed: bool
    """Whether a signature was checked."""

    def with_status(self, status: str) -> tuple[AssumptionText, ...]:
        """Return the assumptions with a status."""
        return tuple(each for each in self.assumptions if each.status == status)


def safety_case(directory: Path, keys: Sequence[Path], certificate: Certificate, lines: Sequence[Check]) -> SafetyCase:
    """Return what a safety case of a finished campaign says.

    `keys` are the public keys of its signers, `lines` the checks of a verification of this certificate.

    Raises:
        EvidenceError: a check failed, or a signature by one of the keys is missing.
        PerfboundError: the campaign cannot be read.

    """
    if failed := [each for each in lines if each.status == "failed"]:
        raise EvidenceError(
            f"{directory}: is not verified: {failed[0].name}: {failed[0].detail}; restore it from a copy"
        )
    campaign, sha256 = finished(directory, certificate), _sha256(directory)
    header, predicate = campaign.header, campaign.predicate
    unit = robustness_unit(header.config, header.spec)
    named = {each.name: _requirement_name(each) for each in header.config.specifications}
    signed = _signed(directory, keys)
    found = SafetyCase(
        campaign=header.config.name,
        certificate_sha256=sha256,
        verdict=campaign.verdict.verdict,
        answer=_answer(campaign.verdict, header, predicate),
        reasons=tuple(_reasons(campaign.verdict, predicate)),
        by_rollouts=campaign.verdict.by_rollouts is not None,
        question=typeset(question_words(header, predicate.claims[0].quantity, predicate.claims[0].starts)),
        requirements=tuple(_requirements(header)),
        system=tuple(_system(header, system_revision(directory))),
        domain=tuple(_domain(header, predicate)),
        claims=tuple(
            ClaimText(
                named.get(each.requirement or "", ""),
                each.method,
                _sentence(each, unit),
                _notes(predicate, k),
                bool(each.refuted),
            )
            for k, each in enumerate(predicate.claims)
        ),
        assumptions=tuple(map(_assumption, predicate.assumptions)),
        checks=tuple(_checks(header, campaign.verdict, predicate)),
        unchecked=tuple(_unchecked(header, predicate, lines, signed=bool(signed))),
        evidence=tuple(_evidence(header, predicate, sha256)),
        words=(),
        verification=_verification(lines),
        rollouts=predicate.evidence.rollouts,
        signatures=tuple(signed) or tuple(_claimed(claimed_signers(directory))),
        signed=bool(signed),
    )
    return replace(found, words=tuple(_words(found)))


def _words(case: SafetyCase) -> Iterator[Named]:
    """Yield the entries of the glossary of which the claims use a name."""
    used = " ".join(
        [case.answer, case.question, *(text for each in case.claims for text in (each.sentence, *each.notes))]
    )
    for entry, meaning in glossary().items():
        names = [name.strip() for name in entry.split(",")]
        if any(re.search(rf"(?<![\w]){re.escape(name)}(?![\w])", used) for name in names):
            yield Named(names[0], typeset(one_line(meaning)))


def _notes(predicate: Predicate, number: int) -> tuple[str, ...]:
    last = on_several(predicate) if number == len(predicate.claims) - 1 > 0 else ()
    return tuple(typeset(one_line(each)) for each in (*notes(predicate, number), " ".join(last)) if each)


def _sentence(claim: CertificateClaim, unit: str) -> str:
    """Return a claim in words, with what takes its worth."""
    words = f"{claim_heading(claim, unit)}, {chance_words(claim)}"
    words += f". {nothing_shown(claim.quantity)}" if claim.vacuous else ""
    words += f". {refutation_sentence(claim.refuted)}" if claim.refuted else ""
    return typeset(one_line(f"{words[0].upper()}{words[1:]}"))


def _answer(found: CampaignVerdict, header: Header, predicate: Predicate) -> str:
    """Return the verdict with its reason: of SHOWN what is claimed, else why not."""
    measured = any(each.form == "measured_system" for each in predicate.assumptions)
    given = [f"{name} = {value}" for name, value in header.template.options.items()]
    options = f" with {some_of(given[:MOST_OPTIONS])}" if given else ""
    of = f"for the {'system' if measured else 'simulator'} {header.spec.name}{options}"
    reason = f"{found.claim}." if found.verdict == "SHOWN" or not found.reasons else found.reasons[0]
    words = f"{found.verdict} {of}. {reason}"
    if found.rests_on:
        words += f" This rests on {found.rests_on}: with twice the norm bound or half the length scale it is not shown."
    return typeset(one_line(words))


def _reasons(found: CampaignVerdict, predicate: Predicate) -> Iterator[str]:
    yield from (typeset(one_line(each)) for each in found.reasons)
    if found.by_rollouts is not None:
        ids = [
            each.id for each in predicate.assumptions if each.id.partition("/")[0] in (*OF_ROLLOUTS, "workers_honest")
        ]
        yield f"This needs no kernel; it rests on {', '.join(ids)}."


def _sha256(directory: Path) -> str:
    return sha256_of(contents(directory / files.CERTIFICATE, files.MAX_CERTIFICATE))


def _requirements(header: Header) -> Iterator[Named]:
    config = header.config
    if not config.specifications:
        yield Named("specification", typeset(one_line(config.formula or "none")))
    for each in config.specifications:
        yield Named(_requirement_name(each), typeset(one_line(each.formula)))
        for words in filter(None, (each.text, each.link)):
            yield Named("", one_line(words))


def _requirement_name(found: Requirement) -> str:
    return one_line(found.name if found.id is None else f"{found.id} ({found.name})")


def _system(header: Header, revision: str | None) -> Iterator[Named]:
    spec, config = header.spec, header.config
    version = f", {revision}" if revision else ""
    yield Named("system", one_line(f"{spec.name}{version}; identity {header.system_sha256[:16]}..."))
    if spec.doc:
        yield Named("in its words", one_line(spec.doc)[:200])
    for variant, part in config.system.simulators.items():
        yield Named(f"simulator {variant}", part.label)
    if options := {**header.template.options}:
        yield Named("options", one_line(", ".join(f"{name} = {value}" for name, value in options.items())))
    yield Named("horizon", f"{config.horizon:g} s")
    if config.clip is not None:
        yield Named("clip", f"robustness beyond {config.clip[0]:g} and {config.clip[1]:g} counts as these")


def _domain(header: Header, predicate: Predicate) -> Iterator[Named]:
    config, spec = header.config, header.spec
    units = {each.name: each.unit for each in spec.declared.parameters}
    units |= {each.name: each.unit for each in spec.disturbances}
    drawn = any(is_sampled(each.quantity) for each in predicate.claims)
    if isinstance(config.space, dict):
        for name, each in config.space.items():
            yield Named(name, one_line(_range_words(each, units.get(name, ""), drawn=drawn)))
    else:
        rows = config.space.rows
        kind = "listed starts" if isinstance(config.space, Scenarios) else "rows of a table, drawn equally often"
        yield Named("starts", f"{len(rows):,} {kind}")
        names = [each.name for each in spec.parameters]
        for number, row in enumerate(rows[:MOST_LISTED]):
            values = zip(names, row, strict=True)
            yield Named(f"start {number}", ", ".join(_number(name, x, units.get(name, "")) for name, x in values))
        if len(rows) > MOST_LISTED:
            yield Named("", f"and {len(rows) - MOST_LISTED:,} more, which the campaign file lists")
    if config.where:
        yield Named("where", typeset(one_line(config.where)))
    for law in spec.disturbances:
        if law.name not in spec.as_parameters:
            yield Named(f"disturbance {law.name}", one_line(law.words))
    for law in spec.reported:
        yield Named(f"reported {law.name}", one_line(law.words))


def _range_words(given: Range, unit: str, *, drawn: bool) -> str:
    """Return the values of a parameter in words."""
    shown = "" if unit == "1" else unit
    if given.choices is not None:
        return in_unit(", ".join(f"{each:g}" for each in given.choices), shown)
    words = in_unit(f"{given.low:g} to {given.high:g}", shown)
    if given.step is not None:
        words += f" in steps of {given.step:g}"
    if given.signal is not None:
        knots = f", {given.knots} knots" if given.knots else ""
        words += f", an input over time ({given.signal}{knots})"
    if drawn:
        keys = ", ".join(f"{key} {value:g}" for key, value in given.described.items())
        law = f"{given.distribution}{f' ({keys})' if keys else ''}"
        words += f", {law}" if given.distribution == "uniform" else f", {law}, truncated to this range"
    return words


def _number(name: str, value: float, unit: str) -> str:
    return f"{name} = {in_unit(f'{value:g}', '' if unit == '1' else unit)}"


def _assumption(found: Assumption) -> AssumptionText:
    return AssumptionText(
        found.id,
        found.status,
        title(found.id, found.form),
        typeset(one_line(found.detail)),
        judge_of(found.id, found.form),
    )


def _checks(header: Header, verdict: CampaignVerdict, predicate: Predicate) -> Iterator[str]:
    if header.config.specifications:
        yield "The specification is all requirements together: its margin is the least of theirs, whatever their units."
    if count := violation_words(verdict):
        yield typeset(one_line(count))
    units = {each.name: each.unit for each in header.spec.parameters}
    if predicate.counterexample is not None:
        yield from map(one_line, counterexample_sentences(predicate.counterexample, header))
    for sentence in check_sentences(predicate, units):
        yield typeset(one_line(sentence))


def _unchecked(header: Header, predicate: Predicate, lines: Sequence[Check], *, signed: bool) -> Iterator[str]:
    """Yield what nobody has checked, and what no claim is about."""
    claim, config = predicate.claims[0], header.config
    known = {each.id.partition("/")[0]: each for each in predicate.assumptions}
    if (system := known.get("simulator_is_the_system")) is not None:
        measured = system.form == "measured_system"
        yield (
            "Whether operation is like the tests that were made."
            if measured
            else "Whether the real system behaves like the simulator: no test was made on it."
        )
    yield "Whether the formulas say what the requirements mean, and whether the ranges cover the operation."
    yield f"Other starts, options and versions of the system, and what happens after {config.horizon:g} s."
    yield from _of_claim(claim)
    if "sampled_at_sample_times" in known:
        yield "What happens between two samples of a trajectory."
    assumed = sum(each.status == "assumed" for each in predicate.assumptions)
    if assumed:
        verb = "assumption is" if assumed == 1 else "assumptions are"
        yield f"{assumed} {verb} tested by no data of the campaign: those with the status assumed."
    if predicate.spot_check is None and not is_sampled(claim.quantity):
        yield "Whether the bounds hold at fresh starts: the campaign has no spot check."
    if predicate.recheck is None:
        yield "Whether rollouts repeat: none was simulated again."
    for each in lines:
        if each.status == "skipped" and each.name not in (*OF_READER, *ABSENT):
            yield f"In the verification, that {each.meaning}: {each.detail}."
    yield "When this document was made, no rollout was simulated again: perfbound verify --resimulate 20 does that."
    yield "Whose keys the signatures are." if signed else "Who made the certificate: no signature was checked."


def _of_claim(claim: CertificateClaim) -> Iterator[str]:
    if claim.quantity in OF_MEANS:
        yield "Single rollouts: the first claim is about a mean over the noise; one may be below it, or violate."
    if is_sampled(claim.quantity):
        yield "Any single start: the first claim is about starts that are drawn as declared."
    elif claim.starts is not None:
        yield f"Starts other than the {claim.starts:,} listed ones."
    if claim.vacuous:
        yield "Anything at all by the first claim: its bound holds without any rollout."


def _evidence(header: Header, predicate: Predicate, sha256: str) -> Iterator[Named]:
    found = predicate.evidence
    yield Named("certificate.json", sha256)
    yield Named("manifest.sha256", f"{found.manifest_sha256}, of {found.rollouts:,} rollouts")
    yield Named("campaign file", header.config_sha256)
    yield Named("system", header.system_sha256)
    yield Named("hash chain", found.chain_head)
    yield Named("software", ", ".join(f"{name} {version}" for name, version in predicate.software.items()))


def _verification(lines: Sequence[Check]) -> str:
    made = [each for each in lines if each.name not in OF_READER]
    passed, skipped = ([each.name for each in made if each.status == status] for status in ("passed", "skipped"))
    without = f"; skipped, because there was nothing to check or it was impossible: {', '.join(skipped)}"
    made_of = "perfbound verify decided the campaign again from its trajectories"
    result = f"{counted(len(passed), 'check')} passed, none failed{without if skipped else ''}"
    return f"{made_of}: {result}. That is: as far as checked, the certificate follows from the recorded rollouts"


def _signed(directory: Path, keys: Sequence[Path]) -> list[str]:
    found = list[str]()
    for key in keys:
        public = load_public(key)
        if fault := unsigned(directory, public):
            raise EvidenceError(f"{directory}: no signature by {key}: {fault}")
        found.append(f"Signed by the Ed25519 key {key_id(public)}: checked.")
    return found


def _claimed(signers: Sequence[str]) -> Iterator[str]:
    if not signers:
        yield "The certificate is not signed."
    for each in signers:
        name = f"key {one_line(each)}" if each else "a key without an id"
        yield f"The certificate has a signature by {name}: not checked here."
