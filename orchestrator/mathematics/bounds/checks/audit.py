"""The audit: tests of the assumptions of the claims against the data, where a test is possible.

| symbol   | name          | meaning                                              | shape | unit   |
|----------|---------------|------------------------------------------------------|-------|--------|
| n        | `len(y)`      | number of tests                                      | ()    | -      |
| y        | `y`           | observations of the maximised J, in test order       | (n,)  | unit J |
| m0       | `prior_mean`  | the norm bound is on J - m0                          | ()    | unit J |
| B, R     | `rkhs_norm`, `noise_scale` | norm bound; sub-Gaussian scale per *test* | ()   | unit J |
| delta    | `delta`       | failure probability of the problem                   | ()    | -      |

Every function returns a status and the named numbers that decided it. `not refuted` is not evidence: a wrong
assumption can pass.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from ...gp.kernels import Matern
from ...gp.lattice import Lattice

Status = Literal["derived", "assumed", "not refuted", "refuted"]
Values = Mapping[str, float | int | str]


class Finding(NamedTuple):
    """The status of one assumption, and the numbers behind it."""

    status: Status
    values: Values


def norm_from_tests(
    y: Sequence[float], *, prior_mean: float, rkhs_norm: float, noise_scale: float, delta: float
) -> Finding:
    """Test the norm bound B against the observations: with k(z, z) = 1, no |J(z) - m0| exceeds ||J - m0||_k <= B.

    Formula: refuted if max|y_i - m0| > B + R sqrt(2 ln(2n/delta)), which n tests of R-sub-Gaussian noise with
    |J - m0| <= B exceed with probability at most delta (two tails, union over the tests).

    Raises:
        ValueError: no observation, or one that is not finite.

    >>> norm_from_tests([0.27], prior_mean=0.0, rkhs_norm=0.1, noise_scale=0.05, delta=0.05).status
    'refuted'

    """
    if not y or not all(math.isfinite(v) for v in y):
        raise ValueError("the audit needs finite observations, at least one")
    deviations = [abs(v - prior_mean) for v in y]
    largest = max(deviations)
    # The noise can lift an observation above B: a bare comparison with B would refute true bounds.
    threshold = rkhs_norm + noise_scale * math.sqrt(2.0 * math.log(2.0 * len(y) / delta))
    values = {
        "largest": largest,
        "rkhs_norm": rkhs_norm,
        "above": sum(d > rkhs_norm for d in deviations),
        "tests": len(y),
        "threshold": threshold,
        "confidence": 1.0 - delta,
    }
    return Finding("refuted" if largest > threshold else "not refuted", values)


def norm_from_set(*, b_min: float, rkhs_norm: float, confidence: float) -> Finding:
    """Test the norm bound B against the smallest norm that the data allow (method `rigorous`).
    Implements eq. (norm) of [PB].

    Formula: B_min = max over n and over a, 7 decades, of sqrt(max(0, y'(K + aI)^-1 y - Q/a)); refuted if B_min > B. The
    maximum over n is never withdrawn and costs nothing: the confidence set holds for all n at once.

    Raises:
        ValueError: `b_min` is negative or not finite.

    >>> norm_from_set(b_min=0.5, rkhs_norm=0.2, confidence=0.95).status
    'refuted'

    """
    if not (math.isfinite(b_min) and b_min >= 0):
        raise ValueError(f"b_min must be a finite number >= 0, not {b_min!r}")
    values = {"b_min": b_min, "rkhs_norm": rkhs_norm, "margin": rkhs_norm - b_min, "confidence": confidence}
    return Finding("refuted" if b_min > rkhs_norm else "not refuted", values)


def rise_between_nodes(lattice: Lattice, kernel: Matern, rkhs_norm: float) -> float:
    """Return by how much J may rise between the nodes of a lattice under the norm bound, in the unit of J.

    Formula: |J(z) - J(g)| <= B sqrt(2 - 2 k(|z - g|)), at the half-diagonal of a cell.
    """
    similarity = float(kernel(np.array([lattice.half_diagonal(kernel.axes)]))[0])
    return rkhs_norm * math.sqrt(max(0.0, 2.0 - 2.0 * similarity))


def centred_risk(replicates: int) -> Finding:
    """Refute, by derivation, that mean - r * sd of a sample is a centred observation of E - r sd.

    Formula: by Jensen's inequality E[s] < sd; for a Gaussian robustness E[s]/sd = c4(n) =
    sqrt(2/(n-1)) Gamma(n/2)/Gamma((n-1)/2), n being the replicates.

    Raises:
        ValueError: fewer than two replicates.

    >>> centred_risk(10).values["percent"]
    2.7

    """
    if replicates < 2:
        raise ValueError(f"a sample standard deviation needs at least 2 replicates, not {replicates}")
    n = replicates
    c4 = math.sqrt(2.0 / (n - 1)) * math.exp(math.lgamma(n / 2) - math.lgamma((n - 1) / 2))
    return Finding("refuted", {"replicates": n, "percent": round(100 * (1 - c4), 1)})


def bounds_agree(*, upper: float, lower: float) -> Finding:
    """Test whether the proven upper bound is above the proven lower bound (method `rigorous`).
    Implements eq. (agreement) of [PB].

    Formula: refuted if min U < max L - 1e-9.
    """
    # Bounds are rounded outward to 1e-9: two that are equal may cross by that much.
    return Finding("refuted" if upper < lower - 1e-9 else "not refuted", {"upper": upper, "lower": lower})


def replicate_spread(
    replicates: Sequence[Sequence[float]], *, noise_scale: float, delta: float, planned: int
) -> Finding | None:
    """Test R of one rollout against the spread of replicates; None where no test has two.
    Implements eq. (spread) of [PB].

    Formula: refuted if the sum of (v - mean of its test)^2 over N values exceeds [ln(1/delta) - (N/2) ln(1-2x)] R^2/x,
    x = min(1/4, sqrt(ln(1/delta)/planned)). For R-sub-Gaussian noise E exp(x xi^2/R^2) <= (1 - 2x)^(-1/2), so that the
    product over the values is a supermartingale; Ville's inequality makes the test valid at every N. Between a pooled
    standard deviation of R and the threshold there is a hint only. `planned` values were fixed beforehand.

    Raises:
        ValueError: a value is not finite, or delta is outside (0, 1).

    >>> replicate_spread([(0.0, 1.0)] * 50, noise_scale=0.1, delta=0.05, planned=100).status
    'refuted'

    """
    if not 0.0 < delta < 1.0:
        raise ValueError(f"delta must be in (0, 1), not {delta!r}")
    groups = [values for values in replicates if len(values) > 1]
    count = sum(len(group) for group in groups)
    if not groups:
        return None
    means = [math.fsum(group) / len(group) for group in groups]
    squares = math.fsum((v - mean) ** 2 for group, mean in zip(groups, means, strict=True) for v in group)
    if not math.isfinite(squares):
        raise ValueError("the audit needs finite replicates")
    sd = math.sqrt(squares / (count - len(groups)))
    # x must be fixed before the data: it depends on the planned number of values, never on those that came.
    x = min(0.25, math.sqrt(math.log(1 / delta) / max(planned, count)))
    status: Status = "not refuted"
    if squares > (math.log(1 / delta) - count / 2 * math.log1p(-2 * x)) * noise_scale**2 / x:
        status = "refuted"
    elif sd > noise_scale:
        status = "assumed"
    return Finding(status, {"tests": len(groups), "sd": sd, "noise_scale": noise_scale, "confidence": 1.0 - delta})


def deterministic_variant(replicates: Sequence[Sequence[float]]) -> Finding:
    """Test R = 0: rollouts of one test must agree bit by bit, and so must tests at one place.

    `replicates` contains the values of equal inputs: one inner sequence per place.

    >>> deterministic_variant([(0.7, 0.7), (0.6, 0.61)]).status
    'refuted'
    """
    repeated = [values for values in replicates if len(values) > 1]
    differing = sum(any(value != values[0] for value in values) for values in repeated)  # a NaN differs from itself
    status: Status = "refuted" if differing else "not refuted" if repeated else "assumed"
    return Finding(status, {"repeated": len(repeated), "differing": differing})


def noise_range(*, noise_scale: float, hoeffding: float) -> Finding:
    """Compare R with half the range of the observation, both per rollout: from there on R is proven, not assumed.

    >>> noise_range(noise_scale=0.4, hoeffding=0.4).status
    'derived'
    """
    values = {"noise_scale": noise_scale, "hoeffding": hoeffding}
    return Finding("derived" if noise_scale >= hoeffding else "assumed", values)
