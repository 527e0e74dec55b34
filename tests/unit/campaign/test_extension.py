"""Campaigns that continue after their budget: what is allowed, what is listed, and what verification finds."""

import json
import math
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import perfbound
from perfbound.orchestrator.campaign.closing.spot_check import LEVEL
from perfbound.orchestrator.campaign.extension import extension_words
from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.run import service
from perfbound.orchestrator.run.display.progress_table import progress_table
from perfbound.orchestrator.run.extend import extend_campaign
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.progress import read_progress
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.orchestrator.store.untrusted import read_untrusted
from perfbound.schemas.errors import CampaignError, IllegalEvent, JournalError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.block_facts import each_fact, each_rollout
from perfbound.schemas.result.facts import BoundFact, ExtensionFact, ProposalFact
from perfbound.schemas.rollout import RolloutRequest
from tests.facts import facts, says
from tests.fakes.simulators import noise, predicate, robustness, simulate, statuses, verified

EXACT: dict[str, Any] = {
    "method": "rigorous",
    "alpha": 1e-6,
    "rkhs_norm": 2.0,
    "noise_scale": 0.0,
    "kernel": {"nu": 2.5, "length_scale": 0.5},
}
NOISY = EXACT | {"noise_scale": "derived", "rkhs_norm": 3.0}


@pytest.fixture(autouse=True, scope="module")
def impatient() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda _: None)
        patch.setattr(service, "TICK", 0.01)
        yield


def wave(request: RolloutRequest) -> float:
    z1, z2 = request.x
    return 0.7 + 0.4 * math.sin(4 * z1) * math.cos(3 * z2)


def copied(request: RolloutRequest) -> float:
    """All replicates of a test have one value."""
    return wave(request) + 0.05 * noise(request.test)


def shaken(request: RolloutRequest) -> float:
    return wave(request) + 0.05 * noise(request.seed)


def campaign(problem: dict[str, Any] | None = None, **changes: Any) -> CampaignConfig:
    return robustness(problem or EXACT, **{"max_tests": 6, "spot_check": 12, "recheck": 3} | changes)


def extend(directory: Path, max_tests: int) -> ExtensionFact | None:
    with closing(Journal.open(directory)) as journal:
        return extend_campaign(directory, journal, max_tests)


def extended(directory: Path, config: CampaignConfig, max_tests: int, **options: Any) -> str | None:
    """Extend a finished campaign and run it to its next certificate."""
    assert extend(directory, max_tests)
    return simulate(directory, config, wave, noisy=False, **options)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign that ended by its budget of 6, and was extended to 10 tests."""
    directory = tmp_path_factory.mktemp("extended") / "run"
    simulate(directory, campaign(), wave, noisy=False)
    shutil.copytree(directory, directory.parent / "before")
    extended(directory, campaign(), 10)
    return directory


@pytest.fixture
def run(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "run"))


@pytest.fixture
def before(original: Path, tmp_path: Path) -> Path:
    """The campaign before its extension."""
    return Path(shutil.copytree(original.parent / "before", tmp_path / "before"))


def text(directory: Path) -> str:
    return (directory / files.CERTIFICATE).read_text()


def edit(directory: Path, statement: str) -> None:
    """Change rows that nothing but a forger changes."""
    with closing(sqlite3.connect(directory / DATABASE)) as connection:
        triggers = connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall()
        for (name,) in triggers:
            connection.execute(f"DROP TRIGGER {name}")
        connection.execute(statement)
        connection.commit()


@pytest.mark.rest
def test_a_budget_beyond_all_starts_is_cut_with_its_reason_and_may_be_repeated(before: Path) -> None:
    fact = extend(before, 700)
    assert fact == ExtensionFact(1, (("robustness", 81),))
    assert says(extension_words(fact, 700), "81 700 noise 81 starts")
    assert extend(before, 700) is None, "the same command again, after a crash"
    with pytest.raises(CampaignError, match="is for a campaign that has finished"):
        extend(before, 60)


# What the certificate says


def test_more_tests_prove_more_and_the_certificate_lists_from_where_to_where(run: Path, before: Path) -> None:
    found, earlier = predicate(text(run)), predicate(text(before))
    assert found["problems"][0]["tests"] == 10
    assert found["problems"][0]["bound"] >= earlier["problems"][0]["bound"]
    (line,) = [each for each in found["assumptions"] if each["id"].startswith("extended_")]
    assert (line["id"], line["status"]) == ("extended_1/robustness", "derived")
    assert line["values"] == {"problem": "robustness", "after": 6, "max_tests": 10}
    assert "extended it to 10" in line["detail"]
    assert line["id"] in found["claims"][0]["assumptions"]
    # Parameters were fixed beforehand, and stay what they were.
    assert found["problems"][0]["parameters"] == earlier["problems"][0]["parameters"]
    fixed = {each["id"]: each["detail"] for each in found["assumptions"]}["fixed_beforehand"]
    assert "extensions that are listed" in fixed
    assert not verified(run)


def test_the_certificate_of_before_is_kept_beside(run: Path, before: Path) -> None:
    for name, kept in ((files.CERTIFICATE, "certificate-1.json"), (files.MANIFEST, "manifest-1.sha256")):
        assert (run / kept).read_bytes() == (before / name).read_bytes()
    listed = (run / files.MANIFEST).read_text().splitlines()
    assert set((run / "manifest-1.sha256").read_text().splitlines()) < set(listed)


def test_the_closing_checks_are_new_ones_with_other_starts(run: Path, before: Path) -> None:
    found = predicate(text(run))
    stored = read_untrusted(run)
    proposals = [fact for fact in each_fact(stored.proposals) if isinstance(fact, ProposalFact)]
    starts = {
        name: {fact.proposal.x for fact in proposals if fact.problem == name} for name in ("spot_check", "spot_check_b")
    }
    assert not starts["spot_check"] & starts["spot_check_b"]
    assert len(starts["spot_check_b"]) == found["spot_check"]["starts"] == 12
    assert found["spot_check"]["level"] == LEVEL / 2
    assert predicate(text(before))["spot_check"]["level"] == LEVEL
    # Its limit is the bound of now.
    assert found["spot_check"]["problems"][0]["limit"] == found["problems"][0]["bound"]
    assert found["recheck"] == {"rollouts": 3, "agreed": 3, "unseen_share": found["recheck"]["unseen_share"]}
    seeds = [
        fact.seed
        for each in stored.rollouts
        for fact in each_rollout(each)
        if not fact.rollout.problem.startswith("recheck")
    ]
    assert len(set(seeds)) == len(seeds)


def test_other_budgets_draw_no_other_starts(before: Path, run: Path) -> None:
    extended(before, campaign(), 8)
    one, other = (
        [
            fact.proposal.x
            for fact in each_fact(read_untrusted(each).proposals)
            if isinstance(fact, ProposalFact) and fact.problem == "spot_check_b"
        ]
        for each in (before, run)
    )
    assert one == other


def test_a_second_extension_has_checks_of_its_own_and_half_their_level(run: Path) -> None:
    found = predicate(extended(run, campaign(), 12))
    assert [each["id"] for each in found["assumptions"] if each["id"].startswith("extended_")] == [
        "extended_1/robustness",
        "extended_2/robustness",
    ]
    assert found["spot_check"]["level"] == LEVEL / 4
    assert {fact.problem for fact in read_untrusted(run).proposals} >= {"spot_check_c", "recheck_c"}
    assert (run / "certificate-1.json").exists()
    assert (run / "certificate-2.json").exists()
    assert not verified(run)


@pytest.mark.rest
@pytest.mark.parametrize("workers", [1, 4])
def test_stops_and_workers_change_nothing(before: Path, run: Path, workers: int) -> None:
    seen = 0

    def stop(_: RolloutRequest) -> bool:
        nonlocal seen
        seen += 1
        return seen == 3

    assert extended(before, campaign(), 10, stop=stop, workers=workers) is None
    assert not extend(before, 10), "the same command again continues"
    assert simulate(before, campaign(), wave, noisy=False, workers=workers) == text(run)


@pytest.mark.rest
def test_a_noisy_problem_keeps_its_window(tmp_path: Path) -> None:
    config = campaign(NOISY, clip=[-1, 1], window=3, max_tests=5, spot_check_followups=4)
    simulate(tmp_path / "run", config, shaken, noisy=True)
    assert extend(tmp_path / "run", 9)
    simulate(tmp_path / "run", config, shaken, noisy=True)
    assert predicate(text(tmp_path / "run"))["problems"][0]["tests"] == 9
    assert not verified(tmp_path / "run")


@pytest.mark.parametrize("key", ["until_counterexample", "anytime"])
def test_drawn_starts_whose_bounds_hold_after_every_sample(tmp_path: Path, key: str) -> None:
    config = campaign({"method": "sample"}, max_tests=20, clip=[-1, 1], **{key: True})
    simulate(tmp_path / "run", config, wave, noisy=False)
    first = predicate(text(tmp_path / "run"))["claims"][0]["bound"]
    extended(tmp_path / "run", config, 40)
    assert predicate(text(tmp_path / "run"))["claims"][0]["bound"] < first
    assert not verified(tmp_path / "run")


@pytest.mark.rest
def test_requirements_share_an_extension(tmp_path: Path) -> None:
    parts = [{"name": "high", "formula": "value >= 0.0"}, {"name": "low", "formula": "value <= 2.0"}]
    config = campaign(EXACT | {"rkhs_norm": 9.0}, specification=None, specifications=parts)
    simulate(tmp_path / "run", config, wave, noisy=False)
    found = predicate(extended(tmp_path / "run", config, 9))
    lines = [each["id"] for each in found["assumptions"] if each["id"].startswith("extended_")]
    assert lines == ["extended_1/robustness/high", "extended_1/robustness/low"]
    assert not verified(tmp_path / "run")


# What is refused


@pytest.mark.parametrize(
    ("problem", "changes", "reason"),
    [
        (
            {
                "method": "paper",
                "alpha": 1e-6,
                "rkhs_norm": 2.0,
                "noise_scale": 0.01,
                "c": 1.0,
                "kernel": EXACT["kernel"],
            },
            {"clip": [-1, 1]},
            "method 'paper' bound test",
        ),
        (
            {"method": "kriging", "rkhs_norm": 2.0, "kernel": EXACT["kernel"]},
            {"clip": [-1, 1], "max_tests": 12},
            "method 'kriging' every start 12 tests",
        ),
        ({"method": "sample"}, {"max_tests": 70, "clip": [-1, 1]}, "number of samples was fixed at 70"),
        (EXACT | {"alpha": 10.0}, {}, "budget robustness: converged"),
        (
            NOISY,
            {"clip": [-1, 1], "resolution": 2, "replicates": 8, "recheck": 0},
            "the certificate refutes independent_rollouts/robustness",
        ),
        (EXACT, {"max_tests": 20}, "no more than the 20 tests so far"),
        (EXACT, {"resolution": 2, "max_tests": 4}, "every start has been tested"),
    ],
)
def test_an_extension_that_proves_nothing_is_refused_with_the_reason(
    tmp_path: Path, problem: dict[str, Any], changes: dict[str, Any], reason: str
) -> None:
    directory = tmp_path / "run"
    function = copied if "refutes" in reason else wave
    assert simulate(directory, campaign(problem, **changes), function, noisy=problem.get("noise_scale") != 0.0)
    before = {path: path.read_bytes() for path in directory.glob("*.json")}
    with pytest.raises(CampaignError, match="cannot be extended") as refused:
        extend(directory, 20)
    assert says(str(refused.value), reason)
    assert {path: path.read_bytes() for path in directory.glob("*.json")} == before


def hole(request: RolloutRequest) -> float:
    """Return `wave`, but for starts that no search of few tests sees."""
    return -5.0 if request.problem.startswith("spot") else wave(request)


def test_a_refuted_bound_cannot_be_tested_until_a_check_passes(tmp_path: Path) -> None:
    simulate(tmp_path / "run", campaign(), hole, noisy=False)
    assert statuses(text(tmp_path / "run"))["rkhs_norm/robustness"] == "refuted"
    with pytest.raises(CampaignError, match=facts("extended spot_check refutes bound")):
        extend(tmp_path / "run", 20)
    with closing(Journal.open(tmp_path / "run")) as journal:
        ledger = Ledger(tmp_path / "run", journal)
        ledger.replay()
        with pytest.raises(IllegalEvent, match="the spot_check refutes a bound"), ledger.transaction():
            ledger.extend(ExtensionFact(1, (("robustness", 20),)))


def test_a_campaign_that_has_not_finished_is_resumed_first(tmp_path: Path) -> None:
    simulate(tmp_path / "run", campaign(), wave, noisy=False, stop=lambda _: True)
    with pytest.raises(CampaignError, match="continue this one with `perfbound resume"):
        extend(tmp_path / "run", 20)


# Crashes


def test_a_crash_before_the_fact_leaves_the_certificate_of_before(before: Path) -> None:
    there = text(before)
    files.withdraw(before, 1)
    assert simulate(before, campaign(), wave, noisy=False) == there
    assert (before / "certificate-1.json").read_text() == there


def test_an_envelope_of_before_is_taken_away(before: Path) -> None:
    (before / files.ENVELOPE).write_text("signed")
    extend(before, 10)
    assert (before / "certificate-1.dsse.json").read_text() == "signed"
    assert not (before / files.ENVELOPE).exists()
    assert not (before / files.CERTIFICATE).exists()


# Forgeries


def test_an_extension_that_is_gone_from_the_database_is_found(run: Path) -> None:
    edit(run, "DELETE FROM extensions")
    assert verified(run) == ["database"]
    with closing(Journal.open(run)) as journal, pytest.raises(JournalError, match="contradict each other"):
        Ledger(run, journal).replay()


@pytest.mark.parametrize(
    "budgets",
    ['[["robustness", 9]]', '[["robustness", 11]]', '[["other", 10]]', "[]"],
)
def test_an_edited_extension_in_the_database_is_found(run: Path, budgets: str) -> None:
    edit(run, f"UPDATE extensions SET budgets = '{budgets}'")
    assert verified(run) == ["database"]
    with closing(Journal.open(run)) as journal, pytest.raises(JournalError, match="contradict each other"):
        Ledger(run, journal).replay()


def forged(directory: Path, change: Callable[[list[dict[str, Any]]], list[dict[str, Any]]]) -> list[str]:
    """Change the assumptions of the certificate, write it as perfbound does, and return the checks that fail."""
    path = directory / files.CERTIFICATE
    content = json.loads(path.read_text())
    content["predicate"]["assumptions"] = change(content["predicate"]["assumptions"])
    path.write_text(json.dumps(content, sort_keys=True, indent=1) + "\n")
    return verified(directory)


def without(assumptions: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [each for each in assumptions if not each["id"].startswith("extended_")]


def changed(**values: Any) -> Callable[[list[dict[str, Any]]], list[dict[str, Any]]]:
    def change(assumptions: list[dict[str, Any]]) -> list[dict[str, Any]]:
        for each in assumptions:
            if each["id"].startswith("extended_"):
                each["values"] |= values
        return assumptions

    return change


def renumbered(assumptions: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [each | {"id": each["id"].replace("extended_1", "extended_2")} for each in assumptions]


@pytest.mark.parametrize(
    ("change", "check"),
    [
        (without, "evidence"),
        (changed(max_tests=9), "requests"),
        (changed(max_tests=11), "stop"),
        (changed(max_tests=True), "certificate"),
        (changed(max_tests="10"), "stop"),
        (changed(problem="sim_gap"), "stop"),
        (changed(after=5), "audit"),
        (renumbered, "stop"),
    ],
)
def test_a_forged_certificate_is_found(run: Path, change: Any, check: str) -> None:
    failed = forged(run, change)
    assert check in failed


def test_an_extension_that_never_was_is_found(before: Path) -> None:
    line = {
        "id": "extended_1/robustness",
        "status": "derived",
        "detail": "",
        "values": {"problem": "robustness", "after": 6, "max_tests": 10},
    }
    assert "stop" in forged(before, lambda assumptions: [*assumptions, line])


@pytest.mark.rest
def test_the_chain_covers_the_extension(before: Path) -> None:
    """One step and two may have the same rollouts, where nothing is checked in between; never the same chain."""
    config = campaign(spot_check=0, recheck=0)
    heads = []
    for budgets in ((10,), (8, 10)):
        directory = before.parent / f"run-{len(budgets)}"
        simulate(directory, config, wave, noisy=False)
        for budget in budgets:
            extended(directory, config, budget)
        heads.append(predicate(text(directory))["evidence"])
    assert heads[0]["manifest_sha256"] == heads[1]["manifest_sha256"]
    assert heads[0]["chain_head"] != heads[1]["chain_head"]
    line = read_untrusted(before.parent / "run-2").extensions
    assert line == (ExtensionFact(1, (("robustness", 8),)), ExtensionFact(2, (("robustness", 10),)))


# What is shown


def test_progress_and_report_have_the_larger_budget(before: Path, original: Path) -> None:
    collector = Collector(before)
    assert collector.refresh().state == "finished"
    extend(before, 10)
    (progress,) = read_progress(before).problems
    assert (progress.tests, progress.stopped_by, progress.extended) == (6, None, 10)
    shown = collector.refresh()
    assert (shown.state, shown.problems[0].stopped_by, shown.problems[0].budget) == ("stopped", None, 10)
    assert not shown.claims
    simulate(before, campaign(), wave, noisy=False)
    (progress,) = read_progress(before).problems
    assert (progress.tests, progress.stopped_by, progress.extended) == (10, "budget", 10)
    shown = collector.refresh()
    assert (shown.state, shown.problems[0].stopped_by, shown.problems[0].observed) == ("finished", "budget", 10)
    fresh = Collector(before).refresh()
    assert replace(fresh, updated=None) == replace(shown, updated=None)
    table = progress_table(campaign(), [(progress, "-")])
    assert "10 of 10" in [cell for column in table.columns for cell in column.cells]
    assert read.observed(original)[-1][0].problem == "recheck_b"


def test_tables_have_the_checks_of_every_extension(run: Path) -> None:
    found = perfbound.open(run)
    assert set(found.tests["problem"]) == {"robustness"}
    assert set(found.closing_checks["problem"]) == {"spot_check", "recheck", "spot_check_b", "recheck_b"}
    assert len(found.table("observations")["test"]) == 10 + 2 * (12 + 3)
    assert not len(found.table("counterexamples")["test"])


def test_a_bound_of_before_is_no_end_after_an_extension(before: Path) -> None:
    extend(before, 10)
    with closing(Journal.open(before)) as journal:
        ledger = Ledger(before, journal)
        ledger.replay()
        (account,) = ledger.accounts.values()
        assert not ledger.done
        assert isinstance(account.last_bound, BoundFact)
        assert (account.last_bound.stopped_by, account.budget, account.progress.extended) == (None, 10, 10)
