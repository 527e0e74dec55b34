"""The rules of a policy: each judges one campaign, and finds nothing where the policy does not ask for it."""

import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from packaging.specifiers import SpecifierSet
from packaging.version import InvalidVersion, Version

from ....schemas.amounts import counted
from ....schemas.result.certificate import Assumption, CertificateClaim
from ...certificate.words.bound_text import in_unit, outward
from ...certificate.words.format import duration
from ...run.known import Finished
from .policy import OTHERS, Policy
from .subject import Subject

KERNEL = ("rkhs_norm", "kernel")
"""First parts of the ids of the assumptions that constants of a kernel are right."""
DAY = 86_400.0
MORE_TESTS = "give the campaign more tests, or other constants: `perfbound show DIR` says what would help"


@dataclass(frozen=True, slots=True)
class Finding:
    """What became of one rule; the texts are one line each."""

    rule: str
    expected: str
    found: str
    remedy: str
    """What to do where it fails."""
    passed: bool


@dataclass(frozen=True, slots=True)
class Judgement:
    """The findings on one run directory, or on all together; with a `fault` it could not be read."""

    name: str
    findings: tuple[Finding, ...]
    fault: str = ""
    subject: Subject | None = None
    """None for the findings on all together."""

    @property
    def passed(self) -> bool:
        """Whether every rule holds."""
        return not self.fault and all(each.passed for each in self.findings)


def judged(policy: Policy, subjects: Sequence[Subject]) -> list[Judgement]:
    """Return the judgement on each subject, and one on all where the policy lists requirements."""
    found = [_on_one(policy, each) for each in subjects]
    if policy.requirements:
        every = [each.campaign for each in subjects if each.campaign is not None]
        found.append(Judgement("requirements", tuple(_shown(policy, each, every) for each in policy.requirements)))
    return found


def _on_one(policy: Policy, subject: Subject) -> Judgement:
    if subject.fault:
        return Judgement(subject.name, (), subject.fault, subject)
    findings = [_verified(policy, subject)] if policy.verifies else []
    if (campaign := subject.campaign) is not None:
        findings += [each for rule in RULES for each in rule(policy, campaign)]
        findings += [_signed(key, subject) for key in policy.signed_by]
    return Judgement(subject.name, tuple(findings), "", subject)


def _verified(policy: Policy, subject: Subject) -> Finding:
    again = f", {counted(policy.resimulated, 'rollout')} simulated again" if policy.resimulated else ""
    passed = f"{subject.checks} passed{'; ' if subject.resimulated else ''}{subject.resimulated}"
    return Finding(
        "verified",
        f"every check of `perfbound verify`{again}",
        "; ".join(subject.failed_checks[:3]) or passed,
        "restore the run directory from a copy, or run the campaign again; no number of it counts until then",
        passed=not subject.failed_checks,
    )


def _signed(key: str, subject: Subject) -> Finding:
    fault = subject.unsigned.get(key, "")
    command = shlex.join(["perfbound", "sign", subject.name, "--key", "KEY"])
    remedy = f"`{command}` with the private key of {key}"
    return Finding("signed_by", f"a signature by {key}", fault or "signed", remedy, passed=not fault)


def _verdict(policy: Policy, campaign: Finished) -> Iterator[Finding]:
    if policy.verdict == "any":
        return
    word, reasons = campaign.verdict.verdict, campaign.verdict.reasons
    passed = word == "SHOWN" if policy.verdict == "SHOWN" else word != "VIOLATED"
    found = word if passed or not reasons else f"{word}: {reasons[0]}"
    remedy = " ".join(campaign.verdict.advice[:1]) or "fix the system: its rollouts violate the requirement"
    yield Finding("verdict", policy.verdict, found, remedy, passed=passed)


def _bound(policy: Policy, campaign: Finished) -> Iterator[Finding]:
    claim, unit = campaign.predicate.claims[0], campaign.verdict.bound_unit
    for rule, sense, limit in (("margin", ">=", policy.margin), ("at_most", "<=", policy.at_most)):
        if limit is None:
            continue
        found = f"{claim.quantity} {claim.sense} {in_unit(outward(claim.bound, claim.sense), unit)}"
        if claim.sense != sense:
            remedy = (
                f"ask for {'at_most' if sense == '>=' else 'margin'}, or for another first claim in the campaign file"
            )
            yield Finding(rule, f"a bound {sense} {limit:g}", found, remedy, passed=False)
            continue
        refuted = f", on refuted assumptions: {', '.join(claim.refuted)}" if claim.refuted else ""
        yield Finding(
            rule, f"{sense} {in_unit(f'{limit:g}', unit)}", found + refuted, MORE_TESTS, passed=_reaches(claim, limit)
        )


def _probability(policy: Policy, campaign: Finished) -> Iterator[Finding]:
    if policy.probability is not None:
        found = campaign.predicate.claims[0].probability
        remedy = "run the campaign with a smaller delta, or with required_probability in its file"
        yield Finding(
            "probability",
            f"at least {policy.probability:g}",
            f"at least {outward(found, '>=')}",
            remedy,
            passed=found >= policy.probability,
        )


def _constants(policy: Policy, campaign: Finished) -> Iterator[Finding]:
    kernels = [each for each in campaign.predicate.claims[0].assumptions if _first_part(each) in KERNEL]
    rests = campaign.verdict.rests_on
    if policy.constants == "doubled":
        shown = campaign.verdict.verdict == "SHOWN"
        found = f"it rests on {rests}" if rests else "the same verdict" if shown else campaign.verdict.verdict
        remedy = "run more tests, or show it without a kernel: method `sample`, or the fresh starts of a spot check"
        expected = "SHOWN also with twice the norm bound or half the length scales"
        yield Finding("constants", expected, found, remedy, passed=shown and not rests)
    elif policy.constants == "none":
        found = f"it assumes {', '.join(kernels)}" if kernels else "it assumes none"
        remedy = "choose a method without a kernel for the first claim: `sample`, or `scenario` with listed starts"
        yield Finding("constants", "no constant of a kernel", found, remedy, passed=not kernels)


def _assumptions(policy: Policy, campaign: Finished) -> Iterator[Finding]:
    if not policy.assumptions:
        return
    wanted = set(campaign.predicate.claims[0].assumptions)
    there = [each for each in campaign.predicate.assumptions if each.id in wanted]
    wrong = [each for each in there if each.status not in _allowed(policy, each)]
    for each in wrong:
        allowed = " or ".join(_allowed(policy, each))
        remedy = f"`perfbound show DIR --assumptions` has the reason; {_for_status(each)}"
        yield Finding("assumptions", f"{each.id}: {allowed}", each.status, remedy, passed=False)
    if not wrong:
        yield Finding(
            "assumptions", "allowed statuses", f"{counted(len(there), 'assumption')}, all allowed", "", passed=True
        )


def _allowed(policy: Policy, each: Assumption) -> Sequence[str]:
    for name in (each.id, _first_part(each.id), OTHERS):
        if name in policy.assumptions:
            return policy.assumptions[name]
    return (each.status,)


def _for_status(each: Assumption) -> str:
    if each.status == "refuted":
        return "do not rely on the claim"
    return "no data of the campaign tested it: judge it, and allow its status in the policy"


def _spot_check(policy: Policy, campaign: Finished) -> Iterator[Finding]:
    if policy.spot_check:
        spot = campaign.predicate.spot_check
        refuted = [each.key for each in spot.problems if each.status == "refuted"] if spot else []
        found = "none" if spot is None else f"{counted(spot.starts, 'fresh start')}"
        found += f"; refuted: {', '.join(refuted)}" if refuted else ""
        remedy = "run the campaign with `spot_check` in its file" if spot is None else "do not rely on the claim"
        good = spot is not None and not refuted
        yield Finding("spot_check", "bounds tested at fresh starts", found, remedy, passed=good)


def _recheck(policy: Policy, campaign: Finished) -> Iterator[Finding]:
    if policy.recheck:
        again = campaign.predicate.recheck
        found = "none" if again is None else f"{again.agreed} of {counted(again.rollouts, 'rollout')} the same"
        remedy = "run the campaign with `recheck` in its file, on a system whose rollouts follow from their seeds"
        good = again is not None and 0 < again.rollouts == again.agreed
        yield Finding("recheck", "recorded rollouts simulated again, and the same", found, remedy, passed=good)


def _age(policy: Policy, campaign: Finished) -> Iterator[Finding]:
    if policy.max_age is not None:
        age = campaign.age
        found = "no rollout has a time" if age is None else f"{_days(age)} since the last rollout"
        # A clock that goes backwards makes no evidence younger.
        good = age is not None and -DAY <= age <= policy.max_age
        remedy = "run the campaign again on the present system, and check the clock of this machine"
        yield Finding("max_age", f"at most {_days(policy.max_age)}", found, remedy, passed=good)


def _days(seconds: float) -> str:
    return f"{seconds / DAY:.1f} days" if abs(seconds) >= 2 * DAY else duration(seconds)


def _software(policy: Policy, campaign: Finished) -> Iterator[Finding]:
    for name, versions in policy.software.items():
        found = campaign.predicate.software.get(name)
        remedy = f"run the campaign with {name} {versions}"
        yield Finding("software", f"{name} {versions}", found or "not recorded", remedy, passed=_fits(found, versions))


def _fits(found: str | None, versions: str) -> bool:
    try:
        return found is not None and SpecifierSet(versions).contains(Version(found), prereleases=True)
    except InvalidVersion:
        return False


RULES: tuple[Callable[[Policy, Finished], Iterable[Finding]], ...] = (
    _verdict,
    _bound,
    _probability,
    _constants,
    _assumptions,
    _spot_check,
    _recheck,
    _software,
    _age,
)
"""In the order of the output."""


def _shown(policy: Policy, wanted: str, campaigns: Iterable[Finished]) -> Finding:
    """Return whether one of some campaigns shows the requirement with this id or name."""
    reasons = [reason for each in campaigns for reason in _reasons(policy, wanted, each)]
    good = [each for each, passed in reasons if passed]
    found = (good or [each for each, _ in reasons] or ["no campaign has it"])[0]
    remedy = "give a run directory whose file has this id under `[specifications]`, and a claim that shows it"
    return Finding("requirements", f"{wanted} is shown", found, remedy, passed=bool(good))


def _reasons(policy: Policy, wanted: str, campaign: Finished) -> Iterator[tuple[str, bool]]:
    config = campaign.header.config
    name = next((each.name for each in config.specifications or () if wanted in (each.id, each.name)), None)
    if name is None:
        return
    # What holds of the whole specification holds of each requirement: it is their conjunction.
    claims = [each for each in campaign.predicate.claims if each.requirement in (None, name)]
    for claim in claims:
        limit = _limit(policy, campaign, claim)
        text = f"{config.name}: {claim.quantity} {claim.sense} {outward(claim.bound, claim.sense)}"
        text += ", and neither `at_most` nor the campaign file says what is acceptable" if limit is None else ""
        yield text, limit is not None and _reaches(claim, limit) and not claim.vacuous
    if not claims:
        yield f"{config.name}: no claim is about it", False


def _limit(policy: Policy, campaign: Finished, claim: CertificateClaim) -> float | None:
    if claim.sense == ">=":
        return campaign.header.config.required_margin if policy.margin is None else policy.margin
    return campaign.header.config.required_at_most if policy.at_most is None else policy.at_most


def _reaches(claim: CertificateClaim, limit: float) -> bool:
    """Whether the bound of a claim is at a limit or beyond, and rests on nothing refuted."""
    return not claim.refuted and (claim.bound >= limit if claim.sense == ">=" else claim.bound <= limit)


def _first_part(name: str) -> str:
    """Return the kind of an assumption.

    >>> _first_part("rkhs_norm/true_risk"), _first_part("clip")
    ('rkhs_norm', 'clip')
    """
    return name.partition("/")[0]
