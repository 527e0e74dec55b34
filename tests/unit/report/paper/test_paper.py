import csv
import io
import shutil
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from rich.console import Console

from perfbound.orchestrator.report import style
from perfbound.orchestrator.report.paper import figures, study, table
from perfbound.orchestrator.report.paper.figures import Decay
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store.facts import ObservedTest
from perfbound.orchestrator.store.journal import Journal
from perfbound.schemas.errors import CampaignError, PerfboundError
from perfbound.schemas.file.composition import Rule
from perfbound.schemas.file.objectives import ProblemName
from perfbound.schemas.result.certificate import (
    CampaignId,
    CertificateClaim,
    CompositionTerms,
    Evidence,
    Predicate,
    ProblemResult,
    Rollouts,
)
from perfbound.schemas.result.facts import BoundFact, Header, ObservationFact, ProposalFact
from perfbound.schemas.values import Bound, Observation, Proposal, StoppedBy
from perfbound.workers.systems.test_function import TestFunctionSystem
from tests import campaigns
from tests.facts import facts

# Which campaigns


def planned(tmp_path: Path, *, functions: int = 0, seeds: int = 0, direct: int = 0, ours: bool = False) -> list[str]:
    extent = study.Extent(functions, seeds, direct, ours)
    return [each.label for each in study.planned(extent, campaigns.FOLDER, tmp_path)]


def test_every_preset_has_its_seeds_and_its_directory(tmp_path: Path) -> None:
    assert planned(tmp_path) == []
    assert planned(tmp_path, functions=2, seeds=1) == ["test-function-0", "test-function-1", "segway-paper-0"]
    assert planned(tmp_path, direct=2) == ["segway-direct-0", "segway-direct-1"]
    assert planned(tmp_path, ours=True) == ["segway-rigorous-1", "segway-scenario-1"]
    one = study.planned(study.Extent(0, 4, 0, ours=False), campaigns.FOLDER, tmp_path)[3]
    assert one.config == campaigns.config("segway-paper", seed=3, recheck=20)
    assert one.directory == tmp_path / "campaigns" / "segway-paper-3"


def test_missing_files_and_problems_are_named(tmp_path: Path) -> None:
    extent = study.Extent(1, 0, 0, ours=False)
    with pytest.raises(PerfboundError, match=r"nowhere: no such folder; .* --campaigns"):
        study.planned(extent, tmp_path / "nowhere", tmp_path)
    with pytest.raises(CampaignError, match=r"test-function\.toml: No such file"):
        study.planned(extent, tmp_path, tmp_path)
    shutil.copy(campaigns.FOLDER / "test-function-rigorous.toml", tmp_path / "test-function.toml")
    with pytest.raises(PerfboundError, match=facts("'maximum' method 'paper'")):
        study.planned(extent, tmp_path, tmp_path)


def test_the_time_left_is_measured_per_cost() -> None:
    assert study.time_left([], [1, 2]) is None
    assert study.time_left([(1, 3.0), (3, 9.0)], [2, 5]) == pytest.approx(21)


def test_only_unfinished_campaigns_are_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = study.planned(study.Extent(4, 0, 0, ours=False), campaigns.FOLDER, tmp_path)
    finished = {"test-function-0", "test-function-2"}
    monkeypatch.setattr(study.Planned, "finished", property(lambda campaign: campaign.label in finished))
    monkeypatch.setattr(study, "_run_or_resume", lambda campaign, _workers: finished.add(campaign.label))
    monkeypatch.setattr(study, "time_left", lambda done, _costs: 75.0 if done else None)
    first = "campaign 2 of 4: test-function-1\ncampaign 4 of 4: test-function-3, about 1 min 15 s left\n"
    for expected in (first, ""):
        out = io.StringIO()
        study.run_unfinished(plan, workers=1, console=Console(file=out))
        assert out.getvalue() == expected
    assert len(finished) == 4


# The history of a campaign


def an_observed_test(  # noqa: PLR0917
    test: int,
    x: tuple[float, ...],
    y: float,
    regret: float | None,
    upper: float | None,
    stopped_by: StoppedBy | None = None,
) -> ObservedTest:
    verdict = None if stopped_by == "budget" else stopped_by
    chosen = Proposal(test, x, 0.0, 1.0, None, regret)
    return ObservedTest(test, chosen, Observation(y, (y,)), Bound(upper, None, verdict), stopped_by)


def test_the_history_holds_observed_tests_alone(tmp_path: Path) -> None:
    journal = Journal.create(tmp_path, Header.new(campaigns.config("test-function"), TestFunctionSystem().spec, {}))
    with journal.transaction():
        for test, (regret, upper) in enumerate([(None, None), (0.5, 1.25), (0.25, None)]):
            journal.add(ProposalFact("maximum", test, Proposal(test, (0.0, float(test)), 0.0, 1.0, None, regret)))
            if test < 2:
                journal.add(ObservationFact("maximum", test, Observation(0.125, (0.125,)), "link"))
                journal.add(BoundFact("maximum", test, Bound(upper, None, None), budget=test > 0))
    journal.close()
    assert recorded_facts.history(tmp_path) == {
        "maximum": (
            an_observed_test(0, (0.0, 0.0), 0.125, None, None),
            an_observed_test(1, (0.0, 1.0), 0.125, 0.5, 1.25, "budget"),
        )
    }


# Tables


def a_result(name: ProblemName, bound: float, tests: int, true: int) -> ProblemResult:
    parameters: dict[str, object] = {"rkhs_norm": 0.1, "noise_scale": 0.15, "delta": 0.05, "alpha": 0.05, "c": 0.3}
    return ProblemResult(
        name=name,
        objective="",
        method="paper",
        sense="max",
        bound=bound,
        partner=None,
        probability=0.92435,
        probabilities={},
        tests=tests,
        rollouts=Rollouts(nominal=tests, true=true),
        stopped_by="converged",
        parameters=parameters,
        last_F=0.01,
    )


def a_predicate(
    seed: int, bound: float, problems: Sequence[ProblemResult], rule: Rule = "single", refuted: tuple[str, ...] = ()
) -> Predicate:
    claim = CertificateClaim(
        quantity="rho_star",
        sense=">=",
        bound=bound,
        probability=0.85443,
        rule=rule,
        method="paper",
        assumptions=refuted,
        refuted=refuted,
    )
    terms = CompositionTerms(rule=rule, nominal_bound=0, gap_bound=0, lipschitz=1, gap_term=0, risk_term=0, bound=bound)
    return Predicate(
        question={},
        campaign=CampaignId(name="c", seed=seed, config_sha256="0", system_sha256="0"),
        claims=(claim,),
        problems=tuple(problems),
        composition=None if rule == "single" else terms,
        assumptions=(),
        evidence=Evidence(manifest_sha256="0", chain_head="0", rollouts=3),
        software={},
        rules=1,
    )


def composed(seed: int, nominal: float, gap: float, tests: int) -> table.Finished:
    problems = [a_result("nominal_robustness", nominal, 10, 0), a_result("sim_gap", gap, tests, tests)]
    refuted = ("rkhs_norm/nominal_robustness", "rkhs_norm/sim_gap")
    return table.Finished("segway-paper", a_predicate(seed, nominal - gap - 0.08, problems, "product", refuted))


FINISHED = [
    composed(0, 0.5, 0.25, 20),
    composed(1, 0.5, 0.125, 40),
    composed(2, 0.5, 0.5, 30),
    table.Finished("segway-scenario", a_predicate(1, 0.66129, [a_result("true_risk", 0.66129, 7, 56)])),
]


def read(text: str) -> dict[str, dict[str, str]]:
    return {next(iter(row.values())): row for row in csv.DictReader(io.StringIO(text))}


def test_table_1_stands_beside_what_was_printed() -> None:
    found = read(table.table_csv(table.rows(FINISHED)))
    assert list(found) == ["true_risk", "nominal_robustness", "sim_gap", "theorem 2", "maximum"]
    gap = found["sim_gap"]
    assert (gap["printed_bound"], gap["seeds"], gap["B"], gap["c"]) == ("0.38", "3", "0.1", "0.3")
    assert (gap["bound_median"], gap["bound_least"], gap["bound_greatest"]) == ("0.25", "0.125", "0.5")
    assert (gap["tests_median"], gap["tests_least"], gap["tests_greatest"]) == ("30", "20", "40")
    both = found["theorem 2"]
    assert (both["printed_bound"], both["printed_probability"], both["printed_tests"]) == ("0", "0.84", "128")
    assert float(both["bound_median"]) == pytest.approx(0.17)
    assert (both["tests_median"], both["true_rollouts_median"], both["probability"]) == ("40", "30", "0.85443")


def test_nothing_run_is_nothing_claimed() -> None:
    """The scenarios' `true_risk` is another quantity than Table I's."""
    direct = read(table.table_csv(table.rows(FINISHED)))["true_risk"]
    assert (direct["printed_bound"], direct["printed_tests"], direct["seeds"]) == ("0.31", "385", "0")
    assert direct["bound_median"] == direct["tests_median"] == direct["probability"] == direct["B"] == ""
    assert all(len(line.split(",")) == len(table.COLUMNS) for line in table.table_csv(table.rows([])).splitlines()[:4])


def test_people_read_the_median_and_the_range() -> None:
    lines = table.table_markdown(table.rows(FINISHED)).splitlines()
    assert len({len(line) for line in lines}) == 1, "columns are aligned"
    gap = [cell.strip() for cell in lines[4].strip("|").split("|")]
    assert gap == [
        *("sim_gap: e~ =", "0.1", "0.15", "0.05", "0.05", "0.3", "0.38", "", "", "3"),
        *("0.250 (0.125 to 0.500)", "0.9243", "30 (20 to 40)", "30"),
    ]


def test_claims_list_what_is_refuted() -> None:
    rows = list(csv.DictReader(io.StringIO(table.claims_csv(table.claim_rows(FINISHED)))))
    assert [(row["source"], row["seed"]) for row in rows] == [
        ("printed in the paper", ""),
        *(("segway-paper", str(seed)) for seed in range(3)),
        ("printed in the paper", ""),
        ("segway-scenario", "1"),
    ]
    assert rows[0]["bound"] == "0"
    assert rows[1]["refuted"] == "rkhs_norm/nominal_robustness rkhs_norm/sim_gap"
    assert (rows[1]["tests"], rows[1]["nominal_rollouts"], rows[1]["true_rollouts"]) == ("30", "30", "20")
    assert (rows[5]["bound"], rows[5]["refuted"]) == ("0.66129", "")


def test_claims_for_people_promise_no_more() -> None:
    last = table.claims_markdown(table.claim_rows(FINISHED)).splitlines()[-1]
    assert [cell.strip() for cell in last.strip("|").split("|")] == [
        *("segway-scenario", "1", "0.6612", "0.8544", "7", "56", "none"),
    ]


# Figures


def decaying(count: int) -> tuple[ObservedTest, ...]:
    """Return tests at two points whose F halves."""
    return tuple(
        an_observed_test(
            i,
            (1.0, float(i == 0)),
            0.5,
            0.5**i if i else None,
            0.52 if i else None,
            "converged" if i == count - 1 else None,
        )
        for i in range(count)
    )


RUNS = {4: decaying(5), 2: decaying(7), 3: decaying(6), 9: decaying(6)}


def test_the_start_has_no_regret() -> None:
    assert figures.curve(decaying(3)) == ([1, 2], [0.5, 0.25])


def test_the_typical_run_has_the_median_number_of_tests() -> None:
    assert figures.typical(RUNS) == 3
    assert figures.typical({7: decaying(3), 5: decaying(9)}) == 7
    assert figures.counted(RUNS) == "6 tests (5 to 7)"
    assert figures.counted({1: decaying(4)}) == "4 tests"


def xs(line: Line2D) -> list[float]:
    return [float(x) for x in np.asarray(line.get_xdata())]


def ys(line: Line2D) -> list[float]:
    return [float(y) for y in np.asarray(line.get_ydata())]


def png(figure: Figure) -> tuple[int, ...]:
    """Return height and width of the picture in pixels."""
    data = style.png(figure)
    assert data == style.png(figure)
    return tuple(imread(io.BytesIO(data)).shape[:2])


def test_figure_2_draws_every_campaign_its_tests_and_its_bound() -> None:
    figure = figures.figure_2(Decay("maximum", 0.015, RUNS))
    function, bar, below = figure.axes
    drawn = [line for line in below.lines if xs(line)]
    curves, tolerance = drawn[:-1], drawn[-1]
    assert [len(xs(line)) for line in curves] == [4, 6, 5, 5]
    assert ys(tolerance) == [0.015, 0.015]
    assert (tolerance.get_color(), tolerance.get_linestyle()) == (style.RED, "--")
    dots = function.collections[-1]
    assert isinstance(dots, PathCollection)
    assert np.asarray(dots.get_offsets()).tolist() == [[1.0, 0.0], [1.0, 1.0]]
    assert dots.get_sizes()[0] > dots.get_sizes()[1]
    bounds = [line for line in bar.lines if line.get_color() == style.BLUE]
    assert [ys(line) for line in bounds] == [[0.52, 0.52]]
    assert bar.get_ylim()[1] > 0.52
    assert [text.get_text() for text in bar.texts] == [r"$\epsilon = 0.520$"]
    assert png(figure) == (int(4.8 * style.DPI), int(style.WIDTH * style.DPI))


def test_figure_4_has_a_panel_a_problem_with_one_thick_line() -> None:
    decays = [Decay("true_risk", 0.05, {0: decaying(9)}), Decay("sim_gap", 0.01, RUNS)]
    figure = figures.figure_4(decays)
    for axes, found, colour in zip(figure.axes, decays, (style.RED, style.GREEN), strict=True):
        lines = [line for line in axes.lines if xs(line) and line.get_marker() == "None"]
        thick = [line for line in lines if line.get_linewidth() == style.THICK and line.get_linestyle() == "-"]
        thin = [line for line in lines if line.get_linewidth() == style.THIN]
        dashed = [line for line in lines if line.get_linestyle() == "--"]
        ends = [line for line in axes.lines if line.get_marker() == "o"]
        assert len(thick) == 1
        assert len(xs(thick[0])) == len(found.runs[figures.typical(found.runs)]) - 1
        assert len(thin) == len(found.runs) - 1
        assert [ys(line) for line in dashed] == [[found.alpha] * 2]
        assert [xs(line)[0] for line in ends] == [tests[-1].test for tests in found.runs.values()]
        assert {line.get_color() for line in axes.lines} == {colour}
        assert axes.get_xlim()[1] > 8, "the longest run of all panels fits"
    assert png(figure)[1] == int(style.WIDTH * style.DPI)


def test_drawing_leaves_the_style_of_others_alone() -> None:
    before = dict(mpl.rcParams)
    style.png(figures.figure_2(Decay("maximum", 0.015, RUNS)))
    assert dict(mpl.rcParams) == before


def test_the_numbers_of_the_figures_are_in_their_csv() -> None:
    function = list(csv.DictReader(io.StringIO(figures.figure_2_csv(Decay("maximum", 0.015, {4: decaying(2)})))))
    assert function == [
        {"seed": "4", "test": "0", "z1": "1.0", "z2": "1.0", "y": "0.5", "F": "", "upper": "", "stopped_by": ""},
        {
            "seed": "4",
            "test": "1",
            "z1": "1.0",
            "z2": "0.0",
            "y": "0.5",
            "F": "0.5",
            "upper": "0.52",
            "stopped_by": "converged",
        },
    ]
    segway = figures.figure_4_csv([Decay("sim_gap", 0.01, {3: decaying(2)})]).splitlines()
    assert segway == [
        "problem,seed,test,F,alpha,stopped_by",
        "sim_gap,3,0,,0.01,",
        "sim_gap,3,1,0.5,0.01,converged",
    ]
