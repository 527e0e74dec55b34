"""Replay of a recorded rollout: output, files and refusals."""

import hashlib
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from PIL import Image

from perfbound.orchestrator.campaign.admission import scored
from perfbound.orchestrator.campaign.ledger import Ledger, Scored
from perfbound.orchestrator.fleet.children import simulate
from perfbound.orchestrator.report.rollout import replay
from perfbound.orchestrator.report.rollout.comparison import compare
from perfbound.orchestrator.report.rollout.load import load_recorded
from perfbound.orchestrator.store import files
from perfbound.orchestrator.store.journal import Journal
from perfbound.schemas.batch import BatchRequest, alone
from perfbound.schemas.errors import EvidenceError, JournalError, PerfboundError
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.ids import FileId
from perfbound.schemas.result.facts import Header
from perfbound.schemas.rollout import RolloutRequest
from perfbound.schemas.trajectory.batch import read_batch
from perfbound.schemas.trajectory.trajectory import Trajectory, decode, encode, read_canonical, read_mcap
from perfbound.workers.batch import run_on
from perfbound.workers.simulate import drawn, run_request
from perfbound.workers.systems import load_system
from tests import campaigns
from tests.facts import facts, says

Spoil = Callable[[bytes], bytes]
NOMINAL = "nominal_robustness.1.nominal.0"
TRUE = "sim_gap.0.true.0"


def simulated(request: RolloutRequest) -> bytes:
    return run_request(request, lambda _: None)


def a_run(directory: Path, name: str, payload: Callable[[RolloutRequest], bytes] = simulated, **changes: Any) -> Path:
    """Run a whole campaign in this process."""
    config = campaigns.config(name, max_tests=2, resolution=3, **changes)
    return run_of(directory, config, lambda request: payload(alone(request)))


def run_of(directory: Path, config: CampaignConfig, payload: Callable[[RolloutRequest | BatchRequest], bytes]) -> Path:
    directory.mkdir()
    journal = Journal.create(directory, Header.new(config, load_system(config.system.name).spec, {}))
    ledger = Ledger(directory, journal)
    with ledger.transaction():
        wanted = ledger.outstanding().wanted
    while wanted:
        request = ledger.request(wanted[0])
        data = payload(request)
        digest = hashlib.sha256(data).hexdigest()
        if isinstance(request, BatchRequest):
            found: Trajectory | Scored = scored(ledger, request, read_batch(data).batch)
        else:
            found = decode(data)
        with ledger.transaction():
            wanted = [*wanted[1:], *ledger.record(wanted[0], data, found, digest).wanted]
    journal.close()
    return directory


@pytest.fixture(scope="module")
def segway(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return a_run(tmp_path_factory.mktemp("runs") / "segway", "segway-paper", horizon=2.0)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign whose files hold the evidence alone."""
    return a_run(tmp_path_factory.mktemp("runs") / "plain", "segway-paper", horizon=2.0, visual="none")


BATCHES = {
    "name": "batches",
    "seed": 5,
    "specification": "always (phi <= 0.5)",
    "horizon": 1.0,
    "batch": 4,
    "recheck": 2,
    "system": {"name": "segway"},
    "space": {"x": {"low": 0.0, "high": 5.0}, "y": {"low": 0.0, "high": 5.0}},
    "claims": [{"quantity": "failure_probability", "delta": 0.05}],
    "problems": [{"name": "robustness", "method": "sample", "max_tests": 6}],
}
IN_BATCHES = "robustness.5.true.0"


@pytest.fixture(scope="module")
def batches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign in batches that asks for visual parts, which the files of batches do not have."""
    config = CampaignConfig.model_validate_json(json.dumps(BATCHES))
    directory = tmp_path_factory.mktemp("runs") / "batches"
    return run_of(directory, config, lambda request: run_on(load_system("segway"), request, lambda _: None))


@pytest.fixture(scope="module")
def function(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return a_run(tmp_path_factory.mktemp("runs") / "function", "test-function")


@pytest.fixture
def spoil(monkeypatch: pytest.MonkeyPatch) -> Callable[[Spoil], None]:
    """Answers for the child in this process, and spoils the file that it writes."""
    spoils: list[Spoil] = []

    def ask(command: str, *arguments: str, **_: object) -> str:
        given = dict(zip(arguments[::2], arguments[1::2], strict=True))
        if command == "visual":
            data = drawn(read_canonical(Path(given["--file"]).read_bytes(), visual=False))
        else:
            assert command == "simulate"
            data = simulated(RolloutRequest.model_validate_json(given["--request"]))
            for each in spoils:
                data = each(data)
        Path(given["--out"]).write_bytes(data)
        return ""

    monkeypatch.setattr(simulate, "ask", ask)
    return spoils.append


def shifted(by: float) -> Spoil:
    """Return a change of phi from the tenth sample on."""

    def spoil(data: bytes) -> bytes:
        file = read_mcap(data)
        samples = file.trajectory.samples.copy()
        samples[10:, file.trajectory.columns.index("phi")] += by
        return rewritten(data, samples)

    return spoil


def rewritten(data: bytes, samples: Any) -> bytes:
    file = read_mcap(data)
    units = dict.fromkeys(file.trajectory.columns, "1")
    metadata = {key: value for key, value in file.metadata.items() if key != "columns"}
    return encode(Trajectory(file.trajectory.columns, samples), request=file.request, metadata=metadata, units=units)


def copied(directory: Path, to: Path) -> Path:
    """Return a copy of a run directory."""
    for path in directory.rglob("*"):
        if path.is_file():
            (to / path.relative_to(directory)).parent.mkdir(parents=True, exist_ok=True)
            (to / path.relative_to(directory)).write_bytes(path.read_bytes())
    return to


def damage(directory: Path, rollout: str) -> Path:
    path = directory / files.relative_path(FileId.parse(rollout))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    return path


# Output


@pytest.mark.parametrize("rollout", [NOMINAL, TRUE, TRUE.replace(".", "-")])
@pytest.mark.parametrize("directory", ["segway", "plain"])
@pytest.mark.usefixtures("spoil")
def test_the_same_seed_gives_the_same_bits(request: Any, directory: str, rollout: str) -> None:
    first, *rest = replay.replay_rollout(request.getfixturevalue(directory), rollout)
    assert first.startswith(f"{rollout.replace('-', '.')}: segway, ")
    assert rest == ["bitwise the same as the recorded trajectory"]


@pytest.mark.usefixtures("spoil")
def test_every_rollout_of_a_batch_is_replayed(batches: Path) -> None:
    rollouts = [*(f"robustness.{test}.true.0" for test in range(6)), "recheck.0.true.0", "recheck.1.true.0"]
    for rollout in rollouts:
        first, *rest = replay.replay_rollout(batches, rollout)
        assert first.startswith(f"{rollout}: segway, true, x = ")
        assert rest == ["bitwise the same as the recorded trajectory"]


@pytest.mark.usefixtures("spoil")
def test_a_rollout_of_a_closing_check_is_replayed_and_drawn(tmp_path: Path) -> None:
    """A recheck has the seed of the rollout that it repeats, and no check has columns of its own."""
    directory = a_run(tmp_path / "run", "test-function", spot_check=2, spot_check_followups=0, recheck=2)
    for rollout in ("spot_check.1.true.0", "recheck.1.true.0"):
        picture = tmp_path / f"{rollout}.png"
        lines = list(replay.replay_rollout(directory, rollout, out=picture))
        assert says(lines[1], "bitwise same recorded")
        assert picture.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(PerfboundError, match=facts("maximum spot_check recheck")):
        load_recorded(directory, "spotcheck.1.true.0")


@pytest.mark.usefixtures("spoil")
def test_the_first_line_tells_start_seed_and_robustness(segway: Path, function: Path) -> None:
    found = load_recorded(segway, TRUE)
    x, y = found.request.x
    line = next(replay.replay_rollout(segway, TRUE))
    assert says(line, f"x = {x:g} m y = {y:g} m seed {found.fact.seed} robustness {found.fact.robustness:.6g}")
    assert says(next(replay.replay_rollout(function, "maximum.0.true.0")), "^maximum.0.true.0: test-function true z1 =")
    assert " 1," not in next(replay.replay_rollout(function, "maximum.0.true.0"))


def test_a_difference_is_told_by_column_and_refused(segway: Path, spoil: Any, tmp_path: Path) -> None:
    spoil(shifted(1e-6))
    said = []
    with pytest.raises(PerfboundError, match=r"phi differs by up to 1e-06 rad at t = 0\.\d+ s") as fault:
        said += list(replay.replay_rollout(segway, NOMINAL, out=tmp_path / "a.png"))
    assert str(fault.value).startswith(f"{NOMINAL}: ")
    assert "\n" not in str(fault.value)
    assert (tmp_path / "a.png").exists(), "it is drawn all the more"


def test_another_machine_may_round_differently(segway: Path, spoil: Any) -> None:
    spoil(shifted(1e-12))
    _, heading, *rows = replay.replay_rollout(segway, NOMINAL)
    assert heading.split() == ["column", "unit", "largest", "difference", "at", "t", "/", "s"]
    largest = {row.split()[0]: float(row.split()[2]) for row in rows}
    assert largest.pop("phi") == pytest.approx(1e-12, rel=1e-3)
    assert set(largest.values()) == {0.0}


def test_a_shorter_trajectory_is_refused(segway: Path, spoil: Any) -> None:
    spoil(lambda data: rewritten(data, read_mcap(data).trajectory.samples[:-1]))
    with pytest.raises(PerfboundError, match="there are 240 samples, not 241"):
        list(replay.replay_rollout(segway, NOMINAL))


def test_negative_zero_is_not_bitwise_zero() -> None:
    zero, negative = (Trajectory(("t", "x"), np.array([[0.0, value]])) for value in (0.0, -0.0))
    assert compare(zero, zero).bitwise
    found = compare(negative, zero)
    assert (found.bitwise, found.within_tolerance) == (False, True)


# Damage


@pytest.mark.parametrize("directory", ["segway", "plain"])
@pytest.mark.usefixtures("spoil")
def test_a_damaged_file_is_made_again(request: Any, directory: str, tmp_path: Path) -> None:
    run_directory = copied(request.getfixturevalue(directory), tmp_path / "run")
    path = damage(run_directory, TRUE)
    _, hurt, good = replay.replay_rollout(run_directory, TRUE)
    assert hurt.startswith(f"{path}: sha256 ")
    assert says(good, "bitwise same recorded")
    path.unlink()
    assert list(replay.replay_rollout(run_directory, TRUE))[1:] == [
        f"{path}: No such file or directory; restore it from a copy",
        good,
    ]


def test_a_damaged_file_of_a_batch_is_compared_by_the_rollout_alone(batches: Path, tmp_path: Path, spoil: Any) -> None:
    run_directory = copied(batches, tmp_path / "run")
    (path,) = (run_directory / "trajectories" / "robustness").rglob("*.4.true.0.2.mcap")
    path.unlink()
    _, hurt, good = replay.replay_rollout(run_directory, IN_BATCHES)
    assert hurt == f"{path}: No such file or directory; restore it from a copy"
    assert good == "simulated again, the trajectory is bitwise the same as the recorded one"
    spoil(shifted(1e-15))
    with pytest.raises(PerfboundError, match=facts("trajectory sha256 not recorded")):
        list(replay.replay_rollout(run_directory, IN_BATCHES))


@pytest.mark.parametrize("directory", ["segway", "plain"])
def test_a_damaged_file_that_cannot_be_made_again_is_told(
    request: Any, directory: str, tmp_path: Path, spoil: Any
) -> None:
    run_directory = copied(request.getfixturevalue(directory), tmp_path / "run")
    damage(run_directory, TRUE)
    spoil(shifted(1e-15))
    with pytest.raises(PerfboundError, match=facts("sha256 not recorded")):
        list(replay.replay_rollout(run_directory, TRUE))


def test_a_file_of_another_request_is_refused(tmp_path: Path) -> None:
    directory = a_run(
        tmp_path / "run",
        "segway-paper",
        lambda request: simulated(request.model_copy(update={"seed": request.seed + 1})),
        horizon=0.1,
    )
    with pytest.raises(EvidenceError, match=facts("another request")):
        load_recorded(directory, TRUE)


def test_a_path_out_of_the_run_directory_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "relative_path", lambda rollout: f"../{rollout}.mcap")
    directory = a_run(tmp_path / "run", "test-function")
    found = load_recorded(directory, "maximum.0.true.0")
    assert found.trajectory is None
    assert "is not a path in the run directory" in found.damage


# Refusals


@pytest.mark.parametrize(
    ("rollout", "text"),
    [
        ("", "'' problem.test.variant.replicate nominal_robustness.0.nominal.0"),
        ("sim_gap.0.true", "names no rollout"),
        ("sim_gap.x.true.0", "names no rollout"),
        (
            "sim_gap.0.true.1",
            "no rollout sim_gap.0.nominal.0 sim_gap.0.true.0",
        ),
        ("sim_gap.2.true.0", "choose a test of sim_gap from 0 to 1"),
        ("maximum.0.true.0", "nominal_robustness sim_gap"),
    ],
)
def test_a_rollout_that_is_not_there(segway: Path, rollout: str, text: str) -> None:
    with pytest.raises(PerfboundError, match=facts(text)):
        load_recorded(segway, rollout)


def test_the_last_test_is_that_of_the_last_batch(batches: Path) -> None:
    """Of a batch, the database has the number of its first test."""
    with pytest.raises(PerfboundError, match=facts("choose a test of robustness from 0 to 5")):
        load_recorded(batches, "robustness.6.true.0")


def test_a_directory_without_a_campaign(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="no campaign here"):
        load_recorded(tmp_path, NOMINAL)


@pytest.mark.integration
def test_the_reason_of_the_child_is_passed_on(segway: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def ask(*_: str, **__: object) -> str:
        raise PerfboundError("the system 'segway' is not installed here; known: test-function")

    monkeypatch.setattr(simulate, "ask", ask)
    with pytest.raises(PerfboundError, match="not installed here"):
        list(replay.replay_rollout(segway, NOMINAL, out=tmp_path / "a.png", mcap=tmp_path / "a.mcap"))
    assert list(tmp_path.iterdir()) == []


# Files


@pytest.mark.parametrize(("directory", "rollout"), [("segway", TRUE), ("plain", TRUE), ("batches", IN_BATCHES)])
@pytest.mark.usefixtures("spoil")
def test_the_file_shows_a_person_everything(request: Any, directory: str, rollout: str, tmp_path: Path) -> None:
    *_, line = replay.replay_rollout(request.getfixturevalue(directory), rollout, mcap=tmp_path / "new" / "a.mcap")
    assert line == f"file: {tmp_path / 'new' / 'a.mcap'}"
    data = (tmp_path / "new" / "a.mcap").read_bytes()
    topics = {channel.topic for _, channel, _ in make_reader(io.BytesIO(data)).iter_messages()}
    assert {"/" + topic.split("/")[1] for topic in topics} == {"/scene", "/solids", "/tf", "/state", "/log"}
    found = load_recorded(request.getfixturevalue(directory), rollout)
    assert found.trajectory is not None
    assert read_mcap(data).trajectory.samples.tobytes() == found.trajectory.samples.tobytes()
    assert data == simulated(found.request.model_copy(update={"visual": True})), "as a campaign with visual parts"


def test_a_visual_part_changes_no_trajectory(segway: Path, plain: Path) -> None:
    for rollout in (NOMINAL, TRUE):
        one, other = (load_recorded(directory, rollout).trajectory for directory in (segway, plain))
        assert one is not None
        assert other is not None
        assert one.samples.tobytes() == other.samples.tobytes()


def test_the_file_shows_what_was_recorded(plain: Path, spoil: Any, tmp_path: Path) -> None:
    spoil(shifted(1e-6))
    with pytest.raises(PerfboundError, match="phi differs"):
        list(replay.replay_rollout(plain, TRUE, mcap=tmp_path / "a.mcap"))
    before = load_recorded(plain, TRUE).trajectory
    assert before is not None
    assert decode((tmp_path / "a.mcap").read_bytes()).samples.tobytes() == before.samples.tobytes()


@pytest.mark.usefixtures("spoil")
def test_equal_rollouts_give_equal_pictures(segway: Path, plain: Path, tmp_path: Path) -> None:
    pictures = []
    for number, directory in enumerate((segway, segway, plain)):
        path = tmp_path / f"{number}.png"
        *_, line = replay.replay_rollout(directory, TRUE, out=path)
        assert line == f"picture: {path}"
        pictures.append(path.read_bytes())
    assert len(set(pictures)) == 1
    with Image.open(io.BytesIO(pictures[0])) as image:
        assert image.width == 1500
        assert 300 < image.height < 900
        assert set(image.info) == {"dpi"}, "neither a time nor a version"


@pytest.mark.usefixtures("spoil")
def test_a_damaged_file_is_drawn_too(segway: Path, tmp_path: Path) -> None:
    run_directory = copied(segway, tmp_path / "run")
    damage(run_directory, TRUE)
    list(replay.replay_rollout(run_directory, TRUE, out=tmp_path / "a.png"))
    with Image.open(tmp_path / "a.png") as image:
        assert image.width == 1500
