"""Comparisons on functions: what is drawn in common, what may be compared, what is continued, and what is written."""

import io
import json
import os
import re
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from perfbound.orchestrator.release.compare import conduct
from perfbound.orchestrator.release.compare.conduct import COMPARISON, REPORT, Terms, compare_pairs
from perfbound.orchestrator.release.compare.outputs import print_comparison, row
from perfbound.orchestrator.release.compare.report import _table
from perfbound.orchestrator.release.compare.systems import Compared, in_common, paired
from perfbound.orchestrator.release.compare.worst_case import bounded, compare_worst
from perfbound.orchestrator.run.extend import extend_campaign
from perfbound.orchestrator.run.link import Link
from perfbound.orchestrator.run.options import RunOptions
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.read import stored_header
from perfbound.schemas.errors import CampaignError, PerfboundError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.disturbance import Disturbance
from perfbound.schemas.link.configuration import LOCAL
from perfbound.schemas.result.comparison import Comparison
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.system import Column, SystemSpec
from tests.facts import facts
from tests.fakes.simulators import Function, noise, robustness, simulate, spec

RIGOROUS = {"method": "rigorous", "alpha": 0.1, "rkhs_norm": 2.0, "noise_scale": 0.0, "kernel": {"length_scale": 0.7}}
NOISY, QUIET = spec(noisy=True), spec(noisy=False)
OPTIONS = RunOptions(1, Link(LOCAL))


def good(request: RolloutRequest) -> float:
    return 0.5 + 0.1 * noise(request.seed) - 0.3 * request.x[0]


def bad(request: RolloutRequest) -> float:
    return good(request) - 0.1


def system(name: str, found: SystemSpec = NOISY, **changes: Any) -> Compared:
    config = robustness(RIGOROUS, **{"clip": [-1, 1], "spot_check": 20} | changes)
    listed = config.space.rows if hasattr(config.space, "rows") else ()
    return Compared(Path(f"{name}.toml"), config, name, found.model_copy(update={"doc": name}), listed)


def both(**changes: Any) -> tuple[Compared, Compared]:
    return paired(system("a", **changes), system("b", **changes))


class Runs:
    """In place of the sessions of two campaigns: each simulates its own function."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, functions: dict[str, Function], *, noisy: bool = True) -> None:
        self.functions, self.simulated, self.noisy = functions, dict.fromkeys(functions, 0), noisy
        self.stop: Callable[[RolloutRequest], bool] = lambda _: False
        monkeypatch.setattr(conduct, "start_campaign", self.start)
        monkeypatch.setattr(conduct, "resume_campaign", self.resume)
        monkeypatch.setattr(os, "fsync", lambda _: None)

    def start(self, config: CampaignConfig, source: Path, directory: Path, options: RunOptions, _: Console) -> None:
        self._simulate(directory, config)

    def resume(self, directory: Path, _options: RunOptions, _: Console, max_tests: int | None = None) -> None:
        if max_tests is not None:
            with closing(Journal.open(directory)) as journal:
                assert extend_campaign(directory, journal, max_tests)
        self._simulate(directory, stored_header(directory).config)

    def _simulate(self, directory: Path, config: CampaignConfig) -> None:
        name = directory.name

        def counted(request: RolloutRequest) -> float | tuple[float, ...]:
            self.simulated[name] += 1
            return self.functions[name](request)

        found = system(name, spec(noisy=self.noisy)).spec
        if simulate(directory, config, counted, noisy=self.noisy, stop=self.stop, system=found) is None:
            raise KeyboardInterrupt


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Comparison]:
    """Return what compares two functions in `tmp_path`, with the same runs each time."""
    runs = Runs(monkeypatch, {"a": good, "b": bad})

    def compared(systems: tuple[Compared, Compared] | None = None, **changes: Any) -> Comparison:
        found: dict[str, Any] = {"most_pairs": 60, "delta": 0.05, "equal": {}}
        terms = Terms(**found | changes)
        return compare_pairs(
            systems or both(), tmp_path / "out", terms, RunOptions(1, Link(LOCAL)), Console(quiet=True)
        )

    compared.runs = runs  # type: ignore[attr-defined]
    return compared


def printed(found: Comparison) -> str:
    console = Console(width=120, file=io.StringIO())
    print_comparison(found, console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


# What is drawn in common


def test_the_campaigns_keep_the_question_and_leave_the_method() -> None:
    one, other = both(candidates=20, required_margin=0.1, falsify={})
    (problem,) = one.config.problems
    assert problem.method == "sample"
    assert (one.config.specification, one.config.clip, one.config.space) == (
        "value >= 0",
        (-1, 1),
        system("a").config.space,
    )
    assert one.config.anytime
    assert one.config.draws == other.config.draws
    assert (one.config.falsify, one.config.candidates, one.config.required_margin) == (None, None, 0.0)


def test_requirements_lose_the_keys_of_their_bounds() -> None:
    parts = [
        {"name": "low", "formula": "value >= 0", "alpha": 0.2, "id": "R-1"},
        {"name": "up", "formula": "value < 3"},
    ]
    one, _ = both(specification=None, specifications=parts)
    assert [(each.formula, each.id, each.alpha) for each in one.config.specifications] == [
        ("value >= 0", "R-1", None),
        ("value < 3", None, None),
    ]


def test_another_version_of_a_system_gets_other_draws() -> None:
    draws = {
        paired(one, other, seed)[0].config.draws
        for one, other, seed in (
            (system("a"), system("b"), None),
            (system("a"), system("b"), 2),
            (system("a"), system("c"), None),
            (system("a", specification="value >= 0.1"), system("b", specification="value >= 0.1"), None),
        )
    }
    assert len(draws) == 4
    assert paired(system("a"), system("b"))[0].config.draws in draws


def test_what_a_pair_has_in_common_is_said() -> None:
    law = Disturbance(name="gust", distribution="normal", mean=0, sd=1)
    gusty = NOISY.model_copy(update={"disturbances": (law,)})
    windy = NOISY.model_copy(update={"disturbances": (law.model_copy(update={"sd": 2.0}),)})
    short = NOISY.model_copy(update={"seed_bits": 32})
    true = NOISY.model_copy(update={"variants": ("true",), "noisy": ("true",)})
    assert in_common(system("a"), system("b")) == ("starts", "seeds")
    assert in_common(system("a", gusty), system("b", gusty)) == ("starts", "seeds", "disturbances")
    assert in_common(system("a", gusty), system("b", windy)) == ("starts", "seeds")
    assert in_common(system("a"), system("b", short)) == ("starts",)
    assert in_common(system("a"), system("b", true)) == ("starts",)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"specification": "value >= 0.1"}, "a.toml b.toml specification 'value >= 0' 'value >= 0.1'"),
        ({"clip": [-1, 2]}, "clip.1 1.0 2.0"),
        ({"horizon": 0.5}, "horizon"),
        ({"where": "z1 > 0.5", "candidates": 20}, "where 'absent' 'z1 > 0.5'"),
    ],
)
def test_different_questions_are_refused_with_both_answers(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(CampaignError, match=facts(reason)):
        paired(system("a"), system("b", **changes))


def test_the_name_of_a_file_changes_no_draw() -> None:
    one, other = system("a"), system("b")
    named = replace(one, config=one.config.model_copy(update={"name": "other"}))
    first, second = paired(named, other)
    assert first.config.name == "other"
    assert first.config.draws == second.config.draws == both()[0].config.draws


def test_other_words_of_a_requirement_and_other_limits_are_the_same_question() -> None:
    part = {"name": "low", "formula": "value >= 0"}
    one = system("a", specification=None, specifications=[part | {"id": "R-1", "text": "old"}], deadline=20.0)
    other = system("b", specification=None, specifications=[part | {"text": "new"}], keep="all", second_opinion=0.5)
    first, second = paired(one, other)
    assert (first.config.deadline, second.config.second_opinion) == (20.0, 0.5)
    assert first.config.draws == second.config.draws


@pytest.mark.parametrize(
    ("columns", "reason"),
    [((("value", "cm"),), "column value 1 cm"), ((("other", "1"),), "column value 1 no such column")],
)
def test_a_column_of_the_specification_in_another_unit_is_refused(columns: Any, reason: str) -> None:
    found = (NOISY.columns[0], *(Column(name=name, unit=unit) for name, unit in columns))
    with pytest.raises(CampaignError, match=facts(reason)):
        paired(system("a"), system("b", NOISY.model_copy(update={"columns": found})))


def test_parameters_in_another_order_are_refused() -> None:
    turned = NOISY.model_copy(update={"parameters": NOISY.parameters[::-1]})
    with pytest.raises(CampaignError, match=facts("z1 z2 z2 z1 order")):
        paired(system("a"), system("b", turned))


# From the first pair to the document


def test_a_worse_system_is_found_and_everything_is_written(run: Callable[..., Comparison], tmp_path: Path) -> None:
    found = run(most_pairs=120)
    assert found.verdict == "WORSE"
    mean = found.differences[0]
    assert mean.lower < -0.1 < mean.upper < 0
    assert mean.b - mean.a == pytest.approx(-0.1), "the noise is in both"
    out = tmp_path / "out"
    assert Comparison.model_validate_json((out / COMPARISON).read_bytes()) == found
    page = (out / REPORT).read_text()
    assert "B IS WORSE: mean robustness" in page
    assert page.count("<svg") == 3
    assert "Where B gains most" in page
    assert "<script" not in page
    text = printed(found)
    assert re.search(r"mean robustness .* WORSE", text)
    assert "120 pairs of rollouts with the same starts and seeds" in text
    assert "B IS WORSE" in text


def test_it_ends_as_soon_as_it_is_decided(run: Callable[..., Comparison], tmp_path: Path) -> None:
    found = run(most_pairs=1000, until_decided=True, equal={"failure_probability": 0.5})
    assert found.pairs in (50, 100, 200)
    assert {each.verdict for each in found.differences} == {"WORSE", "EQUAL"}
    assert run(most_pairs=1000, until_decided=True, equal={"failure_probability": 0.5}) == found


def test_the_same_call_continues_after_it_was_stopped(run: Callable[..., Comparison], tmp_path: Path) -> None:
    runs: Runs = run.runs  # type: ignore[attr-defined]
    runs.stop = lambda _: sum(runs.simulated.values()) > 80
    with pytest.raises(KeyboardInterrupt):
        run()
    assert not (tmp_path / "out" / COMPARISON).exists()
    runs.stop = lambda _: False
    found = run()
    assert found.pairs == 60
    assert run() == found
    more = run(most_pairs=100)
    assert more.pairs == 100
    assert run() == more, "all that are recorded"


def test_another_comparison_in_the_folder_is_refused(run: Callable[..., Comparison], tmp_path: Path) -> None:
    run()
    with pytest.raises(PerfboundError, match=facts("out specification 'value >= 0' 'value >= 0.1' --out")):
        run(both(specification="value >= 0.1"))
    changed = system("b")
    with pytest.raises(PerfboundError, match=facts("out system sources A B seed --out")):
        run(paired(system("a"), replace(changed, spec=changed.spec.model_copy(update={"doc": "changed"}))))


def test_listed_starts_are_compared_at_the_worst_of_them(run: Callable[..., Comparison], tmp_path: Path) -> None:
    starts = [[0.0, 0.5], [0.5, 0.5], [1.0, 0.5]]
    listed = paired(system("a", space={"scenarios": starts}), system("b", space={"scenarios": starts}))
    assert listed[0].listed == ((0.0, 0.5), (0.5, 0.5), (1.0, 0.5))
    found = run(listed, most_pairs=200)
    assert [each.quantity for each in found.differences] == ["mean", "failure_probability", "worst_start"]
    worst = found.differences[-1]
    assert worst.lower < -0.1 < worst.upper
    assert worst.a == pytest.approx(0.2, abs=0.1)


def test_a_refuted_assumption_leaves_nothing_to_compare(run: Callable[..., Comparison], tmp_path: Path) -> None:
    calls = iter(range(10**6))
    run.runs.functions["b"] = lambda request: good(request) + 1e-3 * next(calls)  # type: ignore[attr-defined]
    with pytest.raises(PerfboundError, match=facts("out/b refutes reproducible_rollouts nothing")):
        run()
    assert not (tmp_path / "out" / COMPARISON).exists()


def test_a_system_that_was_changed_meanwhile_is_refused(run: Callable[..., Comparison], tmp_path: Path) -> None:
    run()
    one, other = both()
    changed = replace(other, spec=other.spec.model_copy(update={"doc": "changed"}))
    with pytest.raises(PerfboundError, match=facts("out/b sources b.toml --out")):
        run((one, changed))


def test_a_file_in_the_way_is_found_before_anything_is_simulated(
    run: Callable[..., Comparison], tmp_path: Path
) -> None:
    (tmp_path / "out" / "b").mkdir(parents=True)
    (tmp_path / "out" / "b" / "mine").write_text("")
    with pytest.raises(PerfboundError, match=facts("out/b not empty")):
        run()
    assert run.runs.simulated == {"a": 0, "b": 0}  # type: ignore[attr-defined]


def test_a_folder_of_something_else_is_refused(run: Callable[..., Comparison], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "campaign.db").write_text("")
    with pytest.raises(PerfboundError, match=facts("out not the folder of a comparison --out")):
        run()


def test_a_margin_of_what_is_not_compared_is_refused(run: Callable[..., Comparison]) -> None:
    with pytest.raises(PerfboundError, match=facts("--equal worst_start mean failure_probability")):
        run(equal={"worst_start": 1.0})


def test_a_hostile_name_is_text_on_the_page_and_no_line_is_cut(run: Callable[..., Comparison], tmp_path: Path) -> None:
    found = run(tuple(replace(each, given=Path("<script>&.toml")) for each in both()), most_pairs=5)
    page = (tmp_path / "out" / REPORT).read_text()
    assert "&lt;script&gt;&amp;.toml" in page
    assert "<script" not in page
    unit = found.differences[0].model_copy(update={"unit": "<b>"})
    assert "mean robustness, &lt;b&gt;" in _table(("",), [row(unit)])
    console = Console(width=30, file=io.StringIO(), force_terminal=True)
    print_comparison(found, console)
    assert isinstance(console.file, io.StringIO)
    assert "UNDECIDED" in console.file.getvalue().splitlines()[6]


def test_starts_that_differ_are_no_pairs(run: Callable[..., Comparison], tmp_path: Path) -> None:
    one, other = both()
    alone = replace(other, config=other.config.model_copy(update={"draws": "0" * 64}))
    with pytest.raises(PerfboundError, match="not simulated from the same starts"):
        run((one, alone))


def test_one_system_with_other_options_is_not_the_same(run: Callable[..., Comparison]) -> None:
    found = run(both(), most_pairs=5)
    alike = found.model_copy(update={"b": found.b.model_copy(update={"system_sha256": found.a.system_sha256})})
    assert "Both are one system" in printed(alike)
    aggressive = alike.b.model_copy(update={"options": {"gains": "aggressive"}})
    text = printed(alike.model_copy(update={"b": aggressive}))
    assert "B  b.toml, gains = aggressive" in text
    assert "Both are one system" not in text


def test_without_a_clip_the_output_says_what_is_missing(run: Callable[..., Comparison], tmp_path: Path) -> None:
    found = run(both(clip=None))
    assert [each.quantity for each in found.differences] == ["failure_probability"]
    assert "Without a clip no mean has a bound." in printed(found)
    assert json.loads((tmp_path / "out" / COMPARISON).read_text())["clip"] is None


# The worst case


def slope(request: RolloutRequest) -> float:
    return 0.5 - 0.2 * (sum(request.x) - 1.0)


def worst(out: Path, delta: float = 0.04, **changes: Any) -> Comparison:
    systems = bounded((system("a", QUIET, **changes), system("b", QUIET, **changes)), None, delta)
    terms = Terms(1000, delta, {"worst_case": 0.3} if "equal" in out.name else {})
    return compare_worst(systems, out, terms, OPTIONS, Console(quiet=True))


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> Runs:
    return Runs(monkeypatch, {"a": slope, "b": lambda request: slope(request) - 0.2}, noisy=False)


def test_worst_cases_are_compared_by_bounds_from_both_sides(exact: Runs, tmp_path: Path) -> None:
    found = worst(tmp_path / "out", problems=[{"name": "robustness", **RIGOROUS, "alpha": 0.01, "noise_scale": 0.0}])
    (difference,) = found.differences
    assert (difference.quantity, found.verdict, found.common, found.pairs) == ("worst_case", "WORSE", (), 0)
    assert difference.lower <= -0.2 <= difference.upper < -0.15
    text = printed(found)
    assert re.search(r"robustness at the worst start of all .* WORSE", text)
    assert "if the assumptions of both certificates hold" in " ".join(text.split())
    assert Comparison.model_validate_json((tmp_path / "out" / COMPARISON).read_bytes()) == found
    simulated = dict(exact.simulated)
    assert worst(tmp_path / "out", problems=[{"name": "robustness", **RIGOROUS, "alpha": 0.01}]) == found
    assert exact.simulated == simulated
    header = stored_header(tmp_path / "out" / "a")
    assert header.config.problems[0].delta == 0.02, "half for each"
    with pytest.raises(PerfboundError, match=facts("out problems.0.delta --out")):
        worst(tmp_path / "out", 0.05, problems=[{"name": "robustness", **RIGOROUS, "alpha": 0.01}])


def test_bounds_of_other_starts_are_no_comparison() -> None:
    with pytest.raises(CampaignError, match=facts("a.toml b.toml 20 starts every start candidates")):
        bounded((system("a", candidates=20), system("b")), None, 0.05)


def test_worst_cases_of_a_changed_system_are_computed_anew(exact: Runs, tmp_path: Path) -> None:
    worst(tmp_path / "out", resolution=3)
    systems = bounded((system("a", QUIET, resolution=3), system("c", QUIET, resolution=3)), None, 0.04)
    with pytest.raises(PerfboundError, match=facts("out/b sources c.toml --out")):
        compare_worst(systems, tmp_path / "out", Terms(1000, 0.04, {}), OPTIONS, Console(quiet=True))


def test_a_wide_tolerance_decides_nothing(exact: Runs, tmp_path: Path) -> None:
    assert worst(tmp_path / "out", resolution=3).verdict == "UNDECIDED"


def test_a_refuted_bound_is_not_compared(exact: Runs, tmp_path: Path) -> None:
    problem = {"name": "robustness", **RIGOROUS, "rkhs_norm": 0.05}
    with pytest.raises(PerfboundError, match=facts("out/a refutes rkhs_norm/robustness nothing show out/a")):
        worst(tmp_path / "out", problems=[problem])


@pytest.mark.parametrize(
    "changes",
    [
        {"problems": [{"name": "robustness", "method": "sample"}]},
        {"falsify": {}},
        {"specification": None, "specifications": [{"name": "low", "formula": "value >= 0"}]},
    ],
)
def test_what_has_no_bound_from_both_sides_has_no_worst_case(changes: dict[str, Any]) -> None:
    with pytest.raises(CampaignError, match=facts("b.toml worst case 'rigorous' 'scenario' --worst-case")):
        bounded((system("a"), system("b", **changes)), None, 0.05)
