"""Composition of the bounds of two problems to a bound of the true system, and outward rounding.

| symbol    | name            | meaning                                                         | unit |
|-----------|-----------------|-----------------------------------------------------------------|------|
| rho~      | `robustness`    | lower bound of the minimum expected nominal robustness          | unit of robustness |
| e~        | `gap`           | upper bound of the maximum expected gap                         | unit of the signal |
| L         | `lipschitz`     | Lipschitz constant of the robustness in the gap                 | ratio of the two |
| r         | `risk_weight`   | weight of the standard deviation in the risk                    | -    |
| [-m, M]   | `clip`          | range of the clipped robustness                                 | unit of robustness |
| ell       | `ell`           | lower bound of min_d E[rho] - r sd(rho) of the true system      | unit of robustness |
| Delta_j   | `probabilities` | probability of each bound                                       | -    |
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

Rule = Literal["product", "sum"]

STEP = 10**9
"""Bounds are whole multiples of 1/STEP."""


@dataclass(frozen=True, slots=True)
class Composition:
    """A composed lower bound with its terms: ell = robustness - gap - spread, and the probability that it holds.

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
    low, high = clip
    rho, e, lip, r, m, top = (_decimal(v) for v in (robustness, gap, lipschitz, risk_weight, -low, high))
    if lip < 0 or r < 0:
        raise ValueError(f"lipschitz and risk_weight must not be negative, not {lipschitz!r} and {risk_weight!r}")
    if m + top <= 0:
        raise ValueError(f"clip is [{low!r}, {high!r}]; its lower end must be below its upper end")
    gap_term, spread = lip * e, r * (top + m) / 2
    ell = _on_lattice(math.floor((rho - gap_term - spread) * STEP))
    chance = round_down(joint_probability(probabilities, rule))
    return Composition(float(robustness), float(gap_term), float(spread), ell, chance)


def joint_probability(probabilities: Sequence[float], rule: Rule) -> float:
    """Return a lower bound of the probability that all bounds hold at once.
    Implements eq. (calculated_bound) of [ARA].

    Formula: product: prod Delta_j. sum: max(0, 1 - sum (1 - Delta_j)).
    Assumes for the product that no problem's proposals or stopping saw the other's data; the sum assumes nothing.

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
            raise ValueError(f"a probability must lie in [0, 1], not {p!r}")
    if rule == "product":
        return math.prod(probabilities)
    if rule == "sum":
        return max(0.0, 1.0 - math.fsum(1.0 - p for p in probabilities))
    raise ValueError(f"rule is 'product' or 'sum', not {rule!r}")


def round_down(x: float) -> float:
    """Return the largest multiple of 1e-9 that is not above `x`; a multiple stays where it is.

    Raises:
        ValueError: `x` is not finite.

    >>> round_down(0.1234567899), round_down(0.3)
    (0.123456789, 0.3)

    """
    return _on_lattice(math.floor(_decimal(x) * STEP))


def round_up(x: float) -> float:
    """Return the smallest multiple of 1e-9 that is not below `x`; a multiple stays where it is.

    Raises:
        ValueError: `x` is not finite.

    >>> round_up(0.1234567891), round_up(-0.3)
    (0.12345679, -0.3)

    """
    return _on_lattice(math.ceil(_decimal(x) * STEP))


def _decimal(x: float) -> Fraction:
    """Return the shortest decimal that names the double `x`, exactly.

    That is the number a reader of the certificate sees, so 0.46 - 0.38 - 0.08 is 0 here and not -4e-17. The nearest
    double of a multiple of 1e-9 prints as that multiple, hence rounding leaves it alone.
    """
    if not math.isfinite(x):
        raise ValueError(f"a bound needs finite numbers, not {x!r}")
    return Fraction(repr(float(x)))


def _on_lattice(multiple: int) -> float:
    """Return multiple / STEP as the nearest double (Python divides integers with one correct rounding)."""
    return multiple / STEP
