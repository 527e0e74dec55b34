"""Every claim that the data of a campaign support, the one chosen beforehand first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orchestrator.bounds.audit import Assumption
from orchestrator.bounds.composition import (
    compose,
    compose_mean,
    joint_probability,
    least_risk,
    pointwise_mean,
    round_down,
    round_up,
)
from orchestrator.methods import Paper, Rigorous, Scenario
from orchestrator.store.journal import Header
from schemas import certificate as document
from schemas.campaign import CampaignConfig, Gap, Rule

Methods = Mapping[str, Paper | Rigorous | Scenario]
Results = Mapping[str, document.ProblemResult]
PAIR = ("nominal_robustness", "sim_gap")
MULTIPLIED, ADDED = "independence", "accounting"
"""Assumptions of the two ways in which the probabilities of a pair are combined."""


@dataclass(frozen=True, slots=True)
class Claimed:
    """The claims, and the terms of the first one if it is a composition."""

    claims: tuple[document.Claim, ...]
    composition: document.Composition | None


def claims(header: Header, results: Results, methods: Methods, assumptions: Sequence[Assumption]) -> Claimed:
    """Return the claims in the order: chosen beforehand, other rules over the same pair, direct ones.

    Each has its own probability; whoever reads several pays the sum of what is missing to 1.
    """
    config = header.config
    found: list[tuple[document.Claim, document.Composition | None]] = []
    if set(PAIR) <= set(results):
        found += [_composed(header, results, methods, assumptions, rule) for rule in _rules(config)]
    found += [(_direct(result, assumptions), None) for result in results.values() if result.name not in PAIR]
    found.sort(key=lambda pair: pair[0].rule != config.composition)  # stable
    return Claimed(tuple(claim for claim, _ in found), found[0][1])


def _rules(config: CampaignConfig) -> tuple[Rule, ...]:
    methods = {problem.method for problem in config.problems if problem.name in PAIR}
    if methods == {"paper"}:
        return ("product", "sum") if config.composition == "product" else ("sum", "product")
    if methods != {"rigorous"}:
        return ("sum",)
    same = len({config.candidates_of(problem) for problem in config.problems if problem.name in PAIR}) == 1
    return ("pointwise", "bhatia-davis", "sum") if same else ("bhatia-davis", "sum")


def _direct(result: document.ProblemResult, assumptions: Sequence[Assumption]) -> document.Claim:
    minimum = result.sense == "min"
    return document.Claim(
        quantity="rho_star" if minimum else "J_star",
        sense=">=" if minimum else "<=",
        bound=result.bound,
        probability=result.probability,
        rule="single",
        method=result.method,
        **_rests_on(assumptions, {result.name}, "single"),
    )


def _composed(
    header: Header, results: Results, methods: Methods, assumptions: Sequence[Assumption], rule: Rule
) -> tuple[document.Claim, document.Composition]:
    config = header.config
    paper = rule in ("product", "sum") and isinstance(methods["sim_gap"], Paper)
    terms = _theorem_2(config, results, rule) if paper else _rigorous(header, results, methods, rule)
    claim = document.Claim(
        quantity="rho_star",
        sense=">=",
        bound=terms.bound,
        probability=_probability(results, rule),
        rule=rule,
        method=" + ".join(dict.fromkeys(results[name].method for name in PAIR)),
        **_rests_on(assumptions, set(PAIR), rule),
    )
    return claim, terms


def _theorem_2(config: CampaignConfig, results: Results, rule: Rule) -> document.Composition:
    nominal, gap, measure = results["nominal_robustness"], results["sim_gap"], _gap(config)
    composed = compose(
        nominal.bound,
        gap.bound,
        lipschitz=measure.lipschitz,
        risk_weight=config.risk_weight,
        clip=_clip(config),
        probabilities=(nominal.probability, gap.probability),
        rule="product" if rule == "product" else "sum",
    )
    return document.Composition(
        rule=rule,
        nominal_bound=nominal.bound,
        gap_bound=gap.bound,
        lipschitz=measure.lipschitz,
        gap_term=composed.gap,
        risk_term=composed.spread,
        bound=composed.ell,
    )


def _probability(results: Results, rule: Rule) -> float:
    """Return the probability of a composed claim: failures add up, but for the rule that multiplies."""
    pair = [results[name].probability for name in PAIR]
    return round_down(joint_probability(pair, "product" if rule == "product" else "sum"))


def _rigorous(header: Header, results: Results, methods: Methods, rule: Rule) -> document.Composition:
    config, measure = header.config, _gap(header.config)
    nominal, gap = results["nominal_robustness"], results["sim_gap"]
    mean = compose_mean(nominal.bound, gap.bound, kind=measure.kind, clip=_clip(config), lipschitz=measure.lipschitz)
    if rule == "pointwise":
        mean = _pointwise(config, methods, mean)
    ell = least_risk(
        mean,
        risk_weight=config.risk_weight,
        clip=_clip(config),
        variance="popoviciu" if rule == "sum" else "bhatia-davis",
    )
    return document.Composition(
        rule=rule,
        nominal_bound=nominal.bound,
        gap_bound=gap.bound,
        lipschitz=measure.lipschitz,
        gap_term=round_up(nominal.bound - mean),
        risk_term=round_up(mean - ell),
        bound=ell,
    )


def _pointwise(config: CampaignConfig, methods: Methods, extremes: float) -> float:
    nominal, gap = methods["nominal_robustness"], methods["sim_gap"]
    assert isinstance(nominal, Rigorous)
    assert isinstance(gap, Rigorous)
    if "refuted" in (nominal.method.bound().status, gap.method.bound().status):
        return extremes  # there are no bands any more
    alphas = [problem.alpha for problem in config.problems if problem.name in PAIR]
    return pointwise_mean(
        nominal.method.envelope,
        gap.method.envelope,
        nominal.candidates,
        clip=_clip(config),
        lipschitz=_gap(config).lipschitz,
        slack=min(alphas) / 4,
        extremes=extremes,
    )


def _gap(config: CampaignConfig) -> Gap:
    found = next(config.gap_of(problem) for problem in config.problems if problem.name == "sim_gap")
    assert found is not None, "the campaign file was checked"
    return found


def _clip(config: CampaignConfig) -> tuple[float, float]:
    assert config.clip is not None, "the campaign file was checked"
    return config.clip


def _rests_on(assumptions: Sequence[Assumption], problems: set[str], rule: Rule) -> dict[str, tuple[str, ...]]:
    """Return the assumptions of a claim, and which of them are refuted: of its problems, its rule, and the campaign."""
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
