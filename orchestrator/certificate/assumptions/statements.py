"""The statement that holds where an assumption is right, by the first part of its id."""

STATEMENTS = {
    "accounting": "failure probabilities of the two problems are added",
    "bounded_values": "the clip bounds the value of every rollout",
    "borders": "a time stamp close to a border of a window belongs to the window",
    "bounds_agree": "the bounds from both sides do not contradict each other",
    "limit_agrees": "the bound does not contradict the limit of the expectation",
    "centred_noise": "an observation is right on average",
    "clip": "the claim is about the clipped robustness",
    "common_draws": "no result of a campaign with the same draws decided a key of this file",
    "declared_distribution": "in operation, starts are distributed as the file declares",
    "declared_laws": "what rollouts report of their disturbances has the declared laws",
    "defined_in_session": "the function uses nothing of its session that changes",
    "columns_of_logs": "the columns are what the mapping makes of the logs",
    "law_of_starts": "the starts of the logs have the declared distribution",
    "design": "all tests were planned before the first outcome",
    "common_times": "the gap shows at the times of the coarser simulator",
    "deterministic": "the simulator is deterministic",
    "deterministic_nominal": "the nominal simulator is deterministic",
    "discarded": "a discarded rollout was simulated again with the same seed",
    "drawn_starts": "starts were drawn at random, not chosen",
    "driven_starts": "a start within the tolerance counts as the one that was asked for",
    "early_ends": "a rollout may end before the horizon, and counts as declared",
    "extended": "the extension of the budget does not weaken the bound",
    "finite_rollouts": "no rollout was left out",
    "finite_space": "the claim is about the listed starts alone",
    "fixed_beforehand": "all settings were chosen before the results were known",
    "independence": "the two problems use rollouts of their own",
    "independent_rollouts": "rollouts are independent of each other",
    "kernel": "the objective is as smooth as the kernel says",
    "lattice": "the starts between the nodes are covered",
    "linearised": "the bound on the risk follows from one on an expectation",
    "lipschitz": "the robustness differs by no more than L times the gap",
    "noise_scale": "the noise of a rollout is no larger than R",
    "one_law_per_start": "the simulator does not change during the campaign",
    "only_campaign": "no other campaign asked the same question",
    "regulariser": "the theorem covers this regulariser",
    "replicate_spread": "repeated rollouts vary no more than R allows",
    "reproducible_rollouts": "a rollout follows from its seed",
    "rkhs_norm": "the norm bound B is large enough for this kernel and prior mean",
    "scores_as_computed": "the robustness of rollouts without samples is as it was computed",
    "sampled_at_sample_times": "nothing worse happens between two sample times",
    "sigma": "the theorem covers the width of this band",
    "simulator_is_the_system": "the real system behaves like the simulator",
    "truncated": "what follows the end of a rollout changes nothing",
    "tail": "large deviations are as rare as the noise model says",
    "unrelated_crashes": "crashes and lost attempts are unrelated to outcomes",
    "workers_honest": "worker processes send what they simulated",
}
OF_FORMS = {
    "measured_system": "operation is like the tests that were made",
    "told_honestly": "what was handed in is what the system did",
    "starts_of_logs": "every test that was made is there, and drawn by the law",
}
"""Where a form says something else than others of its assumption."""


def statement(name: str) -> str:
    """Return what an assumption says, as a clause; the id itself where it is one of another version.

    >>> statement("kernel/true_risk"), statement("extended_1/robustness")
    ('the objective is as smooth as the kernel says', 'the extension of the budget does not weaken the bound')
    """
    first = name.partition("/")[0]
    numbered, _, number = first.rpartition("_")
    return STATEMENTS.get(numbered if number.isdigit() else first, first)


def title(name: str, form: str | None = None) -> str:
    """Return the statement of an assumption, of this form, as a title.

    >>> title("kernel/robustness"), title("simulator_is_the_system", "measured_system")
    ('The objective is as smooth as the kernel says', 'Operation is like the tests that were made')
    """
    found = OF_FORMS.get(form or "") or statement(name)
    return found[:1].upper() + found[1:]
