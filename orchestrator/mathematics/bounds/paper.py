"""Method `paper`: Algorithm 1 of [ARA] as printed, with its silent choices made options.

| symbol      | name           | meaning                                                     | shape | unit   |
|-------------|----------------|-------------------------------------------------------------|-------|--------|
| J, J*       |                | maximised objective, its maximum                            |       | unit J |
| m0          | `prior_mean`   | the Gaussian process models J - m0                          | ()    | unit J |
| i           | `n`            | observations before the proposal; test 0 is the start       | ()    | -      |
| eta_i       | `eta(i)`       | 2/i                                                         | ()    | -      |
| K_i         |                | kernel matrix of tests 0 .. i-1                             | (i,i) | -      |
| lambda      | `regulariser`  | added to K_i in mean and variance: 1 + eta_i, or a number   | ()    | -      |
| beta_i      | `beta`         | scale of the band                                           | ()    | unit J |
| mu, sigma   | `mu`, `sigma`  | posterior of J; sigma is the variance or its square root    | (m,)  | unit J, - |
| F_i         | `F`            | bound on the simple regret of test i                        | ()    | unit J |
| B, R        | `rkhs_norm`, `noise_scale` | norm bound of J - m0, sub-Gaussian scale per test | ()  | unit J |
| delta       | `delta`        | failure probability of the band                             | ()    | -      |
| alpha, c    | `alpha`, `c`   | tolerance, noise margin                                     | ()    | unit J |
| eps         | `epsilon`      | claimed upper bound of J*                                   | ()    | unit J |
| Delta       | `mills_probability` | claimed probability of J* <= eps                       | ()    | -      |

The maximiser is sought on the nodes of a lattice. With `refine` it is then improved between them.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from ....schemas.values import Band, Bound, Observation, Proposal, Verdict
from ..gp.acquisition import maximiser, refined, rivals
from ..gp.kernels import Floats, Matern
from ..gp.lattice import Lattice
from ..gp.observations import Anywhere
from ..gp.posterior import Posterior
from ..gp.radial import Radial
from .method import Method

Regulariser = float | Literal["1+eta"]
SigmaReading = Literal["variance", "std"]
Tail = Literal["gaussian", "sub-gaussian"]

SMALLEST_VARIANCE = 1e-16
"""Below this the slope of the standard deviation is round-off."""


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

    Formula: F_i = 2 beta_i sigma_{i-1}(z_i), beta_i being `scale`. Assumes that the band holds.

    >>> regret_bound(0.25, 0.03)
    0.015
    """
    return 2.0 * scale * sigma


def epsilon(y: float, regret: float, alpha: float, c: float) -> float:
    """Return the claimed upper bound of J*, in the unit of J, from the last observation `y` and its F.
    Implements eq. (alpha_bound) of [ARA].

    Formula: eps = y_i + max(alpha, F_i) + c, which is y_i + alpha + c once F_i <= alpha.
    Deviation: for F_i > alpha, a stop at a test fixed beforehand (the budget), where Lemma 1 and Mill's inequality
    give the same probability; a stop chosen after looking at y_i has no such claim.

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


class PaperMethod(Method):
    """One problem's Algorithm 1; `stops` and `epsilon` need the F with which a test was proposed.

    Raises ValueError at construction for parameters outside their range.
    """

    def __init__(
        self,
        lattice: Lattice,
        kernel: Matern,
        *,
        rkhs_norm: float,
        noise_scale: float,
        delta: float,
        alpha: float,
        c: float,
        prior_mean: float = 0.0,
        regulariser: Regulariser = "1+eta",
        sigma: SigmaReading = "variance",
        tail: Tail = "gaussian",
        refine: bool = False,
    ) -> None:
        _check_parameters(rkhs_norm=rkhs_norm, alpha=alpha)
        if not math.isfinite(prior_mean):
            raise ValueError(f"prior_mean must be finite, not {prior_mean!r}")
        if sigma not in {"variance", "std"}:
            raise ValueError(f"sigma is 'variance' or 'std', not {sigma!r}")
        self._probability = mills_probability(c, delta, noise_scale, tail)
        self._lattice = lattice
        self._rkhs_norm, self._noise_scale, self._delta = rkhs_norm, noise_scale, delta
        self._alpha, self._c, self._prior_mean = alpha, c, prior_mean
        self._fixed = None if regulariser == "1+eta" else float(regulariser)
        self._sigma_reading: SigmaReading = sigma
        self._refine = refine
        anywhere = Anywhere(lattice.nodes, Radial(kernel)) if refine else None
        self._posterior = Posterior(lattice.kernel_rows(kernel), self._lambda(1), anywhere)

    @property
    def n(self) -> int:
        """Number of observations."""
        return self._posterior.n

    @property
    def size(self) -> int:
        """Number of nodes."""
        return self._lattice.size

    @property
    def probability(self) -> float:
        """Delta, the claimed probability of J* <= eps."""
        return self._probability

    def propose(self, first: int | None = None, pending: Sequence[int] = ()) -> Proposal:
        """Return the next test, proposed from all observations so far; it changes nothing.
        Implements Algorithm 1 of [ARA].

        Formula: z_i = argmax mu_{i-1} + beta_i sigma_{i-1}, ties to the lowest index; i is the number of observations.
        With `refine`, a climb from that node leads to z_i, within the neighbouring cells.
        Without observations the caller chooses the node `first` (a uniform draw from the campaign's seed).

        Raises:
            ValueError: `first` is missing before the first observation, or given after it; or a test is in flight.
            IndexError: `first` is no node.
            SingularKernelError: K + lambda I is singular.

        """
        if pending:
            raise ValueError("Algorithm 1 is sequential: no test may be in flight")
        if (first is None) != (self.n > 0):
            raise ValueError(f"first must be given before the first observation and only then; there are {self.n}")
        if first is not None:
            return self._proposal(first, self._node(first), 0.0, 1.0, None)
        scale = self._scale()
        index = maximiser(self._values(scale))
        return self._refined(index, scale) if self._refine else self._at_node(index, scale)

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:  # noqa: ARG002  (sequential)
        """Return the proposal of `x` (p,) if another CPU could have taken it for the maximiser; of nodes only."""
        if self.n == 0 or self._refine:
            return None
        scale = self._scale()
        index = rivals(self._values(scale), self._lattice.nodes, x)
        return None if index is None else self._at_node(index, scale)

    def _values(self, scale: float) -> Floats:
        return upper_confidence_bound(self._posterior.mean, self._sigma(), scale)

    def _at_node(self, index: int, scale: float) -> Proposal:
        mu, sigma = float(self._posterior.mean[index]), float(self._sigma()[index])
        return self._proposal(index, self._node(index), mu, sigma, scale)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Add the observation of J at a proposed test and return the bound; there is none after the first test.

        Raises:
            ValueError: y is not finite.
            IndexError: no node has this index.
            SingularKernelError: K + lambda I would be singular.

        """
        self._append(proposal, observation)
        if proposal.F is None:
            return Bound(None, None, None)
        verdict: Verdict | None = "converged" if self.stops(proposal) else None
        return Bound(self.epsilon(proposal, observation.y), None, verdict)

    def recall(self, seen: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations whose bounds are known; raises as `observe`."""
        for proposal, observation in seen:
            self._append(proposal, observation)

    def _append(self, proposal: Proposal, observation: Observation) -> None:
        # lambda first: under "1+eta" the factor is rebuilt anyway, so that the new row is only stored.
        self._posterior.regularise(self._lambda(self.n + 1))
        point = (proposal.x or self._node(proposal.node)) if self._refine else proposal.node
        self._posterior.append(point, observation.y - self._prior_mean)

    def stops(self, proposal: Proposal) -> bool:
        """Return whether the campaign may stop once this proposal's observation is in: F_i <= alpha."""
        return proposal.F is not None and self._alpha >= proposal.F

    def epsilon(self, proposal: Proposal, y: float) -> float:
        """Return the claimed upper bound of J* from the last test, in the unit of J; see the function `epsilon`.

        Raises:
            ValueError: `proposal` is the start, which has no F: a bound needs at least two tests.

        """
        if proposal.F is None:
            raise ValueError("the first test alone gives no bound: allow max_tests of at least 2")
        return epsilon(y, proposal.F, self._alpha, self._c)

    def band(self, bound: Bound) -> Band:  # noqa: ARG002  (the band of a moment follows from the posterior alone)
        """Return m0 + mu -+ beta sigma on every node.

        Raises:
            ValueError: there is no observation yet.
            SingularKernelError: K + lambda I is singular.

        """
        centre, half = self._prior_mean + self._posterior.mean, self._scale() * self._sigma()
        upper, lower = centre + half, centre - half
        possible = upper >= lower.max()
        return Band(*(tuple(each.tolist()) for each in (centre, lower, upper, possible)))

    def _scale(self) -> float:
        """Return beta after the observations so far."""
        return beta(self._posterior.information(eta(self.n)), self._rkhs_norm, self._noise_scale, self._delta)

    def _lambda(self, i: int) -> float:
        return 1.0 + eta(i) if self._fixed is None else self._fixed

    def _sigma(self) -> Floats:
        variance = self._posterior.variance
        return variance if self._sigma_reading == "variance" else np.sqrt(variance)

    def _refined(self, index: int, scale: float) -> Proposal:
        """Climb from a node to the nearest maximum of the acquisition function."""
        node, cell = self._lattice.nodes[index], np.array(self._lattice.spacing)
        low, high = np.maximum(node - cell, self._lattice.low), np.minimum(node + cell, self._lattice.high)
        climbed = refined(lambda z: self._acquisition(z, scale), node, low, high)
        best = max((self._node(index), self._lattice.subnode(climbed)), key=lambda x: self._acquisition(x, scale)[0])
        mu, variance, _, _ = self._posterior.at(best)
        sigma = variance if self._sigma_reading == "variance" else math.sqrt(variance)
        return self._proposal(index, best, mu, sigma, scale)

    def _acquisition(self, z: Sequence[float] | Floats, scale: float) -> tuple[float, Floats]:
        """Return mu(z) + beta sigma(z), in the unit of J, and its gradient, shape (p,)."""
        mu, variance, slope, variance_slope = self._posterior.at(z)
        if self._sigma_reading == "variance":
            return mu + scale * variance, slope + scale * variance_slope
        sigma = math.sqrt(max(variance, SMALLEST_VARIANCE))
        return mu + scale * sigma, slope + scale / (2.0 * sigma) * variance_slope

    def _node(self, index: int) -> tuple[float, ...]:
        if not 0 <= index < self._lattice.size:
            raise IndexError(f"node {index} is outside the lattice of {self._lattice.size} nodes")
        return tuple(self._lattice.nodes[index].tolist())

    def _proposal(self, index: int, x: tuple[float, ...], mu: float, sigma: float, scale: float | None) -> Proposal:
        regret = None if scale is None else regret_bound(scale, sigma)
        return Proposal(index, x, self._prior_mean + mu, sigma, scale, regret)


def _check_probability(delta: float) -> None:
    if not 0.0 < delta < 1.0:
        raise ValueError(f"delta must lie in (0, 1), not {delta!r}")


def _check_parameters(**positive: float) -> None:
    for name, value in positive.items():
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be a positive finite number, not {value!r}")
