"""Lower bounds of the risk E rho - r sd(rho) of one law, by expectations alone.

| symbol   | name          | meaning                                      | shape | unit               |
|----------|---------------|----------------------------------------------|-------|--------------------|
| rho      | `value`       | robustness of a rollout, clipped to [-m, M]  | ()    | unit of robustness |
| [-m, M]  | `clip`        | M > -m                                       | (2,)  | unit of robustness |
| r        | `risk_weight` | weight of the standard deviation, r >= 0; 0 for the mean | () | -         |
| c, s     | `c`, `s`      | about the mean and the sd of rho; s > 0      | ()    | unit of robustness |
| X        | `linearised`  | E[X] is not above the risk                   | ()    | unit of robustness |
| phi      | `bhatia_davis` | phi(E rho) is not above the risk            | ()    | unit of robustness |
| x        |               | X, or rho for phi, moved and scaled to [0, 1] | ()   | -                  |
"""

import math
from dataclasses import dataclass, field
from fractions import Fraction

from ..rounding import STEP, round_down


def linearised(value: float, risk_weight: float, c: float, s: float) -> float:
    """Return X, whose expectation is not above the risk E rho - r sd(rho), in the unit of `value`.
    Implements eq. (linearised) of [PB].

    Formula: X = rho - (r/2)((rho - c)^2/s + s); E[X] <= E rho - r sd(rho) because sd <= sqrt(E(rho - c)^2) and, by the
    arithmetic-geometric mean, 2 sqrt(v) <= v/s + s. Equal for c = E rho, s = sd(rho). Assumes constants c and s > 0
    fixed beforehand (a function of the values before this one would do as well).

    >>> round(linearised(0.5, 0.2, 0.7, 0.1), 6)
    0.45

    """
    return value - 0.5 * risk_weight * ((value - c) ** 2 / s + s)


def linearised_range(clip: tuple[float, float], risk_weight: float, c: float, s: float) -> tuple[float, float]:
    """Return the least and the largest X over the clip, in the unit of `clip`, rounded outward to doubles.
    Implements eq. (range) of [PB].

    Formula: X is a concave parabola in rho with its vertex at c + s/r, so the least value is at an end of the clip and
    the largest at the vertex, or at an end if the vertex is outside. Computed exactly on the printed decimals.

    Raises:
        ValueError: a number is not finite, the clip is empty, r is negative, or s is not positive.

    >>> low, high = linearised_range((-0.05, 0.75), 0.2, 0.7, 0.09)
    >>> round(low, 6), round(high, 6)
    (-0.684, 0.738222)

    """
    check_risk(clip, risk_weight)
    if not (math.isfinite(c) and math.isfinite(s) and s > 0):
        raise ValueError(f"constants are finite numbers c and s > 0, not {c!r} and {s!r}")
    low, high, r, centre, spread = (Fraction(repr(float(v))) for v in (*clip, risk_weight, c, s))
    vertex = (centre + spread / r,) if r else ()  # for r = 0 X is rho itself: no vertex
    places = [low, high, *(place for place in vertex if low < place < high)]
    found = [rho - r / 2 * ((rho - centre) ** 2 / spread + spread) for rho in places]
    return math.nextafter(float(min(found)), -math.inf), math.nextafter(float(max(found)), math.inf)


def least_without_risk(clip: tuple[float, float], risk_weight: float, c: float, s: float) -> float:
    """Return the least E[X] of any law on the clip whose risk is not negative, rounded down; unit of `clip`.
    Implements eq. (no risk) of [PB].

    Formula: with mu and v the mean and the variance of rho, E[X] = mu - (r/2)(((mu - c)^2 + v)/s + s) falls in v, so a
    law with a risk of at least 0 and a mean mu has its least E[X] at v = min(mu^2/r^2, (M - mu)(mu + m)). That is
    concave in mu >= 0 while the first term counts and linear after it, so the least value is at mu = 0, at the mean
    where both terms are equal, or at mu = M. A smaller E[X] proves that the risk is negative, although E[X] is only a
    lower bound of it. For r = 0 both are the mean: 0.

    Raises:
        ValueError: a number is not finite, r is negative, s is not positive, or the clip does not contain 0 inside.

    >>> round(least_without_risk((-0.05, 0.75), 0.2, 0.7, 0.12), 6), least_without_risk((-1.0, 1.0), 0.0, 0.0, 1.0)
    (-0.420333, 0.0)

    """
    linearised_range(clip, risk_weight, c, s)  # raises
    low, high = clip
    if not low < 0 < high:
        raise ValueError(f"clip is [{low!r}, {high!r}]; 0 must be between its ends")
    if risk_weight == 0:
        return 0.0
    steep = 1.0 + 1.0 / risk_weight**2
    # Positive root of mu^2/r^2 = (M - mu)(mu + m).
    mean = (low + high + math.sqrt((low + high) ** 2 - 4.0 * steep * low * high)) / (2.0 * steep)
    laws = ((0.0, 0.0), (mean, (high - mean) * (mean - low)), (high, 0.0))
    found = [mu - 0.5 * risk_weight * (((mu - c) ** 2 + v) / s + s) for mu, v in laws]
    return round_down(min(found) - 1e-12 * (1.0 + max(map(abs, found))))  # far more than a root loses to rounding


def bhatia_davis(mean: float, clip: tuple[float, float], risk_weight: float) -> float:
    """Return a lower bound of the risk of every law on the clip whose mean is at least `mean`, in the unit of `clip`.
    Implements eq. (variance) of [BD].

    Formula: phi(b) = b - r sqrt((M - b)(b + m)) right of its minimum at c0 - h/sqrt(1 + r^2), and left of that its
    least value c0 - h sqrt(1 + r^2); h = (M + m)/2, c0 = (M - m)/2, b clipped to [-m, M].

    Raises:
        ValueError: a number is not finite, the clip is empty, or r is negative.

    >>> round(bhatia_davis(0.558, (-0.05, 0.75), 0.2), 6)
    0.489667

    """
    check_risk(clip, risk_weight)
    if not math.isfinite(mean):
        raise ValueError(f"a mean must be finite, not {mean!r}")
    low, high = clip
    centre, half, steep = 0.5 * (high + low), 0.5 * (high - low), math.sqrt(1.0 + risk_weight**2)
    b = min(max(mean, low), high)
    # Left of its minimum phi falls in b; a law with a larger mean may have a lower risk there, so the minimum counts.
    if b <= centre - half / steep:
        return centre - half * steep
    return b - risk_weight * math.sqrt((high - b) * (b - low))


def check_risk(clip: tuple[float, float], risk_weight: float) -> None:
    """Check the parameters of a risk.

    Raises:
        ValueError: a number is not finite, the clip is empty, or r is negative.

    """
    check_clip(clip)
    if not (math.isfinite(risk_weight) and risk_weight >= 0):
        raise ValueError(f"risk_weight must be finite and not negative, not {risk_weight!r}")


def check_clip(clip: tuple[float, float]) -> tuple[float, float]:
    """Return the ends of a clip that is neither empty nor infinite; raises ValueError for any other."""
    low, high = clip
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ValueError(f"clip is [{low!r}, {high!r}]; its lower end must be below its upper end, both finite")
    return low, high


@dataclass(frozen=True, slots=True)
class RiskReading:
    """Map from the mean of values x in [0, 1] to the risk of one law: X with `constants`, or phi without.

    With r = 0 both are the mean of rho itself.

    Raises:
        ValueError: a number is outside its range.

    """

    clip: tuple[float, float]
    risk_weight: float
    constants: tuple[float, float] | None
    """c and s of the linearised risk; None for phi, where x is the robustness itself."""
    ends: tuple[float, float] = field(init=False)
    """The values that x = 0 and x = 1 represent, unit of robustness."""
    least: float = field(init=False)
    """The least risk that a law on the clip can have, rounded down to 1e-9."""

    def __post_init__(self) -> None:
        """Compute the range of x and the least risk."""
        check_risk(self.clip, self.risk_weight)
        given = self.clip if self.constants is None else linearised_range(self.clip, self.risk_weight, *self.constants)
        object.__setattr__(self, "ends", given)
        # 1e-12 is far more than phi can lose to rounding; a mean loses nothing.
        lowest = bhatia_davis(self.clip[0], self.clip, self.risk_weight) - 1e-12 if self.risk_weight else self.clip[0]
        object.__setattr__(self, "least", math.floor(Fraction(lowest) * STEP) / STEP)

    def lower(self, mean: Fraction) -> float:
        """Return the lower bound of the risk for a lower bound of the mean of x, rounded down to 1e-9."""
        return max(math.floor(self._risk(mean, -1e-12) * STEP) / STEP, self.least)

    def upper(self, mean: Fraction) -> float:
        """Return the upper bound of the limit of `lower` for an upper bound of the mean of x, rounded up to 1e-9."""
        # The limit is never below `least` either, because `lower` is not.
        return max(min(math.ceil(self._risk(mean, 1e-12) * STEP) / STEP, self.clip[1]), self.least)

    def _risk(self, mean: Fraction, round_off: float) -> Fraction:
        """Return X or phi at a mean of x: exactly, or moved outward by the round-off of phi."""
        low, high = (Fraction(end) for end in self.ends)
        value = low + (high - low) * mean
        if self.constants is None and self.risk_weight:
            return Fraction(bhatia_davis(float(value), self.clip, self.risk_weight) + round_off)
        return value
