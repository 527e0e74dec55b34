"""What each claim of a campaign follows from, by its file alone; without numerics, for readers in a hurry."""

from dataclasses import dataclass

from .composition import PAIR, ClaimRule, Rule, composed_claims
from .config import CampaignConfig
from .method_spaces import candidates
from .parts import parts_of


@dataclass(frozen=True, slots=True)
class Basis:
    """What a claim follows from: its rule, and the keys of the bounds that the rule combines."""

    rule: ClaimRule
    problems: tuple[str, ...]
    drawn: int | None = None
    """The place of a claim about drawn starts among those of its problem; None for every other claim."""


def bases(config: CampaignConfig) -> tuple[Basis, ...]:
    """Return the bases in the order: chosen beforehand, other rules over the same pair, direct ones."""
    if composed_claims(config.claims):
        return tuple(Basis(each.rule, each.problems) for each in composed_claims(config.claims))
    if parts_of(config):
        return _of_requirements(config)
    names = [problem.name for problem in config.problems]
    found: list[Basis] = []
    if set(PAIR) <= set(names):
        found += [Basis(rule, PAIR) for rule in _rules(config)]
    for problem in config.problems:
        if problem.name in PAIR:
            continue
        drawn = range(len(config.claims_of(problem)))
        found += [Basis("single", (problem.name,), place) for place in drawn] or [Basis("single", (problem.name,))]
    # Stable. First comes the claim that was fixed beforehand: to pick the best afterwards costs the sum.
    found.sort(key=lambda basis: basis.rule != config.composition)
    return tuple(found)


def _of_requirements(config: CampaignConfig) -> tuple[Basis, ...]:
    """Return the basis of the claim about every requirement, then those of each."""
    (problem,) = config.problems
    keys = tuple(f"{problem.name}/{each.name}" for each in config.specifications)
    return Basis("every", keys), *(Basis("single", (key,)) for key in keys)


def _rules(config: CampaignConfig) -> tuple[Rule, ...]:
    methods = {problem.method for problem in config.problems if problem.name in PAIR}
    # The rules that follow from Theorem 2 as printed.
    if methods == {"paper"}:
        return ("product", "sum") if config.composition == "product" else ("sum", "product")
    if "paper" in methods:
        return ("sum",)
    # Pointwise subtracts one band from the other, start by start: both need the same candidates.
    pair = [problem for problem in config.problems if problem.name in PAIR]
    sizes = {candidates(config.space, config.resolution_of(each), config.starts_of(each)) for each in pair}
    same = len(sizes) == 1 and methods == {"rigorous"}
    return ("pointwise", "bhatia-davis", "sum") if same else ("bhatia-davis", "sum")
