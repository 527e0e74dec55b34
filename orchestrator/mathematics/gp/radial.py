"""The Matern kernel as a function of distance: value, slope, and bounds on its curvature.

`gp.kernels` decides at the candidates; this module is for points and cells between them, where slope and curvature are
needed, and its values agree with that kernel within `error`.

| symbol  | name           | meaning                                          | shape | unit  |
|---------|----------------|--------------------------------------------------|-------|-------|
| nu, l   | `kernel`       | smoothness, length scale                         | ()    | -, m  |
| r       | `r`            | distance, scaled where there is a length per axis | any  | m     |
| l_j     | `axes`         | length scales of the parameters, then l = 1      | (p,)  | parameter |
| s       |                | sqrt(2 nu) r / l                                 | any   | -     |
| c       | `_c`           | 2^(1-nu) / Gamma(nu)                             | ()    | -     |
| P_mu(s) | `_bessel`      | s^mu K_mu(s), positive and decreasing in s       | any   | -     |
| k(r)    | `value`        | c P_nu(s)                                        | any   | -     |
| k'(r)/r | `slope`        | -(2 nu/l^2) c P_{nu-1}(s)                        | any   | 1/m^2 |
| k''(r)  |                | (2 nu/l^2) c (s^2 P_{nu-2}(s) - P_{nu-1}(s))     | any   | 1/m^2 |

All from d/ds s^mu K_mu(s) = -s^mu K_{mu-1}(s). Half-integer orders have closed forms. For other orders a Bessel
function costs half a microsecond, so P is tabulated by cubics that match value and slope; `error` bounds the loss.
"""

import math

import numpy as np
import scipy

from .kernels import Floats, Matern

LARGEST_NU = 40.0


class Radial:
    """Value, slope and curvature bound of one Matern kernel.

    Raises:
        ValueError: nu is above 40.

    >>> radial = Radial(Matern(nu=0.5, length_scale=2.0))
    >>> round(float(radial.value(np.array([2.0]))[0]), 6), round(float(radial.slope(np.array([2.0]))[0]), 6)
    (0.367879, -0.09197)

    """

    def __init__(self, kernel: Matern) -> None:
        if kernel.nu > LARGEST_NU:
            raise ValueError(f"kernel nu = {kernel.nu:g} overflows near 0: take a smaller nu, at most {LARGEST_NU:g}")
        self._nu = kernel.nu
        self.axes = kernel.axes
        self.rate = math.sqrt(2.0 * kernel.nu) / kernel.unit
        self._c = 2.0 ** (1.0 - kernel.nu) / math.gamma(kernel.nu)
        self._tables: dict[float, _Table] = {}

    @property
    def bend(self) -> float:
        """Return sqrt(k^(4)(0)), which bounds |f''| along any line for every f of norm 1; infinite for nu <= 2.

        Formula: k^(4)(0) = 3 nu^2/((nu-1)(nu-2) l^4), from P's series in s^2; f'' is the inner product of f and k''.
        """
        nu = self._nu
        return math.sqrt(0.75 / ((nu - 1.0) * (nu - 2.0))) * self.rate**2 if nu > 2.0 else math.inf

    @property
    def largest_bend(self) -> float:
        """Return -k''(0), which bounds |d^2/dt^2 k(|z + t v|)|, |v| = 1, everywhere; infinite for nu <= 1.

        Formula: nu/((nu - 1) l^2), from P's series. The bound is that of every kernel with a spectral measure: a cosine
        in the integral for k'' is at most 1, as it is at 0.
        """
        return 0.5 * self.rate**2 / (self._nu - 1.0) if self._nu > 1.0 else math.inf

    @property
    def error(self) -> float:
        """Bound of the absolute error of `value`, and of `slope` and `curvature` in units of `rate`^2."""
        return 1e-15 if self._nu in _HALF_INTEGER else 1e-12

    def value(self, r: Floats) -> Floats:
        """Return k(r), in the shape of `r`."""
        # Cubics may exceed k(0) = 1 by `error`; a covariance above 1 would give a negative variance.
        values = np.minimum(self._c * self._bessel(self._nu, self.rate * r), 1.0)
        return np.asarray(np.where(r == 0, 1.0, values), dtype=np.float64)

    def slope(self, r: Floats) -> Floats:
        """Return k'(r)/r, so that the gradient of k(|z - x|) is `slope` (z - x); -inf at r = 0 for nu <= 1."""
        return np.asarray(-(self.rate**2) * self._c * self._bessel(self._nu - 1.0, self.rate * r), dtype=np.float64)

    def value_and_slope(self, r: Floats) -> tuple[Floats, Floats]:
        """Return `value`, and `slope` to about 1e-9 of `rate`^2 (0 at r = 0): faster, but too coarse for a bound."""
        with np.errstate(divide="ignore", invalid="ignore"):
            if self._nu in _HALF_INTEGER:
                value, slope = self.value(r), self.slope(r)
            else:
                value, derivative = self._table(self._nu).with_derivative(self.rate * r)
                value, slope = np.minimum(self._c * value, 1.0), self._c * self.rate * derivative / r
        # At r = 0 a smooth kernel has slope 0 and a rough one a kink, where a climb may take 0 as well.
        return value, np.where(r > 0, slope, 0.0)

    def curvature(self, low: Floats, high: Floats) -> Floats:
        """Return a bound of |d^2/dt^2 k(|z + t v - x|)|, |v| = 1, over all distances in [low, high].

        Formula: the Hessian's eigenvalues are k'' and k'/r, so (2 nu/l^2) c max(P_{nu-1}(s_low), s_high^2
        P_{nu-2}(s_low)) bounds both. Infinite where the kernel has a kink (`low` = 0 and nu <= 2, not tight above 1).
        """
        s_low, s_high = self.rate * low, self.rate * high
        radial = s_high**2 * self._bessel(self._nu - 2.0, s_low)
        tangential = self._bessel(self._nu - 1.0, s_low)
        # P decreases in s, so its largest value over the interval is the one at s_low.
        largest = self._c * np.maximum(tangential, radial) + (1.0 + s_high**2) * self.error
        return np.asarray(self.rate**2 * largest, dtype=np.float64)

    def distance(self, r: float) -> float:
        """Return d_k = sqrt(2 - 2 k(r)), by which any f of norm 1 may differ over the distance r."""
        return math.sqrt(max(0.0, 2.0 - 2.0 * float(self.value(np.array([r]))[0])))

    def _bessel(self, order: float, s: Floats) -> Floats:
        if order in _HALF_INTEGER:
            return _bessel(order, s)
        return self._table(order)(s)

    def _table(self, order: float) -> "_Table":
        if order not in self._tables:
            self._tables[order] = _Table(order)
        return self._tables[order]


class _Table:
    """P_order by cubics from `_start` on; Bessel functions below, where P may be singular; 0 where P is < 1e-20.

    A cubic misses h^4/384 of the fourth derivative, which near 0 is 3/(4 (order - 1) (order - 2)) of P(0).
    """

    STEP = 0.005

    def __init__(self, order: float) -> None:
        self._order = order
        self._start = 0.0 if order >= 3 else 0.5 if order > 2 else 4.0
        stop = 60.0 + 4.0 * abs(order)
        s = np.arange(self._start, stop, self.STEP, dtype=np.float64)
        value, slope = _bessel(order, s), -s * _bessel(order - 1.0, s) * self.STEP
        rise = np.diff(value)
        low, high = slope[:-1], slope[1:]
        columns = [value[:-1], low, 3.0 * rise - 2.0 * low - high, low + high - 2.0 * rise]
        self._cubics = np.ascontiguousarray(np.stack(columns, axis=1))  # (cells, 4)
        self._cubics[-1] = 0.0  # the cell of everything beyond the table

    def __call__(self, s: Floats) -> Floats:
        """Return P(s), in the shape of `s`."""
        t, c = self._cell(s)
        result = np.asarray(c[..., 0] + t * (c[..., 1] + t * (c[..., 2] + t * c[..., 3])), dtype=np.float64)
        if self._start > 0:
            near = s < self._start
            result[near] = _bessel(self._order, s[near])
        return result

    def with_derivative(self, s: Floats) -> tuple[Floats, Floats]:
        """Return P(s) and P'(s) to about 1e-9, in the shape of `s`."""
        t, c = self._cell(s)
        result = c[..., 0] + t * (c[..., 1] + t * (c[..., 2] + t * c[..., 3]))
        derivative = (c[..., 1] + t * (2.0 * c[..., 2] + 3.0 * t * c[..., 3])) / self.STEP
        if self._start > 0:
            near = s < self._start
            result[near] = _bessel(self._order, s[near])
            derivative[near] = -s[near] * _bessel(self._order - 1.0, s[near])
        return result, derivative

    def _cell(self, s: Floats) -> tuple[Floats, Floats]:
        """Return the position within its cell and the cubic of each of `s`."""
        t = np.clip((s - self._start) / self.STEP, 0.0, len(self._cubics) - 1.0)
        cell = t.astype(np.intp)
        return t - cell, self._cubics[cell]


def _bessel(order: float, s: Floats) -> Floats:
    """Return P_order(s) = s^order K_order(s); its limit at 0, 2^(order-1) Gamma(order), or infinity for order <= 0."""
    limit = 2.0 ** (order - 1.0) * math.gamma(order) if order > 0 else math.inf
    with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
        values = _HALF_INTEGER[order](s) if order in _HALF_INTEGER else s**order * scipy.special.kv(abs(order), s)
    # Near 0 a large order overflows; P decreases, so the limit bounds it there and is accurate to s^2.
    return np.where((s == 0) | ~np.isfinite(values), limit, values)


_ROOT = math.sqrt(math.pi / 2.0)
_HALF_INTEGER = {
    2.5: lambda s: _ROOT * np.exp(-s) * (3.0 + s * (3.0 + s)),
    1.5: lambda s: _ROOT * np.exp(-s) * (1.0 + s),
    0.5: lambda s: _ROOT * np.exp(-s),
    -0.5: lambda s: _ROOT * np.exp(-s) / s,
    -1.5: lambda s: _ROOT * np.exp(-s) * (1.0 + s) / s**3,
}
