"""A run read from its directory: certificate, tables, posterior and figures."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes

import perfbound as pb
from perfbound.library import run as run_module
from perfbound.library.run import Run
from perfbound.library.system_argument import GivenSystem
from perfbound.orchestrator.campaign.methods import method
from perfbound.orchestrator.campaign.plan import plans
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.schemas.errors import PerfboundError
from tests.facts import facts
from tests.fakes import finished
from tests.fakes.puppets import Stage


@pytest.fixture(scope="module", params=["paper", "rigorous", "scenario"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp(request.param)
    config = finished.a_list() if request.param == "scenario" else finished.a_pair(request.param)
    finished.finish(finished.play(folder, config), folder)
    return pb.open(folder)


def test_what_a_run_has(run: Run) -> None:
    assert run.finished
    assert run.certificate.claims[0].probability > 0.5
    assert run.verify().checks.good
    assert set(run.tests["problem"]) == {each.name for each in run.header.config.problems}
    assert len(run.rollouts) > len(run.tests)
    row = run.rollouts[0]
    assert run.trajectory(row["rollout"]).columns == ("t", "value")
    assert run.trajectory(0).samples.shape == run.trajectory(row["rollout"]).samples.shape
    assert "probability at least" in repr(run)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({}, "this campaign is here already; read it with"),
        ({"versions": {"numpy": "0"}}, "another campaign is here numpy"),
    ],
)
def test_a_campaign_of_changed_code_is_another_one(run: Run, changed: dict[str, object], words: str) -> None:
    """Its old result would be read as that of the new code."""
    system = GivenSystem(run.header.spec.declared.model_copy(update=changed), run.header.spec.name, {})
    with pytest.raises(PerfboundError, match=facts(words)):
        run_module.run_campaign(run.header.config, Path("c.toml"), system, run.directory, 1, progress=False)


def test_the_posterior_at_the_candidates_is_the_band_of_the_method(run: Run) -> None:
    for name, plan in plans(run.header.config, run.header.spec).items():
        fed, tests = method(plan, run.header), recorded_facts.history(run.directory)[name]
        fed.recall([(each.proposal, each.observation) for each in tests])
        band = fed.band(tests[-1].bound)
        found = run.posterior(plan.chosen_from.nodes, name)
        mean, lower, upper = map(np.array, (band.mean, band.lower, band.upper))
        if plan.objective.sense == "min":
            mean, lower, upper = -mean, -upper, -lower
        np.testing.assert_allclose(found.mean, mean, atol=1e-9)
        np.testing.assert_allclose(found.lower, lower, atol=1e-9)
        np.testing.assert_allclose(found.upper, upper, atol=1e-9)


def test_between_the_candidates_only_the_band_of_a_box_is_known(run: Run) -> None:
    between = [[0.1234, 0.4321]]
    if run.header.config.problems[0].method == "rigorous":
        found = run.posterior(between)
        assert found.lower[0] <= found.mean[0] <= found.upper[0]
    else:
        with pytest.raises(PerfboundError, match="is no candidate; method"):
            run.posterior(between)


def test_starts_that_are_none_are_refused(run: Run) -> None:
    for x, problem, words in (
        ([[9, 9]], None, "is outside the space"),
        ([[np.nan, 0]], None, "is outside the space"),
        ([1, 2, 3], None, "give one row a start, with z1, z2"),
        ([[0, 0]], "gap", "no problem 'gap'"),
    ):
        with pytest.raises(PerfboundError, match=words):
            run.posterior(x, problem)


def test_figures_are_axes_of_the_notebook(run: Run) -> None:
    with pyplot.rc_context({"backend": "agg"}):
        drawn = run.plot.map()
        assert isinstance(drawn, Axes)
        assert drawn.get_xlabel() == "z1"
        assert pyplot.fignum_exists(drawn.figure.number)  # type: ignore[union-attr]
        assert isinstance(run.plot.decay(), Axes)
        pyplot.close("all")
    with pytest.raises(PerfboundError, match="no problem 'x'"):
        run.plot.map("x")


def test_names_in_html_are_text(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_module, "_in_words", lambda _: "<script>")
    assert "<script>" not in run._repr_html_()


def test_before_the_first_observation(tmp_path: Path) -> None:
    stage = Stage(tmp_path, finished.a_pair("rigorous"), 1)
    stage.journal.close()
    early = pb.open(tmp_path)
    with pytest.raises(PerfboundError, match="retry later"):
        early.posterior([[0, 0]])
    for draw in (early.plot.map, early.plot.decay):
        with pytest.raises(PerfboundError, match="retry later"):
            draw()
