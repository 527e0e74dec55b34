"""The sentence of every assumption: the presentation of its status and values, which `verify` does not compare.

A new assumption is a row of `SENTENCES` and a line in `audit.py`. The fields in braces are its values.
"""

from collections.abc import Mapping

from ....schemas import __version__
from ....schemas.file.objectives import OBJECTIVES
from ....schemas.result.certificate import Assumption, Certificate, SpotCheckedProblem, Status

EDITED = "(the certificate was edited: this assumption has no such form, status and values; verify it.)"
SIGNIFICANT = 6
"""Digits of a value: fewer than two types of CPU agree in."""

SENTENCES: dict[str, dict[Status, str]] = {
    "norm_from_tests": {
        "refuted": "largest |y - m0| = {largest} with B = {rkhs_norm} ({above} of {tests} tests above B) exceeds "
        "{threshold}, the most that B and the noise allow at confidence {confidence}: B, the noise scale or the prior "
        "mean is wrong, and the bound is not proven.",
        "not refuted": "largest |y - m0| = {largest} with B = {rkhs_norm} ({above} of {tests} tests above B) is within "
        "{threshold}, which B and the noise allow at confidence {confidence}. This is not evidence that B is large "
        "enough.",
    },
    "norm_from_set": {
        "refuted": "the observations need a norm of at least {b_min} at confidence {confidence}, more than "
        "B = {rkhs_norm}: B, R, the kernel, the prior mean or the independence is wrong.",
        "not refuted": "the observations need a norm of at least {b_min} at confidence {confidence}, which leaves a "
        "margin of {margin} below B = {rkhs_norm}. This is not evidence for B: a B that is far too small often passes.",
    },
    "norm_from_weights": {
        "refuted": "the rollouts need a norm of at least {b_min} at confidence {confidence}, more than "
        "B = {rkhs_norm}: B, the kernel, the prior mean or the independence is wrong.",
        "not refuted": "the rollouts need a norm of at least {b_min} at confidence {confidence}, which leaves a margin "
        "of {margin} below B = {rkhs_norm}. This is not evidence for B: a B that is far too small often passes.",
    },
    "within_ball": {
        "refuted": "the bound exceeds every value that B = {rkhs_norm} around the prior mean allows: B, the kernel, "
        "the prior mean or the independence is wrong.",
        "not refuted": "the bound is a value that B = {rkhs_norm} around the prior mean allows; that is not evidence.",
    },
    "bounded_values": {
        "derived": "the value of a rollout is between {low} and {high} by the clip; no noise scale is assumed.",
    },
    "certified_cells": {
        "derived": "each of {nodes} cells, which cover the box, has a bound for all of its starts; the least one is "
        "claimed, at the full confidence.",
    },
    "fixed_design": {
        "derived": "the {points} starts of the {tests} planned tests, their order and the weights of the rollouts "
        "follow from the campaign file; no start depends on an outcome.",
    },
    "mean_noise": {
        "assumed": "the observation of a test, from {replicates} rollout(s) per variant, is assumed to deviate from "
        "its expectation like sub-Gaussian noise of scale {noise_scale}, which follows from the campaign file.",
    },
    "noise_range": {
        "derived": "the noise scale per rollout is {noise_scale}, and the clip alone proves {hoeffding} (Hoeffding's "
        "lemma), so it needs no assumption.",
        "assumed": "the noise scale per rollout is {noise_scale}, a number from the campaign file and smaller than "
        "{hoeffding}, which the clip alone proves (Hoeffding's lemma).",
    },
    "tail": {
        "assumed": "the bound has probability {gaussian} if the noise is Gaussian, and {sub_gaussian} if it is only "
        "sub-Gaussian; the first is claimed, so the noise is assumed to be Gaussian.",
        "derived": "the bound has probability {gaussian} if the noise is Gaussian, and {sub_gaussian} if it is only "
        "sub-Gaussian; the second is claimed, so only the noise scale is assumed.",
    },
    "sigma_variance": {
        "assumed": "the posterior variance scales the band, as printed in the paper; the theorem that the paper cites "
        "needs the standard deviation, which is larger, so it does not cover this band.",
    },
    "sigma_std": {
        "assumed": "the posterior standard deviation scales the band, as in the theorem that the paper cites; whether "
        "that theorem applies depends on the regulariser.",
    },
    "regulariser_eta": {
        "assumed": "the kernel matrix gets 1 + 2/i on its diagonal at test i; the theorem that the paper cites is "
        "proven for one eta fixed beforehand, not for one that changes with i while the stop depends on the data.",
    },
    "regulariser_fixed": {
        "assumed": "the kernel matrix gets {regulariser} on its diagonal; the theorem that the paper cites needs "
        "1 + eta, the number inside the determinant of beta, so it does not cover this choice.",
    },
    "lattice_alone": {
        "assumed": "the {nodes} nodes of a lattice with {resolution} per axis represent the whole box; between nodes "
        "the objective may be worse by up to {rise} if B = {rkhs_norm} is right, and the bound does not contain this.",
    },
    "lattice_refined": {
        "assumed": "the {nodes} nodes of a lattice with {resolution} per axis, and a search in the cells around the "
        "best one, represent the whole box; between nodes the objective may be worse by up to {rise} if "
        "B = {rkhs_norm} is right, and the bound does not contain this.",
    },
    "certified_box": {
        "derived": "the largest upper value on the candidates is {candidates_upper}, and the cover of the box between "
        "them adds {slack}; the bound contains both.",
    },
    "finite_box": {
        "derived": "the claim covers {starts} listed starts, points of a Sobol sequence over the ranges of [space] "
        "and, where they are few, its corners, and no start between them; over these the optimum is exact.",
    },
    "finite_space": {
        "derived": "the claim covers the {starts} listed starts and no others; over these the optimum is exact.",
    },
    "centred_noise": {
        "refuted": "each observation is mean - r * sample standard deviation of {replicates} rollouts, which is too "
        "high on average, because the sample standard deviation is too small (by {percent} % if the robustness is "
        "Gaussian): the error is on the unsafe side.",
    },
    "bounds_agree": {
        "refuted": "the smallest upper bound on J is {upper} and the largest lower bound {lower}: they contradict each "
        "other, so at least one assumption behind them is wrong.",
        "not refuted": "the smallest upper bound on J is {upper} and the largest lower bound {lower}; that they do not "
        "contradict each other is not evidence for either.",
    },
    "kernel_ball": {
        "assumed": "the objective minus the prior mean is in the ball of radius {rkhs_norm} of the Matern kernel with "
        "nu = {nu} and length scale {length_scale}: a choice in the campaign file that no data can prove.",
    },
    "kernel_near": {
        "assumed": "the objective minus the prior mean is everywhere within {tau} of a function in the ball of radius "
        "{rkhs_norm} of the Matern kernel with nu = {nu} and length scale {length_scale}: a choice in the campaign "
        "file that no data can prove.",
    },
    "replicate_spread": {
        "refuted": "the replicates of {tests} tests have a pooled standard deviation of {sd} per rollout, more than "
        "noise of scale {noise_scale} allows at confidence {confidence}.",
        "assumed": "the replicates of {tests} tests have a pooled standard deviation of {sd} per rollout, above the "
        "noise scale {noise_scale}: a hint, and no proof, that R is too small.",
        "not refuted": "the replicates of {tests} tests have a pooled standard deviation of {sd} per rollout, not "
        "above the noise scale {noise_scale}, which is not evidence for R.",
    },
    "no_replicates": {
        "assumed": "no test has two replicates, so no data were compared with the noise scale.",
    },
    "deterministic": {
        "refuted": "at {differing} of {repeated} repeated starts the values differ, although R = 0 means that the "
        "variant is deterministic: give R > 0.",
        "not refuted": "the values at all {repeated} repeated starts agree bit by bit, as R = 0 requires.",
        "assumed": "R = 0 comes from the campaign file, and no start was simulated with another seed to test it.",
    },
    "deterministic_nominal": {
        "refuted": "the replicates of a test share one nominal rollout, because the system declares that variant "
        "deterministic, but in nominal_robustness the values at {differing} of {repeated} repeated starts differ.",
        "not refuted": "the replicates of a test share one nominal rollout, because the system declares that variant "
        "deterministic; in nominal_robustness the values at all {repeated} repeated starts agree bit by bit.",
        "assumed": "the replicates of a test share one nominal rollout, because the system declares that variant "
        "deterministic; no rollout was repeated to test it.",
    },
    "common_times": {
        "assumed": "the gap of two simulators with unlike time grids is that at the times of the coarser one; what the "
        "finer one does between those is assumed to make it no larger.",
    },
    "lipschitz_column": {
        "refuted": "for some pair of rollouts the robustness differs by {excess} more than L times the gap: L or the "
        "column is wrong, and the composition does not follow.",
        "assumed": "the robustness is assumed to change by at most L = {lipschitz} times the largest difference in "
        "{column}; all pairs of its rollouts obey this, which is not evidence for other pairs.",
    },
    "lipschitz_predicates": {
        "refuted": "for some pair of rollouts the robustness differs by {excess} more than the gap: the composition "
        "does not follow.",
        "derived": "the gap bounds the difference of every min/max robustness, so L = 1 needs no assumption; all "
        "simulated pairs of rollouts obey this.",
    },
    "lipschitz_itself": {
        "refuted": "for some pair of rollouts the robustness differs by {excess} more than the gap: the composition "
        "does not follow.",
        "derived": "the gap is the difference of the robustness itself, so L = 1 needs no assumption; all simulated "
        "pairs of rollouts obey this.",
    },
    "linearised": {
        "derived": "an expectation with the constants {centre} and {spread}, fixed beforehand, bounds the risk: every "
        "choice of them is valid, and a good one loses less. The limit of the bound is not above the risk.",
    },
    "linearised_past": {
        "derived": "an expectation whose constants follow from the earlier rollouts of each start bounds the risk: "
        "whatever those were, it is not above the risk. The opposite bound is one of the least mean.",
    },
    "independent_rollouts": {
        "refuted": "{copies} of {compared} pairs of rollouts with equal values are copies of each other, bit by bit, "
        "although their seeds differ: the simulator draws its noise from something else or from too few seeds, or "
        "some starts have none, so {rollouts} rollouts are fewer independent ones.",
        "assumed": "the {rollouts} noisy rollouts have different seeds, and no two of one start are copies of each "
        "other; that the simulator draws its noise from the seed alone is assumed.",
    },
    "copied_tests": {
        "refuted": "rollouts of one test agree with each other bit by bit, more than with those of other tests at its "
        "start (evidence {evidence} against {threshold}, a false alarm of probability {level}): replicates are copies "
        "of each other although their seeds differ, or their law changes from test to test, so {rollouts} rollouts are "
        "fewer independent ones.",
    },
    "repeated_results": {
        "assumed": "{copies} of {compared} pairs of rollouts with equal values agree bit by bit although their seeds "
        "differ, not more within tests than between those of one start (evidence for copies {evidence}, {threshold} "
        "would refute): so do results that repeat, such as a saturated margin; that the simulator draws its noise from "
        "the seed alone is assumed.",
    },
    "single_rollouts": {
        "assumed": "{copies} of {compared} pairs of rollouts with equal values agree bit by bit although their seeds "
        "differ: results that repeat, such as a saturated margin, or copies, which tests of one rollout each cannot "
        "tell apart; that the simulator draws its noise from the seed alone is assumed.",
    },
    "all_alike": {
        "assumed": "no two rollouts of a test differ although the variant is declared noisy: its noise did not show, "
        "or replicates are copies of each other, which tests of different starts cannot tell apart (evidence for "
        "copies {evidence}, {threshold} would refute); that the simulator draws its noise from the seed alone is "
        "assumed.",
    },
    "one_law_per_start": {
        "refuted": "later rollouts of a start rank above or below its earlier ones (evidence {e_value} against "
        "{threshold}, a false alarm of probability {level}): the simulator drifts, so its rollouts have no single law.",
        "not refuted": "later rollouts of a start do not rank above or below its earlier ones (evidence {e_value} "
        "against {threshold}, {values} values at {starts} starts); a slow drift can pass.",
        "assumed": "no start was tested twice, so nothing shows whether the simulator drifts during the campaign.",
    },
    "one_law": {
        "refuted": "later rollouts rank above or below earlier ones (evidence {e_value} against {threshold}, a false "
        "alarm of probability {level}): the simulator drifts, so its rollouts have no single law.",
        "not refuted": "later rollouts do not rank above or below earlier ones (evidence {e_value} against "
        "{threshold}, {values} values); a slow drift can pass.",
        "assumed": "fewer than two starts were drawn, so nothing shows whether the simulator drifts.",
    },
    "declared_laws": {
        "refuted": "the values of {kind} that rollouts report do not have its declared law, {law} (evidence {e_value} "
        "against {threshold}, a false alarm of probability {level}): what the control takes out need not have the "
        "mean 0.",
        "not refuted": "the values that {values} rollouts report do not contradict their declared laws, {reported} "
        "(evidence {e_value} against {threshold}). A scale that is wrong by {unseen} % passes in about half of such "
        "campaigns, and can make the bound false.",
        "assumed": "no rollout has reported a value of {reported}.",
    },
    "impossible_values": {
        "refuted": "rollouts report values of {kind} that its declared law, {law}, does not have ({impossible} of "
        "{values}): what the control takes out need not have the mean 0.",
    },
    "declared_distribution": {
        "assumed": "the claims are about starts that are distributed as [space] declares; that operation meets such "
        "starts, with such frequencies, is assumed.",
    },
    "starts_of_logs": {
        "assumed": "the {samples} starts are those of the logs: that they were drawn independently of each other from "
        "the distribution under [space], and that every test that was made is among them, whatever its outcome, is "
        "assumed.",
    },
    "law_of_starts": {
        "refuted": "the starts of the logs do not have the distribution under [space]: {kind} is not {law} (evidence "
        "{e_value} against {threshold}, a false alarm of probability {level}).",
        "not refuted": "the starts of the logs do not contradict the distribution under [space], each parameter by "
        "itself (evidence {e_value} against {threshold}). A scale that is wrong by {unseen} % passes in about half of "
        "such campaigns.",
        "assumed": "the starts of the logs were not compared with the distribution under [space]: its parameters "
        "have no laws of their own.",
    },
    "columns_of_logs": {
        "assumed": "the columns are those of the logs, in the units of the system and with a time that begins at "
        "the start, as the mapping of the file says; that it says so rightly is assumed.",
    },
    "resampled_logs": {
        "assumed": "the columns are those of the logs as the mapping of the file says, at every {resample} s of the "
        "rollout: a value between is {between}. What a log does not show between two samples is not judged.",
    },
    "driven_starts": {
        "assumed": "a rollout from a start that was driven near the one that was asked for ({tolerance}) counts as one "
        "from there; the columns driven_NAME have what was driven.",
    },
    "driven_and_counted": {
        "derived": "a rollout was driven from a start near the one that was asked for ({tolerance}); by how much the "
        "objective can differ between the two is part of the misspecification that the bound counts.",
    },
    "drawn_fixed": {
        "derived": "the {samples} starts follow from the seed and their numbers alone, and their number was fixed "
        "beforehand: none was proposed, dropped or repeated because of an outcome. {at_zero} values are exactly 0, "
        "which shows neither that the specification is met nor that it is violated, and count as violations.",
    },
    "drawn_at_every_moment": {
        "derived": "the {samples} starts follow from the seed and their numbers alone; the last one depends on the "
        "outcomes, and the bounds are valid after every sample. {at_zero} values are exactly 0, which shows neither "
        "that the specification is met nor that it is violated, and count as violations.",
    },
    "drawn_beside_a_search": {
        "derived": "the {samples} starts follow from the seed and their numbers alone: of every {random_every} tests "
        "one is such a start, and those that the search chose by earlier outcomes enter no claim; the last test "
        "depends on the outcomes, and the bounds are valid after every sample. {at_zero} values are exactly 0, which "
        "shows neither that the specification is met nor that it is violated, and count as violations.",
    },
    "common_draws": {
        "assumed": "starts and seeds follow from `draws` and not from the whole file, so that other campaigns have the "
        "same ones; that no result of such a campaign decided a key of this file is assumed.",
    },
    "limit_agrees": {
        "refuted": "the bound is {ell} and its limit is at most {limit}, each at its own confidence: they contradict "
        "each other, so the rollouts of one start do not have one law.",
        "not refuted": "the bound is {ell} and its limit is at most {limit}, each at its own confidence; that they do "
        "not contradict each other is not evidence.",
    },
    "clip": {
        "derived": "{at_low} of {values} robustness values are at the lower clip {low}, {at_high} at the upper clip "
        "{high}; every claim is about the clipped robustness, so it does not distinguish values beyond a clip.",
    },
    "norm_start": {
        "refuted": "at the start ({start}) of the spot check the value is beyond the bound {limit}: the norm bound, "
        "the kernel or the prior mean is wrong, and the bound is false there.",
    },
    "norm_risk_start": {
        "refuted": "at the start ({start}) of the spot check the function whose mean bounds the risk is beyond the "
        "bound {limit}: the norm bound, the kernel or the prior mean is wrong. The claim has lost its grounds, and the "
        "risk itself may keep the bound there.",
    },
    "norm_regions": {
        "refuted": "at {starts} of the fresh starts of the spot check the value has another sign than the certified "
        "box around it: the norm bound, the kernel or the prior mean is wrong.",
    },
    "norm_noisy_start": {
        "refuted": "the rollouts of the spot check contradict that the expectation keeps the bound {limit} at every "
        "start (most clearly at {start}): the norm bound, the kernel, the prior mean or the noise scale is wrong.",
    },
    "borders": {
        "assumed": "in {number} of {rollouts} rollouts, those of the closing checks included (the first is {first}), "
        "a time stamp is so close to a border of a window, within a hundredth of a step or the resolution of float32, "
        "that the two count as the same instant, and on that could depend whether the rollout violates the "
        "specification.",
    },
    "early_ends_hold": {
        "assumed": "{number} of {rollouts} rollouts end before the horizon, the first of them {first}; as the system "
        "declares, their last state is held to the horizon, where nothing else is assumed to happen.",
    },
    "early_ends_hold_none": {
        "assumed": "none of {rollouts} rollouts ended before the horizon; as the system declares, the last state of "
        "one that does is held to the horizon, where nothing else is assumed to happen.",
    },
    "early_ends_fail": {
        "derived": "{number} of {rollouts} rollouts end before the horizon, the first of them {first}; as the system "
        "declares, each of them violates the specification: its robustness is at most minus the share of the horizon "
        "that is missing, a number without unit.",
    },
    "early_ends_fail_none": {
        "derived": "none of {rollouts} rollouts ended before the horizon; as the system declares, one that does "
        "violates the specification: its robustness is at most minus the share of the horizon that is missing.",
    },
    "truncated": {
        "assumed": "windows of the specification are truncated: one that reaches beyond the end of a rollout has the "
        "samples that there are, and over none of them `always` is true and `eventually` false; what follows the end "
        "is assumed to change nothing.",
    },
    "finite_rollouts": {
        "derived": "all {rollouts} rollouts behind the bounds are finite: a rollout that never becomes finite ends the "
        "campaign without a certificate.",
    },
    "independence": {
        "derived": "the probabilities of nominal_robustness and sim_gap are multiplied: each problem proposes and "
        "stops from its own observations alone, and its rollouts have their own seeds.",
    },
    "accounting": {
        "derived": "the failure probabilities of nominal_robustness and sim_gap are added, which is valid whatever the "
        "dependence between the problems.",
    },
    "reproducible_rollouts": {
        "refuted": "{rechecked} recorded rollouts were simulated once more with their seeds, and only {agreed} gave "
        "the same trajectory: a rollout does not follow from its seed, and no one can repeat the evidence.",
        "not refuted": "{rechecked} recorded rollouts, drawn after all others were fixed, were simulated once more "
        "with their seeds, and all of them gave the same trajectory; up to {percent} % of all rollouts could differ "
        "unseen (confidence 0.95). What a simulator draws once, when its process starts, is seen only where another "
        "process repeats the rollout.",
        "assumed": "no rollout was simulated once more, so nothing shows whether a rollout follows from its seed.",
    },
    "reproducible_batches": {
        "refuted": "{rechecked} recorded rollouts were simulated once more, each in its whole batch, and only {agreed} "
        "gave the same trajectory: a batch does not follow from its seeds, and no one can repeat the evidence.",
        "not refuted": "the batch is what the system repeats, and no rollout alone: {rechecked} recorded rollouts, "
        "drawn after all others were fixed, were simulated once more, each in its whole batch, and all of them gave "
        "the same trajectory; up to {percent} % of all rollouts could differ unseen (confidence 0.95). What a "
        "simulator draws once, when its process starts, is seen only where another process repeats the batch.",
        "assumed": "the batch is what the system repeats, and no rollout alone; none was simulated once more, so "
        "nothing shows whether a batch follows from its seeds.",
    },
    "discarded": {
        "derived": 'rollout {rollout} was recorded and then discarded (reason given: "{reason}"), because the '
        "objective of its test cannot be computed from it; it was simulated again with the same seed, and its file "
        "(sha256 {sha256}) is kept.",
    },
    "failures_vary": {
        "refuted": "attempts at rollouts that failed or gave another trajectory, while a repetition with the same "
        "seed did not: {failed}. Rollouts depend on more than the seed, so the recorded ones may be selected by their "
        "outcome.",
    },
    "measured": {
        "assumed": "the rollouts were handed in, and no simulator repeats one with its seed: nothing shows that none "
        "was chosen among several trials.",
    },
    "defined_in_session": {
        "assumed": "the function was defined in an interactive session; no other process could import it, and no "
        "one else can repeat a rollout. What it uses from the session beside its own text is not recorded.",
    },
    "measured_system": {
        "assumed": "every claim is about the system that was measured, as it was during the campaign; that it stays "
        "so, and that a trial is like its operation, is assumed.",
    },
    "told_honestly": {
        "assumed": "the trajectories that were handed in are assumed to be those of the system at the requested "
        "starts; robustness and gaps are computed from them.",
    },
    "unrelated_crashes": {
        "assumed": "attempts that ended without a trajectory because their process crashed, hung, missed its deadline "
        "or was lost are repeated with the same seed and not counted; that this has nothing to do with the outcome "
        "of the rollout is assumed.",
    },
    "unrelated_losses": {
        "assumed": "a trial that was lost, or measured again, is not counted; that this has nothing to do with its "
        "outcome is assumed.",
    },
    "only_campaign": {
        "assumed": "this is assumed to be the only campaign for its question; whoever picks the best of several "
        "certificates adds up all their failure probabilities.",
    },
    "sampled_at_sample_times": {
        "assumed": "the specification is evaluated at the sample times of a trajectory; between two samples, and "
        "after the last one up to the horizon, it is assumed to be as good.",
    },
    "simulator_is_the_system": {
        "assumed": "every claim is about the simulator; that the real system has the same trajectories is assumed.",
    },
    "fixed_beforehand": {
        "assumed": "specification, clip, risk weight, starts, alpha, delta, composition, window, norm bounds, noise "
        "scales, kernels, prior means, constants, replicates, budgets, software and the seed are assumed to be chosen "
        "without knowledge of rollouts with these seeds.",
    },
    "fixed_beforehand_extended": {
        "assumed": "specification, clip, risk weight, starts, alpha, delta, composition, window, norm bounds, noise "
        "scales, kernels, prior means, constants, replicates, first budgets, software and the seed are assumed to be "
        "chosen without knowledge of rollouts with these seeds; the extensions that are listed were chosen with it.",
    },
    "extended": {
        "derived": "after test {after} {problem} had spent its budget of {after} tests, and whoever knew its rollouts "
        "extended it to {max_tests}: its bound holds after every test at once, so no choice of the last one can miss "
        "it. The closing checks are new ones; what earlier ones found is in the evidence, and no claim uses it.",
    },
    "second_opinion": {
        "not refuted": "{chosen} % of the rollouts, drawn from the seed, were simulated twice, by two workers where "
        "there were two: {compared} were compared and {agreed} agree bit by bit; up to {percent} % of all rollouts "
        "could be false unseen (confidence 0.95), if no two results of a rollout are false alike, be they of two "
        "workers or of one that was alone, and no worker knows which rollouts are compared.",
        "assumed": "{chosen} % of the rollouts should have been simulated twice, but the draw chose {compared}: the "
        "trajectories that the workers send are assumed to come from the simulator.",
    },
    "second_opinion_in_batches": {
        "not refuted": "{chosen} % of the batches, and of the rollouts in none, drawn from the seed, were simulated "
        "twice, by two workers where there were two: {compared} were compared and {agreed} agree bit by bit; up to "
        "{percent} % of all rollouts could be false unseen (confidence 0.95), if no two results are false alike, be "
        "they of two workers or of one that was alone, and no worker knows which are compared.",
        "assumed": "{chosen} % of the batches should have been simulated twice, but the draw chose {compared}: the "
        "trajectories that the workers send are assumed to come from the simulator.",
    },
    "outvoted": {
        "refuted": "a worker was outvoted by two others, and {count} of the rollouts that it had recorded had another "
        "trajectory when they were simulated again: {rollouts}.",
    },
    "outvoted_in_batches": {
        "refuted": "a worker was outvoted by two others, and {count} of the batches, and of the rollouts in none, that "
        "it had recorded had another trajectory when they were simulated again: {rollouts}.",
    },
    "scores_as_computed": {
        "assumed": '{kept} rollouts have their samples in the evidence (keep = "{keep}"), and their robustness is '
        "recomputed from them; of the {reduced} others start, seed, digest and robustness are left. That their "
        "robustness is the one that was computed when they came is assumed: `perfbound verify --resimulate` simulates "
        "a sample of them again.",
    },
    "honest_scores": {
        "assumed": "the trajectories that the workers send are assumed to come from the simulator; robustness is "
        "recomputed from those whose samples were kept.",
    },
    "workers_honest": {
        "assumed": "the trajectories that the workers send are assumed to come from the simulator; robustness and gaps "
        "are recomputed from them.",
    },
}
"""By form, then status."""


def form_at_start(found: SpotCheckedProblem) -> str:
    """Return the form of an assumption on a norm that a start of the spot check refutes."""
    if found.noisy:
        return "norm_noisy_start"
    # A value of the function that bounds the risk says nothing of the risk itself.
    return "norm_risk_start" if OBJECTIVES[found.name].risk else "norm_start"


def assumption(
    name: str, status: Status, values: Mapping[str, float | int | str] | None = None, *, form: str | None = None
) -> Assumption:
    """Return an assumption with its sentence; `form` is the row of `SENTENCES` where it is not the id's first part."""
    rounded = {key: _rounded(value) for key, value in (values or {}).items()}
    detail = _sentence(form or name.partition("/")[0], status, rounded)
    return Assumption(id=name, status=status, detail=detail, form=form, values=rounded)


def is_in_its_words(found: Assumption) -> bool:
    """Whether the sentence of an assumption is that of its form, its status and its values, byte for byte."""
    return found.detail == _own_sentence(found)


def is_worded_here(software: Mapping[str, str]) -> bool:
    """Whether a certificate is of this version, which has one sentence for a form and its values."""
    return software.get("perfbound") == __version__


def in_own_words(found: Certificate) -> Certificate:
    """Return a certificate with the sentences of the forms and values in it, if it is one of this version.

    Its file is anyone's, and may have been edited; `verify` says so.
    """
    predicate = found.predicate
    if not is_worded_here(predicate.software):
        return found
    own = tuple(each.model_copy(update={"detail": _own_sentence(each) or EDITED}) for each in predicate.assumptions)
    return found.model_copy(update={"predicate": predicate.model_copy(update={"assumptions": own})})


def _own_sentence(found: Assumption) -> str | None:
    """Return the sentence of the form, status and values of an assumption; None if they are none of perfbound's."""
    try:
        return _sentence(found.form or found.id.partition("/")[0], found.status, found.values)
    except (LookupError, ValueError, TypeError):
        return None


def _sentence(form: str, status: Status, values: Mapping[str, float | int | str]) -> str:
    return SENTENCES[form][status].format(**{key: value_text(value) for key, value in values.items()})


def value_text(value: object) -> str:
    """Return the text of a value in the sentence of an assumption.

    >>> value_text(100_000), value_text(0.0123456789), value_text("a.0.nominal.0")
    ('100,000', '0.0123457', 'a.0.nominal.0')
    """
    if isinstance(value, float):
        return f"{value:.{SIGNIFICANT}g}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _rounded(value: float | int | str) -> float | int | str:
    # The last digits depend on the CPU, and a certificate must not.
    return float(f"{value:.{SIGNIFICANT}g}") if isinstance(value, float) else value
