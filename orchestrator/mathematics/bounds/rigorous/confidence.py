"""Confidence set of method `rigorous`: its radius Q and the scale g_a of its bands.

| symbol   | name           | meaning                                                            | shape | unit     |
|----------|----------------|--------------------------------------------------------------------|-------|----------|
| J, m0    |                | maximised objective; the kernel describes J - m0                   |       | unit J   |
| B, R     | `rkhs_norm`, `noise_scale` | ||J - m0||_k <= B; noise of a test is R-sub-Gaussian   | ()    | unit J   |
| delta    | `delta`        | failure probability over all n at once                             | ()    | -        |
| lambda_j, w_j | `regularisers` | mixture fixed beforehand, weights sum to at most 1            | (.,)  | -        |
| tau      | `tau`          | sup|J - m0 - f| for some f with ||f||_k <= B                       | ()    | unit J   |
| tau0     | `round_off`    | round-off of a simulator without noise                             | ()    | unit J   |
| e, u, S, n | `spectrum`   | see `gp.spectrum`                                                  |       |          |
| Gamma    | `information`  | ln det(I + K/lambda)                                               | ()    | -        |
| Q        | `radius`       | sum_i (f(z_i) - y_i)^2 <= Q for f in the set                       | ()    | unit J^2 |
| a        | `a`            | any positive number, which may depend on the data                  | (A,)  | -        |
| g_a^2    | `scales_squared` | |f(z) - mu_a(z)| <= g_a sigma_a(z) for f in the set; < 0 if empty | (A,)  | unit J^2 |

The set C_n = {f : sum (f(z_i) - y_i)^2 <= Q and ||f||_k <= B} contains J - m0 for all n at once with probability
1 - delta ([FR], Gaussian mixture), for any predictable choice of the points. For every a > 0, every f in it has
||f||^2 + sum (f(z_i) - y_i)^2/a <= B^2 + Q/a, and the left side is y'(K + aI)^-1 y plus the squared distance of f
from mu_a in the norm ||h||^2 + sum h(z_i)^2/a, in which |h(z)| <= sigma_a(z) ||h||.
"""

import math
from dataclasses import dataclass

import numpy as np

from ...gp.kernels import Floats
from ...gp.spectrum import Spectrum

Mixture = tuple[tuple[float, float], ...]
"""Pairs (lambda_j, w_j)."""

DECADES = 7
SMALLEST_A = 1e-9
"""Below this the round-off of the kernel matrix outweighs what a smaller a could gain."""


@dataclass(frozen=True, slots=True)
class Premises:
    """The assumptions about J and the noise, fixed before the first observation.

    Raises:
        ValueError: a number is outside its range, or the mixture is empty although R > 0.

    """

    rkhs_norm: float
    noise_scale: float
    delta: float
    regularisers: Mixture
    tau: float = 0.0
    round_off: float = 1e-9

    def __post_init__(self) -> None:
        """Check that every number is in the range where the theorem applies."""
        if not (math.isfinite(self.rkhs_norm) and self.rkhs_norm > 0):
            raise ValueError(f"rkhs_norm must be a positive finite number, not {self.rkhs_norm!r}")
        for name in ("noise_scale", "tau", "round_off"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be a finite number >= 0, not {value!r}")
        if not 0.0 < self.delta < 1.0:
            raise ValueError(f"delta must be in (0, 1), not {self.delta!r}")
        _check_mixture(self.regularisers, needed=self.noise_scale > 0)

    def grid(self) -> Floats:
        """Return the values of a that are tried, shape (A,): 7 decades around (R/B)^2, and every lambda_j.

        It is fixed beforehand only for convenience: the theorem lets a depend on the data.
        """
        # The best a balances g_a and sigma_a and, like the best lambda (see `mixture`), is seldom below (R/B)^2.
        noise = self.noise_scale**2 + self.tau**2 + self.round_off**2
        start = max(SMALLEST_A, 0.01 * noise / self.rkhs_norm**2)
        decades = np.linspace(0.0, DECADES, 2 * DECADES + 1)
        return np.unique([*(start * 10.0**decades), *(value for value, _ in self.regularisers)])


def mixture(rkhs_norm: float, noise_scale: float) -> Mixture:
    """Return the default mixture: lambda = (R/B)^2 times 1, 10, 100, 1000, with equal weights; empty for R = 0.

    The best lambda balances the two terms of Q and is between (R/B)^2 and Gamma (R/B)^2; four values instead of the
    best one cost at most 2 R^2 ln 4 in Q.

    >>> mixture(1.0, 0.1)[2]
    (1.0, 0.25)
    """
    if noise_scale == 0:  # then Q needs no mixture: n tau0^2
        return ()
    ratio = (noise_scale / rkhs_norm) ** 2
    return tuple((_two_digits(max(SMALLEST_A, ratio) * 10.0**power), 0.25) for power in range(4))


@dataclass(frozen=True, slots=True)
class _Excess:
    """Q in two parts: `base` of the order of R^2 Gamma, and lambda y'(K + lambda I)^-1 y at a reference lambda."""

    base: float
    reference: float


def radius(spectrum: Spectrum, premises: Premises) -> float:
    """Return Q, the squared radius of the confidence set in the observations, in the squared unit of J.
    Implements eq. (Gaussian mixture) of [FR].

    Formula: Q = 2R^2 [ln(1/delta) - ln sum_j w_j exp(-Gamma(lambda_j)/2 - lambda_j y'(K + lambda_j I)^-1 y/(2R^2))];
    for R = 0, n tau0^2. With tau > 0, (sqrt(Q) + tau sqrt(n))^2. Assumptions: as in `Premises`.

    >>> premises = Premises(1.0, 0.1, 0.05, ((1.0, 1.0),))
    >>> radius(Spectrum(1, np.array([1.0]), np.eye(1), np.array([0.5]), 0.0, 0.0), premises)  # doctest: +ELLIPSIS
    0.19184...
    """
    n, tau = spectrum.n, premises.tau
    if premises.noise_scale == 0:
        # Without noise each residual is at most tau0 + tau, surely.
        return n * (premises.round_off + tau) ** 2
    parts = _excess(spectrum, premises)
    q = parts.base + parts.reference * spectrum.energy(parts.reference) + spectrum.within
    # f differs from J - m0 by at most tau at each of n points: the triangle inequality for the residuals.
    return (math.sqrt(q) + tau * math.sqrt(n)) ** 2


def scales_squared(spectrum: Spectrum, premises: Premises, a: Floats) -> Floats:
    """Return g_a^2 for every a, shape (A,), in the squared unit of J; negative means that the set is empty.
    Implements eq. (Gaussian mixture) of [FR].

    Formula: g_a^2 = B^2 + (Q - a y'(K + aI)^-1 y)/a without cancellation. Let l be the lambda_j with the largest term
    of the mixture and base = R^2 (Gamma(l) + 2 ln(1/delta)) - 2R^2 ln sum_j w_j exp(s_l - s_j). Then Q - a y'(K +
    aI)^-1 y = base + (l - a) sum u^2 e/((e + l)(e + a)): S and the noise within repeats cancel exactly. With tau, 2 tau
    sqrt(nQ) + n tau^2 are added. For R = 0, n (tau0 + tau)^2 - S - a sum u^2/(e + a). The first-order effect of
    round-off `spectrum.error` in the matrix is added: the result is rounded up.

    Deviation: [FR] has one lambda.

    >>> premises = Premises(1.0, 0.1, 0.05, ((1.0, 1.0),))
    >>> data = Spectrum(1, np.array([1.0]), np.eye(1), np.array([0.5]), 0.0, 0.0)
    >>> round(float(scales_squared(data, premises, np.array([1.0]))[0]), 6)  # B^2 + R^2 (Gamma + 2 ln 20)
    1.066846
    """
    e, u2 = spectrum.values[:, None], spectrum.u[:, None] ** 2  # (q, 1)
    q, n, tau = radius(spectrum, premises), spectrum.n, premises.tau
    # d/de of sum u^2/(e + a): what an error of the matrix may change, to first order.
    rounding = np.sum(u2 / (e + a) ** 2, axis=0)
    if premises.noise_scale == 0:
        excess = q - spectrum.within - a * np.sum(u2 / (e + a), axis=0)
    else:
        parts = _excess(spectrum, premises)
        l = parts.reference  # noqa: E741  (as in the formula)
        drift = 2.0 * tau * math.sqrt(n) * (math.sqrt(q) - tau * math.sqrt(n)) + n * tau**2
        # S cancels here by algebra; subtracting two numbers of size S/a would lose all digits.
        excess = parts.base + drift + (l - a) * np.sum(u2 * e / ((e + l) * (e + a)), axis=0)
        rounding = rounding + l / a * spectrum.energy(l, 2)
    return np.asarray(premises.rkhs_norm**2 + excess / a + 2.0 * spectrum.error * rounding, dtype=np.float64)


def _excess(spectrum: Spectrum, premises: Premises) -> _Excess:
    """Split Q at the lambda_j with the largest term; the others enter by differences without cancellation."""
    e, u2, twice = spectrum.values, spectrum.u**2, 2.0 * premises.noise_scale**2
    lambdas = [value for value, _ in premises.regularisers]
    information = [spectrum.information(value) for value in lambdas]
    energies = [value * spectrum.energy(value) / twice for value in lambdas]
    best = min(range(len(lambdas)), key=lambda j: information[j] / 2.0 + energies[j])
    l = lambdas[best]  # noqa: E741
    terms = [
        math.log(weight)
        + (information[best] - information[j]) / 2.0
        - (value - l) / twice * float(np.sum(u2 * e / ((e + value) * (e + l))))
        for j, (value, weight) in enumerate(premises.regularisers)
    ]
    # log-sum-exp: the terms span hundreds of units, and exp of the largest would overflow.
    top = max(terms)
    log_sum = top + math.log(math.fsum(math.exp(term - top) for term in terms))
    return _Excess(twice * (-math.log(premises.delta) + information[best] / 2.0 - log_sum), l)


def _check_mixture(regularisers: Mixture, *, needed: bool) -> None:
    # Weights that sum to at most 1 make the mixture a supermartingale that starts at most at 1.
    if needed and not regularisers:
        raise ValueError("regularisers: observations with noise (R > 0) need at least one pair (lambda, weight)")
    for value, weight in regularisers:
        if not (math.isfinite(value) and value >= SMALLEST_A):
            raise ValueError(f"regularisers: lambda = {value!r} must be finite and at least {SMALLEST_A:g}")
        if not 0.0 < weight <= 1.0:
            raise ValueError(f"regularisers: weight {weight!r} of lambda = {value!r} must be in (0, 1]")
    if math.fsum(weight for _, weight in regularisers) > 1.0 + 1e-12:
        raise ValueError(f"regularisers: the weights {[w for _, w in regularisers]} add up to more than 1")


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")
