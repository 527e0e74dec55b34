"""The claims of a finished campaign, the one chosen beforehand first."""

from collections.abc import Sequence
from dataclasses import dataclass

from ...schemas.file.bases import Basis, bases
from ...schemas.file.composition import PAIR, Rule, composes
from ...schemas.file.config import CampaignConfig
from ...schemas.file.drawn_claims import SAMPLED
from ...schemas.file.objectives import Quantity
from ...schemas.result import certificate as document
from ..campaign.clip import hiding
from ..campaign.methods import Methods
from ..campaign.plan import UNBOUNDED, Plans, ProblemPlan
from ..mathematics.bounds.composition import (
    VarianceBound,
    compose,
    compose_mean,
    joint_probability,
    least_risk,
    pointwise_mean,
)
from ..mathematics.bounds.rigorous.method import RigorousMethod
from ..mathematics.bounds.rounding import round_down, round_up
from ..mathematics.bounds.sample import SampleMethod
from .problem_results import Results, confidence

MULTIPLIED, ADDED = "independence", "accounting"
"""Assumptions of the two ways in which the probabilities of a pair are combined."""


@dataclass(frozen=True, slots=True)
class Claimed:
    """The claims, and the terms of the first one if it is a composition."""

    claims: tuple[document.CertificateClaim, ...]
    composition: document.CompositionTerms | None


def claims(
    config: CampaignConfig,
    plans: Plans,
    results: Results,
    methods: Methods,
    assumptions: Sequence[document.Assumption],
    *,
    at_each_start: bool = True,
    first_alone: bool = False,
) -> Claimed:
    """Return the claim of every basis, in their order; with `first_alone` that of the first one.

    Each has its own probability; the failure probability of several together is at most their sum. Without
    `at_each_start` the bands of a pair are not combined at each start, which takes seconds: the bound is a weaker one.
    """
    found: list[tuple[document.CertificateClaim, document.CompositionTerms | None]] = []
    for basis in bases(config)[: 1 if first_alone else None]:
        if basis.drawn is not None:
            found.append((_of_drawn_starts(basis, plans, results, methods, assumptions), None))
            continue
        bands = methods if at_each_start else None
        composed = terms(plans, results, bands, basis.rule) if composes(basis.rule) else None
        found.append((_claim(basis, plans, results, composed, assumptions), composed))
    return Claimed(tuple(claim for claim, _ in found), found[0][1])


def _of_drawn_starts(
    basis: Basis, plans: Plans, results: Results, methods: Methods, assumptions: Sequence[document.Assumption]
) -> document.CertificateClaim:
    """Return one of the claims that the samples of a problem make."""
    (name,), place = basis.problems, basis.drawn
    plan, method = plans[name], methods[name]
    assert place is not None
    assert isinstance(method, SampleMethod)
    claim, bound = plan.claims[place], method.found(place)
    assert bound is not None, "the campaign file is checked for samples enough"
    used, refuted = _resting_on(assumptions, basis)
    return document.CertificateClaim(
        quantity=claim.asked.quantity,
        sense=SAMPLED[claim.asked.quantity].sense,
        bound=bound,
        probability=confidence(claim.delta),
        rule=basis.rule,
        method=results[name].method,
        assumptions=used,
        refuted=refuted,
        subject=plan.statement_of(claim, bound).words,
        requirement=claim.requirement,
        clipped=plan.hidden_by(claim, bound=bound),
        level=claim.asked.level,
        factor=None if claim.asked.factor == 1 else claim.asked.factor,
        samples=results[name].tests if method.needs_fixed_number(place) else None,
    )


def of_listed_starts(
    claims: Sequence[document.CertificateClaim], bases: Sequence[Basis], plans: Plans
) -> tuple[document.CertificateClaim, ...]:
    """Return the claims, one for each basis, with the number of listed starts that they cover; None on a box."""
    # The problems of one claim have the same list: the file is checked for that.
    listed = [plans[basis.problems[0]].listed for basis in bases]
    return tuple(claim.model_copy(update={"starts": each}) for claim, each in zip(claims, listed, strict=True))


def bound(basis: Basis, plans: Plans, results: Results, methods: Methods | None) -> float:
    """Return the bound of a claim from those of its problems; see `terms`."""
    if composes(basis.rule):
        return terms(plans, results, methods, basis.rule).bound
    return _weakest(basis, results)


def _weakest(basis: Basis, results: Results) -> float:
    """Return the bound of one problem; of every requirement the least, each at the full delta: see `bounds.joint`."""
    return min(results[key].bound for key in basis.problems)


def _quantity(basis: Basis, plans: Plans) -> Quantity:
    """Return what a claim is about; the terms of a composition compose to the risk."""
    if composes(basis.rule):
        return "rho_star"
    # A claim about every requirement is about values themselves only if no bound of them is one of means.
    plan = min((plans[name] for name in basis.problems), key=lambda each: each.exact)
    return plan.statement.quantity or "rho_star"


def _claim(
    basis: Basis,
    plans: Plans,
    results: Results,
    composed: document.CompositionTerms | None,
    assumptions: Sequence[document.Assumption],
) -> document.CertificateClaim:
    bounded = [results[name] for name in basis.problems]
    first = bounded[0]
    minimum = composed is not None or first.sense == "min"
    used, refuted = _resting_on(assumptions, basis)
    # The claim about every requirement is false only if that of one fixed requirement is: of any, so of the least.
    least = min(each.probability for each in bounded)
    probability = least if composed is None else _probability(results, composed.rule)
    bound = _weakest(basis, results) if composed is None else composed.bound
    return document.CertificateClaim(
        quantity=_quantity(basis, plans),
        sense=">=" if minimum else "<=",
        bound=bound,
        probability=probability,
        rule=basis.rule,
        method=" + ".join(dict.fromkeys(each.method for each in bounded)),
        assumptions=used,
        refuted=refuted,
        requirement=first.requirement if basis.rule == "single" else None,
        clipped=_hidden_by([plans[name] for name in basis.problems], bound, composed=composed is not None),
    )


def _hidden_by(plans: Sequence[ProblemPlan], bound: float, *, composed: bool) -> tuple[float, float] | None:
    """Return the clip that the words of a claim have to name."""
    if not composed:
        return next((clip for each in plans if (clip := each.hidden_by(bound=bound)) is not None), None)
    plan = plans[0]
    clip = None if plan.clip == UNBOUNDED else plan.clip
    # A composition is about the risk of the true system, whatever its terms are.
    return hiding(clip, plan.reaches[None], "risk", ">=", risk_weight=plan.risk_weight)


def terms(plans: Plans, results: Results, methods: Methods | None, rule: Rule) -> document.CompositionTerms:
    """Return the terms of a composition of the pair; `methods` is None for bounds that follow from no data."""
    nominal, gap, plan = results["nominal_robustness"], results["sim_gap"], plans["sim_gap"]
    lipschitz, risk_weight, clip = plan.gap.lipschitz, plan.risk_weight, plan.clip
    # Theorem 2 as printed: extremes, and Popoviciu's inequality for the variance.
    if plan.problem.method == "paper" and rule in ("product", "sum"):
        composed = compose(
            nominal.bound,
            gap.bound,
            lipschitz=lipschitz,
            risk_weight=risk_weight,
            clip=clip,
            probabilities=(nominal.probability, gap.probability),
            rule="product" if rule == "product" else "sum",
        )
        gap_term, risk_term, ell = composed.gap, composed.spread, composed.ell
    else:
        mean = compose_mean(nominal.bound, gap.bound, kind=plan.gap.kind, clip=clip, lipschitz=lipschitz)
        # Without data both bands are flat, so that no start is better than the two extremes.
        if rule == "pointwise" and methods is not None:
            mean = _pointwise(plans, methods, mean)
        variance: VarianceBound = "popoviciu" if rule == "sum" else "bhatia-davis"
        ell = least_risk(mean, risk_weight=risk_weight, clip=clip, variance=variance)
        gap_term, risk_term = round_up(nominal.bound - mean), round_up(mean - ell)
    return document.CompositionTerms(
        rule=rule,
        nominal_bound=nominal.bound,
        gap_bound=gap.bound,
        lipschitz=lipschitz,
        gap_term=gap_term,
        risk_term=risk_term,
        bound=ell,
    )


def _probability(results: Results, rule: Rule) -> float:
    """Return the probability of a composed claim: only the rule `product` multiplies, the others add failures."""
    pair = [results[name].probability for name in PAIR]
    return round_down(joint_probability(pair, "product" if rule == "product" else "sum"))


def _pointwise(plans: Plans, methods: Methods, extremes: float) -> float:
    nominal, gap, plan = methods["nominal_robustness"], methods["sim_gap"], plans["sim_gap"]
    assert isinstance(nominal, RigorousMethod)
    assert isinstance(gap, RigorousMethod)
    if "refuted" in (nominal.bound().status, gap.bound().status):
        return extremes  # a refuted problem has an empty confidence set, so no band
    return pointwise_mean(
        nominal.envelope,
        gap.envelope,
        nominal.candidates,
        clip=plan.clip,
        lipschitz=plan.gap.lipschitz,
        # The default of the cover of a problem, for the tighter of the two tolerances.
        slack=min(alpha for name in PAIR if (alpha := plans[name].problem.alpha)) / 4,
        extremes=extremes,
    )


def _resting_on(assumptions: Sequence[document.Assumption], basis: Basis) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the assumptions of a claim, and those of them that are refuted: of its problems, rule and campaign."""
    problems, rule = set(basis.problems), basis.rule
    # A claim that adds failures needs no independence, a single one needs neither.
    others = {"product": {ADDED}, "single": {ADDED, MULTIPLIED}, "every": {ADDED, MULTIPLIED}}.get(rule, {MULTIPLIED})
    used = [
        each
        for each in assumptions
        if each.id not in others and ("/" not in each.id or each.id.split("/", 1)[1] in problems)
    ]
    return tuple(each.id for each in used), tuple(each.id for each in used if each.status == "refuted")
