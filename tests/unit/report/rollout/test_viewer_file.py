"""`perfbound export --rollout`: rollouts of a run directory in one file for a viewer."""

import io
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.report.rollout import viewer_file
from perfbound.orchestrator.report.rollout.load import load_recorded
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store.journal import Journal
from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import Attempt, RolloutId
from tests.facts import facts, says
from tests.unit.campaign.batches.test_batched_campaign import REDUCED, played
from tests.unit.report.rollout import test_replay

batches, segway = test_replay.batches, test_replay.segway
IN_FIRST_BATCH = "robustness.1.true.0"


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign that keeps the samples of the worst rollouts alone."""
    directory = tmp_path_factory.mktemp("runs") / "kept"
    with played(directory, REDUCED["sample, the worst"]) as play:
        play.certify()
    return directory


def shown(data: bytes) -> dict[str, list[Any]]:
    """Return the messages of each topic."""
    found: dict[str, list[Any]] = {}
    reader = make_reader(io.BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    for _, channel, _, message in reader.iter_decoded_messages():
        found.setdefault(channel.topic, []).append(message)
    return found


def test_named_rollouts_of_any_file(batches: Path) -> None:
    data, number = viewer_file.viewer_file(batches, ["robustness.5.true.0", "robustness.0.true.0"])
    found = shown(data)
    assert number == len(found) == 2
    for test in (5, 0):
        trajectory = load_recorded(batches, f"robustness.{test}.true.0").trajectory
        assert trajectory is not None
        assert [each.phi for each in found[f"/robustness/{test}/true/0"]] == trajectory.column("phi").tolist()


def test_a_whole_batch(batches: Path) -> None:
    data, number = viewer_file.viewer_file(batches, [IN_FIRST_BATCH], batches=True)
    assert list(shown(data)) == [f"/robustness/{test}/true/0" for test in range(4)]
    (record,) = make_reader(io.BytesIO(data)).iter_metadata()
    assert record.metadata["campaign"] == "batches"
    found = load_recorded(batches, IN_FIRST_BATCH)
    assert says(record.metadata[IN_FIRST_BATCH], f"segway true seed {found.request.seed} robustness")
    assert number == 4


def test_a_rollout_alone_is_its_own_batch(segway: Path) -> None:
    data, _ = viewer_file.viewer_file(segway, [test_replay.TRUE, test_replay.TRUE], batches=True)
    assert list(shown(data)) == ["/sim_gap/0/true/0"]


def test_of_a_reduced_batch_those_with_samples(kept: Path) -> None:
    recorded = recorded_facts.observed_rollouts(kept)
    there = next(each for each in recorded if each.kept and each.batch)
    expected = {str(each.rollout) for each in recorded if each.kept and each.path == there.path}
    data, number = viewer_file.viewer_file(kept, [str(there.rollout)], batches=True)
    assert {topic[1:].replace("/", ".") for topic in shown(data)} == expected
    assert number == len(expected)


def test_what_was_not_kept_is_refused_with_the_way_to_it(kept: Path) -> None:
    gone = next(each for each in recorded_facts.observed_rollouts(kept) if not each.kept)
    with pytest.raises(PerfboundError, match=facts(f"{gone.rollout} not kept perfbound replay --mcap")) as refused:
        viewer_file.viewer_file(kept, [str(gone.rollout)])
    assert len(refused.value.lines) == 1


def test_a_rollout_that_failed_says_why(tmp_path: Path) -> None:
    directory = test_replay.a_run(tmp_path / "run", "test-function")
    absent = RolloutId("maximum", 900, "true", 0)
    journal = Journal.open(directory)
    with journal.transaction():
        journal.attempts.ended(Attempt(absent, 1), "w", Failure("system", "ZeroDivisionError: in\nstep"))
    journal.close()
    with pytest.raises(PerfboundError, match=facts(f"{absent} failed ZeroDivisionError choose")) as refused:
        viewer_file.viewer_file(directory, [str(absent)])
    assert len(refused.value.lines) == 1


def test_more_than_a_viewer_takes_is_refused(batches: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer_file, "LARGEST_BATCH", 3)
    with pytest.raises(PerfboundError, match=facts("--rollout 4 rollouts at most 3")):
        viewer_file.viewer_file(batches, [IN_FIRST_BATCH], batches=True)


# The command


def command(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, ["export", *(str(each) for each in arguments)])


def test_the_command_writes_one_file_or_to_stdout(batches: Path, tmp_path: Path) -> None:
    result = command(batches, "--rollout", IN_FIRST_BATCH, "--batch", "--out", tmp_path)
    assert (result.exit_code, result.stdout) == (0, f"{tmp_path / 'rollouts.mcap'}  4 rollouts\n")
    assert [each.name for each in tmp_path.iterdir()] == ["rollouts.mcap"]
    streamed = command(batches, "--rollout", IN_FIRST_BATCH, "--batch", "--out", "-")
    assert streamed.stdout_bytes == (tmp_path / "rollouts.mcap").read_bytes()


@pytest.mark.parametrize(
    "arguments",
    [
        ("--batch",),
        ("tests", "--batch"),
        ("tests", "--rollout", IN_FIRST_BATCH),
        ("--rollout", IN_FIRST_BATCH, "--format", "parquet"),
    ],
)
def test_a_wrong_call_is_a_usage_error(batches: Path, arguments: tuple[str, ...]) -> None:
    result = command(batches, *arguments)
    assert result.exit_code == 2
    assert not (batches / "export").exists()


def test_no_file_is_written_among_the_evidence(batches: Path) -> None:
    result = command(batches, "--rollout", IN_FIRST_BATCH, "--out", batches / "trajectories")
    assert isinstance(result.exception, PerfboundError)
    assert not list((batches / "trajectories").glob("*.mcap"))
