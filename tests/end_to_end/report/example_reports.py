"""Small report data for the page: two problems over a lattice, listed starts, one parameter, hostile names."""

import itertools
import math
from dataclasses import replace

from perfbound.orchestrator.report.data.charts import (
    DisturbanceCharts,
    DisturbanceScatter,
    DisturbanceShare,
    Importance,
    ParameterImportance,
    Prediction,
    ProblemCharts,
    RolloutHistogram,
    VariantCounts,
    WorstRollout,
)
from perfbound.orchestrator.report.data.claims import AssumptionRow, Claim, assumption_row
from perfbound.orchestrator.report.data.page import (
    Axis,
    DeclaredDisturbance,
    Drawn,
    Problem,
    ReportData,
    Surface,
    TestSeries,
)
from perfbound.orchestrator.report.data.rollouts import (
    Curve,
    DrawnRollout,
    DrawnValue,
    FoundCounterexample,
    InputCurve,
    RankedTest,
    Rollout,
    RolloutsOfTest,
    StartGroup,
    ViolatingStart,
    ViolatingStarts,
)
from perfbound.orchestrator.report.data.workers import FailedAttempt, SetAsideRow, Throughput, WorkerRow
from perfbound.orchestrator.store.changes import ComparedResult
from perfbound.schemas.result.certificate import Assumption, CompositionTerms, Status

AXES = (Axis("x", "m", 0.0, 4.0), Axis("y", "m", 0.0, 3.0))
NODES = tuple((float(i), float(j)) for i in range(5) for j in range(4))
STARTED = 1_750_000_000.0


def small(tests: int = 6) -> ReportData:
    """A finished campaign of the two problems, its first claim refuted."""
    problems = (_problem("nominal_robustness", "min", tests), _problem("sim_gap", "max", tests))
    return ReportData(
        name="small",
        seed=1,
        run="c0ffee",
        state="finished",
        updated=None,
        system="segway",
        doc="A system.",
        code="cars.py:cars, commit 0123456789ab, with changes",
        specification="always (abs(phi) <= 0.95)",
        horizon=2.0,
        risk_weight=0.2,
        clip=(-0.05, 0.75),
        axes=AXES,
        now="rho* >= 0.1743 with probability at least 0.8544",
        claims=(_claim("product", ("rkhs_norm/sim_gap", "independence")), _claim("sum", ("accounting",))),
        checks=("Recheck: 20 of 20 rollouts, simulated once more, agree bit by bit.",),
        composition=CompositionTerms(
            rule="product", nominal_bound=0.45, gap_bound=0.2, lipschitz=1.0, gap_term=0.2, risk_term=0.08, bound=0.17
        ),
        assumptions=(
            _assumption("rkhs_norm/sim_gap", "refuted", "largest |y| = 0.68 exceeds B = 0.1."),
            _assumption("independence", "derived", "each problem has seeds of its own."),
            _assumption("accounting", "assumed", "the failure probabilities are added."),
        ),
        problems=problems,
        scenes=tuple(rollouts_of_test(each.name, test) for each in problems for test in (worst(each), 0)),
        counterexamples=(),
        violations=0,
        later_violations=0,
        rollouts=4 * tests,
        workers=(WorkerRow("local-1", "vm", 4 * tests, 0, 9.0, 8.5, STARTED + 9, "unknown", None, None),),
        throughput=Throughput(12.0, STARTED, (0.0, 5.0, 9.0), (0, 10, 4 * tests), 1, 0),
        software={"perfbound": "0.1.0"},
        resume="perfbound resume runs/small",
    )


def _assumption(name: str, status: Status, detail: str) -> AssumptionRow:
    return assumption_row(Assumption(id=name, status=status, detail=detail))


def worst(problem: Problem) -> int:
    """Return the number of the worst test."""
    sign = 1.0 if problem.sense == "min" else -1.0
    seen = [(sign * y, test) for test, y in zip(problem.tests.test, problem.tests.y, strict=True) if y is not None]
    return min(seen)[1]


def calm() -> ReportData:
    """The same without anything refuted."""
    report = small()
    claims = tuple(replace(claim, refuted=()) for claim in report.claims)
    kept = tuple(each for each in report.assumptions if each.status != "refuted")
    return replace(report, claims=claims, assumptions=kept)


def running(tests: int, scenes: tuple[RolloutsOfTest, ...] = ()) -> ReportData:
    """A running campaign at one moment."""
    workers = (WorkerRow("local-1", "vm", tests, 0, 9.0, 8.5, STARTED, "busy", "sim_gap.3.true.0", STARTED + 1),)
    report = replace(small(tests), state="running", updated=STARTED + tests, claims=(), composition=None)
    return replace(report, scenes=scenes, workers=workers)


def begun() -> ReportData:
    """A running campaign before its first test is observed."""
    report = running(1)
    none = TestSeries((), (), (), (), (), ())
    problems = tuple(
        replace(each, tests=none, observed=0, surfaces=(), bound=None, stopped_by=None) for each in report.problems
    )
    return replace(
        report,
        problems=problems,
        assumptions=(),
        workers=(),
        throughput=Throughput(0.0, None, (), (), 1, 0),
        rollouts=0,
    )


def starts() -> ReportData:
    """Listed starts; no start has an upper bound of its own."""
    report = small()
    surface = _surface(shape=None)
    listed = replace(surface, through=(), points=NODES, upper=(None,) * len(NODES))
    problem = replace(report.problems[0], method="scenario", distance="U - L", surfaces=(listed,))
    return replace(report, problems=(problem,))


def cube() -> ReportData:
    """Three parameters of 0 to 3; in every plane the mean at a node is its digits, as in 321 of x = 3, y = 2, z = 1."""
    report = small()
    axes = tuple(Axis(name, "m", 0.0, 3.0) for name in "xyz")
    through, number = (2.0, 1.0, 0.0), (100.0, 10.0, 1.0)
    planes = []
    for pair in ((0, 1), (0, 2), (1, 2)):
        mean = []
        for node in itertools.product(range(4), repeat=2):
            start = list(through)
            for axis, value in zip(pair, node, strict=True):
                start[axis] = float(value)
            mean.append(sum(value * digit for value, digit in zip(start, number, strict=True)))
        planes.append(Surface(pair, through, (4, 4), (), tuple(mean), (None,) * 16, (None,) * 16, (True,) * 16))
    problem = report.problems[0]
    x = ((2.0, 1.0, 0.0), (3.0, 3.0, 3.0), (2.0, 1.0, 3.0), (0.0, 0.0, 0.0), (0.0, 3.0, 0.0), (1.0, 2.0, 3.0))
    found = replace(problem, surfaces=tuple(planes), tests=replace(problem.tests, x=x))
    return replace(report, axes=axes, problems=(found,))


def charted() -> ReportData:
    """One problem of the robustness with every chart: a bound of -20 m after the first test, 2 of 30 starts outside."""
    report = small(12)
    observed = tuple(0.1 * k for k in range(30))
    outside = tuple(k in {3, 4} for k in range(30))
    charts = ProblemCharts(
        required=0.1,
        of_robustness=True,
        clip=(-0.2, 0.75),
        overshoots=0.25,
        importance=Importance(
            True,
            20,
            None,
            (
                ParameterImportance(1, 0.7, 0.8, (0.0, 1.5, 3.0), (0.1, 0.3, 0.6)),
                ParameterImportance(0, 0.2, 0.3, (0.0, 2.0, 4.0), (0.3, 0.2, 0.4)),
            ),
        ),
        prediction=Prediction(
            30,
            28,
            True,
            1,
            0.17,
            False,
            observed,
            tuple(y + 0.05 for y in observed),
            tuple(y + 0.02 if out else y - 0.2 for y, out in zip(observed, outside, strict=True)),
            tuple(y + 0.3 for y in observed),
            outside,
        ),
        rollouts=RolloutHistogram(
            (-0.4, -0.2, 0.0, 0.2, 0.4),
            "rad",
            (
                VariantCounts("nominal", (0, 0, 3, 9), 12, 0, 0.12, 4, (0, 0)),
                VariantCounts("true", (1, 2, 5, 4), 12, 3, -0.31, 7, (1, 0)),
            ),
        ),
    )
    problem = report.problems[0]
    tests = replace(problem.tests, lower=(-20.0, *(problem.tests.lower[1:])))
    return replace(report, problems=(replace(problem, tests=tests, charts=charts, bound=0.3727),))


def disturbed(*, control: bool = True) -> ReportData:
    """The same with two declared disturbances: `gust`, of which 2 of 40 rollouts fail, and a rare `fault`."""
    report = charted()
    gust = tuple(0.5 * k - 10.0 for k in range(40))
    fault = tuple(float(k % 8 == 7) for k in range(40))
    margin = tuple(0.3 - 0.04 * max(0.0, value - 1.0) for value in gust)
    drawn = (DrawnValue(0, 9.5, 2.94, None), DrawnValue(1, 1.0, None, 0.125))
    charts = DisturbanceCharts(
        unit="rad",
        explained=0.976 if control else None,
        left=0.0192 if control else None,
        before_fit=40 if control else 0,
        sampled=0 if control else 4096,
        chance=None if control else 0.01,
        shares=(
            DisturbanceShare(0, 0.95, 0.103 if control else None, (-9.0, 0.0, 9.0), (0.02, 0.01, -0.32)),
            DisturbanceShare(1, 0.026, 0.017 if control else None, (0.0, 1.0), (0.01, -0.04)),
        ),
        scatter=DisturbanceScatter(
            axes=(0, 1),
            at=(gust, fault),
            margin=margin,
            marked=tuple(value < 0 for value in margin),
            test=tuple(range(40)),
            rollouts=100_000,
            violations=sum(value < 0 for value in margin),
        ),
        worst=WorstRollout("nominal_robustness.0.true.1", 0, min(margin), drawn),
    )
    problem = report.problems[0]
    scenes = tuple(
        replace(scene, rollouts=tuple(replace(each, disturbances=drawn) for each in scene.rollouts))
        for scene in report.scenes
    )
    declared = (
        DeclaredDisturbance("gust", "m/s", "normal, mean 0 m/s, sd 3 m/s"),
        DeclaredDisturbance("fault", "", "0 (0.875), 1 (0.125)"),
    )
    problems = (replace(problem, charts=replace(problem.charts, disturbances=charts)),)
    return replace(report, problems=problems, scenes=scenes, disturbances=declared)


def many(parameters: int = 12, tests: int = 30) -> ReportData:
    """Drawn starts of many parameters with long names, which differ at their ends; every tenth violates."""
    report = small()
    axes = tuple(Axis(f"a_parameter_of_a_long_name_{k:04d}", "m/s2", -1.0, 1.0) for k in range(parameters))
    numbers = range(tests)
    x = tuple(tuple(math.sin(1.0 + k * (axis + 1)) for axis in range(parameters)) for k in numbers)
    y = tuple(-0.1 - k / tests if k % 10 == 9 else 0.5 + k / tests for k in numbers)
    none = (None,) * tests
    drawn = Drawn(None, (-1.5, 0.0, 1.5), (tests // 10, tests - tests // 10), tests // 10, 0, "m", (), 0.2, 0, min(y))
    problem = replace(
        report.problems[0],
        method="sample",
        sense="max",
        surfaces=(),
        drawn=drawn,
        observed=tests,
        tests=TestSeries(tuple(numbers), x, y, none, (0.0,) * tests, (1.0,) * tests),
    )
    return replace(report, axes=axes, problems=(problem,), scenes=())


def ended_by_counterexample(report: ReportData, test: int) -> ReportData:
    """The same, ended by a rollout of a test of the first problem."""
    name = report.problems[0].name
    rollouts = (rollout(name, test, "true", 0, -0.2), rollout("shrink", 3, "true", 0, -0.1))
    found = FoundCounterexample(name, test, (f"Test {test} violates the specification.",), rollouts[0].command)
    return replace(report, counterexample=found, counterexamples=rollouts, violations=2, later_violations=1)


def profile() -> ReportData:
    """A system with one parameter."""
    report = small()
    problem = report.problems[0]
    band = replace(_surface(shape=(20,)), axes=(0,), through=(0.5,))
    line = replace(problem, surfaces=(band,), tests=replace(problem.tests, x=((0.5,), (1.5,)) * 3))
    return replace(report, axes=AXES[:1], problems=(line,))


def hostile() -> ReportData:
    """Every text that an attacker may have chosen tries to run, to lead away, or to break the layout."""
    script = '<script>window.pwned=1</script><img src=x onerror="window.pwned=1">'
    long, strange = "a" * 10_000, "evil\u0000\u001b[31m\u202etxt\u2066" + script
    bad = Rollout(script, script, 0, script, 0, 1, (1.0, 2.0), -0.2, "../../etc/passwd", f"rm -rf {long}")
    paths = (
        "javascript:alert(1)",
        "trajectories/../../x.mcap",
        "//evil.example/x",
        "trajectories/\\x",
        "https://e.example",
    )
    rollouts = (bad, *(replace(bad, path=path) for path in paths))
    report = small()
    problem = replace(report.problems[0], name=script, objective=long, method=strange, unit=strange, stopped_by=strange)
    trace = replace(rollouts_of_test("x", 0).traces[0], label=script, column=long, unit=strange)
    stage = replace(rollouts_of_test(script, worst(problem)), traces=(trace,), rollouts=rollouts, error=strange)
    return replace(
        report,
        name=strange,
        system=long,
        doc=script,
        specification=long,
        run=script,
        axes=(Axis(script, strange, 0.0, 4.0), Axis(long, long, 0.0, 3.0)),
        claims=(replace(report.claims[0], sentence=script + long, method=long, rule=strange),),
        assumptions=(
            _assumption("rkhs_norm/sim_gap", "refuted", script + long),
            _assumption(long, "assumed", strange),
        ),
        problems=(problem, replace(report.problems[1], name=long, left=script)),
        scenes=(stage,),
        counterexamples=rollouts,
        violations=len(rollouts),
        workers=(WorkerRow(long, script, 1, 1, 1.0, 1.0, STARTED, strange, script, None),),
        software={script: long},
        resume=long,
        more_workers=1,
        compared=tuple(ComparedResult(kind, long, 1, script, long, STARTED) for kind in (script, "outvoted")),
        compared_results=7,
        set_aside=(
            SetAsideRow(script, long, 2, True, STARTED, strange),
            SetAsideRow("host", long, 1, False, STARTED, ""),
        ),
        failed_attempts=tuple(
            FailedAttempt(script, 1, long, kind, strange, STARTED) for kind in (script, "system", None)
        ),
    )


def rollouts_of_test(problem: str, test: int) -> RolloutsOfTest:
    """The rollouts of a test: one nominal, two true, the second true one the worst; its moment is 1.4 s."""
    t = tuple(round(0.1 * k, 1) for k in range(21))
    variants = (("nominal", 0), ("true", 0), ("true", 1))
    robustness = {("nominal", 0): 0.65, ("true", 0): 0.6, ("true", 1): 0.55}
    rollouts = tuple(rollout(problem, test, *which, robustness[which]) for which in variants)

    def phi(variant: str, k: int) -> tuple[float, ...]:
        size = 0.95 - robustness[variant, k]
        return tuple(size * math.sin(math.pi / 2 * each / 1.4) for each in t)

    traces = tuple(
        Curve(
            f"{each.variant} {each.replicate}",
            each.variant,
            "phi",
            "rad",
            t,
            phi(each.variant, each.replicate),
            each.id,
        )
        for each in rollouts
    )
    drawn = tuple(
        DrawnRollout(
            each.id,
            each.variant,
            each.replicate,
            each.seed,
            each.robustness,
            t,
            tuple(0.95 - abs(value) for value in curve.values),
            (1.4, 1.4) if each.replicate else (1.4, 1.5),
            ("phi",),
        )
        for each, curve in zip(rollouts, traces, strict=True)
    )
    further = tuple(replace(curve, column=column) for column in ("vx", "vy") for curve in traces)
    signal = InputCurve("push", "N", "constant", (0.0, 0.9999, 1.0, 2.0), (0.5, 0.5, -1.0, -1.0), (0.0, 1.0), -2.0, 2.0)
    return RolloutsOfTest(
        problem,
        test,
        traces,
        (-0.95, 0.95),
        rollouts,
        limit_columns=("phi", "phi"),
        inputs=(signal,),
        drawn=drawn,
        margin_of="abs(phi) <= 0.95",
        attained="least",
        margin_unit="rad",
        further=further,
        further_columns=("vx", "vy"),
        x=(1.0, 2.0),
    )


def violating(groups: int = 3, starts: int = 4, rollouts: int = 15) -> ReportData:
    """Groups of starts with counterexamples, fewer of them listed than there are."""
    report, found, listed = calm(), list[StartGroup](), list[Rollout]()
    for group in range(groups):
        members = []
        for k in range(starts if group != 1 else 1):
            x, worst = (1.0 * group, 0.1 * k), -3.0 + group + 0.1 * k
            members.append(ViolatingStart(x, rollouts + 5, 2 * rollouts + 10, worst, "sim_gap", 10 * group + k))
            for n in range(rollouts):
                one = rollout("sim_gap", 10 * group + k, "true", n, worst + 0.001 * n)
                listed.append(replace(one, x=x))
        found.append(
            StartGroup(
                members[0].x,
                members[-1].x,
                tuple(members),
                sum(each.violations for each in members),
                sum(each.rollouts for each in members),
                members[0].worst,
            )
        )
    number = sum(len(group.starts) for group in found)
    return replace(
        report,
        violations=number * (rollouts + 5) + 7,
        rollouts=2 * number * (rollouts + 5) + 99,
        counterexamples=tuple(sorted(listed, key=lambda each: each.robustness or 0.0)),
        violating=ViolatingStarts(tuple(found), number + 2, 0.1, 2, 7, 19),
        ranked=(
            RankedTest("worst", "nominal_robustness", 0, "nominal_robustness.0.true.1", -3.0, "true", 845),
            RankedTest("first violation", "spot_check", 5, "spot_check.5.true.0", -0.1, "true", 845),
            RankedTest("best", "sim_gap", 0, "sim_gap.0.true.0", 0.7, "true", 845),
        ),
    )


def rollout(problem: str, test: int, variant: str, replicate: int, robustness: float = 0.4) -> Rollout:
    """A recorded rollout."""
    name = f"{problem}.{test}.{variant}.{replicate}"
    path = f"trajectories/{problem}/0/{name}.mcap"
    return Rollout(
        name, problem, test, variant, replicate, 7, (1.0, 2.0), robustness, path, f"perfbound replay runs/small {name}"
    )


def _claim(rule: str, assumptions: tuple[str, ...]) -> Claim:
    refuted = tuple(each for each in assumptions if each.startswith("rkhs"))
    sentence = f"rho* >= 0.1743 with probability at least 0.8544 ({rule})"
    return Claim("rho_star", ">=", 0.1743861, 0.8544309, rule, "paper", sentence, assumptions, refuted)


def _problem(name: str, sense: str, tests: int) -> Problem:
    numbers = tuple(range(tests))
    x = tuple(NODES[(7 * k) % 20] for k in numbers)
    return Problem(
        name=name,
        objective="min over d of E[robustness]",
        quantity=None,
        method="paper",
        sense=sense,
        unit="rad",
        distance="F_i",
        alpha=0.05,
        delta=0.05,
        bound=0.17439,
        partner=None,
        probability=0.92435,
        budget=100,
        rollouts=tests,
        stopped_by="converged",
        left=None,
        outlook=None,
        surfaces=(_surface(shape=(5, 4)),),
        observed=tests,
        tests=TestSeries(
            test=numbers,
            x=x,
            y=tuple(0.5 + 0.2 * math.cos(3.0 * k) for k in numbers),
            distance=(None, *(1.0 / (k + 1) for k in numbers[1:])),
            lower=tuple(0.4 - 0.3 / (k + 1) for k in numbers),
            upper=(None,) * tests,
        ),
    )


def _surface(shape: tuple[int, ...] | None) -> Surface:
    mean = tuple(0.3 + 0.02 * k for k in range(20))
    lower, upper = tuple(each - 0.1 for each in mean), tuple(each + 0.1 for each in mean)
    worst = tuple(k < 7 for k in range(20))
    return Surface((0, 1), (1.0, 2.0), shape, (), mean, lower, upper, worst, band="with probability 0.95")
