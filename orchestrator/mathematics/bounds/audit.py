"""The audit: what the claims rest on, tested against the data where that is possible.

| symbol   | name          | meaning                                              | shape | unit   |
|----------|---------------|------------------------------------------------------|-------|--------|
| n        | `len(y)`      | number of tests                                      | ()    | -      |
| y        | `y`           | observations of the maximised J, in test order       | (n,)  | unit J |
| m0       | `prior_mean`  | the norm bound is on J - m0                          | ()    | unit J |
| B, R     | `rkhs_norm`, `noise_scale` | norm bound; sub-Gaussian scale per *test* | ()   | unit J |
| delta    | `delta`       | failure probability of the problem                   | ()    | -      |

Every function returns one `Assumption`: an id like `rkhs_norm/sim_gap`, a status, and one sentence with the numbers
that decided it. `not refuted` is not evidence: a wrong assumption can pass.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..gp.kernels import Matern
from ..gp.lattice import Lattice
from .composition import Rule
from .paper import Regulariser, SigmaReading, Tail, mills_probability

Status = Literal["derived", "assumed", "not refuted", "refuted"]


@dataclass(frozen=True, slots=True)
class Assumption:
    """One thing a claim rests on, what became of it, and why, in one plain sentence."""

    id: str
    status: Status
    detail: str


def rkhs_norm(
    problem: str, y: Sequence[float], *, prior_mean: float, rkhs_norm: float, noise_scale: float, delta: float
) -> Assumption:
    """Test the norm bound B against the observations: with k(z, z) = 1, no |J(z) - m0| exceeds ||J - m0||_k <= B.

    Formula: refuted if max|y_i - m0| > B + R sqrt(2 ln(2n/delta)), which n tests of R-sub-Gaussian noise with
    |J - m0| <= B exceed with probability at most delta (two tails, union over the tests).

    Raises:
        ValueError: no observation, or one that is not finite.

    >>> rkhs_norm("sim_gap", [0.27], prior_mean=0.0, rkhs_norm=0.1, noise_scale=0.05, delta=0.05).status
    'refuted'

    """
    if not y or not all(math.isfinite(v) for v in y):
        raise ValueError(f"the audit of {problem} needs finite observations, at least one")
    deviations = [abs(v - prior_mean) for v in y]
    largest, above = max(deviations), sum(d > rkhs_norm for d in deviations)
    threshold = rkhs_norm + noise_scale * math.sqrt(2.0 * math.log(2.0 * len(y) / delta))
    refuted = largest > threshold
    verdict = (
        f"exceeds {_number(threshold)}, the most that B and the noise allow at confidence {_number(1 - delta)}: "
        "B, the noise scale or the prior mean is wrong and the bound is not proven"
        if refuted
        else f"stays within {_number(threshold)}, what B and the noise allow at confidence {_number(1 - delta)}; "
        "this does not show that B is large enough"
    )
    numbers = f"largest |y - m0| = {_number(largest)} with B = {_number(rkhs_norm)}"
    detail = f"{numbers} ({above} of {len(y)} tests above B) {verdict}."
    return Assumption(f"rkhs_norm/{problem}", "refuted" if refuted else "not refuted", detail)


def clipped_share(problem: str, values: Sequence[float], clip: tuple[float, float]) -> Assumption:
    """Report how many robustness values sit at the ends of the clip; the claims are about the clipped robustness.

    Raises:
        ValueError: no value is given.

    """
    if not values:
        raise ValueError(f"the audit of {problem} needs at least one robustness value")
    low, high = clip
    at_low, at_high = sum(v <= low for v in values), sum(v >= high for v in values)
    detail = (
        f"of {len(values)} robustness values {_share(at_low, len(values))} sit at the lower clip {_number(low)} and "
        f"{_share(at_high, len(values))} at the upper clip {_number(high)}: every claim is about the clipped "
        "robustness, and what lies beyond a clip is not seen."
    )
    return Assumption(f"clip/{problem}", "derived", detail)


def noise_tail(problem: str, *, c: float, delta: float, noise_scale: float, tail: Tail) -> Assumption:
    """Say which tail the probability rests on, with both probabilities."""
    gaussian, sub_gaussian = (mills_probability(c, delta, noise_scale, t) for t in ("gaussian", "sub-gaussian"))
    numbers = f"{_number(gaussian)} if the noise is Gaussian, {_number(sub_gaussian)} if it is only sub-Gaussian"
    if tail == "gaussian":
        detail = f"the probability of the bound is {numbers}; the first is claimed, so the noise is taken as Gaussian."
        return Assumption(f"tail/{problem}", "assumed", detail)
    detail = f"the probability of the bound is {numbers}; the second is claimed and needs no more than the noise scale."
    return Assumption(f"tail/{problem}", "derived", detail)


def noise_scale(problem: str, *, noise_scale: float, replicates: int) -> Assumption:
    """Say that the noise scale is taken from the campaign file."""
    detail = (
        f"the mean of {replicates} rollouts per test is taken to deviate from its expectation like sub-Gaussian noise "
        f"of scale {_number(noise_scale)}, a number from the campaign file."
    )
    return Assumption(f"noise_scale/{problem}", "assumed", detail)


def sigma_reading(problem: str, sigma: SigmaReading) -> Assumption:
    """Say which sigma scales the band: the variance that [ARA] prints, or the standard deviation of [CG]."""
    if sigma == "variance":
        detail = (
            "the band is scaled by the posterior variance, as the paper prints it; the theorem that the paper cites "
            "needs the standard deviation, which is larger, so this band is too narrow to be covered by it."
        )
    else:
        detail = (
            "the band is scaled by the posterior standard deviation, as the theorem that the paper cites needs it; "
            "the regulariser decides whether that theorem applies."
        )
    return Assumption(f"sigma/{problem}", "assumed", detail)


def regulariser(problem: str, regulariser: Regulariser) -> Assumption:
    """Say what is added to the kernel matrix: [CG] proves one fixed eta, and 1 + eta in mean and variance."""
    if regulariser == "1+eta":
        detail = (
            "1 + 2/i is added to the kernel matrix at test i; the theorem that the paper cites is proven for one eta "
            "fixed beforehand, not for one that changes with i together with a stop that depends on the data."
        )
    else:
        detail = (
            f"{_number(regulariser)} is added to the kernel matrix; the theorem that the paper cites needs 1 + eta, "
            "the number inside the determinant of beta, so it does not cover this choice."
        )
    return Assumption(f"regulariser/{problem}", "assumed", detail)


def lattice_for_box(
    problem: str, lattice: Lattice, kernel: Matern, rkhs_norm: float, *, refine: bool = False
) -> Assumption:
    """Say that the maximum is sought on nodes (and near the best one), and by how much J may rise between them under B.

    Formula: |J(z) - J(g)| <= B sqrt(2 - 2 k(|z - g|)), at the half-diagonal of a cell.
    """
    similarity = float(kernel(np.array([lattice.half_diagonal]))[0])
    rise = rkhs_norm * math.sqrt(max(0.0, 2.0 - 2.0 * similarity))
    where = ", the best of them improved in the cells around it," if refine else ""
    detail = (
        f"the {lattice.size} nodes of a {lattice.resolution}-per-axis lattice{where} stand for the whole box; between "
        f"nodes the objective may be worse by up to {_number(rise)} if B = {_number(rkhs_norm)} holds, and the bound "
        "does not contain this."
    )
    return Assumption(f"lattice/{problem}", "assumed", detail)


def independent_problems(problems: Sequence[str], rule: Rule) -> Assumption:
    """Say why the probabilities may be combined as they are."""
    names = " and ".join(problems)
    detail = (
        f"the probabilities of {names} are multiplied: each proposes and stops from its own observations alone, and "
        "its rollouts have seeds of their own."
        if rule == "product"
        else f"the failure probabilities of {names} are added: right however the problems depend on each other."
    )
    return Assumption("independence" if rule == "product" else "accounting", "derived", detail)


def workers_honest() -> Assumption:
    """Say that the trajectories are believed."""
    detail = (
        "the trajectories that the workers send are believed to come from the simulator; robustness and gaps are "
        "recomputed from them."
    )
    return Assumption("workers_honest", "assumed", detail)


def centred_risk(problem: str, replicates: int) -> Assumption:
    """Refute, by derivation, that mean - r * sd of a sample is a centred observation of E - r sd.

    Formula: by Jensen's inequality E[s] < sd; for a Gaussian robustness E[s]/sd = c4(n) =
    sqrt(2/(n-1)) Gamma(n/2)/Gamma((n-1)/2), n being the replicates.

    Raises:
        ValueError: fewer than two replicates.

    >>> "2.7 %" in centred_risk("true_risk", 10).detail
    True

    """
    if replicates < 2:
        raise ValueError(f"a sample standard deviation needs at least 2 replicates, not {replicates}")
    n = replicates
    c4 = math.sqrt(2.0 / (n - 1)) * math.exp(math.lgamma(n / 2) - math.lgamma((n - 1) / 2))
    detail = (
        f"each observation is mean - r * sample standard deviation of {n} rollouts, and the sample standard deviation "
        f"is too small on average (by {100 * (1 - c4):.1f} % if the robustness is Gaussian), so the observations "
        "promise more than the true risk: the unsafe side."
    )
    return Assumption(f"centred_noise/{problem}", "refuted", detail)


def norm_from_data(problem: str, *, b_min: float, rkhs_norm: float, delta: float, noise_scale: float) -> Assumption:
    """Test the norm bound B against the smallest norm that the data allow (method `rigorous`).
    Implements eq. (norm) of [PB].

    Formula: B_min = max over n and over a, 7 decades, of sqrt(max(0, y'(K + aI)^-1 y - Q/a)); refuted if B_min > B. The
    maximum over n is never withdrawn and costs nothing: the confidence set holds for all n at once.

    Raises:
        ValueError: `b_min` is negative or not finite.

    >>> norm_from_data("sim_gap", b_min=0.5, rkhs_norm=0.2, delta=0.05, noise_scale=0.05).status
    'refuted'

    """
    if not (math.isfinite(b_min) and b_min >= 0):
        raise ValueError(f"b_min must be a finite number >= 0, not {b_min!r}")
    sure = "with certainty" if noise_scale == 0 else f"at confidence {_number(1 - delta)}"
    numbers = f"the observations need a norm of at least {_number(b_min)} {sure}; B = {_number(rkhs_norm)}"
    if b_min > rkhs_norm:
        detail = f"{numbers} is below it, so B, R, the kernel, the prior mean or the independence is wrong."
        return Assumption(f"rkhs_norm/{problem}", "refuted", detail)
    detail = (
        f"{numbers} leaves a margin of {_number(rkhs_norm - b_min)}, and this is not evidence for B: a B that is far "
        "too small often passes."
    )
    return Assumption(f"rkhs_norm/{problem}", "not refuted", detail)


def bounds_agree(problem: str, *, upper: float, lower: float) -> Assumption:
    """Test whether the proven upper bound lies above the proven lower bound (method `rigorous`).
    Implements eq. (agreement) of [PB].

    Formula: refuted if min U < max L - 1e-9.
    """
    numbers = f"the smallest upper bound is {_number(upper)} and the largest lower bound {_number(lower)}"
    if upper < lower - 1e-9:
        detail = f"{numbers}: they contradict each other, so at least one assumption behind them is wrong."
        return Assumption(f"bounds_agree/{problem}", "refuted", detail)
    return Assumption(f"bounds_agree/{problem}", "not refuted", f"{numbers}, which is not evidence for either.")


def replicate_spread(
    problem: str, replicates: Sequence[Sequence[float]], *, noise_scale: float, delta: float, planned: int
) -> Assumption:
    """Test R of one rollout against the spread of replicates.
    Implements eq. (spread) of [PB].

    Formula: refuted if the sum of (v - mean of its test)^2 over N values exceeds [ln(1/delta) - (N/2) ln(1-2x)] R^2/x,
    x = min(1/4, sqrt(ln(1/delta)/planned)). For R-sub-Gaussian noise E exp(x xi^2/R^2) <= (1 - 2x)^(-1/2), so that the
    product over the values is a supermartingale; Ville's inequality makes the test valid at every N. Between a pooled
    standard deviation of R and the threshold there is a hint only. `planned` values were fixed beforehand.

    Raises:
        ValueError: a value is not finite, or delta is outside (0, 1).

    >>> replicate_spread("p", [(0.0, 1.0)] * 50, noise_scale=0.1, delta=0.05, planned=100).status
    'refuted'

    """
    if not 0.0 < delta < 1.0:
        raise ValueError(f"delta must lie in (0, 1), not {delta!r}")
    groups = [values for values in replicates if len(values) > 1]
    values = sum(len(group) for group in groups)
    freedom = values - len(groups)
    name = f"replicate_spread/{problem}"
    if not freedom:
        return Assumption(name, "assumed", "no test has two replicates, so nothing was compared with the noise scale.")
    means = [math.fsum(group) / len(group) for group in groups]
    squares = math.fsum((v - mean) ** 2 for group, mean in zip(groups, means, strict=True) for v in group)
    if not math.isfinite(squares):
        raise ValueError(f"the audit of {problem} needs finite replicates")
    sd = math.sqrt(squares / freedom)
    status: Status = "not refuted"
    verdict = "not above it, which is not evidence for R"
    x = min(0.25, math.sqrt(math.log(1 / delta) / max(planned, values)))
    if squares > (math.log(1 / delta) - values / 2 * math.log1p(-2 * x)) * noise_scale**2 / x:
        status, verdict = "refuted", f"more than noise of that scale allows at confidence {_number(1 - delta)}"
    elif sd > noise_scale:
        status, verdict = "assumed", "above it, a hint that R is too small"
    detail = (
        f"the replicates of {len(groups)} tests have a pooled standard deviation of {_number(sd)} per rollout; the "
        f"noise scale is {_number(noise_scale)} and the spread is {verdict}."
    )
    return Assumption(name, status, detail)


def deterministic_variant(problem: str, replicates: Sequence[Sequence[float]]) -> Assumption:
    """Test R = 0: rollouts of one test must agree bit by bit, and so must tests at one place.

    `replicates` holds the values of equal inputs: one inner sequence per place.

    >>> deterministic_variant("nominal_robustness", [(0.7, 0.7), (0.6, 0.61)]).status
    'refuted'
    """
    name = f"deterministic/{problem}"
    repeated = [values for values in replicates if len(values) > 1]
    differing = sum(any(value != values[0] for value in values) for values in repeated)
    if differing:
        detail = (
            f"at {differing} of {len(repeated)} repeated places the values differ although R = 0 says that the variant "
            "is deterministic: give R > 0."
        )
        return Assumption(name, "refuted", detail)
    if not repeated:
        return Assumption(
            name, "assumed", "R = 0 is taken from the campaign file, and no place was repeated to test it."
        )
    detail = f"the values at {len(repeated)} repeated places agree bit by bit, as R = 0 demands."
    return Assumption(name, "not refuted", detail)


def noise_range(problem: str, *, noise_scale: float, hoeffding: float) -> Assumption:
    """Compare R with half the range of the observation, both per rollout: from there on R is proven, not assumed.

    >>> noise_range("sim_gap", noise_scale=0.4, hoeffding=0.4).status
    'derived'
    """
    numbers = f"the noise scale per rollout is {_number(noise_scale)}, and the clip alone proves {_number(hoeffding)}"
    if noise_scale >= hoeffding:
        detail = f"{numbers} (Hoeffding's lemma), so it needs no assumption."
        return Assumption(f"noise_scale/{problem}", "derived", detail)
    detail = f"{numbers}: the smaller number is taken from the campaign file."
    return Assumption(f"noise_scale/{problem}", "assumed", detail)


def certified_box(problem: str, *, nodes: float, slack: float) -> Assumption:
    """Say that the bound covers the box between the nodes, and what that added."""
    detail = (
        f"the largest upper value on the candidates is {_number(nodes)}, and covering the box between them adds "
        f"{_number(slack)}, which the bound contains."
    )
    return Assumption(f"lattice/{problem}", "derived", detail)


def misspecification(problem: str, *, tau: float, nu: float, length_scale: float, rkhs_norm: float) -> Assumption:
    """Say that the objective is taken to lie in the ball of the kernel, up to tau."""
    near = "lies in" if tau == 0 else f"is nowhere further than {_number(tau)} from"
    detail = (
        f"the objective minus the prior mean {near} the ball of radius {_number(rkhs_norm)} of the Matern kernel with "
        f"nu = {_number(nu)} and length scale {_number(length_scale)}: a choice in the campaign file that no data can "
        "prove."
    )
    return Assumption(f"kernel/{problem}", "assumed", detail)


def _number(value: float) -> str:
    """Format compactly and equally everywhere: up to 6 significant digits, no trailing zeros."""
    return f"{value:.6g}"


def _share(count: int, total: int) -> str:
    return f"{count} ({100 * count / total:.1f} %)"
