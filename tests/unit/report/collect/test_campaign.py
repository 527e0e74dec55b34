"""The report data of a campaign, collected while it runs and afterwards."""

import json
import math
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.campaign.methods import methods
from perfbound.orchestrator.campaign.plan import UNBOUNDED, plans
from perfbound.orchestrator.certificate.words.format import replay_command
from perfbound.orchestrator.mathematics.gp.lattice import MAX_NODES, Lattice
from perfbound.orchestrator.report.collect import band as surfaces
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.collect.workers import MOST_FAILED, WorkerStatistics
from perfbound.orchestrator.report.data.page import Problem, ReportData, to_json
from perfbound.orchestrator.report.data.ranges import long_inputs
from perfbound.orchestrator.report.rollout import curves, of_tests, over_time
from perfbound.orchestrator.run.page.page_feed import LiveState
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store.changes import AttemptOutcome, ChangeReader, Changes, Session
from perfbound.orchestrator.store.export_tables import unit
from perfbound.orchestrator.store.lock import campaign_lock
from perfbound.schemas.errors import JournalError, PerfboundError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.parameters import Range
from perfbound.schemas.file.space import Scenarios
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.result.facts import Header, ObservationFact, ProposalFact, RolloutFact
from perfbound.schemas.system import Column, SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory
from perfbound.schemas.values import Band, Proposal
from perfbound.workers.systems import load_system
from tests.campaigns import config
from tests.fakes.finished import a_list, a_pair, contents, finish, insert, play

CONFIGS = {"paper": a_pair("paper"), "rigorous": a_pair("rigorous"), "scenario": a_list()}
TEST_FUNCTION = load_system("test-function").spec
HOSTILE = "</script ><!--<script></script><script>alert(1)</script>\x00\x1b[2J\u2028\n../../" + "x" * 10_000


@pytest.fixture(scope="module", params=CONFIGS)
def finished(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, no_disk: None) -> Path:
    """Return the directory of a finished campaign; tests leave it as it is."""
    directory = tmp_path_factory.mktemp(request.param)
    finish(play(directory, CONFIGS[request.param]), directory)
    return directory


@pytest.fixture
def one(tmp_path: Path, no_disk: None) -> Path:
    """Return a finished campaign that a test may spoil."""
    finish(play(tmp_path, a_pair("paper")), tmp_path)
    return tmp_path


def collected(directory: Path) -> ReportData:
    return Collector(directory).refresh()


def numbers(values: tuple[float | None, ...]) -> list[float]:
    found = [value for value in values if value is not None]
    assert len(found) == len(values)
    return found


# Refreshes


@pytest.mark.rest
@pytest.mark.usefixtures("no_disk")
@pytest.mark.parametrize("name", CONFIGS)
def test_incremental_refreshes_equal_a_fresh_one(tmp_path: Path, name: str) -> None:
    collector, tests = Collector(tmp_path), list[int]()

    def look() -> bool:
        report_data = collector.refresh()
        assert report_data == collected(tmp_path)
        json.loads(to_json(report_data))
        tests.append(sum(len(problem.tests.test) for problem in report_data.problems))
        return False

    with campaign_lock(tmp_path):
        stage = play(tmp_path, CONFIGS[name], look)
        assert collector.refresh().state == "running"
    assert len(set(tests)) > 2, "some refreshes were in the middle"
    assert tests == sorted(tests)
    report_data = collector.refresh()
    assert (report_data.state, report_data.claims, report_data.composition) == ("stopped", (), None)
    assert report_data.violations == len(report_data.counterexamples) > 0
    finish(stage, tmp_path)
    report_data = collector.refresh()
    assert report_data == collected(tmp_path)
    assert report_data.state == "finished"
    assert report_data.now == report_data.claims[0].sentence


def test_a_refresh_changes_no_file_and_leaves_none(finished: Path) -> None:
    before = contents(finished)
    collector = Collector(finished)
    report_data = collector.refresh()
    for problem in report_data.problems:
        collector.rollouts_of_test(problem.name, 0)
    assert contents(finished) == before


def test_an_empty_log_is_not_touched(one: Path) -> None:
    (one / "campaign.db-wal").touch()
    before = contents(one)
    Collector(one).refresh()
    assert contents(one) == before, "no -shm beside it"


def test_a_surface_is_worked_out_again_only_after_a_new_test(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    collector = Collector(finished)
    first = collector.refresh()
    monkeypatch.setattr(surfaces, "surfaces", lambda *_: pytest.fail("nothing is new"))
    monkeypatch.setattr(of_tests, "of_test", lambda *_: pytest.fail("nothing is new"))
    assert collector.refresh() == first


def test_after_an_error_the_next_refresh_starts_over(one: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    collector = Collector(one)
    first = collector.refresh()

    def spoiled(_: ChangeReader) -> Changes:
        raise JournalError("just now")

    with monkeypatch.context() as patch:
        patch.setattr(ChangeReader, "read", spoiled)
        with pytest.raises(JournalError, match="just now"):
            collector.refresh()
    assert collector.refresh() == first


def test_another_campaign_in_its_place_is_not_mixed_in(one: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    collector, other = Collector(one), tmp_path_factory.mktemp("other")
    first = collector.refresh()
    finish(play(other, a_pair("paper", seed=2)), other)
    for name in ("campaign.db", "certificate.json"):
        (other / name).replace(one / name)
    with pytest.raises(JournalError, match="another campaign"):
        collector.refresh()
    assert collector.refresh().run != first.run


def test_the_certificate_of_another_campaign_is_refused(one: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    other = tmp_path_factory.mktemp("other")
    finish(play(other, a_pair("paper", seed=2)), other)
    (other / "certificate.json").replace(one / "certificate.json")
    with pytest.raises(JournalError, match="certificate is that of another campaign"):
        collected(one)


def test_no_campaign_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="no campaign here"):
        collected(tmp_path)


# Numbers


def by_name(report_data: ReportData) -> dict[str, Problem]:
    return {problem.name: problem for problem in report_data.problems}


def test_the_numbers_have_the_sign_of_their_objective(finished: Path) -> None:
    facts = recorded_facts.history(finished)
    for name, problem in by_name(collected(finished)).items():
        sign = -1 if problem.sense == "min" else 1
        seen, tests = facts[name], problem.tests
        assert numbers(tests.y) == [sign * each.observation.y for each in seen]
        outer = [None if each.bound.upper is None else sign * each.bound.upper for each in seen]
        inner = [None if each.bound.lower is None else sign * each.bound.lower for each in seen]
        assert (tests.lower, tests.upper) == (
            (tuple(outer), tuple(inner)) if sign < 0 else (tuple(inner), tuple(outer))
        )
        last = outer[-1]
        assert last is not None
        # What is shown is never weaker than what the clip alone proves.
        limit = problem.by_clip
        shown = last if limit is None else max(last, limit) if sign < 0 else min(last, limit)
        assert problem.bound == pytest.approx(shown, abs=2e-9)
        for lower, upper in zip(tests.lower, tests.upper, strict=True):
            assert lower is None or upper is None or lower <= upper


@pytest.mark.usefixtures("no_disk")
@pytest.mark.parametrize("name", CONFIGS)
def test_a_surface_is_what_the_method_says(tmp_path: Path, name: str) -> None:
    """The method of the campaign also proposed; that of the collector was fed with the facts alone."""
    stage = play(tmp_path, CONFIGS[name])
    for problem in collected(tmp_path).problems:
        method, (surface,) = stage.ledger.methods[problem.name], problem.surfaces
        last = stage.ledger.accounts[problem.name].last_bound
        assert last is not None
        band = method.band(replace(last.bound, verdict=None))
        sides = (surface.upper, surface.lower) if problem.sense == "min" else (surface.lower, surface.upper)
        sign = -1 if problem.sense == "min" else 1
        for found, wanted in zip((surface.mean, *sides), (band.mean, band.lower, band.upper), strict=True):
            values = [math.nan if each is None else each for each in found]
            np.testing.assert_allclose(values, sign * np.array(wanted), rtol=0, atol=1e-9)
        assert surface.worst == band.possible
    stage.journal.close()


def test_the_worst_start_is_where_the_band_is_worst(finished: Path) -> None:
    for problem in collected(finished).problems:
        (surface,) = problem.surfaces
        outer = numbers(surface.lower if problem.sense == "min" else surface.upper)
        worst = int(np.argmin(outer) if problem.sense == "min" else np.argmax(outer))
        assert surface.worst[worst]
        assert len(surface.mean) == len(surface.worst) == (math.prod(surface.shape) if surface.shape else 5)


def test_the_band_of_method_paper_is_the_one_that_its_proposals_were_chosen_by(one: Path) -> None:
    added, bands = ChangeReader(one).read(), dict[str, Band]()
    proposals, checked = dict[str, Proposal](), 0
    own = methods(plans(added.header.config, added.header.spec), added.header)
    for fact in added.decisions:
        match fact:
            case ProposalFact(proposal=Proposal(beta=float()) as chosen):
                band, node = bands[fact.problem], chosen.node
                assert band.mean[node] == pytest.approx(chosen.mu)
                assert band.upper[node] - band.lower[node] == pytest.approx(chosen.F)
                assert max(band.upper) == pytest.approx(band.upper[node])
                checked += 1
            case ObservationFact():
                bound = own[fact.problem].observe(proposals[fact.problem], fact.observation)
                bands[fact.problem] = own[fact.problem].band(bound)
        if isinstance(fact, ProposalFact):
            proposals[fact.problem] = fact.proposal
    assert checked == 14


def test_a_running_problem_of_the_paper_has_no_bound_yet(tmp_path: Path, no_disk: None) -> None:
    seen = list[ReportData]()

    def look() -> bool:
        seen.append(collected(tmp_path))
        return len(seen[-1].problems[0].tests.test) > 3

    stage = play(tmp_path, a_pair("paper"), look)
    report_data = seen[-1]
    assert report_data.problems[0].probability is None
    assert "not yet a bound" in report_data.now
    assert report_data.now.endswith("The composed claim follows when all problems have stopped.")
    stage.journal.close()


def test_a_running_problem_of_the_others_has_a_bound_at_any_time(tmp_path: Path, no_disk: None) -> None:
    seen = list[ReportData]()

    def look() -> bool:
        seen.append(collected(tmp_path))
        return len(seen[-1].problems[0].tests.test) > 3

    stage = play(tmp_path, a_list(), look)
    (problem,) = seen[-1].problems
    assert problem.probability == pytest.approx(0.9)
    assert "with probability at least 0.9000" in seen[-1].now
    assert seen[0].now == "true_risk: no bound yet."
    stage.journal.close()


@pytest.mark.rest
@pytest.mark.usefixtures("no_disk")
def test_a_claim_without_risk_shows_no_weight_of_it(tmp_path: Path) -> None:
    listed = json.loads(a_list().model_dump_json(exclude_none=True))
    config = CampaignConfig.model_validate_json(
        json.dumps({**listed, "problems": [{**listed["problems"][0], "name": "robustness"}]})
    )
    assert isinstance(config.space, Scenarios)
    seen = list[ReportData]()

    def look() -> bool:
        seen.append(collected(tmp_path))
        return False

    finish(play(tmp_path, config, look), tmp_path)
    number = len(config.space.scenarios)
    text = f"expected robustness, clipped to [-0.05, 0.15], at the worst of the {number} listed starts \u2265 "
    found = collected(tmp_path)
    assert any(each.now.startswith(text) for each in seen), "while it runs"
    assert found.now == found.claims[0].sentence
    assert found.now.startswith(text)
    assert (found.risk_weight, found.problems[0].quantity) == (None, "expected_robustness")
    assert found.clip == (-0.05, 0.15)


def test_the_words_promise_no_more_than_the_numbers(finished: Path) -> None:
    for claim in collected(finished).claims:
        sign = {">=": "≥", "<=": "≤"}[claim.sense]
        number = float(claim.sentence.split(f" {sign} ")[1].split()[0].replace("\u2212", "-"))
        assert number <= claim.bound if claim.sense == ">=" else number >= claim.bound
        assert float(claim.sentence.split("at least ")[1].split(".  ")[0].split()[0].rstrip(".")) <= claim.probability


# More than two parameters, fine lattices


@pytest.mark.parametrize("dimension", [1, 2, 3, 4])
def test_every_two_parameters_have_a_plane_through_the_worst_start(dimension: int) -> None:
    """The mean at a node tells the node; the worst start was refined, and is nearest to the nodes 2, 1, 0, 1."""
    lattice = Lattice((0.0,) * dimension, (3.0,) * dimension, 4)
    mean = lattice.nodes @ 10.0 ** np.arange(dimension)
    flags = tuple((mean == mean.max()).tolist())
    found = Band(tuple(mean), tuple(mean - 0.5), tuple(mean + 0.5), flags)
    method = SimpleNamespace(band=lambda _: found, probability=0.95)
    (plan,) = (each for each in plans(CONFIGS["rigorous"], TEST_FUNCTION).values() if each.sense == "max")
    worst = (2.1, 0.8, 0.0, 1.4)[:dimension]
    planes = surfaces.surfaces(
        replace(plan, candidates=lattice, clip=UNBOUNDED), cast(Any, method), cast(Any, None), worst
    )
    assert [each.axes for each in planes] == ([(0,)] if dimension == 1 else [*combinations(range(dimension), 2)])
    for plane in planes:
        assert plane.through == (2.0, 1.0, 0.0, 1.0)[:dimension]
        assert plane.shape == (4,) * len(plane.axes)
        for number, node in enumerate(np.ndindex(*plane.shape)):
            start = np.array(plane.through)
            start[list(plane.axes)] = node
            assert plane.mean[number] == start @ 10.0 ** np.arange(dimension)
            assert plane.worst[number] == (start == 3.0).all()


def test_all_planes_together_are_small() -> None:
    for dimension in range(2, 18):
        most = int(MAX_NODES ** (1 / dimension) + 1e-9)
        nodes = surfaces._kept(most, int(surfaces.MOST_NODES**0.5)) ** 2
        assert math.comb(dimension, 2) * nodes <= 9000


@pytest.mark.parametrize(("resolution", "count"), [(51, 51), (101, 51), (98, 54), (400, 54), (2, 2)])
def test_a_fine_lattice_is_thinned_and_loses_no_possible_worst(resolution: int, count: int) -> None:
    values = np.zeros((resolution, resolution))
    possible = np.zeros_like(values, dtype=np.bool_)
    possible[resolution - 2, 1] = True
    thin, shape = surfaces._thinned(surfaces._Arrays(values, values, values, possible))
    assert shape == (count, count)
    assert thin.mean.size <= surfaces.MOST_NODES
    (at,) = np.argwhere(thin.possible)
    assert (
        np.abs(at / (count - 1) - np.array([resolution - 2, 1]) / (resolution - 1)).max() <= 0.5 / (count - 1) + 1e-12
    )


@given(st.integers(1, 3000), st.integers(0, 2**32))
def test_a_thinned_curve_keeps_ends_and_extremes(size: int, seed: int) -> None:
    values = np.random.default_rng(seed).standard_normal(size)
    t, thin = curves.thinned(np.arange(len(values)) / 100, values)
    assert len(t) == len(thin) <= curves.MOST_POINTS
    assert list(t) == sorted(set(t))
    assert (thin[0], thin[-1]) == (values[0], values[-1])
    assert (min(thin), max(thin)) == (values.min(), values.max())


# Columns and limits


def header(specification: str, name: str = "segway-paper") -> Header:
    return Header.new(config(name, specification=specification), load_system("segway").spec, {})


@pytest.mark.parametrize(
    ("specification", "limits"),
    [
        ("always (abs(phi) <= 0.95)", (("phi", -0.95), ("phi", 0.95))),
        ("always (phi < 0.5 and -0.25 <= phi)", (("phi", -0.25), ("phi", 0.5))),
        ("always (-phi <= 0.5)", (("phi", -0.5),)),
        ("eventually (0.5 >= phi)", (("phi", 0.5),)),
        ("always (phi + 1 <= 0.5)", ()),
    ],
)
def test_limits_are_read_from_simple_predicates(specification: str, limits: tuple[tuple[str, float], ...]) -> None:
    assert curves.limits(header(specification), ("phi",)) == limits


def chasing(specification: str) -> Header:
    names = [f"y{k}" for k in range(1, 6)]
    columns = (Column(name="t", unit="s"), *(Column(name=name, unit="m") for name in names))
    spec = load_system("segway").spec.model_copy(update={"columns": columns})
    return Header.new(config("segway-paper", specification=specification), spec, {})


CHASE = "always[0,1] ((always[0,1] y2 - y1 <= 20) or (eventually[0,1] y5 - y4 >= 40))"


@pytest.mark.parametrize(
    ("specification", "deciding", "shown"),
    [
        (CHASE, ("y2 - y1", "y1", "y2"), ("y2 - y1", "y5 - y4", "y1")),
        (CHASE, ("y5 - y4", "y5", "y4"), ("y5 - y4", "y2 - y1", "y1")),
        ("always (y1 <= 1 and y2 <= 1 and y3 <= 1 and y4 <= 1)", ("y4",), ("y4", "y1", "y2")),
        ("always (y1 <= 2 * y2)", (), ("y1 - 2 * y2", "y1", "y2")),
        ("always (t >= 1 implies y3 <= 1)", ("t", "y3"), ("y3",)),
    ],
)
def test_what_the_specification_compares_is_drawn_first(
    specification: str, deciding: tuple[str, ...], shown: tuple[str, ...]
) -> None:
    about = chasing(specification)
    assert curves.relevant_quantities(about, about.config.problems[0], deciding) == shown


def test_a_compared_expression_has_values_unit_and_limits() -> None:
    about = chasing(CHASE)
    names = ("y2 - y1", "y5 - y4")
    assert curves.limits(about, names) == (("y2 - y1", 20.0), ("y5 - y4", 40.0))
    assert curves.limits(chasing("always (y1 <= y2)"), ("y1 - y2",)) == (("y1 - y2", 0.0),)
    units = [curves.quantity_unit(about, name) for name in ("y1", *names, "y1 * y2")]
    assert units == ["m", "m", "m", ""]
    samples = np.array([[0.0, 1, 2, 3, 4, 6], [1.0, 1, 25, 3, 4, 7], [2.0, 1, 4, 3, 4, 8]])
    trajectory = Trajectory(("t", "y1", "y2", "y3", "y4", "y5"), samples)
    assert curves.values_of(trajectory, "y2 - y1").tolist() == [1.0, 24.0, 3.0]
    tree = curves.formula(about)
    assert over_time.deciding_quantities(trajectory, tree) == {"y2 - y1", "y1", "y2"}
    assert over_time.deciding_quantities(trajectory, None) == frozenset()


def test_the_unit_of_the_objective_is_that_of_its_column() -> None:
    about = header("always (abs(phi) <= 0.95)")
    assert [unit(problem, about.config, about.spec) for problem in about.config.problems] == ["rad", "rad"]
    assert unit(about.config.problems[0], header("always (phi^2 <= 0.95)").config, about.spec) == ""


# Rollouts of a test


def test_every_recorded_column_is_of_the_specification_or_a_further_one() -> None:
    about = header("always (abs(phi) <= 0.95)")
    shown = curves.relevant_quantities(about, about.config.problems[0])
    others = curves.further_columns(about, shown)
    assert shown == ("phi",)
    assert ("t", *sorted((*shown, *others))) == ("t", *sorted(each.name for each in about.spec.columns[1:]))


def test_a_scene_shows_the_worst_tests_nominal_against_true(finished: Path) -> None:
    report_data = collected(finished)
    for problem in report_data.problems:
        ranked = {(each.problem, each.test) for each in report_data.ranked}
        shown = [scene for scene in report_data.scenes if scene.problem == problem.name]
        y, x = numbers(problem.tests.y), problem.tests.x
        order = sorted(problem.tests.test, key=lambda test: (y[test] if problem.sense == "min" else -y[test], test))
        worst = [test for place, test in enumerate(order) if x[test] not in [x[each] for each in order[:place]]]
        others = [scene.test for scene in shown if (problem.name, scene.test) not in ranked]
        assert others == [test for test in worst[:8] if (problem.name, test) not in ranked]
        assert {test for name, test in ranked if name == problem.name} <= {scene.test for scene in shown}
        assert len(worst) < len(order) or problem.method != "scenario"
        for scene in shown:
            assert scene.error is None
            assert {trace.column for trace in scene.traces} == {"value"}
            assert (scene.limits, scene.limit_columns) == ((0.002,), ("value",))
            if problem.name == "sim_gap":
                assert {trace.variant for trace in scene.traces} == {"nominal", "true"}
            robustness = [each.robustness for each in scene.rollouts]
            assert robustness == sorted(robustness, key=lambda value: value or 0.0)


def test_a_damaged_or_missing_file_leaves_its_curve_out(one: Path) -> None:
    scene = next(scene for scene in collected(one).scenes if scene.problem == "sim_gap")
    first, second = (one / rollout.path for rollout in scene.rollouts)
    first.write_bytes(b"x" + first.read_bytes()[1:])
    found = Collector(one).rollouts_of_test("sim_gap", scene.test)
    assert len(found.traces) == len(scene.traces) - 1
    assert found.error is not None
    assert first.name in found.error
    second.unlink()
    report_data = collected(one)
    again = next(each for each in report_data.scenes if (each.problem, each.test) == ("sim_gap", scene.test))
    assert again.traces == ()
    assert again.rollouts == scene.rollouts
    assert again.error is not None
    assert second.name in again.error


def test_a_restored_file_is_read_again(one: Path) -> None:
    collector = Collector(one)
    scene = next(scene for scene in collected(one).scenes if scene.problem == "sim_gap")
    path = one / scene.rollouts[0].path
    data = path.read_bytes()
    path.unlink()
    assert collector.rollouts_of_test("sim_gap", scene.test) != scene
    path.write_bytes(data)
    assert collector.rollouts_of_test("sim_gap", scene.test) == scene


@pytest.mark.parametrize("problem", ["", "no", "../sim_gap", HOSTILE])
def test_a_scene_of_no_problem_is_refused(one: Path, problem: str) -> None:
    with pytest.raises(PerfboundError, match="choose one of nominal_robustness, sim_gap") as error:
        Collector(one).rollouts_of_test(problem, 0)
    assert len(str(error.value)) < 1000


@pytest.mark.parametrize("test", [-1, 8, 10**9])
def test_a_scene_of_no_test_is_refused(one: Path, test: int) -> None:
    with pytest.raises(PerfboundError, match="no test"):
        Collector(one).rollouts_of_test("sim_gap", test)


# Counterexamples


def test_counterexamples_come_worst_first_with_what_reproduces_them(finished: Path) -> None:
    report_data = collected(finished)
    found = [rollout.robustness for rollout in report_data.counterexamples]
    assert found == sorted(value for value in found if value is not None)
    assert report_data.violations == len(found) > 0
    for rollout in report_data.counterexamples:
        assert rollout.robustness is not None
        assert rollout.robustness < 0
        assert rollout.command == f"perfbound replay {finished} {rollout.id}"
        assert (finished / rollout.path).is_file()


def test_a_system_that_is_not_installed_is_named_to_simulate_again_and_one_of_a_session_has_no_command() -> None:
    spec = load_system("test-function").spec
    fact = cast("RolloutFact", SimpleNamespace(rollout=RolloutId("robustness", 0, "nominal", 0)))

    def command(found: SystemSpec, system: str | None) -> str:
        header = cast("Header", SimpleNamespace(spec=found))
        return replay_command(Path("run"), header, str(fact.rollout), system)

    assert command(spec, None) == "perfbound replay run robustness.0.nominal.0"
    assert command(spec, "/me/cars.py:cars") == "perfbound replay run robustness.0.nominal.0 --system /me/cars.py:cars"
    assert command(spec.model_copy(update={"repeated": "session"}), None) == ""


def test_a_directory_with_a_blank_is_quoted(tmp_path: Path, no_disk: None) -> None:
    directory = tmp_path / "a b;rm"
    directory.mkdir()
    finish(play(directory, a_list()), directory)
    report_data = collected(directory)
    assert report_data.counterexamples[0].command.startswith(f"perfbound replay '{directory}' true_risk.")
    assert report_data.resume == f"perfbound resume '{directory}'"


# Untrusted text


def test_hostile_names_are_text(one: Path) -> None:
    attempt = {"rollout": "sim_gap.0.true.0", "attempt": 7, "worker": HOSTILE}
    insert(one, "attempts", **attempt, host=HOSTILE, pid=1, session=1, started=0.0)
    insert(one, "outcomes", **attempt, ended=1.0, outcome="lost", cpu_seconds=0.5, wall_seconds=1.5)
    report_data = Collector(one).refresh({HOSTILE: LiveState(HOSTILE, HOSTILE, 1.0)})
    text = to_json(report_data)
    assert "<" not in text
    assert "\u2028" not in text
    (worker,) = (each for each in json.loads(text)["workers"] if each["name"] == HOSTILE)
    assert (worker["host"], worker["state"], worker["rollout"], worker["failures"]) == (HOSTILE, HOSTILE, HOSTILE, 1)


@pytest.mark.parametrize("path", ["../../etc/passwd", "/etc/passwd", "trajectories/../../x", "javascript:alert(1)"])
def test_a_path_that_leaves_the_run_directory_is_no_link_and_is_not_read(one: Path, path: str) -> None:
    row = {"problem": "sim_gap", "test": 0, "block": 0, "variant": "true", "replicate": 9, "seed": 1, "violations": 1}
    insert(one, "rollouts", seq=10**6, **row, sha256="0" * 64, size=1, path=path, robustness=-0.04, by_tolerance=0)
    scene = Collector(one).rollouts_of_test("sim_gap", 0)
    assert scene.error is not None
    assert "is not a path in the run directory" in scene.error
    assert [each.path for each in scene.rollouts if each.replicate == 9] == [""]


def test_a_number_that_is_not_finite_is_refused(one: Path) -> None:
    report_data = collected(one)
    with pytest.raises(ValueError, match="not JSON compliant"):
        to_json(replace(report_data, risk_weight=math.nan))
    with pytest.raises(ValueError, match="not JSON compliant"):
        to_json(replace(report_data, clip=(0.0, math.inf)))


def test_json_keeps_unix_times_to_the_millisecond(one: Path) -> None:
    text = to_json(replace(collected(one), updated=1795266057.8321, risk_weight=0.123456789))
    found = json.loads(text)
    assert found["updated"] == 1795266057.8321
    assert found["risk_weight"] == 0.1234568


# Workers


def test_work_adds_up(finished: Path) -> None:
    report_data = collected(finished)
    assert sum(worker.rollouts for worker in report_data.workers) == report_data.rollouts
    assert {worker.state for worker in report_data.workers} == {"unknown"}
    assert {worker.host for worker in report_data.workers} == {"memory"}
    assert report_data.throughput.recorded[-1] == report_data.rollouts
    assert list(report_data.throughput.seconds) == sorted(report_data.throughput.seconds)
    assert report_data.throughput.sessions == 1


def test_the_latest_failed_attempts_come_with_their_kind(one: Path) -> None:
    for number in range(MOST_FAILED + 9):
        row = {"rollout": "sim_gap.0.true.0", "attempt": number + 2, "worker": "w", "cpu_seconds": 0, "wall_seconds": 0}
        kind = "system" if number % 2 else "infrastructure"
        insert(one, "outcomes", **row, ended=float(number), outcome="x" * 4000, kind=kind)
    report_data = collected(one)
    assert (report_data.throughput.failures, report_data.throughput.system_failures) == (59, 29)
    assert [each.ended for each in report_data.failed_attempts] == [float(number) for number in range(58, 8, -1)]
    assert [each.kind for each in report_data.failed_attempts[:2]] == ["infrastructure", "system"]
    assert {len(each.reason) for each in report_data.failed_attempts} == {500}


@pytest.mark.rest
def test_of_a_thousand_workers_those_that_matter_have_rows(one: Path) -> None:
    for number in range(1000):
        row = {"rollout": "sim_gap.0.true.0", "worker": f"w{number:03d}", "cpu_seconds": 0, "wall_seconds": 0}
        for attempt in range(2 if number % 20 == 0 else 1):
            insert(one, "outcomes", **row, attempt=2 + 2 * number + attempt, ended=1.0, outcome="lost", kind="system")
    before = collected(one).compared_results
    pause = {"session": 1, "kind": "worker", "reason": "three in a row"}
    insert(one, "set_aside", **pause, name="w997", at=2.0, seconds=30.0)
    insert(one, "set_aside", **pause, name="w997", at=40.0, seconds=60.0)
    insert(one, "set_aside", **pause, name="w997", at=50.0, seconds=0.0)
    insert(one, "set_aside", **pause, name="w998", at=3.0, seconds=math.inf)
    insert(one, "opinions", kind="outvoted", rollout="sim_gap.0.true.0", attempt=1, worker="w999", sha256="f", at=4.0)
    for number in range(60):
        row = {"rollout": f"sim_gap.{number}.true.0", "attempt": 1, "worker": "w000", "sha256": "e", "at": 5.0}
        insert(one, "opinions", kind="compared", **row)
    collector = Collector(one)
    found = collector.refresh({"w001": LiveState("idle")})
    names = [each.name for each in found.workers]
    known = len({*names, *(f"w{number:03d}" for number in range(1000)), "puppet-00000"})
    assert (len(names), found.more_workers) == (100, known - 100)
    assert {"w997", "w998", "w999", "w001", *(f"w{number:03d}" for number in range(0, 1000, 20))} <= set(names)
    assert [(each.name, each.times, each.for_good, each.last) for each in found.set_aside] == [
        ("w998", 1, True, 3.0),
        ("w997", 2, False, 40.0),
    ]
    assert found.compared_results == before + 61
    assert len(found.compared) == 50
    assert (found.compared[0].kind, found.compared[0].worker) == ("outvoted", "w999")
    assert found.compared[1].rollout == "sim_gap.59.true.0"
    assert collector.refresh().compared_results == before + 61, "each is read once"


def test_the_live_state_of_workers_is_added(finished: Path) -> None:
    report_data = Collector(finished).refresh(
        {"puppet-00001": LiveState("busy", "sim_gap.3.true.0", 5.0), "new": LiveState("idle")}, 7.0
    )
    states = {worker.name: (worker.state, worker.rollout, worker.heartbeat) for worker in report_data.workers}
    assert states["puppet-00001"] == ("busy", "sim_gap.3.true.0", 5.0)
    assert states["puppet-00000"] == ("unknown", None, None)
    assert states["new"] == ("idle", None, None)
    assert report_data.updated == 7.0


def test_a_long_campaign_has_few_points(one: Path) -> None:
    statistics, about = WorkerStatistics(), ChangeReader(one).read().header
    outcomes = tuple(AttemptOutcome("r", 1, "w", "recorded", float(t), 0.5, 1.0) for t in range(5000))
    lost = AttemptOutcome("r", 1, "w", "hung", 5000.0, 0.0, 10.0)
    session = Session("h", 0.0, None, None, "x86", None, None)
    statistics.add(Changes(about, (), {}, {"w": 5000}, (), (*outcomes, lost), {"w": "h"}, (session, session)))
    found = statistics.throughput()
    assert len(found.seconds) == len(found.recorded) == 200
    assert (found.recorded[0], found.recorded[-1], found.seconds[-1]) == (1, 5000, 4999.0)
    assert found.rate == pytest.approx(1.0)
    ((worker,), more) = statistics.rows({})
    assert more == 0
    assert (worker.rollouts, worker.failures, worker.busy_seconds, worker.last) == (5000, 1, 5010.0, 5000.0)


def test_a_result_of_a_batch_counts_for_all_its_rollouts(one: Path) -> None:
    statistics, about = WorkerStatistics(), ChangeReader(one).read().header
    about = replace(about, config=about.config.model_copy(update={"batch": 8}))
    outcomes = tuple(AttemptOutcome("r", 1, "w", "recorded", float(t), 0.5, 1.0) for t in range(10))
    statistics.add(Changes(about, (), {"p": 80}, {"w": 80}, (), outcomes, {"w": "h"}, ()))
    found = statistics.throughput()
    assert (found.recorded[0], found.recorded[-1], found.seconds[-1]) == (8, 80, 9.0)
    assert found.rate == pytest.approx(8.0)
    ((worker,), _) = statistics.rows({})
    assert (worker.rollouts, worker.busy_seconds) == (80, 10.0)


def test_the_inputs_of_a_start_are_curves_with_their_steps() -> None:
    found = config("segway-paper")
    space = {
        "x": Range(low=0.0, high=1.0, signal="linear", knots=2),
        "y": Range(low=0.0, high=1.0, signal="constant", knots=2),
    }
    system = load_system("segway").spec
    over_time = tuple(each.model_copy(update={"signal": True, "unit": "N"}) for each in system.parameters)
    about = Header.new(
        found.model_copy(update={"space": space}), system.model_copy(update={"parameters": over_time}), {}
    )
    ramp, steps = curves.of_signals(about, (0.0, 1.0, 0.25, 0.75))
    assert [(each.name, each.unit) for each in (ramp, steps)] == [("x", "N"), ("y", "N")]
    assert (ramp.t[0], ramp.t[-1]) == (steps.t[0], steps.t[-1]) == (0.0, found.horizon)
    assert [(each.kind, each.low, each.high) for each in (ramp, steps)] == [
        ("linear", 0.0, 1.0),
        ("constant", 0.0, 1.0),
    ]
    assert ramp.knots == (0.0, found.horizon)
    assert steps.knots == (0.0, found.horizon / 2)
    assert set(ramp.knots) <= set(ramp.t), "the page marks the points of the curve that are knots"
    assert ramp.values == pytest.approx(np.array(ramp.t) / found.horizon)
    (rise,) = np.flatnonzero(np.diff(steps.values))
    assert steps.t[rise + 1] - steps.t[rise] < 1e-5 * found.horizon, "drawn as a vertical line"
    assert (steps.values[0], steps.values[-1]) == (0.25, 0.75)
    assert list(curves.of_signals(Header.new(found, system, {}), (1.0, 1.0))) == []


def test_a_long_input_is_a_curve_without_marks_and_a_sine_has_its_periods() -> None:
    found, system = config("segway-paper"), load_system("segway").spec
    space = {
        "x": Range(low=0.0, high=1.0, signal="linear", knots=101),
        "y": Range(low=-2.0, high=2.0, signal="sine", amplitude=Range(low=0.0, high=2.0), frequency=10 / found.horizon),
    }
    over_time = tuple(each.model_copy(update={"signal": True}) for each in system.parameters)
    about = Header.new(
        found.model_copy(update={"space": space}), system.model_copy(update={"parameters": over_time}), {}
    )
    long, sine = curves.of_signals(about, (*np.linspace(0.0, 1.0, 101).tolist(), 2.0))
    assert (long.knots, sine.knots) == ((), ())
    assert np.interp(found.horizon / 3, long.t, long.values) == pytest.approx(1 / 3)
    assert (sine.low, sine.high) == (-2.0, 2.0)
    assert np.count_nonzero(np.diff(np.sign(sine.values))) >= 19
    assert long_inputs(about) == {f"x_{k}": "x" for k in range(101)}


def test_listed_starts_have_points_and_no_shape(tmp_path: Path, no_disk: None) -> None:
    finish(play(tmp_path, a_list()), tmp_path)
    report_data = collected(tmp_path)
    (surface,) = report_data.problems[0].surfaces
    assert (surface.axes, surface.through) == ((0, 1), ())
    assert (surface.shape, surface.points[3], set(surface.upper)) == (None, (4.5, 2.0), {None})
    assert [(axis.low, axis.high) for axis in report_data.axes] == [(0.0, 4.5), (0.0, 3.0)]
