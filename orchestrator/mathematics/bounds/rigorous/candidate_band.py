"""The band of one confidence set on every candidate, and the acquisition function over it.

| symbol        | name         | meaning                                                    | shape  | unit      |
|---------------|--------------|------------------------------------------------------------|--------|-----------|
| a, g_a        | `a`, `g`     | regularisers and scales of the band, see `bounds.envelope` | (A,)   | -, unit J |
| K(X, .)       | `kernel`     | kernel between the observed points and the candidates      | (q, m) | -         |
| mu_a, sigma_a | `mu`, `sd`   | moments on the candidates, without m0                      | (m, A) | unit J, - |
| B_min         | `b_min`      | smallest norm that the data allow                          | ()     | unit J    |
|               | `pending`    | candidates of the tests in flight                          | (.,)   | -         |
| sigma'        |              | sigma_a as if the pending candidates were observed         | (m,)   | -         |
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...gp.distinct import Rows
from ...gp.kernels import Floats
from ...gp.observations import Observations
from ...gp.points import Candidates
from ...gp.radial import Radial
from ...gp.spectrum import decompose
from .confidence import Premises, scales_squared
from .envelope import Envelope


@dataclass(frozen=True, slots=True)
class CandidateBand:
    """The band of one problem on its candidates; a snapshot that later data do not change."""

    envelope: Envelope
    kernel: Floats
    mu: Floats
    sd: Floats
    b_min: float

    def limits(self) -> tuple[Floats, Floats]:
        """Return (upper, lower) on every candidate, (m,) each, m0 and tau included, unit J."""
        return self.envelope.limits(self.mu, self.sd)

    def best_column(self, count: int | None = None) -> int:
        """Return the column of the a, among the first `count`, whose largest upper value is lowest."""
        upper = self.mu[:, :count] + self.envelope.g[:count] * self.sd[:, :count]
        return int(np.argmin(np.max(upper, axis=0)))


@dataclass(frozen=True, slots=True)
class Scores:
    """The acquisition function on every candidate, the column of the a that each value comes from, and sigma there."""

    values: Floats  # (m,)
    columns: NDArray[np.intp]  # (m,)
    sd: Floats  # (m,)

    def without(self, indices: Sequence[int]) -> "Scores":
        """Return the same with these candidates excluded."""
        masked = self.values.copy()
        masked[list(indices)] = -np.inf
        return replace(self, values=masked)


def candidate_band(
    data: Observations, candidates: Candidates, radial: Radial, premises: Premises, prior_mean: float
) -> CandidateBand:
    """Return the band that follows from `data`, the observations of J - m0."""
    spectrum, a = decompose(data), premises.grid()
    squared = scales_squared(spectrum, premises, a)
    # g_a^2 = B^2 + (Q - ...)/a: the set is empty once B^2 is below B^2 - g_a^2 for some a.
    b_min = math.sqrt(max(0.0, premises.rkhs_norm**2 - float(squared.min())))
    # An empty set has no band. Proposals continue, at width zero; bounds do not (see `RigorousMethod`).
    g = np.sqrt(np.maximum(squared, 0.0))
    points = candidates.nodes[data.points.indices]
    envelope = Envelope(points, radial, spectrum, a, g, premises.rkhs_norm, prior_mean, premises.tau)
    mu, sd = envelope.moments(data.points.kernel)
    return CandidateBand(envelope, data.points.kernel, mu, sd, b_min)


def scores(band: CandidateBand) -> Scores:
    """Return min_a (mu_a + g_a sigma_a) on every candidate: each a gives a valid upper bound, so the least one counts.
    Implements eq. (proposal) of [PB].

    Formula: min over a of mu_a + g_a sigma_a, shape (m,), unit J without m0.
    """
    upper = band.mu + band.envelope.g * band.sd
    columns = np.argmin(upper, axis=1)
    rows = np.arange(len(upper))
    return Scores(upper[rows, columns], columns, band.sd[rows, columns])


def scores_beside(band: CandidateBand, rows: Rows, pending: Sequence[int], premises: Premises) -> Scores:
    """Return mu + g sigma' on every candidate at one a, `pending` being the candidates of the tests in flight.
    Implements eq. (proposal) of [PB].

    Formula: mu_a + g_a sigma'_a, shape (m,), unit J without m0; a has the lowest maximal upper value among those that
    make a pending test count.
    """
    # For a large a one more test would change nothing: no a above the largest lambda; without noise the smallest.
    largest = max((value for value, _ in premises.regularisers), default=float(band.envelope.a[0]))
    column = band.best_column(int(np.searchsorted(band.envelope.a, largest, side="right")))
    sd = _sd_after(band, rows, pending, column)
    return Scores(band.mu[:, column] + band.envelope.g[column] * sd, np.full(len(sd), column), sd)


def openness(band: CandidateBand, unsafe_above: float, beside: Scores | None = None) -> Floats:
    """Return how far the band of each candidate reaches to both sides of 0 or of t, (m,): not above 0 where decided.
    Implements eq. (undecided) of [PB].

    Formula: max(min(U, -L), min(U - t, t - L)), unit J, m0 and tau included; with tests in flight, of the band of
    `beside` at its a. Between 0 and t nothing is to be proven, however exactly J is known there.
    """
    upper, lower = band.limits()
    if beside is not None:
        mean = band.envelope.prior_mean + band.mu[np.arange(len(beside.columns)), beside.columns]
        reach = band.envelope.g[beside.columns] * beside.sd + band.envelope.tau
        upper, lower = mean + reach, mean - reach
    around = [np.minimum(upper - threshold, threshold - lower) for threshold in (0.0, unsafe_above)]
    return np.asarray(np.maximum(*around), dtype=np.float64)


def _sd_after(band: CandidateBand, rows: Rows, pending: Sequence[int], column: int) -> Floats:
    """Return sigma_a as if the pending candidates had been observed too: one appended Cholesky row for each."""
    a, variance = float(band.envelope.a[column]), band.sd[:, column] ** 2
    spectrum, kernel = band.envelope.spectrum, band.kernel
    gain = spectrum.projector.T / (spectrum.values + a) @ spectrum.projector  # (K(X, X) + a/counts)^-1
    appended: list[Floats] = []
    for index in pending:
        # The posterior covariance with the pending candidate, given the data, then given the pending ones before it.
        row = rows.row(index) - (kernel[:, index] @ gain) @ kernel
        row = row - sum((float(v[index]) * v for v in appended), start=np.zeros(1))
        row = row / math.sqrt(float(variance[index]) + a)
        variance = np.maximum(variance - row * row, 0.0)  # round-off alone makes it negative
        appended.append(row)
    return np.asarray(np.sqrt(variance), dtype=np.float64)
