"""The report of a campaign in batches is read by block, and is the same as if it were read by test."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.collect.recorded_tests import ObservedTests, ProposedTests
from perfbound.orchestrator.report.data.page import ReportData
from perfbound.orchestrator.store import readonly
from perfbound.orchestrator.store.changes import ChangeReader, Changes, Decision, rollouts_of
from perfbound.orchestrator.store.export import counterexamples
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.result.block_facts import BlockObservationFact, BlockProposalFact, each_fact
from perfbound.schemas.result.facts import BoundFact, ObservationFact, ProposalFact
from perfbound.schemas.values import Bound, Observation
from tests.unit.campaign.batches.test_batched_campaign import Play, none, planned, sampled

NUMBER, BATCH = 12, 4
BOUNDS = [Bound(1.0 / (test + 1), None, None) for test in range(NUMBER)]


def blocks() -> Iterable[tuple[BlockProposalFact, BlockObservationFact, BoundFact]]:
    """Yield proposal, observation and bound of blocks; the last one ends the budget."""
    random = np.random.default_rng(1)
    for first in range(0, NUMBER, BATCH):
        last = first + BATCH - 1
        proposed = BlockProposalFact.of("p", first, np.arange(first, last + 1), random.uniform(size=(BATCH, 2)))
        observed = BlockObservationFact.of("p", first, random.normal(size=BATCH), random.normal(size=(BATCH, 3)))
        yield proposed, observed, BoundFact("p", last, BOUNDS[last], budget=last == NUMBER - 1, tests=BATCH)


def in_blocks() -> ObservedTests:
    proposed = ProposedTests()
    found = ObservedTests(proposed)
    for proposal, observation, bound in blocks():
        proposed.add(proposal)
        found.add([observation], bound)
    return found


def test_each_test_of_a_block_is_what_it_is_by_itself() -> None:
    proposed, whole = ProposedTests(), in_blocks()
    single = ObservedTests(proposed)
    for proposal, observation, bound in blocks():
        for each, seen in zip(proposal.each(), observation.each(), strict=True):
            proposed.add(each)
            last = each.test == bound.test
            single.add([seen], BoundFact("p", each.test, bound.bound, budget=last and bound.budget))
    assert len(whole) == len(single) == NUMBER
    for name in ("x", "y", "each"):
        assert np.array_equal(getattr(whole, name), getattr(single, name))
    assert [whole[test] for test in range(NUMBER)] == [single[test] for test in range(NUMBER)]
    assert whole.last == whole[-1]
    assert whole[-1].stopped_by == "budget"
    assert whole[-2].stopped_by is None
    whole.extend()
    assert whole[-1].stopped_by is None


def test_the_start_of_each_test() -> None:
    proposed = ProposedTests()
    for proposal, _, _ in blocks():
        proposed.add(proposal)
    starts = [tuple(x) for proposal, _, _ in blocks() for x in proposal.x.tolist()]
    assert [proposed.start(test) for test in range(NUMBER)] == starts
    assert proposed.start(-1) is proposed.start(NUMBER) is None
    assert [proposed.proposal(test).node for test in range(NUMBER)] == list(range(NUMBER))
    with pytest.raises(KeyError):
        proposed.proposal(NUMBER)


def test_facts_that_do_not_belong_together_are_refused() -> None:
    (proposal, observation, bound), _, _ = blocks()
    proposed = ProposedTests()
    with pytest.raises(ValueError, match="not proposed"):
        ObservedTests(proposed).add([observation], bound)
    proposed.add(proposal)
    with pytest.raises(ValueError, match="not proposed"):
        ObservedTests(proposed).add(list(observation.each()), bound)
    with pytest.raises(ValueError, match="other observations"):
        ObservedTests(proposed).add([observation], BoundFact("p", NUMBER, BOUNDS[0]))


def test_a_test_with_fewer_contributions() -> None:
    proposed = ProposedTests()
    found = ObservedTests(proposed)
    for test, each in enumerate([(1.0,), (2.0, 3.0), ()]):
        proposed.add(ProposalFact("p", test, in_blocks()[test].proposal))
        found.add([ObservationFact("p", test, Observation(0.0, each), "")], BoundFact("p", test, BOUNDS[test]))
    assert list(found.of_replicates(2)) == [[1.0], [2.0, 3.0], []]
    assert [found[test].observation.each for test in range(3)] == [(1.0,), (2.0, 3.0), ()]


# Campaigns


def report(directory: Path, campaign: CampaignConfig) -> ReportData:
    directory.mkdir(exist_ok=True)
    Play(directory, campaign, none).play().certify()
    return Collector(directory).refresh()


@pytest.mark.parametrize("chosen", [sampled, planned])
def test_the_report_by_block_is_that_by_test(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chosen: Callable[[int], CampaignConfig]
) -> None:
    found, read = report(tmp_path, chosen(8)), ChangeReader.read
    assert any(each.traces and not each.error for each in found.scenes)
    assert found.problems[0].observed > 8

    def by_test(reader: ChangeReader) -> Changes:
        changes = read(reader)
        facts = tuple(each_fact(changes.decisions))
        assert len(facts) > 2 * len(changes.decisions)
        return replace(changes, decisions=tuple(each for each in facts if isinstance(each, Decision)))

    monkeypatch.setattr(ChangeReader, "read", by_test)
    assert Collector(tmp_path).refresh() == found


def test_what_is_read_of_a_test_or_of_violations_expands_no_other_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = report(tmp_path, sampled(8))
    lines = counterexamples(tmp_path, tmp_path / "all.csv")
    # Views with a row for each test and rollout need these.
    monkeypatch.setattr(readonly, "_number", lambda *_: pytest.fail("a view is read"))
    monkeypatch.setattr(readonly, "_row", lambda *_: pytest.fail("a view is read"))
    (tmp_path / "again").mkdir()
    assert counterexamples(tmp_path, tmp_path / "again" / "all.csv") == lines == found.violations > 0
    for test in range(0, 50, 7):
        (rollout,) = rollouts_of(tmp_path, "robustness", test)
        assert rollout.rollout.test == test
