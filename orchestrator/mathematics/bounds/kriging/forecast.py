"""Forecast of the bound of method `kriging` at the end of its budget, before a campaign and while it runs.

| symbol | name      | meaning                                                                     | shape  | unit   |
|--------|-----------|-----------------------------------------------------------------------------|--------|--------|
| x_i    |           | the q points of the design                                                  | (q, p) | -      |
| l_i    | `left`    | rollouts at x_i that are still to come                                      | (q,)   | -      |
| X_ik   | `laws`    | values that a rollout at x_i may have, equally likely                       | q (k,) | unit X |
| e_i    | `errors`  | by which the mean of the coming rollouts at x_i may differ from that of X_i | (r, q) | unit X |
| u      |           | guess of the mean at the end                                                | ()     | unit X |
| v_i    |           | planned weight of a rollout at x_i, cut for this u                          | (m, q) | 1/unit X |

At the end S is larger than now by about the sum over i of

    l_i (v_i u + mean_k ln(1 + v_i (X_ik - u))) + l_i e_i mean_k v_i/(1 + v_i (X_ik - u)),

the sums of weights are known, and the bound follows as it does from data. The e_i make the range. It is a forecast and
no claim: only the method's own rollouts prove anything.

A plan for L times as many rollouts has about the weights v_i/sqrt(L): the price kappa of a nat, and the part of the
noise, both fall by sqrt(L). That is used to say what more rollouts would bring, because a plan takes a second or more.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...gp.kernels import Floats
from .audit import PointMeans
from .bound import KrigingBounds

DRAWS = 40
"""Of a forecast while the campaign runs."""


@dataclass(frozen=True, slots=True)
class ComingRollouts:
    """What is expected of the rollouts that are left."""

    left: Floats
    laws: Sequence[Floats]
    errors: Floats


def forecast_minima(bounds: KrigingBounds, coming: ComingRollouts, longer: float = 1.0) -> Floats:
    """Return the bound of the minimum at the end of the budget, for each row of `errors`, (r,), unit X.

    With a plan for `longer` times as many rollouts, `left` are those of the plan that `bounds` has.

    Formula: at the head of this module; never below the bound so far.
    """
    left, used = coming.left * longer, np.flatnonzero(coming.left > 0).tolist()
    if not used:
        return np.full(len(coming.errors), bounds.minimum())
    expected = sum(float(left[i] * coming.laws[i].mean()) for i in used) / float(left.sum())
    u = bounds.guess.after(expected, float(left.sum()))
    v = bounds.weights_at(u) / math.sqrt(longer)
    gains, slopes = np.zeros(len(v)), np.zeros_like(v)
    for i in used:
        wealth = 1.0 + v[:, i, None] * (coming.laws[i] - u)  # (m, k)
        gains += left[i] * (v[:, i] * u + np.log(wealth).mean(axis=1))
        slopes[:, i] = left[i] * v[:, i] * (1.0 / wealth).mean(axis=1)
    end = bounds.ahead(v * left, gains)
    cost = bounds.premises.cost
    found = [end.shifted(slopes @ error).current(cost) for error in coming.errors]
    return np.array([float(np.maximum(bounds.lower, each).min()) for each in found])


@dataclass(frozen=True, slots=True)
class PlannedBounds:
    """The rest of a plan: the bounds and the means of its rollouts so far, and its rollouts at each point, (q,)."""

    bounds: KrigingBounds
    means: PointMeans
    counts: Floats

    @property
    def left(self) -> Floats:
        """Rollouts at each point of the design that are still to come, (q,)."""
        return np.maximum(self.counts - self.means.counts, 0.0)

    def forecast(self, laws: Sequence[Floats], errors: Floats) -> Floats:
        """Return the bound of max J at the end of the plan, for each row of `errors`, (r,), unit J; no claim.

        `laws` are values of J that a rollout at each point of the design may have, equally likely, and `errors` (r, q)
        by how much their means may be wrong.
        """
        return -forecast_minima(self.bounds, ComingRollouts(self.left, self._mirrored(laws), -errors))

    def outlook(self, more: float) -> tuple[Floats, Floats]:
        """Return bounds of max J at the end of the plan, (r,), and what `more` rollouts in it would gain, (r,).

        It is how the rollouts so far may continue, and no claim. Means follow the posterior of a Gaussian process, and
        rollouts have the variance seen so far, so that every point needs some.
        """
        variances = self.means.variances()
        means, covariance = self.means.posterior(variances)
        covariance = covariance + np.diag(variances / np.maximum(self.left, 1.0))
        rng = np.random.default_rng(0)
        errors = rng.multivariate_normal(np.zeros(len(means)), covariance, DRAWS, check_valid="ignore", method="eigh")
        # Two equally likely values have this mean and variance.
        laws = [-(mean + np.array([-sd, sd])) for mean, sd in zip(means, np.sqrt(variances), strict=True)]
        again = ComingRollouts(self.counts, self._mirrored(laws), errors)
        longer = 1.0 + more / float(self.counts.sum())
        now, then = (forecast_minima(self.bounds.empty(), again, factor) for factor in (1.0, longer))
        return self.forecast(laws, -errors), np.maximum(then - now, 0.0)

    def _mirrored(self, laws: Sequence[Floats]) -> list[Floats]:
        return [np.clip(-law, *self.bounds.premises.ends) for law in laws]
