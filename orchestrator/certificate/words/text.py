"""A certificate printed on a console: refuted assumptions first, then the claim, its problems, its other assumptions.

Bounds are rounded outward, so that no line claims more than the certificate. Everything is printed as plain text with
styles, never as markup: names, paths and formulas may contain brackets.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized

from rich.console import Console
from rich.text import Text

from ....schemas.amounts import counted
from ....schemas.file.composition import composes
from ....schemas.file.drawn_claims import PROBABILITIES, is_sampled
from ....schemas.file.objectives import OBJECTIVES, Quantity
from ....schemas.result.certificate import (
    Assumption,
    Bounded,
    BoundedDisturbance,
    Certificate,
    CertificateClaim,
    CompositionTerms,
    MostStarts,
    Predicate,
    ProblemResult,
    Recheck,
    SpotCheck,
    SpotCheckedProblem,
)
from ....schemas.system import SCORED
from ...campaign.clip import SAME, floored, is_vacuous
from ..assumptions.sentences import value_text
from ..assumptions.statements import title
from .bound_text import chance, clip_words, in_unit, margin_text, outward, short_chance, start_words, with_named_starts
from .console_lines import hanging, heading, plain_line
from .control_text import control_line, control_sentence
from .refutation_text import counterexample_parts, refutation_sentence, risk_sentence
from .region_text import region_sentences
from .search_text import failure_parts, search_parts

# The assumptions

COLOURS = {"refuted": "red", "derived": "green"}
STATUS = 12
"""Columns of a status and the blank behind it; the longest is `not refuted`."""


def print_list(assumptions: Iterable[Assumption], console: Console) -> None:
    """Print assumptions problem by problem: status, what is assumed, its id, and below it the finding."""
    groups: dict[str, list[tuple[str, Assumption]]] = {}
    for each in assumptions:
        name, _, problem = each.id.partition("/")
        groups.setdefault(problem or "whole campaign", []).append((name, each))
    for group, members in groups.items():
        plain_line(console, f"  {group}", "bold")
        for name, each in members:
            head = Text(f"    {each.status:<{STATUS}}", COLOURS.get(each.status, "yellow"))
            console.print(head.append(title(each.id, each.form), "bold").append(f" ({name})", "dim"), soft_wrap=True)
            hanging(console, Text(" " * (4 + STATUS)), each.detail)


QUANTITIES: dict[Quantity, str] = {
    "rho_star": "rho* (robustness risk{clipped} of the true system at its worst start)",
    "J_star": "J* (maximum of the expectation)",
    "robustness": "worst robustness{clipped} over all starts",
    "expected_robustness": "worst expected robustness{clipped} over all starts",
    "safe_share": "share of the starts that are certified safe{within}",
}
LISTED: dict[Quantity, str] = {
    "rho_star": "rho* (robustness risk{clipped} of the true system at the worst of the {starts} listed starts)",
    "J_star": "J* (expectation at the worst of the {starts} listed starts)",
    "robustness": "robustness{clipped} at the worst of the {starts} listed starts",
    "expected_robustness": "expected robustness{clipped} at the worst of the {starts} listed starts",
}
"""The same where the starts are a list, which the claim does not leave."""

TRUNCATED = ", its windows truncated at the end of a rollout"
"""Of a claim about a specification whose windows may reach beyond the horizon."""
VALID = "the bound is valid at every moment"
BUDGET = {"paper": "the bound contains the difference", "rigorous": VALID, "kriging": VALID, "scenario": VALID}
"""The reason, by method, why a problem has a bound that ended by its budget and not by its tolerance."""
PLANNED = {"sample": "all its samples were drawn", "kriging": "all its tests were made"}
"""The end of problems, by method, whose number of tests was fixed beforehand."""
VACUOUS = "It shows nothing: the clip alone proves it."
CERTAIN = "It shows nothing: every probability is at most 1."
NO_SHARE = "It shows nothing: no start is certified safe."
VARIED = {
    ("rkhs_norm", 2.0): "2 B",
    ("rkhs_norm", 4.0): "4 B",
    ("length_scale", 0.5): "half the length scale",
    ("control", 0.0): "no control of disturbances",
}
"""Names of the variations of the sensitivity."""


def quantity_words(quantity: Quantity, starts: int | None, clip: Sequence[float] | None = None) -> str:
    """Return the subject of a claim in words; `starts` is the number of listed starts, None for a box.

    `clip` is named where the values themselves may contradict what is claimed of the clipped ones.

    >>> quantity_words("robustness", 25)
    'robustness at the worst of the 25 listed starts'
    >>> quantity_words("expected_robustness", None, (-1, 2))
    'worst expected robustness, clipped to [-1, 2], over all starts'
    """
    words = (QUANTITIES if starts is None else LISTED)[quantity]
    clipped = "" if clip is None else clip_words(clip)
    return words.format(
        starts=starts and f"{starts:,}",
        clipped=clipped and f", {clipped},",
        within=clipped and f" (robustness {clipped})",
    )


def nothing_shown(quantity: Quantity | None) -> str:
    """Return the sentence beside a bound that holds without any rollout."""
    if quantity == "safe_share":
        return NO_SHARE
    return CERTAIN if quantity in PROBABILITIES else VACUOUS


def claim_words(claim: CertificateClaim) -> str:
    """Return the subject of a claim in words."""
    # Of a gap or a column no window is read.
    cut = TRUNCATED if "truncated" in claim.assumptions and claim.quantity != "J_star" else ""
    if claim.subject is not None:
        return f"{claim.subject}{cut}"
    words = quantity_words(claim.quantity, claim.starts, claim.clipped)
    if claim.rule == "every":
        return f"{words}, of every requirement{cut}"
    return f"{words}{cut}" if claim.requirement is None else f"{words}, of requirement {claim.requirement}{cut}"


def print_certificate(
    certificate: Certificate,
    console: Console,
    unit: str = "",
    *,
    assumptions: bool = True,
    units: Mapping[str, str] | None = None,
) -> None:
    """Print the whole certificate; `unit` is that of the robustness, `units` those of the parameters, in their order.

    Without `assumptions` only those that are refuted are listed.
    """
    predicate = with_named_starts(certificate, units or {}).predicate
    # First of all: a claim that rests on a refuted assumption proves nothing, however good its number.
    broken = [each for each in predicate.assumptions if each.status == "refuted"]
    of_first = [each for each in broken if each.id in predicate.claims[0].assumptions]
    _refuted(of_first, "", console)
    print_counterexample(predicate, console, unit, units)
    first_claim(certificate, console, unit)
    for number in range(1, len(predicate.claims)):
        _claim("also", certificate, number, console, unit)
    _refuted([each for each in broken if each not in of_first], ", of other claims than the first", console)
    if len(predicate.claims) > 1:
        console.print()
        for line in on_several(predicate):
            plain_line(console, line)
    if found_regions := region_sentences(predicate):
        heading(console, "Regions", "bold")
    for sentence in found_regions:
        plain_line(console, f"  {sentence}", "bold red" if "REFUTED" in sentence else "")
    if sentences := check_sentences(predicate, units):
        heading(console, "After the campaign", "bold")
    for sentence in sentences:
        plain_line(console, f"  {sentence}", "bold red" if "REFUTED" in sentence else "")
    heading(console, "Problems", "bold")
    for problem in predicate.problems:
        _problem(problem, console)
    if assumptions:
        heading(console, "Assumptions that are not refuted", "bold")
        print_list([each for each in predicate.assumptions if each.status != "refuted"], console)


def print_counterexample(
    predicate: Predicate,
    console: Console,
    unit: str,
    units: Mapping[str, str] | None = None,
    *,
    most: int | None = None,
) -> None:
    """Print the rollout that ended the campaign, if one did, and what a search has found.

    `unit` and `units` as in `print_certificate`, `most` as in `failure_parts`.
    """
    found = predicate.counterexample
    searched = search_parts(predicate.search, unit, units)
    if found is not None:
        clusters = failure_parts(predicate.failures, unit, units, most)
        _headed(
            console,
            Text("COUNTEREXAMPLE  ", "bold red"),
            (*counterexample_parts(found, unit, units), *clusters, *searched),
        )
    elif searched:
        _headed(console, Text("SEARCH  "), searched)


def _headed(console: Console, head: Text, parts: Sequence[str]) -> None:
    """Print parts below each other, the first one behind a head."""
    first, *later = parts
    # `hanging` adds to its head.
    below = " " * len(head)
    console.print()
    hanging(console, head, first)
    for each in later:
        hanging(console, Text(below), f"{each[0].upper()}{each[1:]}.")


def _refuted(broken: Sequence[Assumption], whose: str, console: Console) -> None:
    if broken:
        title = f"REFUTED{whose}, by the data of this campaign or by derivation: {_count(broken)}"
        heading(console, title, "bold red")
        print_list(broken, console)


def on_several(predicate: Predicate) -> tuple[str, ...]:
    """Return what holds of several claims together."""
    if predicate.problems[0].parameters.get("jointly"):
        together = 1.0 - sum(1.0 - claim.probability for claim in predicate.claims)
        return (f"All {len(predicate.claims)} claims hold together {chance(together)}.",)
    if predicate.regions is not None:
        return ("Both claims follow from one event, so they hold together with this probability.",)
    return (
        "The first claim was chosen beforehand. Each has its own probability; if you pick the best",
        "claim afterwards, its failure probability is the sum of all their failure probabilities.",
    )


def print_assumptions(certificate: Certificate, console: Console) -> None:
    """Print every assumption."""
    heading(console, "Assumptions", "bold")
    print_list(certificate.predicate.assumptions, console)


def first_claim(certificate: Certificate, console: Console, unit: str = "") -> None:
    """Print the claim that was chosen beforehand; `unit` is that of the robustness."""
    _claim("CLAIM", certificate, 0, console, unit)


def other_claims(predicate: Predicate, unit: str, most: int) -> tuple[str, ...]:
    """Return the claims after the first in a line each, at most so many of them, and how many more there are."""
    others = [
        f"{claim_heading(claim, unit)}, {short_chance(claim.probability, claim.assumptions)}"
        + (f", {claim.rule} rule" if composes(claim.rule) else "")
        + (": REFUTED" if claim.refuted else "")
        for claim in predicate.claims[1:]
    ]
    more = len(others) - most
    return tuple(others) if more <= 0 else (*others[:most], counted(more, "further claim"))


def claim_heading(claim: CertificateClaim, unit: str) -> str:
    """Return what a claim says, without its probability; `unit` is that of the robustness."""
    return f"{claim_words(claim)} {claim.sense} {margin_text(_bound(claim), claim, unit)}"


def notes(predicate: Predicate, number: int) -> tuple[str, ...]:
    """Return what stands beside a claim, in sentences: what it owes to its constants, and what needs none of them."""
    claim = predicate.claims[number]
    rows = [row for row in predicate.sensitivity or () if row.claim == number]
    found = list(clip_in_words(predicate, claim))
    # A claim that shows nothing says so, and owes nothing to the constants.
    if claim.without_data is not None and not claim.vacuous:
        found.append(_alone_proves(claim, claim.without_data))
    of_control = next((row for row in rows if number == 0 and row.constant == "control"), None)
    shown = [row for row in rows if row is not of_control]
    if shown and not (claim.vacuous and all(_nothing(claim, row.bound) for row in shown)):
        both = ", in both problems" if composes(claim.rule) else ""
        values = "; ".join(f"with {VARIED[row.constant, row.factor]} {_varied(claim, row.bound)}" for row in shown)
        found.append(f"The same tests{both}: {values}.")
    if number == 0 and predicate.bounded is not None:
        found += _bounded_words(predicate.bounded)
    if of_control is not None and not claim.vacuous:
        found.append(control_sentence(claim, of_control.bound, predicate.problems))
    most = predicate.spot_check and predicate.spot_check.most_starts
    if number == 0 and most and not is_irreproducible(claim):
        found.append(_sentence_on_most_starts(most))
    return tuple(found)


def _bounded_words(bounded: Bounded) -> list[str]:
    """Return what the set of bounded disturbances is, and what a claim for all of it implies, in a sentence each."""
    each = list(map(_range_words, bounded.disturbances))
    here = "it in this range" if len(each) == 1 else "all of them in these ranges"
    inside = outward(1.0 - bounded.outside, ">=")
    found = [
        f"The claim is for every {' and every '.join(each)}; a rollout has {here} with probability at least {inside}."
    ]
    if bounded.failure_probability is not None:
        share = outward(bounded.failure_probability, "<=")
        found.append(
            f"Nothing else is random, so that at every start a rollout fails with probability at most {share}, if "
            "the claim holds."
        )
    return found


def _range_words(found: BoundedDisturbance) -> str:
    """Return a bounded disturbance in words."""
    low, high = (f"{each:.4g}" for each in found.values)
    values = in_unit(f"{low} to {high}", found.unit_of_values)
    if found.unit != SCORED:
        return f"{found.name} from {values}"
    scores = f"within {found.high:g} sd" if found.low == -found.high else f"from {found.low:g} to {found.high:g} sd"
    return f"{found.name} {scores} ({values})"


def is_irreproducible(claim: CertificateClaim) -> bool:
    """Whether the rollouts behind a claim do not follow from their seeds: then those at fresh starts show as little."""
    return "reproducible_rollouts" in claim.refuted


def clip_in_words(predicate: Predicate, claim: CertificateClaim) -> tuple[str, ...]:
    """Return the sentence on the values that the clip hides behind a claim; none where it hides none that were seen."""
    hidden = (each for each in predicate.assumptions if _hides_values(each, claim))
    return tuple(_sentence_on_clip(each.id.partition("/")[2], each.values) for each in hidden)


def _hides_values(assumption: Assumption, claim: CertificateClaim) -> bool:
    """Whether an assumption is that of a clip whose lower end has hidden values behind a claim."""
    is_clip = assumption.id.startswith("clip/") and assumption.id in claim.assumptions
    # The counts are those of the whole specification.
    if not is_clip or claim.requirement is not None or claim.sense != ">=" or claim.clipped is None:
        return False
    return float(assumption.values.get("at_low", 0)) > 0


def _sentence_on_clip(problem: str, found: Mapping[str, object]) -> str:
    # The file is anyone's: an edited one may lack a value.
    hidden, number, low = (value_text(found.get(key, "?")) for key in ("at_low", "values", "low"))
    return (
        f"The claim is about the clipped robustness: {hidden} of {number} values of {problem} are at the lower "
        f"clip {low}, so the robustness itself may be lower by any amount, its mean too."
    )


def _sentence_on_most_starts(found: MostStarts) -> str:
    """Return the sentence on all starts but a share, which the spot check proves without a kernel."""
    return (
        f"Without a kernel: on all but {100 * found.share:g} % of the box the {margin_at_most_starts(found)} is at "
        f"least {outward(found.bound, '>=')}, {chance(found.probability)}."
    )


def margin_at_most_starts(found: MostStarts) -> str:
    """Return what is bounded at all starts but a share."""
    clipped = "" if found.clipped is None else f", {clip_words(found.clipped)},"
    return f"{'robustness' if found.quantity == 'robustness' else 'expected robustness'}{clipped}"


def _nothing(claim: CertificateClaim, value: float | None) -> bool:
    return value is None or is_vacuous(value, claim.sense, claim.by_clip)


def _alone_proves(claim: CertificateClaim, alone: float) -> str:
    """Return a sentence about the share of the rollouts in a claim."""
    by_clip = is_vacuous(alone, claim.sense, claim.by_clip)
    premises = "the clip alone implies" if by_clip else "B and the prior mean imply"
    gain = claim.bound - alone if claim.sense == ">=" else alone - claim.bound
    start = f"Without any rollout {premises} {outward(alone, claim.sense)}"
    if gain > SAME:
        return f"{start}; the rollouts {'raise' if claim.sense == '>=' else 'lower'} it to {_bound(claim)}."
    if gain > -SAME:
        return f"{start}: the rollouts add nothing."
    return (
        f"{start}, which is stronger than the claim: B or the prior mean is wrong, or the method is too weak for them."
    )


def _varied(claim: CertificateClaim, value: float | None) -> str:
    if value is None:
        return "no bound"
    return "no more than the clip" if _nothing(claim, value) else outward(value, claim.sense)


def _bound(claim: CertificateClaim) -> str:
    return outward(claim.bound, claim.sense)


def _claim(title: str, certificate: Certificate, number: int, console: Console, unit: str) -> None:
    predicate = certificate.predicate
    claim = predicate.claims[number]
    console.print()
    hanging(console, Text(f"{title}  ", "bold"), claim_heading(claim, unit))
    rule = f"{claim.rule} rule, " if composes(claim.rule) else ""
    source = f"method {claim.method}, {rule}{_validity(claim)}"
    # Certainty names the assumptions that it rests on itself.
    counted = source.removesuffix(", ") if claim.probability == 1.0 else f"{source}{_count(claim.assumptions)}"
    plain_line(console, f"       {chance(claim.probability, claim.assumptions)} ({counted})")
    # Behind every bound as well: a reader may copy these lines alone.
    if claim.refuted:
        hanging(console, Text("       ", "bold red"), refutation_sentence(claim.refuted))
    # The terms of a composition are those of the first claim; the others have none in the certificate.
    if predicate.composition is not None and number == 0:
        _composition(claim, predicate.composition, console)
    if claim.vacuous:
        plain_line(console, f"       {nothing_shown(claim.quantity)}", "bold red")
    for note in notes(predicate, number):
        hanging(console, Text("       "), note)


def _validity(claim: CertificateClaim) -> str:
    """Return for which number of samples a claim about drawn starts holds; empty for every other claim."""
    if not is_sampled(claim.quantity):
        return ""
    return "valid after every sample, " if claim.samples is None else f"{claim.samples:,} samples, fixed beforehand, "


def _composition(claim: CertificateClaim, composition: CompositionTerms, console: Console) -> None:
    terms = f"{_signed_term(composition.gap_term)} (gap) {_signed_term(composition.risk_term)} (risk)"
    line = f"{outward(composition.nominal_bound, '>=')} (nominal) {terms}"
    # A claim is never weaker than what the clip alone proves, and then it is not the sum of the terms.
    if claim.vacuous and composition.bound < claim.bound - SAME:
        plain_line(console, f"       composed: {line} = {outward(composition.bound, claim.sense)}, below the clip")
    else:
        plain_line(console, f"       = {line}")


def check_sentences(predicate: Predicate, units: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """Return what fresh starts and repeated rollouts showed, a sentence each; `units` are those of the parameters."""
    clip = predicate.claims[0].clipped
    return (*_spot_sentences(predicate.spot_check, units or {}, clip), *_recheck_sentences(predicate.recheck))


def _spot_sentences(
    spot: SpotCheck | None, units: Mapping[str, str], clip: tuple[float, float] | None
) -> Iterator[str]:
    if spot is None:
        return
    confidence = outward(1 - spot.level, ">=")
    yield f"Spot check: {spot.starts:,} fresh starts, drawn uniformly after the campaign; confidence {confidence} each."
    for each in spot.problems:
        yield f"Bound of {each.key}: {_spot_finding(each, spot)}."
        if each.risk is not None:
            start = start_words([f"{value:.6g}" for value in each.start or ()], units)
            clipped = "" if clip is None else f", {clip_words(clip)}"
            subject = f"Risk of {each.key} at its start ({start}){clipped}"
            yield risk_sentence(subject, each.risk, outward(each.risk.risk, "<="), outward(each.limit, ">="))
    if spot.failures is not None and spot.failure_probability is not None:
        share = outward(spot.failure_probability, "<=")
        verb = "violates" if spot.failures == 1 else "violate"
        violate = f"{spot.failures:,} of {spot.starts:,} rollouts at fresh starts {verb} the specification"
        known = f"a rollout does so with probability at most {share}, confidence {confidence}"
        yield f"{violate}; at a uniform start {known}."


OF_STATUS = {
    "refuted": "REFUTED, ",
    "not refuted": "not refuted, ",
    "beyond": "it is one of the listed starts and FALSE over the box, ",
    "not testable": "",
}
"""What the spot check found, before its numbers."""


def _spot_finding(found: SpotCheckedProblem, spot: SpotCheck) -> str:
    """Return the finding for one bound: of a deterministic value by its violations, of a noisy one by its evidence."""
    refuted = OF_STATUS[found.status]
    if found.status == "not testable":
        return "not tested, because nothing bounds its noise"
    if found.violated_share is not None:
        share, number = outward(100 * found.violated_share, "<="), found.violations
        seen = f"{number:,} of {spot.starts:,} fresh starts {'is' if number == 1 else 'are'} beyond it"
        if OBJECTIVES[found.name].risk:  # of which its value at a start is no bound
            seen = f"at {number:,} of {spot.starts:,} fresh starts the function that bounds the risk is beyond it"
        return f"{refuted}{seen}; with this confidence at most {share} % of the box is"
    left = f"; at {found.undecided:,} starts they are too few to tell" if found.undecided else ""
    evidence = f"evidence against it {found.wealth or 0.0:.3g} after {found.rollouts:,} rollouts"
    return f"{refuted}{evidence}; {1 / spot.level:g} would refute it{left}"


def _recheck_sentences(recheck: Recheck | None) -> Iterator[str]:
    if recheck is not None:
        yield f"Recheck: {recheck.agreed:,} of {recheck.rollouts:,} rollouts, simulated once more, agree bit by bit."


def _signed_term(term: float) -> str:
    """Return a term that is subtracted, with one sign, and rounded so that the sum claims no more."""
    rounded = outward(term, "<=")
    return f"+ {rounded[1:]}" if rounded.startswith("-") else f"- {rounded}"


def _problem(problem: ProblemResult, console: Console) -> None:
    sense = ">=" if problem.sense == "min" else "<="
    end = _ending(problem)
    plain_line(console, f"  {problem.key}", "bold")
    shown = floored(problem.bound, sense, problem.by_clip)
    # Of a probability no clip is given.
    alone = "the clip alone proves it" if "clipped" in problem.objective else "it holds without any rollout"
    alone = f" ({alone})" if is_vacuous(problem.bound, sense, problem.by_clip) else ""
    bound = outward(shown, sense)
    plain_line(console, f"    {problem.objective} {sense} {bound}{alone}, {short_chance(problem.probability)}")
    counts = ((problem.rollouts.nominal, "nominal"), (problem.rollouts.true, "true"))
    rollouts = (" and ".join(f"{number:,} {variant}" for number, variant in counts if number) or "no") + " rollouts"
    plain_line(console, f"    {problem.tests:,} tests with {rollouts}")
    if problem.control is not None:
        plain_line(console, f"    {control_line(problem.control)}")
    planned = problem.method in PLANNED and problem.stopped_by != "refuted"
    as_planned = problem.stopped_by == "converged" or planned
    plain_line(console, f"    {end}", "" if as_planned else "yellow")


def _ending(problem: ProblemResult) -> str:
    """Return why a problem ended, and what that means for its bound."""
    if problem.stopped_by == "counterexample":
        return "it ended with a rollout that violates the specification; the bound is valid at every moment"
    if problem.method in PLANNED and problem.stopped_by == "budget":
        return PLANNED[problem.method]
    alpha, left = problem.parameters.get("alpha"), _left(problem)
    if problem.stopped_by == "converged":
        return f"alpha reached: {left} is at most {alpha}"
    if problem.stopped_by == "budget":
        return f"alpha NOT reached: its budget ended at {left}, alpha is {alpha}; {BUDGET[problem.method]}"
    return "REFUTED: the data contradict the assumptions, so this bound proves nothing"


def _left(problem: ProblemResult) -> str:
    """Return the largest distance between the bound and the optimum, as far as the method has one."""
    if problem.last_F is not None:
        return f"F = {problem.last_F:.4f}"
    width = abs((problem.partner or 0.0) - problem.bound)
    return f"{'possible gain by more rollouts' if problem.method == 'scenario' else 'upper - lower'} = {width:.4f}"


def _count(assumptions: Sized) -> str:
    return counted(len(assumptions), "assumption")
