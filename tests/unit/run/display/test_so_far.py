"""What a run has shown so far: the audit and verdict before the end, the forecast of the end, their words and file."""

import json
import math
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.so_far import AuditSoFar, Holding
from perfbound.orchestrator.certificate.words.known_text import (
    bar_words,
    holding_rows,
    left_words,
    refutation_line,
    so_far_line,
)
from perfbound.orchestrator.cli.status import print_status, status_object
from perfbound.orchestrator.forecast.campaign_end import RolloutCounts, expected, expected_verdict
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.run import service
from perfbound.orchestrator.run.display.progress import PLAIN_PERIOD, Plain
from perfbound.orchestrator.run.display.so_far import Pace, SoFarListener
from perfbound.orchestrator.run.known import verdict_of
from perfbound.orchestrator.run.routers import RouterLink
from perfbound.orchestrator.run.service import RunStatus
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.lock import campaign_lock
from perfbound.orchestrator.store.so_far import NAME, read_so_far, remove_so_far, write_so_far
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.ids import closing_check
from perfbound.schemas.result.certificate import Assumption
from perfbound.schemas.result.known import Expected, SoFar, Span
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.values import MARKED, Bound, ProblemProgress
from tests.campaigns import FOLDER
from tests.facts import says
from tests.fakes.simulators import noise, robustness, simulate, spec

RIGOROUS: dict[str, Any] = {
    "method": "rigorous",
    "alpha": 1e-3,
    "rkhs_norm": 8.0,
    "noise_scale": 0.05,
    "kernel": {"nu": 2.5, "length_scale": 1.0},
}
SCENARIO = {"method": "scenario", "alpha": 1e-6, "replicates": 6}
SAMPLE = {"method": "sample"}
KRIGING = {"method": "kriging", "rkhs_norm": 1.0, "prior_mean": -0.7, "kernel": {"nu": 2.5, "length_scale": 0.5}}
LIST = {"space": {"scenarios": [[0.2, 0.2], [0.5, 0.8], [0.9, 0.4]]}}


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(service, "TICK", 0.01)


def quiet(request: RolloutRequest) -> float:
    return 0.5 + 0.01 * noise(request.seed)


def loud(request: RolloutRequest) -> float:
    return 0.5 + 0.1 * noise(request.seed)


def failing(request: RolloutRequest) -> float:
    return -0.5 + 0.01 * noise(request.seed)


def a_rigorous_one(**changes: Any) -> CampaignConfig:
    base = {"clip": [-10, 10], "replicates": 4, "max_tests": 30, "recheck": 0, "spot_check": 0}
    return robustness(RIGOROUS, **(base | changes))


def wavering(request: RolloutRequest) -> float:
    """Return a value with noise of which no two values are equal, as those of copies would be."""
    return 0.7 + 0.1 * math.sin(noise(request.seed))


class Output:
    """A terminal that keeps everything."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.refutations: list[tuple[str, str]] = []
        self.found: list[SoFar] = []

    def print_line(self, line: str) -> None:
        self.lines.append(line)

    def refuted(self, found: Assumption, then: str) -> None:
        self.refutations.append((found.id, then))

    def so_far(self, found: SoFar) -> None:
        self.found.append(found)


@contextmanager
def replayed(directory: Path) -> Iterator[Ledger]:
    with closing(Journal.open(directory)) as journal:
        ledger = Ledger(directory, journal)
        ledger.replay()
        yield ledger


def status_of(ledger: Ledger, *, seconds: float, recorded: int) -> RunStatus:
    return RunStatus(
        ledger.config,
        {name: account.progress for name, account in ledger.accounts.items()},
        {name: each.progress for name, each in ledger.series.items() if closing_check(name)},
        workers={},
        known={},
        recorded=recorded,
        waiting=0,
        seconds=seconds,
    )


def shown(directory: Path) -> tuple[SoFar, Output]:
    """Return what a listener has written about a campaign, after one rollout per second."""
    output = Output()
    with replayed(directory) as ledger:
        listener = SoFarListener(directory, ledger, output)
        listener.show(status_of(ledger, seconds=0.0, recorded=0))
        listener.show(status_of(ledger, seconds=10.0, recorded=10))
        listener._next = 0.0
        listener.show(status_of(ledger, seconds=10.0, recorded=10))
    found = read_so_far(directory)
    assert found == output.found[-1]
    return output.found[-1], output


CASES = {
    "rigorous": (a_rigorous_one(), quiet, True),
    "refuted": (a_rigorous_one(), loud, True),
    "violated": (a_rigorous_one(), failing, True),
    "exact": (robustness(RIGOROUS | {"noise_scale": 0.0}, max_tests=12, recheck=0, spot_check=0), lambda _: 0.5, False),
    "scenario": (robustness(SCENARIO, clip=[-1, 1], max_tests=20, recheck=0, **LIST), quiet, True),
    "sample": (robustness(SAMPLE, clip=[-1, 1], max_tests=80, recheck=0), quiet, True),
    "kriging": (
        robustness(KRIGING, max_tests=60, replicates=4, clip=(-1, 2), spot_check=0, recheck=0),
        wavering,
        True,
    ),
}


@pytest.mark.rest
@pytest.mark.parametrize("name", CASES)
def test_at_the_end_it_agrees_with_the_certificate(tmp_path: Path, name: str) -> None:
    config, function, noisy = CASES[name]
    simulate(tmp_path, config, function, noisy=noisy)
    certificate = files.read(tmp_path)
    assert certificate is not None
    found, output = shown(tmp_path)
    verdict = verdict_of(tmp_path, read.stored_header(tmp_path), certificate)
    assert (found.verdict, found.bound, found.probability) == (verdict.verdict, verdict.bound, verdict.probability)
    assert (found.claim, found.reasons) == (verdict.claim, verdict.reasons)
    assert found.violations == verdict.violations
    tested = {each.id: each for each in certificate.predicate.assumptions if each.status in ("refuted", "not refuted")}
    assert {each.id: each for each in found.assumptions} == tested
    assert [each.status for each in found.assumptions] == sorted(
        (each.status for each in tested.values()), reverse=True
    )
    assert [each for each, _ in output.refutations] == [key for key, each in tested.items() if each.status == "refuted"]


def cut(directory: Path, config: CampaignConfig, function: Any, after: int, *, noisy: bool = True) -> None:
    count = iter(range(1, 10**6))
    assert simulate(directory, config, function, noisy=noisy, stop=lambda _: next(count) == after) is None


TWO = [{"quantity": "mean"}, {"quantity": "next_rollout", "level": 0.1}]


@pytest.mark.parametrize(
    ("problem", "changes", "proven"),
    [
        (SAMPLE, {"claims": TWO, "max_tests": 80}, ">= 0.4"),
        (KRIGING, {"replicates": 4, "max_tests": 60, "spot_check": 0}, "nothing yet"),
    ],
    ids=["another claim has no bound yet", "no bound holds before the end"],
)
def test_both_tables_have_the_same_bound(
    problem: dict[str, Any], changes: dict[str, Any], proven: str, tmp_path: Path
) -> None:
    cut(tmp_path, robustness(problem, clip=[-0.3, 1], recheck=0, **changes), quiet, after=30)
    shown(tmp_path)
    lines = in_words(tmp_path).splitlines()
    (above,) = (line for line in lines if line.startswith("proven so far"))
    (below,) = (line for line in lines if line.startswith("robustness "))
    assert f"  {proven}" in above
    assert f" {proven.removeprefix('>= ')}" in below if proven.startswith(">=") else below.split()[4:7] == ["-"] * 3


def test_without_a_link_to_the_router_no_time_is_expected(tmp_path: Path) -> None:
    cut(tmp_path, a_rigorous_one(max_tests=60), quiet, after=120)
    output = Output()
    with replayed(tmp_path) as ledger:
        listener = SoFarListener(tmp_path, ledger, output)
        listener.show(status_of(ledger, seconds=0.0, recorded=0))
        for link in (RouterLink(None, 1), RouterLink(3.0, 0)):
            listener._next = 0.0
            listener.show(replace(status_of(ledger, seconds=10.0, recorded=10), link=link))
    up, down = output.found[1:]
    assert up.expected.seconds is not None
    assert down.expected == up.expected.model_copy(update={"seconds": None})
    assert holding_rows(up)[1].verdict.startswith("SHOWN, in about ")
    assert says(holding_rows(down)[1].verdict, "^SHOWN no time link router")


def test_status_reports_a_link_that_is_down(tmp_path: Path) -> None:
    cut(tmp_path, a_rigorous_one(max_tests=60), quiet, after=120)
    with replayed(tmp_path) as ledger, campaign_lock(tmp_path):
        listener = SoFarListener(tmp_path, ledger, Output())

        def status(link: RouterLink | None) -> tuple[str, float | None]:
            listener._next = 0.0
            listener.show(replace(status_of(ledger, seconds=10.0, recorded=10), link=link))
            return in_words(tmp_path), status_object(tmp_path)["router_link_down_for"]

        text, seconds = status(RouterLink(75.0, 0))
        assert says(text, "link router 1 min 15 s no rollout")
        assert seconds == pytest.approx(75.0, abs=30.0)
        for link in (RouterLink(None, 1), None):
            text, seconds = status(link)
            assert "the link to the router" not in text
            assert seconds is None
            assert "link_down_since" not in (tmp_path / NAME).read_text(), "an older perfbound reads the file"
        status(RouterLink(75.0, 0))
        Journal.open(tmp_path).close()  # a new session, which has written nothing yet
        assert status_object(tmp_path)["router_link_down_for"] is None
    status_of_stopped = status_object(tmp_path)
    assert status_of_stopped["router_link_down_for"] is None
    assert "the link to the router has been down" not in in_words(tmp_path)


def in_words(directory: Path) -> str:
    output = StringIO()
    print_status(directory, Console(file=output, width=200))
    return output.getvalue()


@pytest.mark.rest
def test_before_the_end_it_says_what_would_hold_and_what_is_expected(tmp_path: Path) -> None:
    cut(tmp_path, a_rigorous_one(max_tests=60), quiet, after=120)
    found, output = shown(tmp_path)
    assert found.verdict in ("SHOWN", "NOT SHOWN")
    assert found.bound is not None
    assert "ended by the budget" not in " ".join(found.reasons), "it has not ended"
    assert 20 <= found.tests < 60
    assert found.expected.tests is not None
    assert found.tests < found.expected.tests.low <= found.expected.tests.high <= 60
    assert found.expected.bound is not None
    assert found.bound <= found.expected.bound.low + 1e-9
    assert found.expected.seconds is not None
    assert 0 < found.expected.seconds.low <= found.expected.seconds.high
    assert 0 < found.expected.share < 1
    assert output.refutations == []
    report = Collector(tmp_path).refresh()
    assert report.live is not None
    assert report.live.rows[0][-1] == f"if it ended now: {found.verdict}"
    assert "after a resume, about " in report.live.rows[1][-1]
    assert status_object(tmp_path)["so_far"]["verdict"] == found.verdict
    console = Console(width=120, force_terminal=False)
    with console.capture() as captured:
        print_status(tmp_path, console)
    assert f"if it ended now: {found.verdict}" in captured.get()
    assert f"as of {found.tests} tests" in captured.get()


REQUIREMENTS = {
    "specification": None,
    "specifications": [
        {"name": "low", "formula": "value >= 0"},
        {"name": "high", "formula": "value <= 2"},
    ],
}


@pytest.mark.rest
@pytest.mark.parametrize("after", [3, 17, 60])
@pytest.mark.parametrize(
    ("problem", "changes"),
    [
        (RIGOROUS, REQUIREMENTS | {"replicates": 2}),
        (SAMPLE, REQUIREMENTS),
        (SAMPLE, {"falsify": {}}),
        (RIGOROUS, {"until_counterexample": True}),
        (SCENARIO, LIST),
        (SAMPLE, {"claims": [{"quantity": "quantile", "level": 0.1}, {"quantity": "mean"}]}),
    ],
)
def test_every_kind_of_campaign_has_it_at_any_moment(
    tmp_path: Path, problem: dict[str, Any], changes: dict[str, Any], after: int
) -> None:
    config = robustness(problem, **({"clip": [-10, 10], "max_tests": 80, "recheck": 0, "spot_check": 0} | changes))
    cut(tmp_path, config, quiet, after=after)
    with replayed(tmp_path) as ledger:
        tests = sum(len(account.observations) for account in ledger.accounts.values())
    if tests == 0:
        return
    found, output = shown(tmp_path)
    assert output.lines == []
    assert found.tests == tests
    assert found.verdict in ("SHOWN", "NOT SHOWN")
    assert holding_rows(found)[1].verdict


RISK = {"centre": 0.5, "spread": 0.1}


@pytest.mark.rest
def test_the_first_claim_needs_no_bound_of_other_problems(tmp_path: Path) -> None:
    pair = ["nominal_robustness", "sim_gap"]
    changes = {
        "problems": [
            {**RIGOROUS, "name": "true_risk", "noise_scale": 0.5, "max_tests": 4, "linearised": RISK},
            {**RIGOROUS, "name": pair[0], "noise_scale": 0.0},
            {**KRIGING, "name": pair[1], "max_tests": 40},
        ],
        "claims": [{"rule": "single", "problems": ["true_risk"]}, {"rule": "sum", "problems": pair}],
        "clip": [-1, 2],
        "risk_weight": 0.2,
        "horizon": 1.0,
        "gap": {"kind": "signal_sup", "column": "value", "lipschitz": 1.0},
    }
    table = a_rigorous_one().model_dump(mode="json", exclude_unset=True, exclude={"composition"})
    config = CampaignConfig.model_validate_json(json.dumps(table | changes))
    both = spec(noisy=True).model_copy(update={"variants": ("nominal", "true"), "noisy": ("true",)})
    last = "sim_gap.20.true.0"
    assert simulate(tmp_path, config, quiet, noisy=True, system=both, stop=lambda each: each.rollout == last) is None
    found, output = shown(tmp_path)
    assert output.lines == []
    assert found.bound is not None
    assert found.claim.startswith("Margin at least ")
    assert holding_rows(found)[0].bound != "nothing yet"


def test_what_further_claims_alone_rest_on_is_no_refutation_of_the_first() -> None:
    """A claim by method `kriging`, and for comparison the paper's, whose norms are refuted."""
    first, second = ((FOLDER / name).read_text() for name in ("segway.toml", "segway-paper.toml"))
    gap = 'gap = { kind = "signal_sup", column = "phi", lipschitz = 1.0 }\n'
    claims = """
        [[claims]]
        rule = "single"
        problems = ["true_risk"]
        [[claims]]
        rule = "product"
        problems = ["nominal_robustness", "sim_gap"]
        """
    problems = second[second.index("[[problems]]") :]
    ledger: Any = SimpleNamespace(config=parse_campaign((gap + first + claims + problems).encode(), "segway"))
    assert AuditSoFar(ledger)._concerns_first_claim(an_assumption("rkhs_norm/true_risk"))
    assert AuditSoFar(ledger)._concerns_first_claim(an_assumption("reproducible_rollouts"))
    assert not AuditSoFar(ledger)._concerns_first_claim(an_assumption("rkhs_norm/sim_gap"))
    of_gap = an_assumption("rkhs_norm/sim_gap")
    assert not Holding((of_gap,), None, ("rkhs_norm/sim_gap",)).refuted
    assert Holding((of_gap,), None, ()).refuted


def an_assumption(name: str) -> Assumption:
    return Assumption(id=name, status="refuted", detail="it is too small")


def test_a_fault_in_it_does_not_stop_the_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cut(tmp_path, a_rigorous_one(), quiet, after=60)
    output = Output()
    with replayed(tmp_path) as ledger:
        listener = SoFarListener(tmp_path, ledger, output)
        monkeypatch.setattr(listener, "_examined", lambda: 1 / 0)
        for second in range(3):
            listener.show(status_of(ledger, seconds=second, recorded=0))
    (line,) = output.lines
    assert says(line, "not shown: ZeroDivisionError")
    assert output.found == []


@pytest.mark.parametrize(
    ("config", "function", "words"),
    [
        (CASES["kriging"][0], CASES["kriging"][1], "kriging nothing last test"),
        (a_rigorous_one(), quiet, "few tests"),
    ],
)
def test_where_nothing_is_proven_it_says_so(tmp_path: Path, config: CampaignConfig, function: Any, words: str) -> None:
    cut(tmp_path, config, function, after=50 if "kriging" in words else 2)
    found, _ = shown(tmp_path)
    assert (found.verdict, found.bound) == ("NOT SHOWN", None)
    (reason,) = found.reasons
    assert says(reason, words)
    assert holding_rows(found)[0].bound == "nothing yet"
    assert "with probability" not in Collector(tmp_path).refresh().now, "the page agrees"


def test_a_bound_of_a_method_with_a_fixed_budget_is_no_bound_so_far(tmp_path: Path) -> None:
    cut(tmp_path, *CASES["kriging"][:2], after=50)
    page = Collector(tmp_path).refresh()
    assert page.problems[0].bound is not None
    assert says(page.now, "^robustness: not bound kriging")
    stream = StringIO()
    lines = Plain(Console(file=stream, width=300))
    lines._last -= PLAIN_PERIOD
    with replayed(tmp_path) as ledger:
        lines.show(status_of(ledger, seconds=0.0, recorded=50))
    assert ", with this budget the bound would be -" in stream.getvalue()


def test_the_line_counts_one_test_and_says_once_that_there_is_no_forecast(tmp_path: Path) -> None:
    cut(tmp_path, a_rigorous_one(), quiet, after=2)
    found, _ = shown(tmp_path)
    early = found.model_copy(
        update={"expected": found.expected.model_copy(update={"by_budget": True, "bound": None, "most_tests": 4100})}
    )
    line = so_far_line(early.model_copy(update={"tests": 1}))
    assert says(line, "1 test expected no forecast open")
    assert line.count("forecast") == 1
    assert line.endswith(" % of the budget of 4,100 tests")
    assert ", 1,200 tests); " in so_far_line(early.model_copy(update={"tests": 1200}))


@pytest.mark.parametrize(("key", "then"), [("continue", "the campaign continues"), ("stop", "robustness ends here")])
def test_a_refutation_is_reported_once_with_what_follows(tmp_path: Path, key: str, then: str) -> None:
    simulate(tmp_path, a_rigorous_one(on_refuted=key), loud, noisy=True)
    found, output = shown(tmp_path)
    (one,) = output.refutations
    assert one[0] == "replicate_spread/robustness"
    assert one[1].startswith(then)
    assert found.expected.verdict == found.verdict == "NOT SHOWN"
    assert found.on_refuted == key
    assert found.refuted
    assert holding_rows(found)[0].bound.endswith(", refuted")
    line = refutation_line(found.assumptions[0], one[1])
    assert says(line, "^REFUTED: replicate_spread/robustness: replicates")
    assert "\n" not in line


def test_the_file_is_of_one_run_and_goes_with_the_certificate(tmp_path: Path) -> None:
    cut(tmp_path, a_rigorous_one(), quiet, after=60)
    found, _ = shown(tmp_path)
    write_so_far(tmp_path, found.model_copy(update={"run": "another"}))
    assert Collector(tmp_path).refresh().live is None
    assert status_object(tmp_path)["so_far"] is None
    (tmp_path / NAME).write_text("{}")
    assert read_so_far(tmp_path) is None
    remove_so_far(tmp_path)
    remove_so_far(tmp_path)
    assert not (tmp_path / NAME).exists()
    write_so_far(tmp_path / "missing", found)  # a folder that is gone is the journal's business


def progress(tests: int, *, stopped_by: Any = None, rollouts: int | None = None) -> ProblemProgress:
    course = tuple((n, 1 + 2 / math.sqrt(n), 2 / math.sqrt(n)) for n in sorted(MARKED) if n <= tests)
    bound = Bound(1 + 2 / math.sqrt(tests), 1.0, None) if tests else None
    return ProblemProgress(tests, tests if rollouts is None else rollouts, None, bound, stopped_by, None, course)


NO_CHECKS = RolloutCounts({"robustness": 1}, (0, 0), 0)


def test_the_share_of_the_work_follows_the_forecast_and_is_of_the_budget_before() -> None:
    config = robustness(RIGOROUS | {"alpha": 0.1}, max_tests=1000, clip=[-10, 10])
    early = expected(config, {"robustness": progress(5)}, {}, NO_CHECKS, rate=2.0)
    assert early.by_budget
    assert early.tests is None
    assert early.share == pytest.approx(5 / 1000)
    assert bar_words(early) == "0 % of the budget of 1,000 tests"
    assert says(left_words(early), "^in 8 min 18 s at most budget")
    later = expected(config, {"robustness": progress(200)}, {}, NO_CHECKS, rate=2.0)
    assert not later.by_budget
    assert later.tests is not None
    # 2/sqrt(n) is .1 at n = 400
    assert later.tests.low <= 400 <= later.tests.high
    assert later.share == pytest.approx(200 / later.tests.middle, rel=0.01)
    assert later.seconds is not None
    assert later.seconds.middle == pytest.approx((later.tests.middle - 200) / 2)
    assert bar_words(later).endswith("% of the work, by forecast")


def test_closing_checks_are_part_of_the_work_with_what_follows_up() -> None:
    config = robustness(RIGOROUS, max_tests=1000, clip=[-10, 10])
    work = RolloutCounts({"robustness": 1}, (100, 300), 20)
    ended = {"robustness": progress(100, stopped_by="converged")}
    before = expected(config, ended, {}, work, rate=10.0)
    assert before.seconds == Span(low=12.0, middle=22.0, high=32.0)
    assert before.share == pytest.approx(100 / 320)
    check = {"spot_check": progress(0, rollouts=250)}
    assert expected(config, ended, check, work, rate=10.0).seconds == Span(low=2.0, middle=4.5, high=7.0)
    over = {"spot_check": progress(0, rollouts=250, stopped_by="converged")}
    found = expected(config, ended, over, work, rate=10.0)
    assert found.seconds == Span(low=2.0, middle=2.0, high=2.0)
    assert left_words(found) == "in about 2 s"


@pytest.mark.parametrize(
    ("ends", "now", "required", "word"),
    [
        ((0.1, 0.5), "NOT SHOWN", 0.0, "SHOWN"),
        ((-0.5, -0.1), "NOT SHOWN", 0.0, "NOT SHOWN"),
        ((-0.5, 0.1), "NOT SHOWN", 0.0, None),
        ((0.1, 0.5), "VIOLATED", 0.0, "VIOLATED"),
        ((0.1, 0.5), "NOT SHOWN", None, None),
    ],
)
def test_the_verdict_at_the_end_is_open_where_the_range_has_both(
    ends: tuple[float, float], now: Any, required: float | None, word: Any
) -> None:
    span = Span(low=ends[0], middle=sum(ends) / 2, high=ends[1])
    found = Expected(share=0.5, by_budget=False, tests=None, most_tests=9, seconds=None, bound=span, verdict=None)
    assert expected_verdict(found, now, required, refuted=False) == word
    assert expected_verdict(found, now, required, refuted=True) == now


def test_a_share_falls_only_with_a_word(tmp_path: Path) -> None:
    cut(tmp_path, a_rigorous_one(), quiet, after=60)
    output = Output()
    with replayed(tmp_path) as ledger:
        listener = SoFarListener(tmp_path, ledger, output)

    def share(value: float, seconds: float = 0.0) -> float:
        found = Expected(share=value, by_budget=False, tests=None, most_tests=9, seconds=None, bound=None, verdict=None)
        return listener._never_falling(found, seconds).share

    assert [share(each) for each in (0.5, 0.48, 0.52)] == [0.5, 0.5, 0.52]
    assert output.lines == []
    assert share(0.3) == 0.3
    (line,) = output.lines
    assert says(line, "forecast 30 % not 52 %")
    assert [share(0.6, 10.0), share(0.2, 59.0), share(0.2, 60.0)] == [0.6, 0.6, 0.2], "at most one line a minute"
    assert len(output.lines) == 2


def test_the_pace_of_slow_rollouts_is_that_of_the_whole_run() -> None:
    pace = Pace()
    status: Any = type("Status", (), {})
    for second in range(0, 3600, 60):
        status.seconds, status.recorded = float(second), second // 300
        rate = pace.of(status)
    assert rate == pytest.approx(1 / 300, rel=0.1)
    quick = Pace()
    for second in range(1000):
        # Ten a second, then a hundred.
        status.seconds, status.recorded = float(second), 10 * min(second, 500) + 100 * max(0, second - 500)
        rate = quick.of(status)
    assert rate == pytest.approx(100)


def test_json_has_no_value_that_json_lacks(tmp_path: Path) -> None:
    cut(tmp_path, a_rigorous_one(), quiet, after=60)
    shown(tmp_path)
    json.loads(json.dumps(status_object(tmp_path), allow_nan=False))
