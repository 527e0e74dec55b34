"""Band of one confidence set: upper and lower bounds of J at points and over cells.

| symbol     | name        | meaning                                                        | shape  | unit    |
|------------|-------------|----------------------------------------------------------------|--------|---------|
| X          | `points`    | distinct observed points                                       | (q, p) | m       |
| a, g_a     | `a`, `g`    | regularisers chosen after the data, their scales               | (A,)   | -, unit J |
| P, u, e    | `spectrum`  | see `gp.spectrum`; W = P k(X, z)                               |        |         |
| mu_a, sigma_a | `mu`, `sd` | sum W u/(e + a), sqrt(1 - sum W^2/(e + a))                    | (N, A) | unit J, - |
| w, b(z)    |             | weights of the data: mu_a(z) = w'k(X, z), b = P'(W/(e + a))    | (q,), (q, N) | |
| c, h       | `centres`, `half` | centre and half side lengths of a cell                   | (N, p), (p,) | m |
|            | `radial.axes` | length scales of the parameters; points and cells are divided by them first | (p,) | m |
| B, m0, tau |             | as in `bounds.confidence`                                      | ()     | unit J  |

**A cell, smooth kernels** (nu > 2). For f of norm <= B, |d_jj f| <= B sqrt(k^(4)(0)) = B `bend`, so f differs from the
interpolant of its corner values, linear in each coordinate, by at most B bend sum_j h_j^2/2; the corners' upper values
bound it.

**A cell, rough kernels** (nu <= 2). Every function of the ball may rise like |z|^nu, but the band's edge is smooth
where no data are. Let mu, sigma, g belong to one a, z be a point of the cell, and k_i, grad k_i the kernel of
observation i and its gradient at the centre. Taylor: k(z, x_i) = k_i + grad k_i'(z - c) + rho_i with |rho_i| <= rem_i
(curvature over the cell, or the range of k where it has a kink). As A = P'diag(1/(e + a))P is positive semidefinite,

    mu(z)      = mu(c) + (sum w_i grad k_i)'(z - c) + sum w_i rho_i
    sigma^2(z) = sigma^2(c) - 2 b'dk - dk'A dk <= sigma^2(c) - 2 (sum b_i grad k_i)'(z - c) - 2 sum b_i rho_i

with dk = k(X, z) - k(X, c), b = A k(X, c). The square root is concave, so mu(z) + g sigma(z) is at most

    mu(c) + g sigma(c) + sum_j d_j(mu + g sigma)(c) (z - c)_j + sum (|w_i| + g |b_i|/sigma(c)) rem_i     (1)

linear plus a rest that is quadratic in h. Near the data sigma(c) is small, and bounding the square root whole is better
(2). A third bound needs no data: the band at c plus B d_k(|h|) (3). The best of the three counts, at the a that is best
at c.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...blocks import blocks
from ...gp.kernels import Floats, scaled
from ...gp.radial import Radial
from ...gp.spectrum import Spectrum


@dataclass(frozen=True, slots=True)
class Envelope:
    """The band of one problem after n observations, m0 and tau included; a snapshot that later data do not change."""

    points: Floats
    radial: Radial
    spectrum: Spectrum
    a: Floats
    g: Floats
    rkhs_norm: float
    prior_mean: float = 0.0
    tau: float = 0.0

    def band(self, kernel: Floats) -> tuple[Floats, Floats]:
        """Return (upper, lower) at N points whose kernel with the data is `kernel` (q, N); each (N,), unit J.
        Implements eq. (Gaussian mixture) of [FR].

        Formula: m0 + tau + min_a (mu_a + g_a sigma_a), m0 - tau + max_a (mu_a - g_a sigma_a), never beyond m0 +- (B +
        tau).
        """
        return self.limits(*self.moments(kernel))

    def limits(self, mu: Floats, sd: Floats) -> tuple[Floats, Floats]:
        """Return (upper, lower), (N,) each, from the moments (N, A) there: the formula of `band`."""
        reach = self.g * sd
        # Every a gives a valid band of the same set, so the intersection over a is valid too.
        upper, lower = np.min(mu + reach, axis=1), np.max(mu - reach, axis=1)
        high, low = self.prior_mean + self.tau, self.prior_mean - self.tau
        return high + np.minimum(upper, self.rkhs_norm), low + np.maximum(lower, -self.rkhs_norm)

    def at(self, z: Floats) -> tuple[Floats, Floats]:
        """Return (upper, lower) at the points `z` (N, p), which need not be candidates."""
        return _joined([self.limits(*moments) for moments in self._moments_of_blocks(z)])

    def moments_at(self, z: Floats) -> tuple[Floats, Floats]:
        """Return mu_a and sigma_a, (N, A) each, at the points `z` (N, p); see `moments`."""
        return _joined(list(self._moments_of_blocks(z)))

    def _moments_of_blocks(self, z: Floats) -> Iterator[tuple[Floats, Floats]]:
        # The differences have p numbers for each pair of an observed point and one of z.
        for part in blocks(len(z), max(self.points.size, self.a.size)):
            kernel = self.radial.value(_lengths(self._differences(z[part])))
            yield self._moments(self.spectrum.projector @ kernel)

    def scaled(self, factor: float) -> "Envelope":
        """Return the band of `factor` times the objective, factor > 0: everything in the unit of J is multiplied."""
        return replace(
            self,
            spectrum=replace(self.spectrum, u=factor * self.spectrum.u),
            g=factor * self.g,
            rkhs_norm=factor * self.rkhs_norm,
            prior_mean=factor * self.prior_mean,
            tau=factor * self.tau,
        )

    def mirrored(self) -> "Envelope":
        """Return the band of minus the objective: upper and lower change places."""
        spectrum = replace(self.spectrum, u=-self.spectrum.u)
        return replace(self, spectrum=spectrum, prior_mean=-self.prior_mean)

    def moments(self, kernel: Floats) -> tuple[Floats, Floats]:
        """Return mu_a and sigma_a, (N, A) each, for `kernel` (q, N); sigma is rounded up, mu by what g sigma may lose.

        The first-order effect of the round-off `error` in the matrix, |d mu| <= error |u/(e + a)| |W/(e + a)| and
        d sigma^2 <= error |W/(e + a)|^2, is added to sigma: without it a tiny a would be too good to be true.
        """
        # In blocks of the N, because W and its squares are as large as the kernel.
        parts = [
            self._moments(self.spectrum.projector @ kernel[:, part]) for part in blocks(kernel.shape[1], len(kernel))
        ]
        return _joined(parts)

    def over(self, centres: Floats, half: Floats, signs: Floats) -> tuple[Floats, Floats, Floats]:
        """Bound J over cells by a linear function and a rest: corner values (N, 2^p), rest (N,), upper value at c (N,).
        Implements eq. (cover) of [PB].

        Formula: (1), (2) or (3) of the module; corner v is centre + signs[v] half, `signs` (2^p, p) being +-1.
        """
        # A cell of the box is a cell of the scaled box, and a linear function of one is a linear function of the other.
        half = scaled(half, self.radial.axes)
        difference = self._differences(centres)  # (q, N, p)
        r, reach = _lengths(difference), float(np.linalg.norm(half))
        kernel, slope = self.radial.value(r), self.radial.slope(r)
        projected = self.spectrum.projector @ kernel
        mu, sd = self._moments(projected)
        best = np.argmin(mu + self.g * sd, axis=1)
        rows = np.arange(len(centres))
        mu, sd, g = mu[rows, best], sd[rows, best], self.g[best]
        w = (self.spectrum.projector.T @ (self.spectrum.u[:, None] / (self.spectrum.values[:, None] + self.a)))[:, best]
        b = self.spectrum.projector.T @ (projected / (self.spectrum.values[:, None] + self.a[best]))  # (q, N)
        slope = np.where(r > 0, slope, 0.0)  # at an observation a rough kernel has a kink, and no gradient
        remainder = self._remainder(kernel, slope, r, reach)
        grad_mu = np.einsum("qn,qnp->np", w * slope, difference)
        grad_k = np.einsum("qn,qnp->np", b * slope, difference)
        rest_mu = np.einsum("qn,qn->n", np.abs(w), remainder)
        rest_k = np.einsum("qn,qn->n", np.abs(b), remainder)
        # (1): linear in z, with a rest quadratic in h.
        top = mu + g * sd
        tilt = grad_mu - (g / sd)[:, None] * grad_k
        smooth = rest_mu + g / sd * rest_k
        # (2): the square root bounded whole, for cells near the data.
        near = np.abs(grad_mu) @ half + rest_mu
        near += g * (np.sqrt(sd**2 + 2.0 * (np.abs(grad_k) @ half + rest_k)) - sd)
        # (3): B d_k(|h|) needs no data, and no value of the ball exceeds B.
        flat = np.minimum(np.minimum(near, self.rkhs_norm * self.radial.distance(reach)), self.rkhs_norm - top)
        linear = np.abs(tilt) @ half + smooth < flat
        corners = top[:, None] + np.where(linear[:, None], (tilt * half) @ signs.T, 0.0)
        shift = self.prior_mean + self.tau
        return shift + corners, np.where(linear, smooth, flat), shift + np.minimum(top, self.rkhs_norm)

    def rest(self, half: Floats) -> float:
        """Return how far J may exceed the interpolant of its corner values in a cell; infinite for rough kernels."""
        return self.rkhs_norm * self.radial.bend * float(np.sum(scaled(half, self.radial.axes) ** 2)) / 2.0

    def _moments(self, w: Floats) -> tuple[Floats, Floats]:
        shrunk = 1.0 / (self.spectrum.values[:, None] + self.a)  # (q, A)
        squares = w * w
        mu = w.T @ (self.spectrum.u[:, None] * shrunk)
        variance = np.maximum(1.0 - squares.T @ shrunk, 0.0)
        error, spread = self.spectrum.error, squares.T @ (shrunk * shrunk)
        sd = np.sqrt(variance + error * (1.0 + spread))
        lost = error * np.sqrt(spread) * np.sqrt(np.sum((self.spectrum.u[:, None] * shrunk) ** 2, axis=0))
        # The empty posterior has no scale to divide by: without data nothing is lost.
        return mu, sd + np.divide(lost, self.g, out=np.zeros_like(lost), where=self.g > 0)

    def _remainder(self, kernel: Floats, slope: Floats, r: Floats, reach: float) -> Floats:
        """Return rem_i (q, N): half the curvature times the squared reach, or what the range of k leaves."""
        low, high = np.maximum(r - reach, 0.0), r + reach
        curved = 0.5 * reach**2 * self.radial.curvature(low, high)
        error = self.radial.error * (1.0 + (self.radial.rate * reach) ** 2)
        change = np.maximum(self.radial.value(low) - kernel, kernel - self.radial.value(high))
        return np.asarray(np.fmin(curved, change + np.abs(slope) * r * reach) + error, dtype=np.float64)

    def _differences(self, z: Floats) -> Floats:
        points, z = scaled(self.points, self.radial.axes), scaled(z, self.radial.axes)
        return np.asarray(z[None, :, :] - points[:, None, :], dtype=np.float64)  # (q, N, p)


def _joined(parts: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """Return two arrays of all blocks."""
    first, second = (np.concatenate(each) for each in zip(*parts, strict=True))
    return first, second


def _lengths(difference: Floats) -> Floats:
    return np.asarray(np.sqrt(np.einsum("qnp,qnp->qn", difference, difference)), dtype=np.float64)
