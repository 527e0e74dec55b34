"""The sentence of every assumption: presentation of its status and values, and no part of what is verified.

A new assumption is a row of `SENTENCES` and a line in `assumptions.py`. The fields in braces are its values.
"""

from collections.abc import Mapping

from ...schemas.certificate import Assumption, Status

SIGNIFICANT = 6
"""Digits of a value: fewer than two types of CPU agree in."""

SENTENCES: dict[str, dict[Status, str]] = {
    "norm_from_tests": {
        "refuted": "largest |y - m0| = {largest} with B = {rkhs_norm} ({above} of {tests} tests above B) exceeds "
        "{threshold}, the most that B and the noise allow at confidence {confidence}: B, the noise scale or the prior "
        "mean is wrong and the bound is not proven.",
        "not refuted": "largest |y - m0| = {largest} with B = {rkhs_norm} ({above} of {tests} tests above B) stays "
        "within {threshold}, which B and the noise allow at confidence {confidence}; this does not show that B is "
        "large enough.",
    },
    "norm_from_set": {
        "refuted": "the observations need a norm of at least {b_min} at confidence {confidence}, and B = {rkhs_norm} "
        "is below it: B, R, the kernel, the prior mean or the independence is wrong.",
        "not refuted": "the observations need a norm of at least {b_min} at confidence {confidence}; B = {rkhs_norm} "
        "leaves a margin of {margin}. This is not evidence for B: a B that is far too small often passes.",
    },
    "mean_noise": {
        "assumed": "the mean of {replicates} rollouts per test is assumed to deviate from its expectation like "
        "sub-Gaussian noise of scale {noise_scale}, a number from the campaign file.",
    },
    "noise_range": {
        "derived": "the noise scale per rollout is {noise_scale}, and the clip alone proves {hoeffding} (Hoeffding's "
        "lemma), so it needs no assumption.",
        "assumed": "the noise scale per rollout is {noise_scale}, and the clip alone proves {hoeffding}: the smaller "
        "number comes from the campaign file.",
    },
    "tail": {
        "assumed": "the probability of the bound is {gaussian} if the noise is Gaussian, {sub_gaussian} if it is only "
        "sub-Gaussian; the first is claimed, so the noise is assumed to be Gaussian.",
        "derived": "the probability of the bound is {gaussian} if the noise is Gaussian, {sub_gaussian} if it is only "
        "sub-Gaussian; the second is claimed and needs no more than the noise scale.",
    },
    "sigma_variance": {
        "assumed": "the band is scaled by the posterior variance, as the paper prints it; the theorem that the paper "
        "cites needs the standard deviation, which is larger, so it does not cover this band.",
    },
    "sigma_std": {
        "assumed": "the band is scaled by the posterior standard deviation, as the theorem that the paper cites needs "
        "it; the regulariser decides whether that theorem applies.",
    },
    "regulariser_eta": {
        "assumed": "1 + 2/i is added to the kernel matrix at test i; the theorem that the paper cites is proven for "
        "one eta fixed beforehand, not for one that changes with i together with a stop that depends on the data.",
    },
    "regulariser_fixed": {
        "assumed": "{regulariser} is added to the kernel matrix; the theorem that the paper cites needs 1 + eta, the "
        "number inside the determinant of beta, so it does not cover this choice.",
    },
    "lattice_alone": {
        "assumed": "the {nodes} nodes of a lattice with {resolution} per axis represent the whole box; between nodes "
        "the objective may be worse by up to {rise} if B = {rkhs_norm} holds, and the bound does not contain this.",
    },
    "lattice_refined": {
        "assumed": "the {nodes} nodes of a lattice with {resolution} per axis, the best one improved in the cells "
        "around it, represent the whole box; between nodes the objective may be worse by up to {rise} if "
        "B = {rkhs_norm} holds, and the bound does not contain this.",
    },
    "certified_box": {
        "derived": "the largest upper value on the candidates is {candidates_upper}, and covering the box between "
        "them adds {slack}, which the bound contains.",
    },
    "finite_space": {
        "derived": "the claim is about the {starts} listed starts and no others; for these the optimum is exact.",
    },
    "centred_noise": {
        "refuted": "each observation is mean - r * sample standard deviation of {replicates} rollouts, and the sample "
        "standard deviation is too small on average (by {percent} % if the robustness is Gaussian), so the "
        "observations promise more than the true risk: the unsafe side.",
    },
    "bounds_agree": {
        "refuted": "the smallest upper bound is {upper} and the largest lower bound {lower}: they contradict each "
        "other, so at least one assumption behind them is wrong.",
        "not refuted": "the smallest upper bound is {upper} and the largest lower bound {lower}, which is not evidence "
        "for either.",
    },
    "kernel_ball": {
        "assumed": "the objective minus the prior mean lies in the ball of radius {rkhs_norm} of the Matern kernel "
        "with nu = {nu} and length scale {length_scale}: a choice in the campaign file that no data can prove.",
    },
    "kernel_near": {
        "assumed": "the objective minus the prior mean is nowhere further than {tau} from the ball of radius "
        "{rkhs_norm} of the Matern kernel with nu = {nu} and length scale {length_scale}: a choice in the campaign "
        "file that no data can prove.",
    },
    "replicate_spread": {
        "refuted": "the replicates of {tests} tests have a pooled standard deviation of {sd} per rollout; the noise "
        "scale is {noise_scale}, and the spread is more than noise of that scale allows at confidence {confidence}.",
        "assumed": "the replicates of {tests} tests have a pooled standard deviation of {sd} per rollout; the noise "
        "scale is {noise_scale}, and the spread is above it, a hint that R is too small.",
        "not refuted": "the replicates of {tests} tests have a pooled standard deviation of {sd} per rollout; the "
        "noise scale is {noise_scale}, and the spread is not above it, which is not evidence for R.",
    },
    "no_replicates": {
        "assumed": "no test has two replicates, so nothing was compared with the noise scale.",
    },
    "deterministic": {
        "refuted": "at {differing} of {repeated} repeated places the values differ although R = 0 says that the "
        "variant is deterministic: give R > 0.",
        "not refuted": "the values at {repeated} repeated places agree bit by bit, as R = 0 demands.",
        "assumed": "R = 0 comes from the campaign file, and no place was repeated to test it.",
    },
    "deterministic_nominal": {
        "refuted": "the replicates of a test share one nominal rollout, because the system declares that variant "
        "deterministic; in nominal_robustness, the values at {differing} of {repeated} repeated places differ.",
        "not refuted": "the replicates of a test share one nominal rollout, because the system declares that variant "
        "deterministic; in nominal_robustness, the values at {repeated} repeated places agree bit by bit.",
        "assumed": "the replicates of a test share one nominal rollout, because the system declares that variant "
        "deterministic; nothing was repeated to test it.",
    },
    "lipschitz_column": {
        "refuted": "for some pair of rollouts the robustness differs by {excess} more than L times the gap, so L or "
        "the column is wrong and the composition does not follow.",
        "assumed": "robustness is assumed to change by at most L = {lipschitz} times the largest difference in "
        "{column}; all pairs of rollouts obey it, which is not evidence for the others.",
    },
    "lipschitz_predicates": {
        "refuted": "for some pair of rollouts the robustness differs by {excess} more than the gap, so the composition "
        "does not follow.",
        "derived": "the gap dominates the difference of every min/max robustness, so that L = 1 needs no assumption; "
        "all pairs of rollouts obey it.",
    },
    "lipschitz_itself": {
        "refuted": "for some pair of rollouts the robustness differs by {excess} more than the gap, so the composition "
        "does not follow.",
        "derived": "the gap is the difference of the robustness itself, so that L = 1 needs no assumption; all pairs "
        "of rollouts obey it.",
    },
    "linearised": {
        "derived": "the risk is bounded by an expectation with the constants {centre} and {spread}, fixed beforehand: "
        "any constants are valid, good ones lose less. The limit of the bound is not above the risk.",
    },
    "independent_rollouts": {
        "derived": "the {rollouts} rollouts have seeds of their own, and those of one start differ in nothing else; "
        "the bound needs no more of the noise than this and the clip.",
    },
    "one_law_per_start": {
        "refuted": "the bound is {ell} and its limit is at most {limit}, each at its own confidence; they contradict "
        "each other, so the rollouts of a start do not have one law.",
        "not refuted": "the bound is {ell} and its limit is at most {limit}, each at its own confidence; that they "
        "agree is not evidence.",
    },
    "clip": {
        "derived": "of {values} robustness values {at_low} are at the lower clip {low} and {at_high} at the upper clip "
        "{high}: every claim is about the clipped robustness, and it does not cover what lies beyond a clip.",
    },
    "finite_rollouts": {
        "derived": "all {rollouts} rollouts behind the bounds are finite, and none was dropped or drawn again because "
        "of its outcome: one that is never finite ends the campaign without a certificate.",
    },
    "independence": {
        "derived": "the probabilities of nominal_robustness and sim_gap are multiplied: each proposes and stops from "
        "its own observations alone, and its rollouts have seeds of their own.",
    },
    "accounting": {
        "derived": "the failure probabilities of nominal_robustness and sim_gap are added, which is right however the "
        "problems depend on each other.",
    },
    "fixed_beforehand": {
        "assumed": "norm bounds, noise scales, kernels, prior means, constants, replicates, budgets and the seed are "
        "assumed to be chosen without knowledge of rollouts with these seeds: a campaign that was changed after its "
        "results were seen needs a new seed.",
    },
    "workers_honest": {
        "assumed": "the trajectories that the workers send are assumed to come from the simulator; robustness and gaps "
        "are recomputed from them.",
    },
}
"""By form, then status."""


def assumption(
    name: str, status: Status, values: Mapping[str, float | int | str] | None = None, *, form: str | None = None
) -> Assumption:
    """Return an assumption with its sentence; `form` names it where one assumption has several."""
    rounded = {key: _rounded(value) for key, value in (values or {}).items()}
    words = {key: f"{value:.{SIGNIFICANT}g}" if isinstance(value, float) else value for key, value in rounded.items()}
    sentence = SENTENCES[form or name.partition("/")[0]][status]
    return Assumption(id=name, status=status, detail=sentence.format(**words), values=rounded)


def _rounded(value: float | int | str) -> float | int | str:
    # The last digits depend on the CPU, and a certificate must not.
    return float(f"{value:.{SIGNIFICANT}g}") if isinstance(value, float) else value
