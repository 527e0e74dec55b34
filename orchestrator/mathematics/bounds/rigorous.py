"""Method `rigorous`: an upper and a lower bound of max J that hold at every moment, from one confidence set.

| symbol      | name           | meaning                                                            | shape  | unit   |
|-------------|----------------|--------------------------------------------------------------------|--------|--------|
| J, J*       |                | maximised objective, its maximum over Z                            |        | unit J |
| Z           | `candidates`   | a box seen through a `Lattice`, or finitely many `Points`          | (m, p) | m      |
| m0          | `prior_mean`   | the kernel describes J - m0                                        | ()     | unit J |
| B, R, delta | `premises`     | norm bound, noise scale per test, failure probability              | ()     | unit J |
| lambda_j, w_j | `regularisers` | mixture fixed beforehand                                         | (., 2) | -      |
| tau, tau0   | `tau_misspecification`, `round_off` | misspecification; round-off of a simulator    | ()     | unit J |
| alpha       | `alpha`        | tolerance: the campaign stops when U - L <= alpha                  | ()     | unit J |
| U_n         | `upper`        | m0 + max_z min_a (mu_a + g_a sigma_a)                              | ()     | unit J |
| L_n         | `lower`        | m0 + max_z max_a (mu_a - g_a sigma_a)                              | ()     | unit J |
| B_min       | `b_min`        | smallest norm that the data allow                                  | ()     | unit J |

With probability at least 1 - delta, for all n at once: max_{m<=n} L_m <= J* <= min_{m<=n} U_m.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ....schemas.values import Band, Bound, Observation, Proposal
from ..gp.acquisition import maximiser, rivals
from ..gp.kernels import Floats, Matern
from ..gp.lattice import Lattice
from ..gp.observations import Observations
from ..gp.points import Points
from ..gp.radial import Radial
from ..gp.spectrum import decompose
from .confidence import Mixture, Premises, scales_squared
from .cover import certified_maximum
from .envelope import Envelope
from .method import Method

Status = Literal["open", "converged", "refuted"]

ROUNDING = 1e-9
"""U below L by more than this contradicts the premises; bounds are rounded outward to it."""
MAX_CELLS = 20_000
"""Cells of the box that one observation may cost; beyond it the bound is valid but less tight than `slack`."""


class ExhaustedError(ValueError):
    """Every candidate has been observed without noise, and the tolerance is not reached."""

    def __init__(self, size: int) -> None:
        super().__init__(
            f"all {size} candidates have been observed without noise and the bound is still wider than alpha: what is "
            "left lies between the candidates. Raise the resolution or alpha; a repeat would make the kernel matrix "
            "singular and teach nothing"
        )


@dataclass(frozen=True, slots=True)
class RigorousBound:
    """What n observations prove: lower <= J* <= upper with probability at least 1 - delta, `slack` included.

    `upper` is the running minimum of U_n and `lower` the running maximum of L_n. At the n that set `upper`, the maximum
    over the candidates alone was `candidates_upper`, and `slack` = upper - candidates_upper is what the rest of the box
    adds (0 for a finite list). `b_min` is the running maximum of B_min. `status`: converged if upper - lower <= alpha;
    refuted if upper < lower - 1e-9 or b_min > B, and then for ever: the premises are wrong and the bounds proven by
    them are worth nothing.
    """

    n: int
    upper: float
    lower: float
    candidates_upper: float
    slack: float
    b_min: float
    status: Status


class RigorousMethod(Method):
    """Proposals and bounds of one problem, from one confidence set.

    Raises ValueError at construction for parameters outside their range.
    """

    def __init__(
        self,
        candidates: Lattice | Points,
        kernel: Matern,
        *,
        rkhs_norm: float,
        noise_scale: float,
        delta: float,
        alpha: float,
        regularisers: Mixture,
        prior_mean: float = 0.0,
        tau_misspecification: float = 0.0,
        round_off: float = 1e-9,
        slack: float | None = None,
    ) -> None:
        self._premises = Premises(rkhs_norm, noise_scale, delta, regularisers, tau_misspecification, round_off)
        if not (math.isfinite(alpha) and alpha > 0):
            raise ValueError(f"alpha must be a positive finite number, not {alpha!r}")
        if slack is not None and not 0 < slack <= alpha:
            raise ValueError(f"slack must lie in (0, alpha = {alpha!r}], not {slack!r}")
        if not math.isfinite(prior_mean):
            raise ValueError(f"prior_mean must be finite, not {prior_mean!r}")
        self._candidates, self._radial = candidates, Radial(kernel)
        self._prior_mean, self._alpha, self._slack = prior_mean, alpha, slack or alpha / 4.0
        self._grid = self._premises.grid()
        self._rows = candidates.kernel_rows(kernel)
        self._data = Observations(self._rows)
        reach = rkhs_norm + tau_misspecification
        top = prior_mean + reach
        self._bound = RigorousBound(0, top, prior_mean - reach, top, 0.0, 0.0, "open")
        self._update()

    @property
    def n(self) -> int:
        """Number of observations."""
        return self._data.n

    @property
    def size(self) -> int:
        """Number of candidates."""
        return self._candidates.size

    @property
    def candidates(self) -> Lattice | Points:
        """The candidates, a box seen through a lattice or a finite list."""
        return self._candidates

    @property
    def probability(self) -> float:
        """Return the probability of the bound: 1 - delta, or 1 for R = 0, where nothing is random."""
        return 1.0 if self._premises.noise_scale == 0 else 1.0 - self._premises.delta

    @property
    def envelope(self) -> Envelope:
        """The band of J after the last observation, m0 and tau included."""
        return self._envelope

    def band(self, bound: Bound) -> Band:
        """Return the band of J on every candidate, its mean at one a for all; refuted premises have no band."""
        upper, lower = self._envelope.band(self._data.kernel)
        column = int(np.argmin(np.max(self._mu + self._g * self._sd, axis=0)))
        mean = np.clip(self._prior_mean + self._mu[:, column], lower, upper)
        if bound.verdict == "refuted" or bound.lower is None:
            lower, upper = np.full_like(mean, np.nan), np.full_like(mean, np.nan)
            possible = np.ones_like(mean, dtype=np.bool_)
        else:
            possible = upper >= max(float(lower.max()), bound.lower)
        return Band(*(tuple(each.tolist()) for each in (mean, lower, upper, possible)))

    def bound(self) -> RigorousBound:
        """Return what the observations so far prove; it costs nothing."""
        return self._bound

    def propose(self, first: int | None = None, pending: Sequence[int] = ()) -> Proposal:
        """Return the next test, given all observations so far and the tests in flight; it changes nothing.
        Implements eq. (proposal) of [PB].

        Formula: argmax over the candidates of min_a (mu_a + g_a sigma_a), ties to the lowest index. With `pending`
        nodes, whose observations are not known, mu + g sigma' at one a, sigma' being the standard deviation as if they
        were observed: that needs their places alone, so the proposal stays predictable and the theorem holds. Without
        noise no node is observed twice. Without observations and pending tests the caller chooses `first`.

        Raises:
            ValueError: `first` is missing for the first test, or given for another one.
            IndexError: `first` or a pending index is no candidate.
            ExhaustedError: R = 0 and every candidate is observed or pending.

        """
        if (first is None) != bool(self.n or pending):
            raise ValueError("first must be given for the first test and only then")
        if first is not None:
            return self._proposal(first, 0.0, 1.0, None)
        for index in pending:
            self._check(index)
        values, columns, sd = self._scored(pending)
        return self._at(maximiser(self._without_repeats(values, pending)), columns, sd)

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:
        """Return the proposal of `x` (p,) if another CPU could have taken it for the maximiser."""
        if not (self.n or pending):
            return None
        values, columns, sd = self._scored(pending)
        index = rivals(self._without_repeats(values, pending), self._candidates.nodes, x)
        return None if index is None else self._at(index, columns, sd)

    def _scored(self, pending: Sequence[int]) -> tuple[Floats, NDArray[np.intp], Floats]:
        """Return the value of every candidate, the column of a that it comes from, and sigma there; shapes (m,)."""
        column = self._column_for_pending()
        if pending:
            sd = self._spread_after(pending, column)
            columns, values = np.full(len(sd), column), self._mu[:, column] + self._g[column] * sd
        else:
            ucb = self._mu + self._g * self._sd
            columns = np.argmin(ucb, axis=1)
            values = ucb[np.arange(len(ucb)), columns]
            sd = self._sd[np.arange(len(ucb)), columns]
        return values, columns, sd

    def _at(self, index: int, columns: NDArray[np.intp], sd: Floats) -> Proposal:
        chosen = int(columns[index])
        return self._proposal(index, float(self._mu[index, chosen]), float(sd[index]), float(self._g[chosen]))

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Add the observation of J at a candidate and return the bound; on an error nothing changes.
        Implements eq. (anytime) of [PB].

        Formula: U = min(U, U_n), L = max(L, L_n), B_min = max(B_min, sqrt(max(0, B^2 - min_a g_a^2))).

        Raises:
            ValueError: y is not finite.
            IndexError: no candidate has this index.

        """
        self._data.append(proposal.node, observation.y - self._prior_mean)
        self._update()
        old, now = self._bound, self._bound_now()
        lower, b_min = max(old.lower, now.lower), max(old.b_min, now.b_min)
        best = now if now.upper < old.upper else old
        self._bound = RigorousBound(
            self.n, best.upper, lower, best.candidates_upper, best.slack, b_min, self._status(best.upper, lower, b_min)
        )
        status = self._bound.status
        return Bound(best.upper, lower, None if status == "open" else status)

    def recall(self, seen: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations whose bounds are known: certifying each again would take as long as the campaign.

        Raises:
            ValueError: a value is not finite.
            IndexError: no candidate has this index.

        """
        for proposal, observation in seen:
            self._data.append(proposal.node, observation.y - self._prior_mean)
        self._update()

    def _status(self, upper: float, lower: float, b_min: float) -> Status:
        contradiction = upper < lower - ROUNDING or b_min > self._premises.rkhs_norm
        if self._bound.status == "refuted" or contradiction:
            return "refuted"
        return "converged" if upper - lower <= self._alpha else "open"

    def _update(self) -> None:
        """Compute everything that depends on the data alone."""
        premises, spectrum = self._premises, decompose(self._data)
        squared = scales_squared(spectrum, premises, self._grid)
        self._b_min = math.sqrt(max(0.0, premises.rkhs_norm**2 - float(squared.min())))
        # After a refutation there is no band. Proposals go on (zero width), bounds do not: see `_bound_now`.
        self._g = np.sqrt(np.maximum(squared, 0.0))
        points = self._candidates.nodes[self._data.indices]
        self._envelope = Envelope(
            points, self._radial, spectrum, self._grid, self._g, premises.rkhs_norm, self._prior_mean, premises.tau
        )
        self._mu, self._sd = self._envelope.moments(self._data.kernel)

    def _bound_now(self) -> RigorousBound:
        old = self._bound
        if old.status == "refuted" or self._b_min > self._premises.rkhs_norm:
            return RigorousBound(self.n, math.inf, -math.inf, math.inf, 0.0, self._b_min, "refuted")
        upper, lower = self._envelope.band(self._data.kernel)
        nodes, low = float(upper.max()), float(lower.max())
        if isinstance(self._candidates, Points):
            return RigorousBound(self.n, nodes, low, nodes, 0.0, self._b_min, "open")
        slack = self._needed_slack(nodes - max(low, old.lower))
        cover = certified_maximum((self._envelope,), self._candidates, nodes=nodes, slack=slack, max_cells=MAX_CELLS)
        return RigorousBound(self.n, cover.upper, low, nodes, cover.upper - nodes, self._b_min, "open")

    def _needed_slack(self, width: float) -> float:
        """Return how closely the box is searched: a tenth of a wide bound; near the stop, what is left to alpha."""
        room = self._alpha - width
        return max(self._slack, 0.1 * width) if room <= 0 else max(min(self._slack, 0.9 * room), self._alpha / 64.0)

    def _column_for_pending(self) -> int:
        """Return the column of a with the lowest maximal UCB, among those that make a pending test count.

        A large a would say that one more test changes nothing: no a above the largest lambda; without noise the
        smallest.
        """
        top = max((value for value, _ in self._premises.regularisers), default=float(self._grid[0]))
        count = int(np.searchsorted(self._grid, top, side="right"))
        return int(np.argmin(np.max(self._mu[:, :count] + self._g[:count] * self._sd[:, :count], axis=0)))

    def _spread_after(self, pending: Sequence[int], column: int) -> Floats:
        """Return sigma_a as if the pending nodes had been observed too: one appended Cholesky row for each."""
        a, variance = float(self._grid[column]), self._sd[:, column] ** 2
        spectrum, kernel = self._envelope.spectrum, self._data.kernel
        gain = spectrum.projector.T / (spectrum.values + a) @ spectrum.projector  # (K(X, X) + a/counts)^-1
        appended: list[Floats] = []
        for index in pending:
            row = self._rows.row(index) - (kernel[:, index] @ gain) @ kernel
            row = row - sum((float(v[index]) * v for v in appended), start=np.zeros(1))
            row = row / math.sqrt(float(variance[index]) + a)
            variance = np.maximum(variance - row * row, 0.0)
            appended.append(row)
        return np.asarray(np.sqrt(variance), dtype=np.float64)

    def _without_repeats(self, values: Floats, pending: Sequence[int]) -> Floats:
        if self._premises.noise_scale > 0:
            return values
        known = [*self._data.indices, *pending]
        masked = values.copy()
        masked[known] = -np.inf
        if len(set(known)) == len(values):
            raise ExhaustedError(len(values))
        return masked

    def _check(self, index: int) -> None:
        if not 0 <= index < self._candidates.size:
            raise IndexError(f"node {index} is outside the {self._candidates.size} candidates")

    def _proposal(self, index: int, mu: float, sd: float, g: float | None) -> Proposal:
        self._check(index)
        x = tuple(self._candidates.nodes[index].tolist())
        return Proposal(index, x, self._prior_mean + mu, sd, g, None)
