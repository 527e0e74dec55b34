"""The Matern kernel of unit amplitude, evaluated by scikit-learn.

This kernel decides at the candidates, where all kernel rows are made of its values; `gp.radial` repeats it with slope
and curvature, for points and cells between the candidates.

| symbol | name           | meaning                                    | shape | unit |
|--------|----------------|--------------------------------------------|-------|------|
| k(r)   | `Matern()`     | covariance of two points at distance r     | any   | -    |
| nu     | `nu`           | smoothness                                 | ()    | -    |
| l      | `length_scale` | length scale                               | ()    | m    |
| r      | `distances`    | Euclidean distances                        | any   | m    |

The amplitude is part of the norm bound B (`rkhs_norm`), so k(0) = 1.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Matern:
    """The Matern kernel of smoothness `nu` and length scale `length_scale`.

    Formula: k(r) = 2^(1-nu)/Gamma(nu) s^nu K_nu(s) with s = sqrt(2 nu) r/l, as scikit-learn's `Matern` defines it.

    Raises:
        ValueError: `nu` or `length_scale` is not a positive finite number.

    >>> round(float(Matern(nu=0.5, length_scale=2.0)(np.array([2.0]))[0]), 6)
    0.367879

    """

    nu: float
    length_scale: float

    def __post_init__(self) -> None:
        """Check that a kernel with these parameters exists."""
        for name in ("nu", "length_scale"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"kernel {name} must be a positive finite number, not {value!r}")

    def __call__(self, distances: Floats) -> Floats:
        """Return k at each of `distances`, in the shape of `distances`.

        Raises:
            ValueError: a distance is negative or not finite, or the Bessel function overflows (nu far above 10).

        """
        # scikit-learn takes over a second to import, and most commands evaluate no kernel.
        from sklearn.gaussian_process.kernels import Matern as ScikitMatern  # noqa: PLC0415

        r = np.asarray(distances, dtype=np.float64)
        if not np.all(np.isfinite(r) & (r >= 0)):
            raise ValueError("kernel distances must be finite and not negative")
        # Equal distances get one evaluation: 760 ns each for a general nu, and bitwise equal values.
        unique, inverse = np.unique(r, return_inverse=True)
        with np.errstate(invalid="ignore", over="ignore"):
            values = ScikitMatern(length_scale=self.length_scale, nu=self.nu)(np.zeros((1, 1)), unique[:, None])[0]
        values[unique == 0] = 1.0  # the limit; the general formula computes 0 * inf there for a large nu
        if not np.all(np.isfinite(values)):
            raise ValueError(f"Matern kernel overflows at nu = {self.nu:g} for these distances: take a smaller nu")
        return np.asarray(values[inverse].reshape(r.shape), dtype=np.float64)
