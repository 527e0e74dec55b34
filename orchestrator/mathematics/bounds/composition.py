"""Composition of the bounds of two problems into a bound of the true system.

| symbol    | name            | meaning                                                         | unit |
|-----------|-----------------|-----------------------------------------------------------------|------|
| rho~      | `robustness`    | lower bound of the minimum expected nominal robustness          | unit of robustness |
| e~        | `gap`           | upper bound of the maximum expected gap                         | unit of the signal |
| L         | `lipschitz`     | Lipschitz constant of the robustness in the gap                 | ratio of the two |
| r         | `risk_weight`   | weight of the standard deviation in the risk                    | -    |
| [-m, M]   | `clip`          | range of the clipped robustness                                 | unit of robustness |
| ell       | `ell`           | lower bound of min_d E[rho] - r sd(rho) of the true system      | unit of robustness |
| Delta_j   | `probabilities` | probability of each bound                                       | -    |
| b, mu     | `mean`          | (lower bound of) the least expected robustness of the true system | unit of robustness |
| c0, h     |                 | (M - m)/2, (M + m)/2: centre and half width of the clip         | unit of robustness |
| phi(mu)   | `bhatia_davis`  | least E - r sd of a variable in [-m, M] with mean mu            | unit of robustness |
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ..gp.lattice import Lattice
from ..gp.points import Candidates
from .one_law.risk import bhatia_davis, check_clip, check_risk
from .rigorous.box_maximum import certified_maximum
from .rigorous.envelope import Envelope
from .rounding import STEP, decimal, floor_to_step, round_down

Rule = Literal["product", "sum"]
GapKind = Literal["signal_sup", "predicate_sup", "robustness"]
NoiseKind = Literal["nominal_robustness", "signal_sup", "predicate_sup", "robustness"]
VarianceBound = Literal["popoviciu", "bhatia-davis"]


@dataclass(frozen=True, slots=True)
class Composition:
    """A composed lower bound with its terms: ell = robustness - gap - spread, and the probability that it is valid.

    `robustness` is rho~, `gap` is L e~, `spread` is r (M + m)/2, all in the unit of robustness.
    """

    robustness: float
    gap: float
    spread: float
    ell: float
    probability: float


def compose(
    robustness: float,
    gap: float,
    *,
    lipschitz: float,
    risk_weight: float,
    clip: tuple[float, float],
    probabilities: Sequence[float],
    rule: Rule,
) -> Composition:
    """Return the lower bound of the true system's risk and its terms.
    Implements eq. (calculated_bound) of [ARA].

    Formula: ell = rho~ - L e~ - r (M + m)/2, computed exactly on the printed decimals, then rounded down to 1e-9;
    the probability is that of `joint_probability`, rounded down too.
    Assumes both bounds, a robustness clipped to [-m, M], and |rho(s) - rho(z)| <= L ||s - z||.
    Deviation: the proof's last line drops L and writes eps~ for e~; its own inequality needs L e~.

    Raises:
        ValueError: a number is not finite, L or r is negative, the clip is empty, or a probability is outside [0, 1].

    >>> compose(0.46, 0.38, lipschitz=1.0, risk_weight=0.2, clip=(-0.05, 0.75),
    ...         probabilities=(0.924354, 0.924354), rule="product").ell
    0.0

    """
    check_risk(clip, risk_weight)
    low, high = clip
    rho, e, lip, r, m, top = (decimal(v) for v in (robustness, gap, lipschitz, risk_weight, -low, high))
    if lip < 0:
        raise ValueError(f"lipschitz must not be negative, not {lipschitz!r}")
    gap_term, spread = lip * e, r * (top + m) / 2
    ell = floor_to_step(rho - gap_term - spread)
    chance = round_down(joint_probability(probabilities, rule))
    return Composition(float(robustness), float(gap_term), float(spread), ell, chance)


def joint_probability(probabilities: Sequence[float], rule: Rule) -> float:
    """Return a lower bound of the probability that all bounds are valid at once.
    Implements eq. (calculated_bound) of [ARA].
    Implements eq. (accounting) of [PB].

    Formula: product: prod Delta_j. sum: max(0, 1 - sum (1 - Delta_j)).
    Assumes for the product that no problem's proposals or stopping depend on the other's data; the sum assumes nothing.

    Raises:
        ValueError: a probability is outside [0, 1], none is given, or the rule is unknown.

    >>> round(joint_probability((0.924354, 0.924354), "product"), 6)
    0.85443
    >>> round(joint_probability((0.9, 0.95), "sum"), 6)
    0.85

    """
    if not probabilities:
        raise ValueError("a composition needs at least one probability")
    for p in probabilities:
        if not 0.0 <= p <= 1.0:
            raise ValueError(f"a probability must be in [0, 1], not {p!r}")
    if rule == "product":
        return math.prod(probabilities)
    if rule == "sum":
        # fsum of the complements: 1 - p is exact for p in [1/2, 1], a sum of the p is not.
        return max(0.0, 1.0 - math.fsum(1.0 - p for p in probabilities))
    raise ValueError(f"rule is 'product' or 'sum', not {rule!r}")


def compose_mean(
    robustness: float, gap: float, *, kind: GapKind, clip: tuple[float, float], lipschitz: float = 1.0
) -> float:
    """Return the lower bound of the least expected true robustness from two extremes, rounded down.
    Implements eq. (gap) of [PB].

    Formula: b = rho~ - L e~ for `signal_sup`; rho~ - e~ for `predicate_sup`, since min/max robustness is 1-Lipschitz in
    it, and for `robustness`, the signed gap E[rho(nominal) - rho(true)]; never below -m, where the clip ends.
    Assumes for `signal_sup` |rho(s) - rho(z)| <= L ||s - z||, otherwise nothing.

    Raises:
        ValueError: a number is not finite, L is negative or given for another kind, or the clip is empty.

    >>> compose_mean(0.688, 0.13, kind="robustness", clip=(-0.05, 0.75))
    0.558

    """
    low, _ = check_clip(clip)
    lip = decimal(lipschitz)
    if lip < 0 or (kind != "signal_sup" and lip != 1):
        raise ValueError(f"lipschitz is {lipschitz!r}; it must not be negative, and only signal_sup has one")
    # The clip ends at -m, so no expected robustness is lower, however large the gap.
    exact = decimal(robustness) - lip * decimal(gap)
    return max(round_down(low), floor_to_step(exact))


def least_risk(mean: float, *, risk_weight: float, clip: tuple[float, float], variance: VarianceBound) -> float:
    """Return the bound of the risk that follows from the bound `mean` of the least expected robustness, rounded down.
    Implements eq. (risk) of [PB].

    Formula: ell = phi(b) (`bhatia_davis`), or b - r (M + m)/2 (`popoviciu`, as in Theorem 2 of [ARA]); the unit is
    that of robustness.

    Raises:
        ValueError: a number is outside its range.

    >>> least_risk(0.558, risk_weight=0.2, clip=(-0.05, 0.75), variance="popoviciu")
    0.478

    """
    check_risk(clip, risk_weight)
    low, high = clip
    if variance == "bhatia-davis":
        return round_down(bhatia_davis(mean, clip, risk_weight) - STEP**-1 / 1000.0)  # round-off of the square root
    if variance == "popoviciu":
        spread = decimal(risk_weight) * (decimal(high) - decimal(low)) / 2
        return floor_to_step(decimal(mean) - spread)
    raise ValueError(f"variance is 'popoviciu' or 'bhatia-davis', not {variance!r}")


def pointwise_mean(
    robustness: Envelope,
    gap: Envelope,
    candidates: Candidates,
    *,
    clip: tuple[float, float],
    lipschitz: float = 1.0,
    slack: float,
    extremes: float,
) -> float:
    """Return the lower bound of the least expected true robustness from two bands over one Z, rounded down.
    Implements eq. (pointwise) of [PB].

    Formula: min_d [LCB_rho(d) - L UCB_gap(d)] = -max_d [U_1(d) + L U_2(d)], U_1 being the upper band of J = -rho; over
    a box the maximum is certified to within `slack`. `extremes` (`compose_mean`) is valid on the same event, so the
    larger one counts.
    Assumes that both bands are valid: their deltas add up as in `confidence`.

    Raises:
        ValueError: slack or L is not positive, or the clip is empty.

    """
    if not (slack > 0 and lipschitz > 0):
        raise ValueError(f"slack and lipschitz must be positive, not {slack!r} and {lipschitz!r}")
    low, _ = check_clip(clip)
    bands = (robustness, gap.scaled(lipschitz))
    top = float((bands[0].at(candidates.nodes)[0] + bands[1].at(candidates.nodes)[0]).max())
    # Between the nodes the sum of the two bands may be higher than at any node.
    if isinstance(candidates, Lattice):
        top = certified_maximum(bands, candidates, nodes=top, slack=slack).upper
    return max(extremes, round_down(max(low, -top)))


def derived_noise_scale(
    kind: NoiseKind,
    clip: tuple[float, float],
    *,
    deterministic_nominal: bool,
    common_seeds: bool,
    lipschitz: float = 1.0,
) -> float:
    """Return the R of one rollout (or pair) that boundedness alone proves, in the unit of the observation.
    Implements eq. (Hoeffding) of [PB].

    Formula: half the range of y. (M + m)/2 for a robustness and for a sup gap clipped at (M + m)/L (divided by L: the
    unit of the signal); for the signed gap (M + m)/2 with a deterministic nominal system, (M + m)/sqrt(2) for
    independent draws, M + m with common seeds. 0 for the robustness of a deterministic nominal system.

    Raises:
        ValueError: the clip is empty, the kind is unknown, or L is not positive.

    >>> derived_noise_scale("robustness", (-0.05, 0.75), deterministic_nominal=True, common_seeds=False)
    0.4

    """
    low, high = check_clip(clip)
    if not (math.isfinite(lipschitz) and lipschitz > 0):
        raise ValueError(f"lipschitz must be a positive finite number, not {lipschitz!r}")
    width = float(decimal(high) - decimal(low))
    if kind == "nominal_robustness":
        return 0.0 if deterministic_nominal else width / 2.0
    # Hoeffding: a variable in an interval of length w is (w/2)-sub-Gaussian.
    if kind == "signal_sup":
        return width / (2.0 * lipschitz)
    if kind == "predicate_sup":
        return width / 2.0
    if kind == "robustness":
        # A difference: two independent parts add squares, two dependent ones have twice the range.
        return width / 2.0 if deterministic_nominal else width if common_seeds else width / math.sqrt(2.0)
    raise ValueError(f"no noise scale can be derived for {kind!r}")
