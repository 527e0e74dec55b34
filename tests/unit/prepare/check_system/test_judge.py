"""The findings of `check-system`, from measurements that are made here."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.prepare.check_system.costs import GROWTH_MARGIN
from perfbound.orchestrator.prepare.check_system.findings import OF_PROGRAM, SYSTEM_CHECKS, SystemFinding
from perfbound.orchestrator.prepare.check_system.judge import judge
from perfbound.orchestrator.prepare.check_system.measurements import Measurements
from perfbound.orchestrator.prepare.check_system.trials import (
    CORNERS,
    GROWTH,
    MANY_SEEDS,
    SEED,
    START,
    Trials,
    corners,
    own_horizon,
)
from perfbound.schemas.errors import SimulationError
from perfbound.schemas.file.disturbance import Normal
from perfbound.schemas.file.parameters import Range
from perfbound.schemas.file.space import Scenarios
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.system_check import Acts, ChildRun, Measured, SampleTimes, Trial
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.workers.systems.function import as_trajectory
from tests.facts import says

SPEC = SystemSpec(
    name="cart",
    doc="",
    parameters=(Parameter(name="x", unit="m", low=0.0, high=1.0), Parameter(name="v", unit="m/s", low=-1.0, high=1.0)),
    columns=(Column(name="t", unit="s"), Column(name="y", unit="m")),
    max_horizon=100.0,
)
TRIALS = Trials.of(SPEC, {}, variants=("nominal", "true"), horizon=10.0, seed=3)
MB = 2**20

Rule = Callable[[int, int, Trial], dict[str, Any]]
"""What differs from a sound rollout: a function of the process, the place in it and the trial."""


def sound(trial: Trial) -> Measured:
    request = trial.request
    seed = request.seed if request.variant in SPEC.noisy else 0
    samples = f"{request.variant} {request.x} {seed} {request.horizon}"
    grid = SampleTimes(samples=101, first=0.0, last=request.horizon, least_step=0.1, greatest_step=0.1)
    return Measured(
        file_sha256=f"{samples} {request.seed} {request.problem}",
        samples_sha256=samples,
        beginning_sha256=f"{request.variant} {request.x} {seed}",
        file_bytes=4000,
        grid=grid,
        seconds=0.01,
        memory=100 * MB,
        peak=110 * MB,
        tasks=1,
    )


def evidence(rule: Rule = lambda process, place, trial: {}) -> Measurements:
    plans = TRIALS.fresh(), TRIALS.first(0.01), TRIALS.second(), *TRIALS.together(0.01)
    runs = tuple(run(process, plan, rule) for process, plan in enumerate(plans))
    return Measurements(SPEC, runs[:3], 60.0, 4, together=runs[3:])


def run(process: int, trials: Sequence[Trial], rule: Rule) -> ChildRun:
    measured = tuple(sound(each).model_copy(update=rule(process, k, each)) for k, each in enumerate(trials))
    return ChildRun(trials=tuple(trials), loaded=Measured(), measured=measured)


def findings(rule: Rule = lambda process, place, trial: {}) -> dict[str, SystemFinding]:
    return {each.check: each for each in judge(evidence(rule))}


def others(found: dict[str, SystemFinding]) -> dict[str, str]:
    return {name: each.status for name, each in found.items() if each.status != "passed"}


def test_a_sound_system_passes_every_check() -> None:
    found = findings()
    without = {"disturbances", "reported", "actions"}
    assert list(found) == [name for name in SYSTEM_CHECKS if name not in without], "it declares none, and has no policy"
    assert others(found) == {}
    assert not any(each.remedy for each in found.values())
    assert says(found["speed"].detail, "^10 ms rollout 4 kB file 100 rollouts/s 1 worker")
    assert "at most 400 from 4" in found["speed"].detail
    assert "batch = 16" in found["speed"].detail


def changed(samples: str) -> dict[str, Any]:
    return {"file_sha256": samples, "samples_sha256": samples}


@pytest.mark.parametrize(
    ("uses", "residual", "statuses", "remedies"),
    [
        ("both", False, ("passed", "passed"), ("", "")),
        ("gust", False, ("passed", "warning"), ("", "argument of this name")),
        ("", False, ("failed", "warning"), ("values declared disturbances", "argument of this name")),
        ("both seed", False, ("passed", "failed"), ("", "declare the seed as a disturbance")),
        ("both seed", True, ("passed", "passed"), ("", "")),
        ("both", True, ("passed", "warning"), ("", "declare residual=False")),
    ],
)
def test_what_is_random_is_what_is_declared(
    uses: str, residual: bool, statuses: tuple[str, str], remedies: tuple[str, str]
) -> None:
    laws = (Normal(0, 1).named("gust", ""), Normal(0, 1).named("load", ""))
    spec = SPEC.model_copy(update={"disturbances": laws, "residual": residual})
    trials = Trials.of(spec, {}, variants=("true",), horizon=10.0, seed=3)

    def rule(_process: int, _place: int, trial: Trial) -> dict[str, Any]:
        gust, load = trial.request.disturbances
        drawn = {"both": (gust, load), "gust": (gust,)}.get(uses.removesuffix(" seed"), ())
        return changed(f"{trial.request.x} {drawn} {trial.request.seed if 'seed' in uses else ''}")

    runs = tuple(run(process, plan, rule) for process, plan in enumerate((trials.fresh(), trials.first(0.01))))
    found = {each.check: each for each in judge(Measurements(spec, runs, 60.0, 4))}
    for check, status, remedy in zip(("seed", "disturbances"), statuses, remedies, strict=True):
        assert found[check].status == status, check
        assert says(found[check].remedy, remedy) if remedy else not found[check].remedy


# The rollouts


def test_both_processes_begin_with_the_fresh_rollouts_and_the_second_runs_all_in_the_opposite_order() -> None:
    fresh, first, second = TRIALS.fresh(), TRIALS.first(0.01), TRIALS.second()
    assert first[: len(fresh)] == first[len(fresh) : 2 * len(fresh)] == fresh
    compared = [
        each.request.model_dump_json()
        for each in first
        if each.reseed is None and each.request.horizon == 10 and each.request.problem not in {GROWTH, SEED}
    ]
    assert [each.request.model_dump_json() for each in reversed(second)] == list(dict.fromkeys(compared))


def test_a_slow_system_gets_no_rollouts_for_the_growth_of_memory() -> None:
    kinds = [each.request.problem for each in TRIALS.first(60.0)]
    assert GROWTH not in kinds
    assert SEED not in kinds
    assert len(TRIALS.first(0.0)) == len(kinds) + 300 + MANY_SEEDS


def test_seeds_are_those_of_campaigns_and_follow_from_the_seed_of_the_check() -> None:
    seeds = {each.request.seed for each in TRIALS.first(0.1)}
    assert max(seeds) > 2**32
    assert seeds == {each.request.seed for each in TRIALS.first(0.1)}
    assert seeds.isdisjoint(each.request.seed for each in replace(TRIALS, seed=4).first(0.1))


@pytest.mark.parametrize(("parameters", "count"), [(1, 2), (4, 16), (9, CORNERS)])
def test_corners(parameters: int, count: int) -> None:
    box = [Parameter(name=f"p{k}", low=-1.0, high=k + 1.0) for k in range(parameters)]
    found = corners(box, 0)
    assert len(found) == count
    assert {tuple(each.low for each in box), tuple(each.high for each in box)} <= set(found)
    assert all(value in (-1.0, k + 1.0) for point in found for k, value in enumerate(point))


def test_the_starts_are_in_the_box_of_the_campaign() -> None:
    space = {"v": Range(low=-0.5, high=0.0), "x": Range(low=0.2, high=0.3)}
    trials = Trials.of(SPEC, {}, variants=("true",), horizon=1.0, seed=0, space=space)
    starts = {each.request.x for each in trials.first(0.1)}
    assert {(0.2, -0.5), (0.2, 0.0), (0.3, -0.5), (0.3, 0.0)} < starts
    assert all(0.2 <= x <= 0.3 and -0.5 <= v <= 0.0 for x, v in starts)
    listed = Trials.of(SPEC, {}, variants=("true",), horizon=1.0, seed=0, space=Scenarios(scenarios=((0.2, 0.0),)))
    assert listed.box == SPEC.parameters


def test_a_system_without_horizon_is_checked_with_its_own() -> None:
    fresh = TRIALS.fresh()

    def lasting(last: float) -> ChildRun:
        grid = SampleTimes(samples=3, first=0.0, last=last, least_step=1.0, greatest_step=1.0)
        return ChildRun(trials=fresh, loaded=Measured(), measured=(Measured(grid=grid),))

    assert [own_horizon(SPEC, lasting(last)) for last in (0.0, 3.0, 9.9, 10.0, 20.0, 200.0)] == [
        0.0,
        3.0,
        None,
        None,
        20.0,
        None,
    ]
    assert own_horizon(SPEC.model_copy(update={"timed": True}), lasting(3.0)) is None
    assert own_horizon(SPEC, ChildRun(trials=fresh, loaded=None, measured=())) is None
    assert SPEC.model_copy(update={"max_horizon": 2.0}).assumed_horizon == 2.0
    assert {each.request.horizon for each in TRIALS.of_own_horizon(3.0).first(1.0)} == {3.0}


# Errors


@pytest.mark.parametrize(
    ("make", "check"),
    [
        (lambda: Trajectory(("t", "y"), np.array([[0, np.nan]])), "finite"),
        (lambda: Trajectory(("t", "y"), np.array([[0, 1], [0, 2], [0, 3]])), "times"),
        (lambda: Trajectory(("t", "y"), np.array([[0, 1], [2, 1], [1, 1]])), "times"),
        (lambda: Trajectory(("t", "y"), np.array([[-1, 1]])), "times"),
        (lambda: Trajectory(("t", "y"), np.zeros((2, 3))), "columns"),
        (lambda: Trajectory(("y", "t"), np.zeros((1, 2))), "columns"),
        (lambda: as_trajectory([1, np.inf], ("t", "a", "b"), 0.1), "finite"),
        (lambda: as_trajectory([np.ones(2)], ("t", "a"), None), "times"),
        (lambda: as_trajectory([np.ones(2), np.ones(3)], ("t", "a", "b"), 0.1), "columns"),
        (lambda: as_trajectory({"c": np.ones(2)}, ("t", "a"), 0.1), "columns"),
        (lambda: as_trajectory(np.ones((2, 3)), ("t", "a"), 0.1), "columns"),
        (lambda: as_trajectory("no", ("t", "a"), 0.1), "columns"),
        (lambda: as_trajectory(None, ("t", "a"), 0.1), "columns"),
        (lambda: as_trajectory(np.ones((0,)), ("t", "a"), 0.1), "columns"),
    ],
)
def test_what_perfbound_refuses_is_a_finding_of_the_check_that_it_is_about(
    make: Callable[[], object], check: str
) -> None:
    with pytest.raises((SimulationError, ValueError)) as caught:
        make()
    broken = {"error": str(caught.value), "grid": None}
    found = findings(lambda process, place, trial: broken if trial.request.x == (1.0, -1.0) else {})
    assert others(found) == {check: "failed"}
    assert says(found[check].detail, "x = 1 v = -1 variant nominal seed")
    assert found[check].remedy


def test_an_exception_of_the_system_is_one_whatever_its_words() -> None:
    broken = {
        "error": "ValueError: not finite, a column\nand more",
        "raised": True,
        "place": "a.py, line 3",
        "grid": None,
    }
    found = findings(lambda process, place, trial: broken)
    assert says(found["errors"].detail, "^a.py 3: ValueError: not finite x =")
    assert {found[name].status for name in ("columns", "finite", "times", "seed", "horizon", "speed")} == {"skipped"}


@pytest.mark.parametrize(
    ("changes", "status", "words"),
    [
        ({"uncovered": "the first row is at t = 0.1 s"}, "failed", "the first row is at t = 0.1 s; at x = "),
        ({"stamps": "float32"}, "warning", "the times are rounded to float32"),
        ({"stamps": "float32"}, "warning", "the system says that they are exact"),
        ({"stamps": "accumulated"}, "warning", "times sums step round-off"),
        ({"last": 9.9}, "passed", "101 samples from 0 to 9.9 s"),
        ({"greatest_step": 0.2}, "warning", "0.1 0.2 s"),
        ({"greatest_step": 0.1 * (1 + 1e-9)}, "passed", "in steps of 0.1 s"),
    ],
)
def test_the_times_follow_the_rule_of_admission(changes: dict[str, Any], status: str, words: str) -> None:
    found = findings(
        lambda process, place, trial: (
            {"grid": sound(trial).grid.model_copy(update=changes)}  # type: ignore[union-attr]
            if trial.request.horizon == 10
            else {}
        )
    )
    assert (found["times"].status, others(found).keys() <= {"times"}) == (status, True)
    assert says(found["times"].detail, words)


def test_different_times_at_different_starts_are_a_warning() -> None:
    other = SampleTimes(samples=51, first=0.0, last=10.0, least_step=0.2, greatest_step=0.2)
    found = findings(lambda process, place, trial: {"grid": other} if trial.request.problem == GROWTH else {})
    assert says(found["times"].detail, "51 samples 0.2 s 101 samples 0.1 s")
    assert others(found) == {"times": "warning"}


def test_nothing_rests_on_rollouts_of_another_horizon() -> None:
    found = findings(
        lambda process, place, trial: {"error": "no", "grid": None} if trial.request.horizon < 10 else {},
    )
    assert others(found) == {}
    assert found["horizon"].detail == "10 s; no other one was tried"


# Repeatability


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        (
            lambda process, place, trial: {"file_sha256": f"{process} {place}"},
            "samples not visual",
        ),
        (
            lambda process, place, trial: changed(f"{process} {place}"),
            "in a new process too",
        ),
        (
            lambda process, place, trial: changed(f"{process} {trial.request}"),
            "differ two processes not one",
        ),
        (
            lambda process, place, trial: changed(f"{place}"),
            "keeps state from one rollout to the next",
        ),
        (
            lambda process, place, trial: changed(f"{process}") if trial.request.problem == "corner" else {},
            "differ two processes opposite",
        ),
        (
            lambda process, place, trial: {**changed(""), "error": "no"} if (process, place) == (1, 3) else {},
            "fail in one repeat and not in another",
        ),
    ],
)
def test_the_cause_of_unequal_repeats(rule: Rule, words: str) -> None:
    found = findings(rule)
    assert found["repeatable"].status == "failed"
    assert says(found["repeatable"].detail, words)
    assert found["repeatable"].remedy
    assert (found["seed"].status, found["horizon"].status) == ("skipped", "skipped")


def test_a_dependence_on_the_global_random_state() -> None:
    def rule(process: int, place: int, trial: Trial) -> dict[str, Any]:
        drawn = trial.reseed if trial.reseed is not None else f"{process} {place}"
        return {"file_sha256": str(drawn), "samples_sha256": str(drawn), "reseeded": ("numpy.random",)}

    found = findings(rule)
    assert found["random state"].status == "failed"
    assert "they depend on the global random state" in found["repeatable"].detail


def test_rollouts_under_a_set_global_random_state_are_no_repeats() -> None:
    found = findings(lambda process, place, trial: {} if trial.reseed is None else changed(str(trial.reseed)))
    assert others(found) == {"random state": "failed"}


def test_a_change_of_the_global_random_state_alone_is_a_warning() -> None:
    found = findings(lambda process, place, trial: {"reseeded": ("random", "numpy.random")})
    assert others(found) == {"random state": "warning"}
    assert says(found["random state"].detail, "global numpy.random random")


def test_a_noisy_variant_that_ignores_the_seed_and_another_one_that_does_not() -> None:
    found = findings(lambda process, place, trial: {"samples_sha256": f"{trial.request.x}"})
    assert says(found["seed"].detail, "true are declared noisy")
    found = findings(lambda process, place, trial: {"samples_sha256": f"{trial.request.seed}"})
    assert says(found["seed"].detail, "nominal not declared noisy")
    assert "noisy=['nominal']" in found["seed"].remedy


def test_noise_that_acts_at_one_start_is_enough() -> None:
    seen = {each.request.x for each in TRIALS.second() if each.request.problem == "random"}
    chosen = min(seen)
    found = findings(
        lambda process, place, trial: {"samples_sha256": f"{trial.request.x}"} if trial.request.x != chosen else {}
    )
    assert others(found) == {}
    assert says(found["seed"].detail, "true two seeds 1 of 83")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "10 s half agree"),
        ({"beginning_sha256": "another"}, "do not agree"),
        ({"grid": sound(TRIALS.fresh()[0]).grid}, "half 10 s same length"),
    ],
)
def test_the_horizon_is_information(changes: dict[str, Any], words: str) -> None:
    found = findings(lambda process, place, trial: changes if trial.request.horizon < 10 else {})
    assert says(found["horizon"].detail, words)
    assert others(found) == {}


# Costs and traces


@pytest.mark.parametrize(
    ("memory", "status"),
    [
        (lambda place: 100 * MB, "passed"),
        (lambda place: 100 * MB + min(place, 60) * MB, "passed"),  # a cache fills, and is full
        (lambda place: 100 * MB + place % 40 * MB, "passed"),  # garbage comes and goes
        (lambda place: 100 * MB + GROWTH_MARGIN * (place > 200), "passed"),  # an arena more
        (lambda place: 100 * MB + 36 * MB * (place > 200), "passed"),  # something is compiled
        (lambda place: 100 * MB + place * 10_000, "warning"),
        (lambda place: 100 * MB + place * 10_000 + 36 * MB * (place > 200), "warning"),
        (lambda place: 100 * MB + place * 2 * MB, "failed"),  # 20 GB in a campaign
    ],
)
def test_the_growth_of_memory(memory: Callable[[int], int], status: str) -> None:
    found = findings(lambda process, place, trial: {"memory": memory(place)})
    assert found["memory"].status == status
    assert others(found).keys() <= {"memory"}
    if status == "warning":
        assert says(found["memory"].detail, "10 kB 0.1 GB 10,000 rollouts")


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(2e-5, "batch = 1024 one more costs about 0.02 ms"), (0.0, "batch = 1024 one more costs too little measured")],
)
def test_the_batch_follows_from_the_samples_and_from_what_one_more_rollout_costs(seconds: float, words: str) -> None:
    several = run(0, TRIALS.fresh(), lambda process, place, trial: {"seconds": seconds})
    pictures = evidence(lambda process, place, trial: {"file_bytes": 10 * MB})  # of which a batch has none
    found = {each.check: each for each in judge(replace(pictures, batched=several))}
    assert says(found["speed"].detail, words)


def test_few_rollouts_show_no_growth() -> None:
    short = replace(evidence(), runs=(run(0, TRIALS.fresh(), lambda process, place, trial: {"memory": place * MB}),))
    found = {each.check: each for each in judge(short)}
    assert says(found["memory"].detail, "growth not 2")


def test_a_text_at_the_first_use_is_no_fault() -> None:
    once = findings(lambda process, place, trial: {"printed": 9 if place == 0 else 0})
    assert others(once) == {}
    always = findings(lambda process, place, trial: {"printed": 9})
    assert others(always) == {"output": "warning"}


@pytest.mark.rest
def test_files_and_threads_that_stay() -> None:
    cache = findings(lambda process, place, trial: {"files": ("$TMPDIR/cache",) if place == 0 else ()})
    assert others(cache) == {}
    here = findings(lambda process, place, trial: {"files": ("out.csv",) if place == 0 else ()})
    assert here["leftovers"].detail == "new files: out.csv"
    files = findings(lambda process, place, trial: {"files": (f"$TMPDIR/{place % 5}",)})
    assert says(files["leftovers"].detail, "new $TMPDIR/0 $TMPDIR/1 $TMPDIR/2 2 more")
    pool = findings(lambda process, place, trial: {"threads": ("pool",), "tasks": 5})
    assert says(pool["leftovers"].detail, "last first pool")
    grown = findings(lambda process, place, trial: {"tasks": place})
    assert "more with every rollout" in grown["leftovers"].detail
    late = findings(lambda process, place, trial: {"tasks": 2 if place > 200 else 1})
    assert others(late) == {}


# Ends


def broken(ended: str, *, reached: int, **changes: Any) -> dict[str, SystemFinding]:
    whole = run(0, TRIALS.fresh(), lambda process, place, trial: {})
    changed = whole.model_copy(update={"measured": whole.measured[:reached], "ended": ended, **changes})
    return {each.check: each for each in judge(replace(evidence(), runs=(changed,)))}


TRIALS_HUNG = ChildRun(
    trials=TRIALS.fresh(), loaded=Measured(), measured=(), ended="gave no answer within 60 s", hung=True
)


@pytest.mark.rest
def test_a_crash_names_its_rollout_and_what_was_measured_before_counts() -> None:
    found = broken("ended by signal SIGSEGV", reached=1, place="a.c.py, line 1", stderr="bad\x1b[2J")
    start = TRIALS.fresh()[1].request
    assert says(
        found["ends"].detail,
        f"SIGSEGV a.c.py 1: x = {start.x[0]:g} v = {start.x[1]:g} variant true seed {start.seed} (bad\\x1b[2J)",
    )
    assert found["columns"].status == "passed"
    assert {found[name].status for name in ("repeatable", "seed")} == {"skipped"}


def test_a_hang_and_an_end_while_loading() -> None:
    hung = broken("gave no answer within 60 s", reached=0, hung=True)
    assert says(hung["ends"].detail, "60 s x =")
    assert "--timeout" in hung["ends"].remedy
    program = replace(evidence(), runs=(TRIALS_HUNG,), program="./pendulum --fast")
    assert says(judge(program)[0].detail, "60 s ./pendulum --fast x =")
    lost = broken("ended with exit code 1", reached=0, loaded=None, stderr="another build")
    assert says(lost["ends"].detail, "exit code 1 loaded another build")
    assert {each.status for name, each in lost.items() if name != "ends"} == {"skipped"}


# Seeds that are cut, failures that do not repeat, leftover processes, programs


@pytest.mark.parametrize(("most", "status"), [(7, "warning"), (1, "passed"), (10**9, "passed")])
def test_a_seed_that_is_cut_is_seen_and_a_start_without_noise_is_no_cut(most: int, status: str) -> None:
    def rule(process: int, place: int, trial: Trial) -> dict[str, Any]:
        cut = trial.request.seed % most
        return changed(f"{cut}") if trial.request.problem == SEED else {}

    found = findings(rule)["seed"]
    assert found.status == status, found
    if status == "warning":
        assert says(found.detail, f"{MANY_SEEDS} seeds only 7")
        assert "seed_bits=32" in found.remedy


def test_a_failure_that_does_not_repeat_is_no_state() -> None:
    def rule(process: int, place: int, trial: Trial) -> dict[str, Any]:
        late = process == 1 and place > 10 and trial.request.problem == START
        return {"error": "OSError: no licence", "raised": True} if late else {}

    found = findings(rule)
    assert found["errors"].status == "failed"
    assert "fail in one repeat and not in another" in found["repeatable"].detail
    assert found["repeatable"].remedy == "fix the failure first, then check again"


def test_processes_that_run_on_are_leftovers() -> None:
    found = findings(lambda process, place, trial: {"processes": ("sleep",)})["leftovers"]
    assert (found.status, found.detail) == ("warning", "processes run on after a rollout: sleep")


def test_remedies_for_a_program_speak_of_programs() -> None:
    bad = evidence(lambda process, place, trial: {"error": "numbers are not finite"})
    (finite,) = [each for each in judge(replace(bad, program="./pendulum")) if each.check == "finite"]
    assert "narrow the ranges of [space]" in finite.remedy
    assert not any("np.random" in each or "decorator" in each for each in OF_PROGRAM.values())
    assert set(OF_PROGRAM) <= set(SYSTEM_CHECKS)


def test_starts_are_those_of_the_region() -> None:
    inside = replace(TRIALS, where="x + v <= 0.5")
    starts = {trial.request.x for trial in inside.first(0.01)}
    assert len(starts) > 10
    assert all(x + v <= 0.5 for x, v in starts)
    assert (0.0, -1.0) in starts
    assert (1.0, 1.0) not in starts
    everywhere = {trial.request.x for trial in TRIALS.first(0.01)}
    assert {(x, v) for x, v in everywhere if x + v <= 0.5} <= starts, "the others are where they were"


def test_an_input_over_time_has_rollouts_of_one_horizon() -> None:
    """Its knots follow the horizon, so that half of it has another input."""
    over_time = tuple(each.model_copy(update={"signal": True}) for each in SPEC.parameters)
    spec = SPEC.model_copy(update={"parameters": over_time}).spread()
    trials = Trials.of(spec, {}, variants=("nominal",), horizon=10.0, seed=3)
    assert {trial.request.horizon for trial in trials.first(0.01)} == {10.0}
    assert {len(trial.request.x) for trial in trials.first(0.01)} == {10}


@pytest.mark.parametrize(
    ("acts", "status", "words"),
    [
        (lambda _: Acts(), "passed", "within their limits"),
        (
            lambda k: Acts(outside="policy.py returned 17, outside [-2, 2]" if k == 3 else ""),
            "warning",
            "policy.py returned 17 outside [-2, 2] at x = of rollouts np.clip",
        ),
        (lambda _: Acts(idle="control.py returned None"), "warning", "control.py returned None return data.ctrl"),
        # One that acts in some rollouts alone has a reason.
        (lambda k: Acts(idle="control.py returned None" if k else ""), "passed", "within their limits"),
    ],
)
def test_what_a_policy_does_is_a_finding(acts: Callable[[int], Acts], status: str, words: str) -> None:
    found = findings(lambda _process, place, _trial: {"acts": acts(place)})["actions"]
    assert found.status == status
    assert says(f"{found.detail} {found.remedy}", words)


def test_numbers_that_rollouts_report_have_a_finding_with_its_meaning() -> None:
    spec = SPEC.model_copy(update={"noisy": ("true",), "reported": (Normal(0, 2).named("y", "m"),)})
    measured = evidence(lambda _process, place, _trial: {"reported": (0.1 * (place % 7),)})
    found = {each.check: each for each in judge(replace(measured, spec=spec))}
    assert found["reported"].meaning
