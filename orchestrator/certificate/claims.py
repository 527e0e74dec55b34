"""Every claim that the data of a campaign support, the one chosen beforehand first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from orchestrator.bounds.composition import (
    compose,
    compose_mean,
    compose_risk,
    confidence,
    joint_probability,
    pointwise_mean,
    round_down,
)
from orchestrator.methods import Paper, Rigorous, Scenario, noise_per_test
from orchestrator.store.journal import Header
from schemas import certificate as document
from schemas.campaign import CampaignConfig, Gap, Problem, RigorousProblem, Rule

Methods = Mapping[str, Paper | Rigorous | Scenario]
Results = Mapping[str, document.ProblemResult]
PAIR = ("nominal_robustness", "sim_gap")


@dataclass(frozen=True, slots=True)
class Claimed:
    """The claims, and the terms of the first one if it is a composition."""

    claims: tuple[document.Claim, ...]
    composition: document.Composition | None


def claims(header: Header, results: Results, methods: Methods, assumptions: Sequence[str]) -> Claimed:
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


def _direct(result: document.ProblemResult, assumptions: Sequence[str]) -> document.Claim:
    minimum = result.sense == "min"
    return document.Claim(
        quantity="rho_star" if minimum else "J_star",
        sense=">=" if minimum else "<=",
        bound=result.bound,
        probability=result.probability,
        rule="single",
        method=result.method,
        assumptions=used(assumptions, {result.name}),
    )


def _composed(
    header: Header, results: Results, methods: Methods, assumptions: Sequence[str], rule: Rule
) -> tuple[document.Claim, document.Composition]:
    config, nominal = header.config, results["nominal_robustness"]
    paper = rule in ("product", "sum") and isinstance(methods["sim_gap"], Paper)
    terms = _theorem_2(config, results, rule) if paper else _rigorous(header, results, methods, rule)
    probability = _theorem_2_probability(results, rule) if paper else _rigorous_probability(header)
    claim = document.Claim(
        quantity="rho_star",
        sense=">=",
        bound=terms.bound,
        probability=probability,
        rule=rule,
        method=nominal.method,
        assumptions=used(assumptions, set(PAIR)),
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


def _theorem_2_probability(results: Results, rule: Rule) -> float:
    pair = [results[name].probability for name in PAIR]
    return round_down(joint_probability(pair, "product" if rule == "product" else "sum"))


def _rigorous(header: Header, results: Results, methods: Methods, rule: Rule) -> document.Composition:
    config, measure = header.config, _gap(header.config)
    nominal, gap = results["nominal_robustness"], results["sim_gap"]
    mean = compose_mean(nominal.bound, gap.bound, kind=measure.kind, clip=_clip(config), lipschitz=measure.lipschitz)
    if rule == "pointwise":
        mean = _pointwise(config, methods, mean)
    ell = compose_risk(
        mean,
        risk_weight=config.risk_weight,
        clip=_clip(config),
        variance="popoviciu" if rule == "sum" else "bhatia-davis",
        spent=_spent(header),
    ).ell
    return document.Composition(
        rule=rule,
        nominal_bound=nominal.bound,
        gap_bound=gap.bound,
        lipschitz=measure.lipschitz,
        gap_term=round_down(nominal.bound - mean),
        risk_term=round_down(mean - ell),
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


def _rigorous_probability(header: Header) -> float:
    return confidence(_spent(header))


def _spent(header: Header) -> list[tuple[float, float]]:
    """Return (delta, R) of the pair: a bound without noise is certain and spends nothing."""
    return [(problem.delta, _noise(header, problem)) for problem in header.config.problems if problem.name in PAIR]


def _noise(header: Header, problem: Problem) -> float:
    return noise_per_test(header.config, header.spec, problem) if isinstance(problem, RigorousProblem) else 1.0


def _gap(config: CampaignConfig) -> Gap:
    found = next(config.gap_of(problem) for problem in config.problems if problem.name == "sim_gap")
    assert found is not None, "the campaign file was checked"
    return found


def _clip(config: CampaignConfig) -> tuple[float, float]:
    assert config.clip is not None, "the campaign file was checked"
    return config.clip


def used(assumptions: Sequence[str], problems: set[str]) -> tuple[str, ...]:
    """Return the assumptions of these problems and those of the whole campaign."""
    return tuple(each for each in assumptions if "/" not in each or each.split("/")[1] in problems)
