"""Method `paper`: Algorithm 1 of [ARA] as printed, which bounds max J by UCB; its open choices are options.

The notation is that of `bounds.paper_formulas`. The maximiser is searched on the nodes of a lattice, and with `refine`
improved between them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .....schemas.values import Band, Bound, Observation, Proposal
from ...gp.acquisition import climb, maximiser, rival_node
from ...gp.distinct import OffNodeKernel
from ...gp.kernels import Floats, Matern
from ...gp.lattice import Lattice
from ...gp.points import point_at
from ...gp.posterior import Posterior
from ...gp.radial import Radial
from ..method import Integers, Method
from .formulas import PaperParameters, epsilon, eta, regret_bound, upper_confidence_bound

SMALLEST_VARIANCE = 1e-16
"""Below this the slope of the standard deviation is round-off."""


class PaperMethod(Method):
    """One problem's Algorithm 1; `stops` and `epsilon` need the F with which a test was proposed.

    Raises ValueError at construction for parameters outside their range.
    """

    def __init__(self, lattice: Lattice, kernel: Matern, parameters: PaperParameters, *, refine: bool = False) -> None:
        self._lattice, self._parameters, self._refine = lattice, parameters, refine
        off_nodes = OffNodeKernel(lattice.nodes, Radial(kernel)) if refine else None
        self._posterior = Posterior(lattice.kernel_rows(kernel, kernel.axes), parameters.lambda_at(1), off_nodes)

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
        return self._parameters.probability

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
        # beta_i depends on i - 1 observations; the proof has no proposal with one of them missing.
        if pending:
            raise ValueError("Algorithm 1 is sequential: no test may be in flight")
        if (first is None) != (self.n > 0):
            raise ValueError(f"first must be given before the first observation and only then; there are {self.n}")
        if first is not None:
            # The prior: mu = 0, sigma = 1. There is no eta_0, so the start has no beta and no F.
            mean = self._parameters.prior_mean + 0.0
            return Proposal(first, point_at(self._lattice, first), mean, 1.0, None, None)
        acquisition = self._acquisition()
        return self._proposal(maximiser(acquisition.on_nodes()), acquisition)

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:  # noqa: ARG002  (sequential)
        """Return the proposal of `x` (p,) if another CPU could have chosen it as maximiser; of nodes only."""
        # The end of a climb depends on the last bits, so no tolerance separates a rival from other points.
        if self.n == 0 or self._refine:
            return None
        acquisition = self._acquisition()
        index = rival_node(acquisition.on_nodes(), self._lattice.nodes, x)
        return None if index is None else self._proposal(index, acquisition)

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
        return Bound(self.epsilon(proposal, observation.y), None, "converged" if self.stops(proposal) else None)

    def recall(self, tests: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations whose bounds are known; raises as `observe`."""
        for proposal, observation in tests:
            self._append(proposal, observation)

    def bound_after(self, tests: Sequence[tuple[Proposal, Observation]]) -> Bound:
        """Add the tests of a whole campaign, proposed with other constants, and return the bound at the last of them.

        Formula: eps = y_n + max(alpha, F_n) + c, F_n by the constants of this method; no bound after one test. Raises
        as `observe`.
        """
        if len(tests) < 2:
            self.recall(tests)
            return Bound(None, None, None)
        self.recall(tests[:-1])
        proposal, observation = tests[-1]
        acquisition = self._acquisition()
        if self._refine:
            _, sigma = acquisition.moments(proposal.x)
        else:
            sigma = float(acquisition.sigma[proposal.node])
        return self.observe(replace(proposal, F=regret_bound(acquisition.beta, sigma)), observation)

    def observe_each(self, nodes: Integers, y: Floats, each: Floats) -> Bound:
        """Add observations, and return no bound: it follows from F of a proposal. Raises as `recall_each`."""
        self.recall_each(nodes, y, each)
        return Bound(None, None, None)

    def recall_each(self, nodes: Integers, y: Floats, each: Floats) -> None:
        """Add observations whose bounds are known.

        Raises:
            ValueError: starts are refined, so that no node is a start; use `recall`.

        """
        if self._refine:
            raise ValueError("refined starts are no nodes: add each observation with its proposal")
        super().recall_each(nodes, y, each)

    def stops(self, proposal: Proposal) -> bool:
        """Return whether the campaign may stop once this proposal's observation is recorded: F_i <= alpha."""
        return proposal.F is not None and self._parameters.alpha >= proposal.F

    def epsilon(self, proposal: Proposal, y: float) -> float:
        """Return the claimed upper bound of J* from the last test, in the unit of J; see the function `epsilon`.

        Raises:
            ValueError: `proposal` is the start, which has no F: a bound needs at least two tests.

        """
        if proposal.F is None:
            raise ValueError("the first test alone gives no bound: allow max_tests of at least 2")
        return epsilon(y, proposal.F, self._parameters.alpha, self._parameters.c)

    def band(self, bound: Bound) -> Band:  # noqa: ARG002  (the posterior alone determines the band)
        """Return m0 + mu -+ beta sigma on every node.

        Raises:
            ValueError: there is no observation yet.
            SingularKernelError: K + lambda I is singular.

        """
        acquisition = self._acquisition()
        centre, half = self._parameters.prior_mean + self._posterior.mean, acquisition.beta * acquisition.sigma
        upper, lower = centre + half, centre - half
        # J* is at least every lower end, so a node whose upper end is below one of them cannot attain it.
        possible = upper >= lower.max()
        return Band(*(tuple(values.tolist()) for values in (centre, lower, upper, possible)))

    def _acquisition(self) -> "_Acquisition":
        scale = self._parameters.beta(self._posterior.information(eta(self.n)))
        return _Acquisition(self._posterior, self._parameters, scale)

    def _append(self, proposal: Proposal, observation: Observation) -> None:
        # lambda first: under "1+eta" the factor is rebuilt anyway, so that the new row is only stored.
        self._posterior.regularise(self._parameters.lambda_at(self.n + 1))
        point = (proposal.x or point_at(self._lattice, proposal.node)) if self._refine else proposal.node
        self._posterior.append(point, observation.y - self._parameters.prior_mean)

    def _proposal(self, index: int, acquisition: "_Acquisition") -> Proposal:
        if self._refine:
            x = acquisition.climb(self._lattice, index)
            mu, sigma = acquisition.moments(x)
        else:
            x = point_at(self._lattice, index)
            mu, sigma = float(self._posterior.mean[index]), float(acquisition.sigma[index])
        scale = acquisition.beta
        return Proposal(index, x, self._parameters.prior_mean + mu, sigma, scale, regret_bound(scale, sigma))


@dataclass(frozen=True, slots=True)
class _Acquisition:
    """mu + beta sigma after the observations so far, on the nodes and between them; J is centred by m0."""

    posterior: Posterior
    parameters: PaperParameters
    beta: float

    @property
    def sigma(self) -> Floats:
        """Sigma on every node, shape (m,)."""
        return self.parameters.read_sigma(self.posterior.variance)

    def on_nodes(self) -> Floats:
        """Return the values on every node, shape (m,), in the unit of J."""
        return upper_confidence_bound(self.posterior.mean, self.sigma, self.beta)

    def at(self, z: Sequence[float] | Floats) -> tuple[float, Floats]:
        """Return mu(z) + beta sigma(z), in the unit of J, and its gradient, shape (p,)."""
        mu, variance, slope, variance_slope = self.posterior.at(z)
        if self.parameters.sigma == "variance":
            return mu + self.beta * variance, slope + self.beta * variance_slope
        # d sigma = d sigma^2/(2 sigma): at an observed point without noise sigma is 0, and there is no gradient.
        sigma = math.sqrt(max(variance, SMALLEST_VARIANCE))
        return mu + self.beta * sigma, slope + self.beta / (2.0 * sigma) * variance_slope

    def moments(self, x: Sequence[float]) -> tuple[float, float]:
        """Return mu and sigma at any point `x` (p,) of the box."""
        mu, variance, _, _ = self.posterior.at(x)
        return mu, variance if self.parameters.sigma == "variance" else math.sqrt(variance)

    def climb(self, lattice: Lattice, index: int) -> tuple[float, ...]:
        """Return the better of a node and the maximum that a climb from it ends at, within the neighbouring cells."""
        node, cell = lattice.nodes[index], np.array(lattice.spacing)
        low, high = np.maximum(node - cell, lattice.low), np.minimum(node + cell, lattice.high)
        top = lattice.subnode(climb(self.at, node, low, high))
        # Rounding to a subnode may lose more than the climb gained; then the node counts.
        return max((point_at(lattice, index), top), key=lambda x: self.at(x)[0])
