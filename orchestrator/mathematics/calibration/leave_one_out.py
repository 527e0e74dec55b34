"""Prediction of each value from all others, by the fitted kernel.

| symbol | name         | meaning                                               | shape | unit   |
|--------|--------------|-------------------------------------------------------|-------|--------|
| y, v   |              | see `sampled`                                         |       |        |
| p_i    | `predicted`  | prediction of y_i from the other values               | (n,)  | unit J |
| s_i    | `sd`         | standard deviation of y_i - p_i, in units of A        | (n,)  | -      |
| Q^2    | `explained`  | 1 - sum (y - p)^2 / sum (y - mean)^2                  | ()    | -      |
|        | `excess`     | mean of (y - p)^2 over v: 1 is a perfect prediction   | ()    | -      |
|        | `largest`    | largest |y_i - p_i| / (A s_i)                         | ()    | -      |
"""

from dataclasses import dataclass

import numpy as np
import scipy

from ..gp.kernels import Floats
from .kernel_fit import KernelFit
from .sampled import SampledValues


@dataclass(frozen=True, slots=True)
class LeaveOneOut:
    """The predictions, and how good they are."""

    observed: Floats
    predicted: Floats
    sd: Floats
    explained: float
    excess: float
    """Infinite without noise, where any error is above it."""
    largest: float
    worst: int
    """Where it is."""


def leave_one_out(fit: KernelFit, data: SampledValues) -> LeaveOneOut:
    """Return the prediction of every value from the others, in the unit of the values.

    Formula: with M = (K + lambda I)^-1 and y centred by its mean, y_i - p_i = (M y)_i / M_ii and s_i = M_ii^(-1/2).
    """
    centre = float(data.values.mean())
    inverse = scipy.linalg.cho_solve((fit.factor(data), True), np.eye(len(data.values)), check_finite=False)
    diagonal = np.diag(inverse)
    errors = inverse @ (data.values - centre) / diagonal
    square, sd = float(np.mean(errors**2)), 1.0 / np.sqrt(diagonal)
    return LeaveOneOut(
        data.values,
        data.values - errors,
        sd,
        1.0 - square / max(float(np.var(data.values)), 1e-300),
        square / data.variance if data.variance else np.inf,
        float(np.max(np.abs(errors) / sd)) / fit.amplitude,
        int(np.argmax(np.abs(errors) / sd)),
    )
