"""Method `rigorous`: an upper and a lower bound of max J, valid at every moment, from one confidence set.

| symbol      | name           | meaning                                                            | shape  | unit   |
|-------------|----------------|--------------------------------------------------------------------|--------|--------|
| J, J*       |                | maximised objective, its maximum over Z                            |        | unit J |
| Z           | `candidates`   | a box with the nodes of a `Lattice`, or finitely many `Points`     | (m, p) | m      |
| m0          | `prior_mean`   | the kernel describes J - m0                                        | ()     | unit J |
| B, R, delta, tau, .. | `premises` | norm bound, noise scale, and the rest of `confidence.Premises` | ()     | unit J |
| alpha       | `alpha`        | tolerance: the campaign stops when U - L <= alpha                  | ()     | unit J |
| U_n         | `upper`        | m0 + max_z min_a (mu_a + g_a sigma_a)                              | ()     | unit J |
| L_n         | `lower`        | m0 + max_z max_a (mu_a - g_a sigma_a)                              | ()     | unit J |
| B_min       | `b_min`        | smallest norm that the data allow                                  | ()     | unit J |

With probability at least 1 - delta, for all n at once: max_{m<=n} L_m <= J* <= min_{m<=n} U_m.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .....schemas.values import Band, Bound, Observation, Proposal
from ...gp.acquisition import maximiser, rival_node
from ...gp.kernels import Floats, Matern
from ...gp.lattice import check_index
from ...gp.observations import Observations
from ...gp.points import Candidates, Points, point_at
from ...gp.radial import Radial
from ..method import Method
from .box_maximum import certified_maximum
from .candidate_band import CandidateBand, Scores, candidate_band, openness, scores, scores_beside
from .confidence import Premises
from .envelope import Envelope

Status = Literal["open", "converged", "refuted"]

ROUNDING = 1e-9
"""U below L by more than this contradicts the premises; bounds are rounded outward to it."""


class ExhaustedError(ValueError):
    """Every candidate has been observed without noise, and the tolerance is not reached."""

    def __init__(self, size: int) -> None:
        super().__init__(
            f"all {size} candidates have been observed without noise and the bound is still wider than alpha: the "
            "rest is between the candidates. Raise the resolution or alpha; a repeat would make the kernel matrix "
            "singular and add nothing"
        )


@dataclass(frozen=True, slots=True)
class RigorousBound:
    """The bound that n observations prove: lower <= J* <= upper with probability at least 1 - delta, `slack` included.

    `upper` is the running minimum of U_n and `lower` the running maximum of L_n. At the n that set `upper`, the maximum
    over the candidates alone was `candidates_upper`, and `slack` = upper - candidates_upper is what the rest of the box
    adds (0 for a finite list). `b_min` is the running maximum of B_min. `status`: converged if upper - lower <= alpha;
    refuted if upper < lower - 1e-9 or b_min > B, and refuted from then on: the premises are wrong and the bounds proven
    by them are worth nothing.
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

    `slack` is how far the certified maximum over a box may exceed the best upper value found; alpha/4 by default.
    `unsafe_above` is t of a campaign that divides the box by the signs of J and J - t; None for any other. Every other
    test is then at the start whose sign is most open, and the campaign continues until no candidate is open by alpha.

    Raises ValueError at construction for parameters outside their range.
    """

    def __init__(
        self,
        candidates: Candidates,
        kernel: Matern,
        premises: Premises,
        *,
        alpha: float,
        prior_mean: float = 0.0,
        slack: float | None = None,
        unsafe_above: float | None = None,
    ) -> None:
        if not (math.isfinite(alpha) and alpha > 0):
            raise ValueError(f"alpha must be a positive finite number, not {alpha!r}")
        if slack is not None and not 0 < slack <= alpha:
            raise ValueError(f"slack must be in (0, alpha = {alpha!r}], not {slack!r}")
        if not math.isfinite(prior_mean):
            raise ValueError(f"prior_mean must be finite, not {prior_mean!r}")
        self.candidates, self._premises, self._radial = candidates, premises, Radial(kernel)
        self._prior_mean, self._alpha, self._slack = prior_mean, alpha, slack or alpha / 4.0
        self._unsafe_above = unsafe_above
        self._rows = candidates.kernel_rows(kernel, kernel.axes)
        self._data = Observations(self._rows)
        # Before any data |J - m0| <= B + tau, because k(z, z) = 1.
        reach = premises.rkhs_norm + premises.tau
        top = prior_mean + reach
        self._bound = RigorousBound(0, top, prior_mean - reach, top, 0.0, 0.0, "open")
        self.recall(())

    @property
    def size(self) -> int:
        """Number of candidates."""
        return self.candidates.size

    @property
    def probability(self) -> float:
        """Return the probability of the bound: 1 - delta, or 1 for R = 0, where nothing is random."""
        return 1.0 if self._premises.noise_scale == 0 else 1.0 - self._premises.delta

    @property
    def envelope(self) -> Envelope:
        """The band of J after the last observation, m0 and tau included."""
        return self._band.envelope

    def band(self, bound: Bound) -> Band:
        """Return the band of J on every candidate, its mean at one a for all; refuted premises have no band."""
        upper, lower = self._band.limits()
        mean = np.clip(self._prior_mean + self._band.mu[:, self._band.best_column()], lower, upper)
        if bound.verdict == "refuted" or bound.lower is None:
            lower, upper = np.full_like(mean, np.nan), np.full_like(mean, np.nan)
            possible = np.ones_like(mean, dtype=np.bool_)
        else:
            # J* is at least L, so a candidate whose upper end is below L cannot attain it.
            possible = upper >= max(float(lower.max()), bound.lower)
        return Band(*(tuple(values.tolist()) for values in (mean, lower, upper, possible)))

    def bound(self) -> RigorousBound:
        """Return the bound that the observations so far prove; it is stored, so the call costs nothing."""
        return self._bound

    def propose(self, first: int | None = None, pending: Sequence[int] = ()) -> Proposal:
        """Return the next test, given all observations so far and the tests in flight; it changes nothing.
        Implements eq. (proposal) of [PB].

        Formula: argmax over the candidates of min_a (mu_a + g_a sigma_a), ties to the lowest index. With `pending`
        nodes, whose observations are missing, mu + g sigma' at one a, sigma' being the standard deviation as if they
        were observed: that needs their places alone, so the proposal stays predictable and the theorem applies. Without
        noise no node is observed twice. Without observations and pending tests the caller chooses `first`.

        Raises:
            ValueError: `first` is missing for the first test, or given for another one.
            IndexError: `first` or a pending index is no candidate.
            ExhaustedError: R = 0 and every candidate is observed or pending.

        """
        if (first is None) != bool(self._data.n or pending):
            raise ValueError("first must be given for the first test and only then")
        if first is not None:
            # The prior: mu = 0, sigma = 1, and no scale, because no acquisition function chose this test.
            return Proposal(first, point_at(self.candidates, first), self._prior_mean + 0.0, 1.0, None, None)
        found = self._scores(pending)
        return _proposed(self._band, self.candidates, self._prior_mean, maximiser(found.values), found)

    def acquisition(self, pending: Sequence[int]) -> Floats:
        """Return how large J may be at each candidate (m,), given the tests in flight; -inf where none may follow.

        Raises as `propose`.
        """
        return self._prior_mean + self._scores(pending).values

    def proposal_at(self, index: int, pending: Sequence[int]) -> Proposal:
        """Return the proposal of a candidate that another rule than `propose` chose."""
        return _proposed(self._band, self.candidates, self._prior_mean, index, self._scores(pending))

    def rival(self, x: Sequence[float], pending: Sequence[int] = ()) -> Proposal | None:
        """Return the proposal of `x` (p,) if another CPU could have chosen it as maximiser."""
        if not (self._data.n or pending):
            return None
        found = self._scores(pending)
        index = rival_node(found.values, self.candidates.nodes, x)
        return None if index is None else _proposed(self._band, self.candidates, self._prior_mean, index, found)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Add the observation of J at a candidate and return the bound; on an error nothing changes.
        Implements eq. (anytime) of [PB].

        Formula: U = min(U, U_n), L = max(L, L_n), B_min = max(B_min, sqrt(max(0, B^2 - min_a g_a^2))).

        Raises:
            ValueError: y is not finite.
            IndexError: no candidate has this index.

        """
        return self.bound_after([(proposal, observation)])

    def bound_after(self, tests: Sequence[tuple[Proposal, Observation]]) -> Bound:
        """Add observations, and return the bound that follows from all of them, none being made in between.

        Raises as `recall`.
        """
        self.recall(tests)
        old, now = self._bound, self._bound_now()
        # The sets C_n contain J for all n on one event, so running extremes cost nothing.
        lower, b_min = max(old.lower, now.lower), max(old.b_min, now.b_min)
        best = now if now.upper < old.upper else old
        # On the event of the theorem J is in every C_n; an empty one, or L > U, contradicts the premises at 1 - delta.
        contradiction = best.upper < lower - ROUNDING or b_min > self._premises.rkhs_norm
        t = self._unsafe_above
        decided = t is None or float(openness(self._band, t).max()) <= self._alpha
        status: Status = "converged" if best.upper - lower <= self._alpha and decided else "open"
        if old.status == "refuted" or contradiction:
            status = "refuted"
        self._bound = RigorousBound(self._data.n, best.upper, lower, best.candidates_upper, best.slack, b_min, status)
        return Bound(best.upper, lower, None if status == "open" else status)

    def recall(self, tests: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations whose bounds are known: certifying each again would take as long as the campaign.

        Raises:
            ValueError: a value is not finite.
            IndexError: no candidate has this index.

        """
        for proposal, observation in tests:
            self._data.append(proposal.node, observation.y - self._prior_mean)
        # Everything that depends on the data alone is computed here, once.
        self._band = candidate_band(self._data, self.candidates, self._radial, self._premises, self._prior_mean)

    def _scores(self, pending: Sequence[int]) -> Scores:
        """Return the acquisition function; without noise, candidates that are observed or pending are excluded."""
        for index in pending:
            check_index(index, self.size)
        found = scores_beside(self._band, self._rows, pending, self._premises) if pending else scores(self._band)
        # A repeat adds nothing without noise, and would make the kernel matrix singular up to tau0.
        excluded = [*self._data.points.indices, *pending] if self._premises.noise_scale == 0 else []
        if len(set(excluded)) == self.size:
            raise ExhaustedError(self.size)
        # The theorem allows any rule that uses past observations alone: here the number of the test and the band.
        if self._unsafe_above is not None and (_is_tight(self._band, self._alpha) or (self._data.n + len(pending)) % 2):
            values = openness(self._band, self._unsafe_above, found if pending else None)
            unsure = replace(found, values=values).without(excluded)
            if unsure.values.max() > 0:
                return unsure
        return found.without(excluded)

    def _bound_now(self) -> RigorousBound:
        """Return the bound that the last confidence set alone proves, its `status` left open."""
        old, b_min = self._bound, self._band.b_min
        # False premises prove nothing: the running extremes keep the bounds from before the contradiction.
        if old.status == "refuted" or b_min > self._premises.rkhs_norm:
            return RigorousBound(self._data.n, math.inf, -math.inf, math.inf, 0.0, b_min, "refuted")
        upper, lower = self._band.limits()
        nodes, low = float(upper.max()), float(lower.max())
        if isinstance(self.candidates, Points):  # Z is the list itself: nothing is between
            return RigorousBound(self._data.n, nodes, low, nodes, 0.0, b_min, "open")
        # L may come from the nodes alone: any J(z) is below J*. U must cover the whole box.
        slack = _needed_slack(nodes - max(low, old.lower), self._alpha, self._slack)
        cover = certified_maximum((self.envelope,), self.candidates, nodes=nodes, slack=slack)
        return RigorousBound(self._data.n, cover.upper, low, nodes, cover.upper - nodes, b_min, "open")


def _proposed(band: CandidateBand, candidates: Candidates, prior_mean: float, index: int, found: Scores) -> Proposal:
    column = int(found.columns[index])
    mu, scale = float(band.mu[index, column]), float(band.envelope.g[column])
    return Proposal(index, point_at(candidates, index), prior_mean + mu, float(found.sd[index]), scale, None)


def _is_tight(band: CandidateBand, alpha: float) -> bool:
    """Whether the candidates alone leave less than alpha between the bounds of the maximum."""
    upper, lower = band.limits()
    return bool(upper.max() - lower.max() <= alpha)


def _needed_slack(width: float, alpha: float, slack: float) -> float:
    """Return how closely the box is searched: a tenth of a wide bound; near the stop, the rest to alpha."""
    room = alpha - width
    # Any slack gives a valid bound; this one spends cells only where they can end the campaign.
    return max(slack, 0.1 * width) if room <= 0 else max(min(slack, 0.9 * room), alpha / 64.0)
