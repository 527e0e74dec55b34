"""Who can judge an assumption that no data of a campaign prove, by the first part of its id; apart as a table."""

from collections.abc import Mapping

SIMULATOR = "an expert for the simulator"
VALIDATION = "who compares the simulator with the real system"
OPERATION = "an expert for the operation"
CONSTANTS = "an expert for the constants of the kernel"
PLAN = "who can see how the campaign was planned"
WORKERS = "who can inspect the machines of the workers"
TESTS = "who can see how tests and logs were made"
METHOD = "an expert for the method, which the theory derives"

BY_JUDGE: Mapping[str, tuple[str, ...]] = {
    SIMULATOR: (
        "borders",
        "common_times",
        "declared_laws",
        "defined_in_session",
        "deterministic",
        "deterministic_nominal",
        "early_ends",
        "finite_rollouts",
        "independent_rollouts",
        "one_law_per_start",
        "reproducible_rollouts",
        "sampled_at_sample_times",
        "truncated",
    ),
    VALIDATION: ("simulator_is_the_system",),
    OPERATION: ("declared_distribution",),
    CONSTANTS: ("kernel", "lattice", "lipschitz", "noise_scale", "replicate_spread", "rkhs_norm", "tail"),
    PLAN: (
        "clip",
        "common_draws",
        "design",
        "drawn_starts",
        "extended",
        "finite_space",
        "fixed_beforehand",
        "only_campaign",
    ),
    WORKERS: ("discarded", "scores_as_computed", "unrelated_crashes", "workers_honest"),
    TESTS: ("columns_of_logs", "driven_starts", "law_of_starts"),
    METHOD: (
        "accounting",
        "bounded_values",
        "bounds_agree",
        "centred_noise",
        "independence",
        "limit_agrees",
        "linearised",
        "regulariser",
        "sigma",
    ),
}
OF_FORMS = {"measured_system": OPERATION, "told_honestly": TESTS, "starts_of_logs": TESTS}
"""Where a form of an assumption says something else."""
_JUDGES = {name: judge for judge, names in BY_JUDGE.items() for name in names}


def judge_of(name: str, form: str | None = None) -> str:
    """Return who can judge an assumption, by its id and its form.

    >>> judge_of("rkhs_norm/robustness"), judge_of("extended_1/robustness")
    ('an expert for the constants of the kernel', 'who can see how the campaign was planned')
    """
    first = name.partition("/")[0]
    numbered, _, number = first.rpartition("_")
    found = _JUDGES.get(numbered if number.isdigit() else first)
    return OF_FORMS.get(form or "") or found or "an expert for the system"
