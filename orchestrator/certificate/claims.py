"""The claims of a finished campaign, the one chosen beforehand first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...schemas import certificate as document
from ...schemas.campaign import CampaignConfig, Rule
from ...schemas.problems import Quantity
from ..campaign.methods import Methods
from ..campaign.plan import Plans
from ..mathematics.bounds.composition import (
    VarianceBound,
    compose,
    compose_mean,
    joint_probability,
    least_risk,
    pointwise_mean,
)
from ..mathematics.bounds.paper import PaperMethod
from ..mathematics.bounds.rigorous import RigorousMethod
from ..mathematics.bounds.rounding import round_down, round_up

Results = Mapping[str, document.ProblemResult]
PAIR = ("nominal_robustness", "sim_gap")
MULTIPLIED, ADDED = "independence", "accounting"
"""Assumptions of the two ways in which the probabilities of a pair are combined."""


@dataclass(frozen=True, slots=True)
class Claimed:
    """The claims, and the terms of the first one if it is a composition."""

    claims: tuple[document.CertificateClaim, ...]
    composition: document.CompositionTerms | None


def claims(
    config: CampaignConfig, plans: Plans, results: Results, methods: Methods, assumptions: Sequence[document.Assumption]
) -> Claimed:
    """Return the claims in the order: chosen beforehand, other rules over the same pair, direct ones.

    Each has its own probability; the failure probability of several together is at most their sum.
    """
    found: list[tuple[document.CertificateClaim, document.CompositionTerms | None]] = []
    if set(PAIR) <= set(results):
        found += [_composed(plans, results, methods, assumptions, rule) for rule in _rules(config)]
    for name, result in results.items():
        quantity = plans[name].statement.quantity
        if quantity is not None:
            found.append((_direct(result, quantity, assumptions), None))
    # Stable. First comes the claim that was fixed beforehand: to pick the best afterwards costs the sum.
    found.sort(key=lambda pair: pair[0].rule != config.composition)
    return Claimed(tuple(claim for claim, _ in found), found[0][1])


def _rules(config: CampaignConfig) -> tuple[Rule, ...]:
    methods = {problem.method for problem in config.problems if problem.name in PAIR}
    # The rules that follow from Theorem 2 as printed.
    if methods == {"paper"}:
        return ("product", "sum") if config.composition == "product" else ("sum", "product")
    if methods != {"rigorous"}:
        return ("sum",)
    # Pointwise subtracts one band from the other, start by start: both need the same candidates.
    same = len({config.candidates_of(problem) for problem in config.problems if problem.name in PAIR}) == 1
    return ("pointwise", "bhatia-davis", "sum") if same else ("bhatia-davis", "sum")


def _direct(
    result: document.ProblemResult, quantity: Quantity, assumptions: Sequence[document.Assumption]
) -> document.CertificateClaim:
    return document.CertificateClaim(
        quantity=quantity,
        sense=">=" if result.sense == "min" else "<=",
        bound=result.bound,
        probability=result.probability,
        rule="single",
        method=result.method,
        **_rests_on(assumptions, {result.name}, "single"),
    )


def _composed(
    plans: Plans, results: Results, methods: Methods, assumptions: Sequence[document.Assumption], rule: Rule
) -> tuple[document.CertificateClaim, document.CompositionTerms]:
    terms = _terms(plans, results, methods, rule)
    claim = document.CertificateClaim(
        quantity="rho_star",
        sense=">=",
        bound=terms.bound,
        probability=_probability(results, rule),
        rule=rule,
        method=" + ".join(dict.fromkeys(results[name].method for name in PAIR)),
        **_rests_on(assumptions, set(PAIR), rule),
    )
    return claim, terms


def _terms(plans: Plans, results: Results, methods: Methods, rule: Rule) -> document.CompositionTerms:
    nominal, gap, plan = results["nominal_robustness"], results["sim_gap"], plans["sim_gap"]
    lipschitz, risk_weight, clip = plan.gap.lipschitz, plan.risk_weight, plan.clip
    # Theorem 2 as printed: extremes, and Popoviciu's inequality for the variance.
    if isinstance(methods["sim_gap"], PaperMethod) and rule in ("product", "sum"):
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
        if rule == "pointwise":
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
        slack=min(plans[name].problem.alpha for name in PAIR) / 4,
        extremes=extremes,
    )


def _rests_on(assumptions: Sequence[document.Assumption], problems: set[str], rule: Rule) -> dict[str, tuple[str, ...]]:
    """Return the assumptions of a claim (of its problems, its rule and the campaign) and the refuted ones of them."""
    # A claim that adds failures needs no independence, a single one needs neither.
    others = {"product": {ADDED}, "single": {ADDED, MULTIPLIED}}.get(rule, {MULTIPLIED})
    used = [
        each
        for each in assumptions
        if each.id not in others and ("/" not in each.id or each.id.split("/")[1] in problems)
    ]
    return {
        "assumptions": tuple(each.id for each in used),
        "refuted": tuple(each.id for each in used if each.status == "refuted"),
    }
