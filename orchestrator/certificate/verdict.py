"""The verdict on a finished campaign: does its first claim show what the campaign file requires?"""

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from ...schemas.campaign import CampaignConfig
from ...schemas.certificate import CertificateClaim, Predicate, ProblemResult
from ...schemas.claims import PROBABILITIES, is_sampled
from ...schemas.errors import one_line
from ...schemas.facts import Header
from ...schemas.problems import Quantity, rolled_out
from ...schemas.requirements import parts_of
from ...schemas.verdict import ByRollouts, CampaignVerdict, VerdictWord, Violations
from ..campaign.clip import SAME
from ..mathematics.bounds.opposite import OppositeTest
from ..store.export_tables import robustness_unit
from ..store.robustness import RolloutValue
from .advice import NO_COMMANDS, Commands, Progress, ShortBound, for_a_better_bound, instead_of_refuted
from .bases import bases
from .counterexample import margin_words, named_start
from .refutation_text import refutation_words
from .text import claim_words, nothing_shown, outward

WORST: dict[Quantity, str] = {
    "rho_star": "robustness risk: mean less {:g} standard deviations",
    "robustness": "robustness",
    "expected_robustness": "expected robustness",
}
"""Quantities of a claim about the worst start, and what their margin is."""

_SAY_LIMIT = "say it with the key `required_at_most`; the bound stays the same."

Values = Iterable[RolloutValue]


@dataclass(frozen=True, slots=True)
class _Required:
    """What the file requires of the first claim."""

    bound: float | None
    """None where it requires nothing."""
    probability: float
    unit: str
    """Of the robustness."""


@dataclass(frozen=True, slots=True)
class _Finding:
    """A verdict with its reasons, and what would help."""

    word: VerdictWord
    reasons: tuple[str, ...]
    advice: tuple[str, ...] = ()
    by_rollouts: ByRollouts | None = None


def tested_by(header: Header) -> str:
    """Return the variant whose robustness the claims are about: the true system where it is simulated."""
    return max(variant for problem in header.config.problems for variant in rolled_out(problem.name, header.spec))


def campaign_verdict(
    header: Header,
    predicate: Predicate,
    violations: Violations,
    values: Callable[[], Values],
    *,
    unit: str = "",
    commands: Commands = NO_COMMANDS,
    progress: Progress = tuple,
) -> CampaignVerdict:
    """Return the verdict; `values` are the rollouts of the tested variant in test order, read only where needed.

    `unit` is that of the robustness, and `progress` that of the problems, asked for where a forecast would help.
    """
    claim, config = predicate.claims[0], header.config
    limit = config.required_margin if claim.sense == ">=" else config.required_at_most
    required = _Required(limit, _required_probability(config, claim), unit)

    def better(limit: float) -> str:
        noisy = not _is_deterministic(header)
        return for_a_better_bound(ShortBound(config, predicate, limit, violations, commands, noisy, progress))

    found = (
        _shown(predicate, required)
        or _violated(header, predicate, required, violations, values)
        or _not_shown(predicate, required, better)
    )
    return CampaignVerdict(
        verdict=found.word,
        campaign=config.name,
        seed=config.seed,
        claim=guarantee(claim, unit, config.risk_weight),
        reasons=found.reasons,
        advice=found.advice,
        bound=claim.bound,
        sense=claim.sense,
        required=required.bound,
        probability=claim.probability,
        required_probability=required.probability,
        unit=unit,
        violations=violations,
        clipped=violations.least is not None and config.clip is not None and violations.least <= config.clip[0],
        by_rollouts=found.by_rollouts,
        repeat=commands.repeat if violations.violations else "",
    )


def guarantee(claim: CertificateClaim, unit: str, risk_weight: float) -> str:
    """Return the first claim in plain words, as a margin where it is one; what is refuted is not called guaranteed.

    >>> guarantee(CertificateClaim(quantity="robustness", sense=">=", bound=0.58125, probability=0.95, rule="single",
    ...                            method="rigorous", assumptions=(), refuted=()), "rad", 0.2)
    'Guaranteed margin 0.5812 rad (robustness) from every start, with probability at least 0.9500'
    """
    bound, probability = outward(claim.bound, claim.sense), outward(claim.probability, ">=")
    many = f"{len(claim.assumptions)} assumption{'' if len(claim.assumptions) == 1 else 's'}"
    # Certainty is that of a system without noise, and of nothing else.
    chance = f"if its {many} hold" if claim.probability == 1.0 else f"with probability at least {probability}"
    if claim.probability < 1.0 and claim.assumptions:
        chance += f", if its {many} hold"
    meaning = WORST.get(claim.quantity)
    if meaning is None:
        words = f"Refuted: {claim_words(claim)}" if claim.refuted else _capitalised(claim_words(claim))
        return f"{words} {claim.sense} {_margin_text(bound, claim, unit)}, {chance}"
    where = "every start" if claim.starts is None else f"each of the {claim.starts} listed starts"
    of = {"every": ", of every requirement"}.get(claim.rule, f", of {claim.requirement}" if claim.requirement else "")
    margin = f"{_margin_text(bound, claim, unit)} ({meaning.format(risk_weight)}{of})"
    head = (
        "Refuted: margin at least" if claim.refuted else "Guaranteed margin" if claim.bound > 0 else "Margin at least"
    )
    return f"{head} {margin} from {where}, {chance}"


def _capitalised(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}"


def _margin_text(text: str, claim: CertificateClaim, unit: str) -> str:
    has = unit not in ("", "1") and claim.quantity not in PROBABILITIES and claim.quantity != "J_star"
    return f"{text} {one_line(unit)}" if has else text


def _required_probability(config: CampaignConfig, claim: CertificateClaim) -> float:
    """Return what the file requires; by default 1 - delta, with the deltas of a composed claim added up."""
    if config.required_probability is not None:
        return config.required_probability
    if is_sampled(claim.quantity):
        return claim.probability
    deltas: dict[str, float] = {problem.name: problem.delta or 0.0 for problem in config.problems}
    for each, part in zip(config.specifications, parts_of(config), strict=False):
        deltas |= {f"{problem.name}/{each.name}": problem.delta or 0.0 for problem in part.problems}
    basis = bases(config)[0]
    found = [deltas[key] for key in basis.problems]
    return 1.0 - (max(found) if basis.rule == "every" else math.fsum(found))


def _shown(predicate: Predicate, required: _Required) -> _Finding | None:
    claim = predicate.claims[0]
    if claim.refuted or claim.vacuous or _falls_short(claim, required) or _too_unlikely(claim, required):
        return None
    limit = _margin_text(f"{required.bound:g}", claim, required.unit)
    reasons = [f"Required {'at least' if claim.sense == '>=' else 'at most'} {limit}."]
    if (partner := _partner(predicate)) is not None:
        least = claim.sense == ">="
        other = _margin_text(outward(partner, "<=" if least else ">="), claim, required.unit)
        reasons.append(f"With the same probability it is at {'most' if least else 'least'} {other} at the worst start.")
    return _Finding("SHOWN", tuple(reasons))


def _falls_short(claim: CertificateClaim, required: _Required) -> bool:
    """Whether the bound is on the wrong side of what is required, or nothing is."""
    if required.bound is None:
        return True
    return claim.bound < required.bound if claim.sense == ">=" else claim.bound > required.bound


def _too_unlikely(claim: CertificateClaim, required: _Required) -> bool:
    return claim.probability < required.probability - SAME


# The opposite


def _violated(
    header: Header,
    predicate: Predicate,
    required: _Required,
    violations: Violations,
    values: Callable[[], Values],
) -> _Finding | None:
    claim, clip = predicate.claims[0], header.config.clip
    if required.bound is not None and clip is not None and claim.sense == ">=" and required.bound >= clip[1]:
        return None  # every clipped value is below it, whatever the robustness is
    if required.bound is not None:
        # Where no value is below the limit, none can show that a mean is: most campaigns need not be read for that.
        beyond = claim.quantity in WORST and violations.least is not None and violations.least >= required.bound
        found = None if beyond else _by_rollouts(header, claim, required.bound, required.probability, values)
        return found or _by_partner(predicate, required.bound)
    if claim.quantity == "failure_probability" and claim.requirement is None:
        return _any_violation(values())
    return None


def _any_violation(values: Values) -> _Finding | None:
    """Return the finding where some rollout violates the specification: who names no acceptable share accepts none."""
    if all(each.robustness >= 0.0 for each in values):
        return None
    reason = "A rollout violates the specification, and the campaign file names no acceptable probability of that."
    return _Finding("VIOLATED", (reason,), (f"If some are acceptable, {_SAY_LIMIT}",), "certain")


def _is_deterministic(header: Header) -> bool:
    return tested_by(header) not in header.spec.noisy


def _by_partner(predicate: Predicate, required: float) -> _Finding | None:
    """Return the finding where the bound from the other side is beyond what is required, at the same probability."""
    claim, partner = predicate.claims[0], _partner(predicate)
    if partner is None or claim.refuted:
        return None
    other = "<=" if claim.sense == ">=" else ">="
    if not (partner < required if claim.sense == ">=" else partner > required):
        return None
    chance = f"with probability at least {outward(claim.probability, '>=')}"
    return _Finding("VIOLATED", (f"{_capitalised(claim_words(claim))} {other} {outward(partner, other)}, {chance}.",))


def _partner(predicate: Predicate) -> float | None:
    """Return the bound from the other side of the quantity of a claim about one problem; None where there is none."""
    claim, (first, *others) = predicate.claims[0], predicate.problems
    if claim.rule != "single" or others or is_sampled(claim.quantity) or first.parameters.get("linearised"):
        return None
    return first.partner if _is_of(first, claim) else None


def _is_of(result: ProblemResult, claim: CertificateClaim) -> bool:
    return result.requirement == claim.requirement and result.method == claim.method


def _by_rollouts(
    header: Header, claim: CertificateClaim, required: float, probability: float, values: Callable[[], Values]
) -> _Finding | None:
    """Return the finding where the robustness of rollouts shows the opposite, which needs no smoothness."""
    if claim.requirement is not None:
        return None  # the stored robustness is that of the whole specification
    if claim.quantity in WORST:
        return _worst_below(header, claim, required, probability, values)
    return _drawn_below(header, claim, required, probability, values) if is_sampled(claim.quantity) else None


def _worst_below(
    header: Header, claim: CertificateClaim, required: float, probability: float, values: Callable[[], Values]
) -> _Finding | None:
    """Return the finding about a worst start; a risk is at most the expectation, which therefore shows it too."""
    if _is_deterministic(header):
        return _one_start_below(header, claim, required, values())
    if claim.rule == "every":
        return None  # the mean of the least of several requirements may be below that of each
    pairs = ((each.start, each.robustness) for each in values())
    return _mean_below(header.config, required, probability, pairs, "At some start the expected robustness")


def _drawn_below(
    header: Header, claim: CertificateClaim, required: float, probability: float, values: Callable[[], Values]
) -> _Finding | None:
    """Return the finding about rollouts at drawn starts."""
    samples = (each.robustness for each in _drawn_samples(header.config, values()))
    if claim.quantity in ("mean", "risk"):
        pairs = (("", each) for each in samples)
        return _mean_below(header.config, required, probability, pairs, "The mean robustness at drawn starts")
    # A quantile or CVaR at a level is below the margin if more than this share of the rollouts is.
    if claim.quantity == "failure_probability":
        return _too_many_below(required, 0.0, probability, samples)
    if claim.quantity in ("quantile", "cvar"):
        return _too_many_below(claim.level or 1.0, required, probability, samples)
    return None


def _one_start_below(header: Header, claim: CertificateClaim, required: float, values: Values) -> _Finding | None:
    below = min((each for each in values if each.robustness < required), key=lambda each: each.robustness, default=None)
    if below is None:
        return None
    units = {parameter.name: parameter.unit for parameter in header.spec.parameters}
    start = named_start(dict(zip(units, json.loads(below.start), strict=True)), units)
    unit = robustness_unit(header.config, header.spec)
    margin = margin_words(below.robustness, unit)
    least = "" if required == 0 else f", less than the required {_margin_text(f'{required:g}', claim, unit)}"
    return _Finding(
        "VIOLATED",
        (f"At {start} the robustness is {margin}{least}, and nothing there is random.",),
        by_rollouts="certain",
    )


def _mean_below(
    config: CampaignConfig, required: float, probability: float, pairs: Iterable[tuple[str, float]], whose: str
) -> _Finding | None:
    """Return the finding where some mean of the values, each with its start, is below the margin."""
    if config.clip is None or not config.clip[0] < required < config.clip[1]:
        return None
    low, high = config.clip
    test = OppositeTest(required, low, high)
    for start, value in pairs:
        test.observe(start, min(max(value, low), high))
    return _refuting(test, probability, f"{whose} is below {required:g}")


def _too_many_below(share: float, margin: float, probability: float, samples: Iterable[float]) -> _Finding | None:
    """Return the finding where more than a share of the values is below the margin."""
    if not share < 1.0:
        return None
    test = OppositeTest(1.0 - share, 0.0, 1.0)
    for value in samples:
        test.observe("", float(value >= margin))
    return _refuting(
        test, probability, f"More than {100 * share:g} % of the rollouts at drawn starts are below {margin:g}"
    )


def _refuting(test: OppositeTest, probability: float, words: str) -> _Finding | None:
    if not test.refutes(1.0 - probability):
        return None
    return _Finding(
        "VIOLATED", (f"{words}, with probability at least {outward(probability, '>=')}.",), by_rollouts="probable"
    )


def _drawn_samples(config: CampaignConfig, values: Values) -> Values:
    """Return the first rollout at each start that was drawn; further ones there are no samples of their own."""
    (problem,), search = config.problems, config.falsify
    of_problem = (each for each in values if each.series == problem.name and each.replicate == 0)
    return (each for each in of_problem if search is None or search.is_random(each.test))


# Neither


def _not_shown(predicate: Predicate, required: _Required, better: Callable[[float], str]) -> _Finding:
    """Return the reasons, and what would help; `better` says what would bring the bound to a limit."""
    claim, reasons, advice = predicate.claims[0], list[str](), list[str]()
    if claim.refuted:
        reasons.append(f"{refutation_words(claim.refuted)} Do not rely on the bound.")
        advice.append(instead_of_refuted(claim))
    if claim.vacuous:
        reasons.append(nothing_shown(claim.quantity).replace("It shows", "The bound shows"))
    if required.bound is None:
        what = "probability" if claim.quantity in PROBABILITIES else "value"
        reasons.append(f"The campaign file does not say the largest acceptable {what}.")
        advice.append(_SAY_LIMIT.capitalize())
    elif _falls_short(claim, required):
        limit, bound = _margin_text(f"{required.bound:g}", claim, required.unit), outward(claim.bound, claim.sense)
        reasons.append(f"The bound {bound} does not reach the required {limit}{_budget_words(predicate)}.")
        if not claim.refuted:
            advice.append(better(required.bound))
    if _too_unlikely(claim, required):
        chance = outward(claim.probability, ">=")
        reasons.append(f"It holds with probability {chance}, and {required.probability:g} is required.")
        advice.append("Choose a smaller `delta`, or say with `required_probability` what is enough.")
    return _Finding("NOT SHOWN", tuple(reasons), tuple(advice))


def _budget_words(predicate: Predicate) -> str:
    spent = [each.key for each in predicate.problems if each.stopped_by == "budget"]
    return f"; {' and '.join(spent)} ended by the budget" if spent else ""
