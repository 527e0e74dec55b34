"""The Matern kernel of unit amplitude, bitwise equal to scikit-learn's.

This kernel decides at the candidates, where all kernel rows are made of its values; `gp.radial` repeats it with slope
and curvature, for points and cells between the candidates.

| symbol | name           | meaning                                    | shape | unit |
|--------|----------------|--------------------------------------------|-------|------|
| k(r)   | `Matern()`     | covariance of two points at distance r     | any   | -    |
| nu     | `nu`           | smoothness                                 | ()    | -    |
| l      | `length_scale` | length scale                               | ()    | m    |
| l_j    | `axes`         | length scales of the parameters            | (p,)  | parameter |
| r      | `distances`    | Euclidean distances; with axes, of z_j/l_j | any   | m    |

The amplitude is part of the norm bound B (`rkhs_norm`), so k(0) = 1.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ..blocks import blocks

Floats = NDArray[np.float64]


def scaled(z: Floats, axes: Floats | None) -> Floats:
    """Return parameters or their differences (..., p), divided by the length scales of the parameters if given.

    Raises:
        ValueError: there is not one length scale per parameter.

    """
    if axes is None:
        return z
    if z.shape[-1] != len(axes):
        raise ValueError(f"the kernel has {len(axes)} length scales for {z.shape[-1]} parameters; give one for each")
    return np.asarray(z / axes, dtype=np.float64)


def squared_distances(first: Floats, second: Floats, axes: Floats | None = None) -> Floats:
    """Return the squared distances between two lists of points (n, p) and (m, p), (n, m), scaled by `axes` if given.

    >>> squared_distances(np.array([[0.0, 0.0]]), np.array([[3.0, 4.0], [0.0, 1.0]])).tolist()
    [[25.0, 1.0]]
    """
    found = np.empty((len(first), len(second)))
    # The differences have p numbers for each pair.
    for part in blocks(len(first), second.size):
        difference = scaled(first[part, None, :] - second[None, :, :], axes)
        found[part] = np.sum(difference * difference, axis=2)
    return found


@dataclass(frozen=True, slots=True)
class Matern:
    """The Matern kernel of smoothness `nu` and length scale `length_scale`, one number or one per parameter.

    With one per parameter it is the kernel of the scaled parameters z_j/l_j, whose length scale is 1 (`unit`).

    Formula: k(r) = 2^(1-nu)/Gamma(nu) s^nu K_nu(s) with s = sqrt(2 nu) r/l, as scikit-learn's `Matern` defines it.

    Raises:
        ValueError: `nu` or `length_scale` is not a positive finite number.

    >>> round(float(Matern(nu=0.5, length_scale=2.0)(np.array([2.0]))[0]), 6)
    0.367879

    """

    nu: float
    length_scale: float | tuple[float, ...]

    @property
    def axes(self) -> Floats | None:
        """Length scales per parameter, (p,); None for one number."""
        return np.array(self.length_scale) if isinstance(self.length_scale, tuple) else None

    @property
    def unit(self) -> float:
        """The length scale of scaled distances."""
        return 1.0 if isinstance(self.length_scale, tuple) else self.length_scale

    def __post_init__(self) -> None:
        """Check that a kernel with these parameters exists."""
        lengths = self.length_scale if isinstance(self.length_scale, tuple) else (self.length_scale,)
        for name, value in (("nu", self.nu), *(("length_scale", each) for each in lengths)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"kernel {name} must be a positive finite number, not {value!r}")
        if not lengths:
            raise ValueError("kernel length_scale must be a number, or one per parameter")

    def __call__(self, distances: Floats) -> Floats:
        """Return k at each of `distances`, in the shape of `distances`; scaled ones where there is a length per axis.

        Raises:
            ValueError: a distance is negative or not finite, or the Bessel function overflows (nu far above 10).

        """
        r = np.asarray(distances, dtype=np.float64)
        if not np.all(np.isfinite(r) & (r >= 0)):
            raise ValueError("kernel distances must be finite and not negative")
        # Equal distances get one evaluation: 760 ns each for a general nu, and bitwise equal values.
        unique, inverse = np.unique(r, return_inverse=True)
        with np.errstate(invalid="ignore", over="ignore"):
            values = _matern(self.nu, unique / self.unit)
        values[unique == 0] = 1.0  # the limit; the general formula computes 0 * inf there for a large nu
        if not np.all(np.isfinite(values)):
            raise ValueError(f"Matern kernel overflows at nu = {self.nu:g} for these distances: take a smaller nu")
        return np.asarray(values[inverse].reshape(r.shape), dtype=np.float64)


def _matern(nu: float, r: Floats) -> Floats:
    """Return the kernel of length scale 1 at r, (m,), by the floating-point operations of scikit-learn in their order.

    Equal operations give equal bits, which certificates depend on; to import its kernel takes 1.2 s of CPU.
    """
    r = np.sqrt(np.square(r))  # its Euclidean distance in one dimension, as it computes it: 0 below 1e-162
    if nu == 0.5:
        return np.exp(-r)
    if nu == 1.5:
        s = r * math.sqrt(3)
        return np.asarray((1.0 + s) * np.exp(-s), dtype=np.float64)
    if nu == 2.5:
        s = r * math.sqrt(5)
        return np.asarray((1.0 + s + s**2 / 3.0) * np.exp(-s), dtype=np.float64)
    r[r == 0.0] += np.finfo(np.float64).eps  # the Bessel function is infinite at 0
    s = math.sqrt(2 * nu) * r
    values = np.full_like(r, 2 ** (1.0 - nu) / scipy.special.gamma(nu))
    values *= s**nu
    values *= scipy.special.kv(nu, s)
    return values
