"""A certificate printed on a console: refuted assumptions first, then the claim, its problems, its other assumptions.

Bounds are rounded outward, so that no line claims more than the certificate. Everything is printed as plain text with
styles, never as markup: names, paths and formulas may contain brackets.
"""

import math
import shlex
import textwrap
from collections.abc import Iterable, Iterator, Sized
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ...schemas.certificate import (
    Assumption,
    Certificate,
    CertificateClaim,
    CompositionTerms,
    Predicate,
    ProblemResult,
    Recheck,
    SpotCheck,
    SpotCheckedProblem,
)
from ...schemas.problems import Quantity

WIDTH = 100
DIGITS = 4
COLOURS = {"refuted": "red", "derived": "green"}
QUANTITIES: dict[Quantity, str] = {
    "rho_star": "rho* (robustness risk of the true system at its worst start)",
    "J_star": "J* (maximum of the expectation)",
    "robustness": "worst robustness over all starts",
    "expected_robustness": "worst expected robustness over all starts",
}

VALID = "the bound is valid at every moment"
BUDGET = {"paper": "the bound contains the difference", "rigorous": VALID, "scenario": VALID}
"""The reason, by method, why a problem that ended by its budget has a bound."""
WEALTH = 20
"""1 / level of the spot check."""
NAME = 25
"""Columns of the name of an assumption; the longest are `simulator_is_the_system` and `sampled_at_sample_times`."""


def outward(bound: float, sense: str) -> str:
    """Return a bound with four digits that is no stronger than `bound`.

    >>> outward(0.00019, ">="), outward(-0.00011, ">="), outward(0.00011, "<=")
    ('0.0001', '-0.0002', '0.0002')
    """
    scaled = bound * 10**DIGITS
    nearest = round(scaled)
    # A bound that has four digits, but for the last bits of a float, keeps them.
    if not math.isclose(scaled, nearest, rel_tol=0, abs_tol=1e-6):
        nearest = math.floor(scaled) if sense == ">=" else math.ceil(scaled)
    return f"{nearest / 10**DIGITS:.{DIGITS}f}"


def print_certificate(certificate: Certificate, console: Console) -> None:
    """Print the whole certificate."""
    predicate = certificate.predicate
    # First of all: a claim that rests on a refuted assumption proves nothing, however good its number.
    broken = [each for each in predicate.assumptions if each.status == "refuted"]
    if broken:
        _heading(console, f"REFUTED, by the data of this campaign or by derivation: {_count(broken)}", "bold red")
        _assumptions(broken, console)
    first_claim(certificate, console)
    for claim in predicate.claims[1:]:
        _claim("also", claim, None, console)
    if len(predicate.claims) > 1:
        console.print()
        _line(console, "The first claim was chosen beforehand. Each has its own probability; if you pick the best")
        _line(console, "claim afterwards, its failure probability is the sum of all their failure probabilities.")
    if sentences := check_sentences(predicate):
        _heading(console, "After the campaign", "bold")
    for sentence in sentences:
        _line(console, f"  {sentence}", "bold red" if "REFUTED" in sentence else "")
    _heading(console, "Problems", "bold")
    for problem in predicate.problems:
        _problem(problem, console)
    _heading(console, "Assumptions that are not refuted", "bold")
    _assumptions([each for each in predicate.assumptions if each.status != "refuted"], console)


def print_assumptions(certificate: Certificate, console: Console) -> None:
    """Print every assumption."""
    _heading(console, "Assumptions", "bold")
    _assumptions(certificate.predicate.assumptions, console)


def first_claim(certificate: Certificate, console: Console) -> None:
    """Print the claim that was chosen beforehand."""
    # The terms of a composition are those of the first claim; the others have none in the certificate.
    _claim("CLAIM", certificate.predicate.claims[0], certificate.predicate.composition, console)


def print_files(directory: Path, console: Console) -> None:
    """Print the output files of a run."""
    _heading(console, "Output files", "bold")
    for name, content in (
        ("certificate.json", "certificate"),
        ("certificate.dsse.json", "signed"),
        ("manifest.sha256", "manifest"),
        ("trajectories", "evidence"),
        ("campaign.db", "database"),
        ("report.html", "report"),
    ):
        if (directory / name).exists():
            _line(console, f"  {content:<12} {directory / name}")
    _line(console, f"  verify with  perfbound verify {shlex.quote(str(directory))}")


def _claim(title: str, claim: CertificateClaim, composition: CompositionTerms | None, console: Console) -> None:
    bound, probability = outward(claim.bound, claim.sense), outward(claim.probability, ">=")
    _heading(console, f"{title}  {QUANTITIES[claim.quantity]} {claim.sense} {bound}", "bold")
    rule = "" if claim.rule == "single" else f"{claim.rule} rule, "
    source = f"method {claim.method}, {rule}{_count(claim.assumptions)}"
    _line(console, f"       with probability at least {probability} ({source})")
    if composition is not None:
        terms = f"{_signed_term(composition.gap_term)} (gap) {_signed_term(composition.risk_term)} (risk)"
        _line(console, f"       = {outward(composition.nominal_bound, '>=')} (nominal) {terms}")
    # Beside every claim as well: a reader may copy these lines alone.
    if claim.refuted:
        _line(console, f"       It rests on {_count(claim.refuted)} REFUTED: do not rely on it.", "bold red")


def check_sentences(predicate: Predicate) -> tuple[str, ...]:
    """Return what fresh starts and repeated rollouts showed, a sentence each."""
    return (*_spot_sentences(predicate.spot_check), *_recheck_sentences(predicate.recheck))


def _spot_sentences(spot: SpotCheck | None) -> Iterator[str]:
    if spot is None:
        return
    confidence = outward(1 - spot.level, ">=")
    yield f"Spot check: {spot.starts} fresh starts, drawn uniformly after the campaign; confidence {confidence} each."
    for each in spot.problems:
        yield f"{each.name}: {_spot_finding(each)}."
    if spot.failures is not None and spot.failure_probability is not None:
        share = outward(spot.failure_probability, "<=")
        violate = f"{spot.failures} of {spot.starts} rollouts violate the specification"
        yield f"{violate}; at a uniform start a rollout violates it with probability at most {share}."


def _spot_finding(found: SpotCheckedProblem) -> str:
    """Return the finding for one bound: of a deterministic value by its violations, of a noisy one by a test."""
    refuted = "REFUTED, " if found.status == "refuted" else "not refuted, "
    if found.status == "not testable":
        return "not tested, because nothing bounds its noise"
    if found.violated_share is not None:
        share = outward(100 * found.violated_share, "<=")
        return f"{refuted}{found.violations} starts are beyond the bound, at most {share} % of the box"
    left = f", {found.undecided} suspicious starts are undecided" if found.undecided else ""
    return f"{refuted}evidence {found.wealth or 0.0:.3g} after {found.rollouts} rollouts, {WEALTH} would refute{left}"


def _recheck_sentences(recheck: Recheck | None) -> Iterator[str]:
    if recheck is not None:
        yield f"Recheck: {recheck.agreed} of {recheck.rollouts} rollouts, simulated once more, agree bit by bit."


def _signed_term(term: float) -> str:
    """Return a term that is subtracted, with one sign, and rounded so that the sum claims no more."""
    rounded = float(outward(term, "<="))
    return f"{'-' if rounded >= 0 else '+'} {abs(rounded):.{DIGITS}f}"


def _problem(problem: ProblemResult, console: Console) -> None:
    sense = ">=" if problem.sense == "min" else "<="
    alpha = problem.parameters.get("alpha")
    left = _left(problem)
    end = {
        "converged": f"converged: {left} is at most alpha = {alpha}",
        "budget": f"NOT converged: its budget ended at {left}, alpha is {alpha}; {BUDGET[problem.method]}",
        "refuted": "REFUTED: the data contradict the assumptions, so this bound proves nothing",
    }[problem.stopped_by]
    _line(console, f"  {problem.name}", "bold")
    bound, probability = outward(problem.bound, sense), outward(problem.probability, ">=")
    _line(console, f"    {problem.objective} {sense} {bound}, probability {probability}")
    rollouts = f"{problem.rollouts.nominal} nominal and {problem.rollouts.true} true rollouts"
    _line(console, f"    {problem.tests} tests with {rollouts}")
    _line(console, f"    {end}", "" if problem.stopped_by == "converged" else "yellow")


def _left(problem: ProblemResult) -> str:
    """Return the largest distance between the bound and the optimum, as far as the method has one."""
    if problem.last_F is not None:
        return f"F = {problem.last_F:.4f}"
    width = abs((problem.partner or 0.0) - problem.bound)
    return f"{'possible gain by more rollouts' if problem.method == 'scenario' else 'upper - lower'} = {width:.4f}"


def _assumptions(assumptions: Iterable[Assumption], console: Console) -> None:
    """Print assumptions problem by problem, with hanging indents."""
    groups: dict[str, list[tuple[str, Assumption]]] = {}
    for each in assumptions:
        name, _, problem = each.id.partition("/")
        groups.setdefault(problem or "whole campaign", []).append((name, each))
    for group, members in groups.items():
        _line(console, f"  {group}", "bold")
        for name, each in members:
            head = Text(f"    {name:<{NAME}}")
            head.append(f"{each.status:<12}", COLOURS.get(each.status, "yellow"))
            _hanging(console, head, each.detail)


def _hanging(console: Console, head: Text, body: str) -> None:
    """Print `body` right of `head`, wrapped, its lines below each other."""
    indent = len(head.plain)
    width = min(console.width, WIDTH) if console.is_terminal else WIDTH
    lines = textwrap.wrap(body, max(40, width - indent), break_long_words=False, break_on_hyphens=False)
    console.print(head.append(("\n" + " " * indent).join(lines)), soft_wrap=True)


def _heading(console: Console, text: str, style: str) -> None:
    console.print()
    _line(console, text, style)


def _line(console: Console, text: str, style: str = "") -> None:
    console.print(Text(text, style), soft_wrap=True)


def _count(assumptions: Sized) -> str:
    return f"{len(assumptions)} assumption{'s' if len(assumptions) > 1 else ''}"
