"""The failures of a campaign as regression tests: their kinds, the nearest of each, the table, what a replay says."""

import csv
import io
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.release.regression import export as exports
from perfbound.orchestrator.release.regression.export import Wanted, export_regression
from perfbound.orchestrator.release.regression.failures import Failure, Failures, alike, failures_of
from perfbound.orchestrator.release.regression.minimise import Movable, minimised
from perfbound.orchestrator.release.regression.outcome import Judge, Outcome
from perfbound.orchestrator.release.regression.replay import compared
from perfbound.orchestrator.release.regression.scenarios import read_scenarios, scenario_table
from perfbound.orchestrator.store.read import stored_header
from perfbound.schemas.errors import EvidenceError, PerfboundError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.disturbance import Choice, Normal
from perfbound.schemas.file.space import SystemChoice
from perfbound.schemas.result.facts import Header
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Column, Option, SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory
from tests.fakes.simulators import robustness, simulate, spec

SAMPLE = {"method": "sample"}
ASKED: dict[str, Any] = {
    "claims": [{"quantity": "failure_probability"}],
    "max_tests": 80,
    "spot_check": 0,
    "recheck": 0,
}


def two_columns(*, disturbed: bool = False) -> SystemSpec:
    """Return a system with two columns, and with a gust and a choice if it is disturbed."""
    laws = (Normal(0, 1).named("gust", "m/s"), Choice([0, 1]).named("wet", "1")) if disturbed else ()
    plain = spec(noisy=disturbed)
    columns = (*plain.columns, Column(name="force", unit="1"))
    return plain.model_copy(update={"columns": columns, "disturbances": laws, "residual": not disturbed})


def corners(request: RolloutRequest) -> tuple[float, float]:
    """Return what fails in two corners, in each something else."""
    x, y = request.x
    return 1.6 - x - y, x + y - 0.4


def gusty(request: RolloutRequest) -> tuple[float, float]:
    """Return what fails where the start and the gust are large."""
    gust, wet = request.disturbances or (0.0, 0.0)
    return 1.5 - request.x[0] - 0.5 * gust - 0.2 * wet, 1.0


def config(**changes: Any) -> CampaignConfig:
    return robustness(SAMPLE, **({"specification": "value >= 0 and force >= 0"} | ASKED | changes))


def judge_of(header: Header, specification: Any = None) -> Judge:
    return Judge(specification or header.config.formula or "", header.spec, header.config.beyond)


def shown(judge: Judge, spec: SystemSpec, request: RolloutRequest, values: Sequence[float]) -> Outcome:
    times = [0.0, request.horizon]
    samples = np.array([[t, *values] for t in times])
    return judge.outcome(Trajectory(tuple(column.name for column in spec.columns), samples))


def found_in(directory: Path, header: Header) -> Failures:
    return failures_of(directory, header, judge_of(header), lambda *_: None)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign that fails in two corners."""
    found = tmp_path_factory.mktemp("regression") / "two-corners"
    assert simulate(found, config(name="two-corners"), corners, noisy=False, system=two_columns())
    return found


@pytest.fixture(scope="module")
def header(run: Path) -> Header:
    return stored_header(run)


def test_failures_are_grouped_by_start_and_by_what_they_violate(run: Path, header: Header) -> None:
    found = found_in(run, header)
    kinds = {group[0].outcome.violated for group in found.groups}
    assert kinds == {("value >= 0",), ("force >= 0",)}
    assert sum(map(len, found.groups)) == found.rollouts > 4
    for group in found.groups:
        margins = [each.outcome.robustness for each in group]
        assert margins == sorted(margins)
        assert {each.outcome.violated for each in group} == {group[0].outcome.violated}


def test_the_nearest_failures_are_within_a_hundredth_of_the_true_border(run: Path, header: Header) -> None:
    judge, movable, asked = judge_of(header), Movable(header, {}), list[int]()

    def simulated(requests: Sequence[RolloutRequest]) -> list[Outcome | None]:
        asked.append(len(requests))
        return [shown(judge, header.spec, each, corners(each)) for each in requests]

    worst = [group[0] for group in found_in(run, header).groups]
    counts = list[int]()
    nearest = minimised(worst, movable, simulated, tests=60, report=counts.append)
    for before, after in zip(worst, nearest, strict=True):
        assert after.outcome.fails
        assert after.outcome.violated == before.outcome.violated
        # Of both corners the border is that of a sum of both parameters, whose ranges are 1.
        assert -0.02 <= after.outcome.robustness < 0
        assert math.dist(after.x, (0.5, 0.5)) <= math.dist(before.x, (0.5, 0.5))
    assert counts == sorted(counts)
    assert counts[-1] == sum(asked) - len(worst), "and each once to see it fail here"


def test_the_number_of_rollouts_is_limited_and_a_crash_counts_as_passing(run: Path, header: Header) -> None:
    judge, movable, asked = judge_of(header), Movable(header, {}), list[RolloutRequest]()
    worst = [next(group[0] for group in found_in(run, header).groups if group[0].outcome.violated == ("value >= 0",))]
    crash = (worst[0].x[0] + 0.6) / 2

    def simulated(requests: Sequence[RolloutRequest]) -> list[Outcome | None]:
        asked.extend(requests)
        return [shown(judge, header.spec, each, corners(each)) if each.x[0] > crash else None for each in requests]

    (found,) = minimised(worst, movable, simulated, tests=60, report=lambda _: None)
    assert crash < found.x[0] < worst[0].x[0]
    several = len(asked)
    asked.clear()
    (few,) = minimised(worst, movable, simulated, tests=3, report=lambda _: None)
    assert len(asked) == 1 + 3 < several
    assert minimised(worst, movable, simulated, tests=0, report=lambda _: None) == worst
    assert few.outcome.fails


def test_a_failure_that_is_none_here_is_refused_with_both_numbers(run: Path, header: Header) -> None:
    worst = [found_in(run, header).groups[0][0]]
    text = r"robustness\.\d+\.nominal\.0: simulated again it has the robustness 1, and failed in the campaign with -0\."
    with pytest.raises(PerfboundError, match=text):
        minimised(
            worst,
            Movable(header, {}),
            lambda each: [Outcome(1.0, (), None)] * len(each),
            tests=9,
            report=lambda _: None,
        )
    with pytest.raises(PerfboundError, match="simulated again it gives no trajectory"):
        minimised(worst, Movable(header, {}), lambda each: [None] * len(each), tests=9, report=lambda _: None)


def test_disturbances_are_moved_to_their_medians_and_a_choice_stays(tmp_path: Path) -> None:
    system = two_columns(disturbed=True)
    assert simulate(tmp_path / "run", config(), gusty, noisy=True, system=system)
    header = stored_header(tmp_path / "run")
    judge, movable = judge_of(header), Movable(header, {"z1": 0.25})
    worst = [group[0] for group in found_in(tmp_path / "run", header).groups]

    def simulated(requests: Sequence[RolloutRequest]) -> list[Outcome | None]:
        return [shown(judge, header.spec, each, gusty(each)) for each in requests]

    nearest = minimised(worst, movable, simulated, tests=100, report=lambda _: None)
    assert worst
    for before, after in zip(worst, nearest, strict=True):
        gust, wet = after.disturbances
        assert after.x[0] == 0.25 or gust == 0 or after.outcome.robustness > -0.03
        assert abs(gust) < abs(before.disturbances[0])
        assert wet == before.disturbances[1]
        assert after.x[1] == 0.5, "it does not matter"


def test_a_start_of_a_list_stays_as_it_is_and_its_disturbances_move() -> None:
    starts = {"scenarios": [[0.9, 0.1], [0.1, 0.9]]}
    listed = robustness({"method": "scenario", "alpha": 1.0}, space=starts, clip=[-5, 5])
    header = Header.new(listed, two_columns(disturbed=True), {}, run="0" * 16)
    movable = Movable(header, {})
    assert movable.groups == ((2,),)
    assert movable.allowed((0.9, 0.1, 1.0, 0.0)) == (0.9, 0.1, 1.0, 0.0)


def test_starts_outside_the_region_are_not_simulated(run: Path, header: Header) -> None:
    inside = header.config.model_copy(update={"where": "z1 > 0.7"})
    movable = Movable(Header.new(inside, header.spec, {}, run="0" * 16), {})
    assert movable.allowed((0.6, 0.5)) is None
    assert movable.allowed((0.8, 0.5)) == (0.8, 0.5)


def failure(x: tuple[float, ...], moment: float | None, violated: str = "value >= 0", margin: float = -1.0) -> Failure:
    from perfbound.schemas.ids import RolloutId

    return Failure(RolloutId("robustness", 0, "nominal", 0), x, 1, (), Outcome(margin, (violated,), moment))


def test_failures_at_other_moments_are_of_other_kinds(header: Header) -> None:
    long = Header.new(header.config.model_copy(update={"horizon": 10.0}), header.spec, {}, run="0" * 16)
    early, late, chained, none, other = (
        failure((0.5, 0.5), 1.0, margin=-2.0),
        failure((0.5, 0.5), 4.0),
        failure((0.55, 0.5), 1.9, margin=-3.0),
        failure((0.5, 0.5), None),
        failure((0.5, 0.5), 1.0, "force >= 0"),
    )
    groups = alike(long, [early, late, chained, none, other])
    assert set(groups) == {(chained, early), (late,), (none,), (other,)}
    assert groups[0] == (chained, early), "the worst first"


def test_the_table_reads_back_and_another_tool_reads_it(run: Path, header: Header, tmp_path: Path) -> None:
    groups = found_in(run, header).groups
    named = [(f"{number}-worst", group[0]) for number, group in enumerate(groups, 1)]
    path = tmp_path / "scenarios.csv"
    path.write_bytes(scenario_table(header, named))
    rows = list(csv.DictReader(io.StringIO(path.read_text(), newline="")))
    assert [row["scenario"] for row in rows] == [name for name, _ in named]
    assert float(rows[0]["z1 (1)"]) == groups[0][0].x[0]
    found = read_scenarios(path)
    for (name, before), each in zip(named, found.values(), strict=True):
        assert (each.name, each.seed, each.outcome) == (name, before.seed, before.outcome)
        assert each.numbers == dict(zip(("z1", "z2"), before.x, strict=True))
        assert each.rollout == str(before.rollout)
        assert each.units == {"z1": "1", "z2": "1"}
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert read_scenarios(path) == found, "with the mark of a spreadsheet"


def test_a_formula_that_begins_as_one_of_a_spreadsheet_reads_back(header: Header, tmp_path: Path) -> None:
    path = tmp_path / "scenarios.csv"
    for violated in ("-value >= 0", "value >= 0; -force >= 0"):
        path.write_bytes(scenario_table(header, [("1-worst", failure((0.5, 0.5), None, violated))]))
        assert read_scenarios(path)["1-worst"].outcome.violated == tuple(violated.split("; "))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda text: text.replace("scenario,", "name,"), "it has no column 'scenario'; export it again"),
        (lambda text: text.replace("nominal,", "other,"), "line 2: there is no variant 'other'"),
        (lambda text: text.replace("1-worst", "2-worst"), "the scenario '2-worst' is there twice"),
        (lambda text: text.partition("\n")[0], "it has no scenario"),
        (lambda _: "", "it has no column 'scenario'"),
        (lambda text: text.replace(",-0", ",nix"), "line 2: 'nix.*' is no number"),
        (lambda _: "\0" * 20, "it has no column 'scenario'|cannot be read"),
    ],
)
def test_a_table_that_is_none_is_refused_in_one_line(
    run: Path, header: Header, tmp_path: Path, change: Any, text: str
) -> None:
    named = [(f"{number}-worst", group[0]) for number, group in enumerate(found_in(run, header).groups, 1)]
    path = tmp_path / "scenarios.csv"
    path.write_text(change(scenario_table(header, named).decode()), newline="")
    with pytest.raises(PerfboundError, match=text):
        read_scenarios(path)


def test_the_judge_names_requirements_or_the_parts_of_a_formula() -> None:
    system = two_columns()
    trajectory = Trajectory(("t", "value", "force"), np.array([[0.0, 1.0, 2.0], [1.0, -1.0, 3.0], [2.0, 0.5, -3.0]]))
    by_part = Judge("always (value >= 0 and force >= 1)", system, "refuse").outcome(trajectory)
    assert by_part == Outcome(-4.0, ("always value >= 0", "always force >= 1"), 1.0), "when the first one is violated"
    named = {"R-1": "always value >= 0", "R-2": "always force >= -5"}
    assert Judge(named, system, "refuse").outcome(trajectory) == Outcome(-1.0, ("R-1",), 1.0)
    assert Judge("eventually value >= 1", system, "refuse").outcome(trajectory) == Outcome(0.0, (), None)
    whole = Judge("eventually[0, 1] value >= 3", system, "refuse").outcome(trajectory)
    assert whole == Outcome(-2.0, ("eventually[0,1] value >= 3",), 0.0), "where it comes closest"


FAILED = Outcome(-1.0, ("R-1",), 2.0)


@pytest.mark.parametrize(
    ("now", "state", "text"),
    [
        (Outcome(0.0, (), None), "fixed", "robustness 0.0000 m; it was -1.0000 m"),
        (
            Outcome(-1.0, ("R-1",), 2.9),
            "still failing",
            "violates R-1 with robustness -1.0000 m, violated at 2.9 s; it was -1.0000 m, violated at 2 s",
        ),
        (
            Outcome(-0.5, ("R-1",), 2.0),
            "still failing",
            "violates R-1 with robustness -0.5000 m, violated at 2 s; it was -1.0000 m, violated at 2 s",
        ),
        (
            Outcome(-1.0, ("R-2",), 2.0),
            "changed",
            "violates R-2, with robustness -1.0000 m, violated at 2 s; before R-1",
        ),
        (
            Outcome(-1.0, ("R-1",), 3.1),
            "changed",
            "fails at another moment: robustness -1.0000 m, violated at 3.1 s",
        ),
        (Outcome(-1.0, ("R-1",), None), "changed", "fails at another moment"),
    ],
)
def test_a_scenario_is_fixed_still_failing_or_changed(now: Outcome, state: str, text: str) -> None:
    found, words = compared(FAILED, now, 10.0, "m")
    assert found == state
    assert words.startswith(text)


def exported(run: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, **wanted: Any) -> list[str]:
    """Export with the system of the run and a function in its place."""
    header = stored_header(run)
    judge = judge_of(header)

    def simulated(_system: Any, _judge: Any, requests: Sequence[RolloutRequest]) -> list[Outcome | None]:
        return [shown(judge, header.spec, each, corners(each)) for each in requests]

    monkeypatch.setattr(exports, "load_campaign", lambda _: header.config)
    monkeypatch.setattr(exports, "system_of", lambda *_: header.spec)
    monkeypatch.setattr(exports, "simulated", simulated)
    given: dict[str, Any] = {"groups": 10, "tests": 60, "nominal": {}} | wanted
    return export_regression(run, folder, Wanted(Path("there/cars.toml"), **given), lambda *_: None)


def test_the_export_says_what_fails_and_writes_both_files(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = exported(run, Path("tests"), monkeypatch)
    assert "rollouts violate the specification; 2 kinds of failure" in lines[0]
    assert [line[0] for line in lines[1:5]] == ["1", " ", "2", " "]
    table = read_scenarios(tmp_path / "tests" / "two_corners_failures.csv")
    assert list(table) == ["1-worst", "1-nearest", "2-worst", "2-nearest"]
    text = (tmp_path / "tests" / "test_two_corners_failures.py").read_text()
    compile(text, "exported", "exec")
    assert 'campaign=HERE / "../there/cars.toml"' in text
    assert 'specification="value >= 0 and force >= 0"' in text
    assert f"horizon={stored_header(run).config.horizon!r}" in text
    few = exported(run, Path("few"), monkeypatch, groups=1, tests=0)
    assert "1 kind of failure" in few[0]
    assert any(
        re.search(r"^\d+ groups? of near failures left out, the milder ones: --groups \d+ looks at all$", line)
        for line in few
    )
    assert list(read_scenarios(tmp_path / "few" / "two_corners_failures.csv")) == ["1-worst"]


def test_another_option_in_the_campaign_file_is_named(header: Header) -> None:
    option = Option(name="gain", default=1.0, doc="")
    spec_with = header.spec.model_copy(update={"options": (option,)})
    chosen = header.config.model_copy(update={"system": SystemChoice(name="any-function", gain=2.0)})
    other = Header.new(header.config, spec_with, {}, run="0" * 16)
    (line,) = exports.differing_options(other, Path("cars.toml"), chosen)
    assert line == "cars.toml has gain = 2.0, and 1.0 in the run: the tests replay what is in the file"
    same = Header.new(chosen, spec_with, {}, run="0" * 16)
    assert exports.differing_options(same, Path("cars.toml"), chosen) == []


def test_a_failure_at_another_moment_is_no_step_towards_the_nearest_one(header: Header) -> None:
    long = Header.new(header.config.model_copy(update={"horizon": 10.0}), header.spec, {}, run="0" * 16)
    start = failure((1.0, 0.5), 4.0, "value >= 0")
    (found,) = minimised(
        [start],
        Movable(long, {}),
        # Nearer than 0.8 it fails at once, which is another failure.
        lambda each: [Outcome(-1.0, ("value >= 0",), 4.0 if one.x[0] >= 0.8 else 1.0) for one in each],
        tests=50,
        report=lambda _: None,
    )
    assert 0.8 <= found.x[0] < 0.81
    assert Movable(long, {"z1": 1.0}).is_nominal(start)


def test_requirements_are_named_by_their_ids(tmp_path: Path) -> None:
    requirements = [
        {"name": "low", "formula": "value >= 0", "id": "R-1"},
        {"name": "soft", "formula": "force >= 0"},
    ]
    several = config(specification=None, specifications=requirements)
    header = Header.new(several, two_columns(), {}, run="0" * 16)
    found = exports.specification_of(header, tmp_path)
    assert found == {"R-1": "value >= 0", "soft": "force >= 0"}
    same = [dict(each, id="R-1") for each in requirements]
    header = Header.new(config(specification=None, specifications=same), two_columns(), {}, run="0" * 16)
    assert list(exports.specification_of(header, tmp_path)) == ["low", "soft"]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"repeated": "nowhere"}, "rollouts of any-function cannot be simulated again; nothing was exported"),
        ({"vectorised": True, "batch_is_the_unit": True}, "cannot be simulated one by one"),
        ({"doc": "another one"}, "its system is another one than that of .*doc any function .here another one"),
    ],
)
def test_another_system_is_refused(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any], text: str
) -> None:
    header = stored_header(run)
    other = header.spec.model_copy(update=change)
    monkeypatch.setattr(exports, "load_campaign", lambda _: header.config)
    monkeypatch.setattr(exports, "system_of", lambda *_: other)
    if "doc" not in change:
        changed = Header.new(header.config, other, {}, run=header.run)
        monkeypatch.setattr(exports, "stored_header", lambda _: changed)
    with pytest.raises(PerfboundError, match=text):
        export_regression(run, tmp_path / "out", Wanted(Path("a.toml"), 1, 1, {}), lambda *_: None)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("nominal", "text"),
    [
        ({"z3": 1.0}, "--nominal z3: the parameters are z1, z2"),
        ({"z1": 2.0}, r"--nominal z1=2: it is not in \[0, 1\] 1"),
    ],
)
def test_a_nominal_value_that_is_none_is_refused(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, nominal: dict[str, float], text: str
) -> None:
    with pytest.raises(PerfboundError, match=text):
        exported(run, tmp_path / "out", monkeypatch, nominal=nominal)


def test_a_campaign_without_failures_and_a_damaged_file_are_refused(tmp_path: Path) -> None:
    assert simulate(tmp_path / "good", config(), lambda _: (1.0, 1.0), noisy=False, system=two_columns())
    header = stored_header(tmp_path / "good")
    with pytest.raises(PerfboundError, match="no rollout violates the specification"):
        found_in(tmp_path / "good", header)
    assert simulate(tmp_path / "bad", config(), lambda _: (-1.0, 1.0), noisy=False, system=two_columns())
    for path in (tmp_path / "bad" / "trajectories").rglob("*.mcap"):
        path.write_bytes(b"damaged")
    with pytest.raises(EvidenceError, match=r"sha256|digest"):
        found_in(tmp_path / "bad", stored_header(tmp_path / "bad"))
