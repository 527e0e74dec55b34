"""Formulas of Algorithm 1 of [ARA], and the parameters that they take.

| symbol      | name           | meaning                                                     | shape | unit   |
|-------------|----------------|-------------------------------------------------------------|-------|--------|
| J, J*       |                | maximised objective, its maximum                            |       | unit J |
| m0          | `prior_mean`   | the Gaussian process models J - m0                          | ()    | unit J |
| i           | `i`            | observations before the proposal; test 0 is the start       | ()    | -      |
| eta_i       | `eta(i)`       | 2/i                                                         | ()    | -      |
| K_i         |                | kernel matrix of tests 0 .. i-1                             | (i,i) | -      |
| lambda      | `regulariser`  | added to K_i in mean and variance: 1 + eta_i, or a number   | ()    | -      |
| beta_i      | `beta`         | scale of the band                                           | ()    | unit J |
| mu, sigma   | `mu`, `sigma`  | posterior of J; sigma is the variance or its square root    | (m,)  | unit J, - |
| F_i         | `regret_bound` | bound on the simple regret of test i                        | ()    | unit J |
| B, R        | `rkhs_norm`, `noise_scale` | norm bound of J - m0, sub-Gaussian scale per test | ()  | unit J |
| delta       | `delta`        | failure probability of the band                             | ()    | -      |
| alpha, c    | `alpha`, `c`   | tolerance, noise margin                                     | ()    | unit J |
| eps         | `epsilon`      | claimed upper bound of J*                                   | ()    | unit J |
| Delta       | `mills_probability` | claimed probability of J* <= eps                       | ()    | -      |
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...gp.kernels import Floats

Regulariser = float | Literal["1+eta"]
SigmaReading = Literal["variance", "std"]
Tail = Literal["gaussian", "sub-gaussian"]


def eta(i: int) -> float:
    """Return eta_i = 2/i, the i-th proposal's share of the regulariser.

    Raises:
        ValueError: i < 1; proposal 0 is the start and has no eta.

    >>> eta(4)
    0.5

    """
    if i < 1:
        raise ValueError(f"eta_i needs i >= 1, not {i}")
    return 2.0 / i


def beta(information: float, rkhs_norm: float, noise_scale: float, delta: float) -> float:
    """Return the scale of the confidence band, in the unit of J.
    Implements eq. (beta) of [ARA].

    Formula: beta_i = B + R sqrt(2 ln( sqrt(det((1 + eta_i) I + K_i)) / delta )), `information` being the ln det.
    Assumes ||J - m0||_k <= B and R-sub-Gaussian noise.

    Raises:
        ValueError: delta is outside (0, 1).

    >>> round(beta(math.log(3 + 1), rkhs_norm=0.25, noise_scale=0.005, delta=0.05), 6)
    0.263581

    """
    _check_probability(delta)
    # 2 ln(sqrt(det)/delta) = ln det + 2 ln(1/delta): det itself would overflow after some hundred tests.
    return rkhs_norm + noise_scale * math.sqrt(information + 2.0 * math.log(1.0 / delta))


def upper_confidence_bound(mu: Floats, sigma: Floats, scale: float) -> Floats:
    """Return the acquisition function on every node, shape (m,), in the unit of `mu`.
    Implements eq. (UCB) of [ARA].

    Formula: mu(z) + beta_i sigma(z), beta_i being `scale`.

    >>> upper_confidence_bound(np.array([0.5]), np.array([0.25]), 2.0).tolist()
    [1.0]
    """
    return mu + scale * sigma


def regret_bound(scale: float, sigma: float) -> float:
    """Return F_i, which bounds J* - J(z_i), in the unit of J.
    Implements eq. (F) of [ARA].

    Formula: F_i = 2 beta_i sigma_{i-1}(z_i), beta_i being `scale`. Assumes that the band is valid.

    >>> regret_bound(0.25, 0.03)
    0.015
    """
    return 2.0 * scale * sigma


def epsilon(y: float, regret: float, alpha: float, c: float) -> float:
    """Return the claimed upper bound of J*, in the unit of J, from the last observation `y` and its F.
    Implements eq. (alpha_bound) of [ARA].

    Formula: eps = y_i + max(alpha, F_i) + c, which is y_i + alpha + c once F_i <= alpha.
    Deviation: for F_i > alpha, a stop at a test fixed beforehand (the budget), where Lemma 1 and Mill's inequality
    give the same probability; a stop that depends on y_i has no such claim.

    >>> round(epsilon(0.27, regret=0.008, alpha=0.01, c=0.1), 6)
    0.38
    """
    return y + max(alpha, regret) + c


def tail_probability(c: float, noise_scale: float, tail: Tail) -> float:
    """Return an upper bound on P[noise > c], dimensionless, within [0, 1].

    Formula: gaussian R/(c sqrt(2 pi)) exp(-c^2/(2R^2)); sub-gaussian exp(-c^2/(2R^2)). Without noise (R = 0) it is 0.
    Assumes c > 0 and noise that is Gaussian with standard deviation at most R, or R-sub-Gaussian, respectively.

    Raises:
        ValueError: c is not positive, R is negative, or the tail is unknown.

    >>> round(tail_probability(0.2, 0.1, "sub-gaussian"), 6)
    0.135335

    """
    if not (c > 0 and math.isfinite(c) and noise_scale >= 0 and math.isfinite(noise_scale)):
        raise ValueError(f"c must be positive, noise_scale not negative, both finite; not {c!r} and {noise_scale!r}")
    ratio = math.inf if noise_scale == 0 else c / noise_scale
    exponential = math.exp(-0.5 * ratio * ratio)
    if tail == "sub-gaussian":
        return exponential
    if tail == "gaussian":
        divisor = ratio * math.sqrt(2.0 * math.pi)
        # Mill's inequality exceeds 1 for a small ratio; the comparison also avoids a division that overflows.
        return 1.0 if divisor <= exponential else exponential / divisor
    raise ValueError(f"tail is 'gaussian' or 'sub-gaussian', not {tail!r}")


def mills_probability(c: float, delta: float, noise_scale: float, tail: Tail) -> float:
    """Return Delta, the claimed probability of J* <= eps, dimensionless.
    Implements eq. (probfac) of [ARA].

    Formula: Delta = (1 - P[noise > c]) (1 - delta), the tail as in `tail_probability`.
    Deviation: Mill's inequality as printed is a Gaussian tail; `sub-gaussian` is what R-sub-Gaussian noise gives.

    Raises:
        ValueError: delta is outside (0, 1), c is not positive, R is negative, or the tail is unknown.

    >>> round(mills_probability(0.2, 0.05, 0.1, "gaussian"), 6)
    0.924354

    """
    _check_probability(delta)
    return (1.0 - tail_probability(c, noise_scale, tail)) * (1.0 - delta)


@dataclass(frozen=True, slots=True)
class PaperParameters:
    """Premises, tolerances and readings of Algorithm 1, fixed before the first observation.

    `sigma` is the reading of sigma in the band, `regulariser` that of lambda, `tail` that of the noise in Delta: the
    choices that [ARA] leaves open.

    Raises:
        ValueError: a parameter is outside its range.

    """

    rkhs_norm: float
    noise_scale: float
    delta: float
    alpha: float
    c: float
    prior_mean: float = 0.0
    regulariser: Regulariser = "1+eta"
    sigma: SigmaReading = "variance"
    tail: Tail = "gaussian"

    def __post_init__(self) -> None:
        """Check the ranges; c, delta and noise_scale are checked by the probability that they give."""
        for name in ("rkhs_norm", "alpha"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be a positive finite number, not {value!r}")
        if not math.isfinite(self.prior_mean):
            raise ValueError(f"prior_mean must be finite, not {self.prior_mean!r}")
        if self.sigma not in {"variance", "std"}:
            raise ValueError(f"sigma is 'variance' or 'std', not {self.sigma!r}")
        _ = self.probability

    @property
    def probability(self) -> float:
        """Delta, the claimed probability of J* <= eps."""
        return mills_probability(self.c, self.delta, self.noise_scale, self.tail)

    def lambda_at(self, i: int) -> float:
        """Return lambda of proposal i, i >= 1."""
        return 1.0 + eta(i) if self.regulariser == "1+eta" else float(self.regulariser)

    def beta(self, information: float) -> float:
        """Return beta, in the unit of J, for the ln det of the observations so far."""
        return beta(information, self.rkhs_norm, self.noise_scale, self.delta)

    def read_sigma(self, variance: Floats) -> Floats:
        """Return sigma as the band reads it: the variance itself, or its square root."""
        return variance if self.sigma == "variance" else np.sqrt(variance)


def _check_probability(delta: float) -> None:
    if not 0.0 < delta < 1.0:
        raise ValueError(f"delta must be in (0, 1), not {delta!r}")
