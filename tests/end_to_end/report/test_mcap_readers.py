"""The files of rollouts in the hands of others: rerun, and the reader that Foxglove is made of."""

import base64
import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from google.protobuf.message import Message
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from perfbound.schemas.trajectory.trajectory import decode
from tests.end_to_end import processes
from tests.end_to_end.processes import BIN, Ended, Processes
from tests.patience import PATIENCE
from tests.unit.schemas.trajectory import test_topics

ROOT = Path(__file__).parents[3]
PACKAGES = ROOT / "build" / "node"
NEEDED = tuple(json.loads(Path(__file__).with_name("node").joinpath("package.json").read_text())["dependencies"])
CARS = Path(__file__).parents[3] / "deploy" / "examples" / "cars" / "cars.py"
PLOTS = {"/distance", "/speed"}
FRAMES = 91
"""Of three seconds at 30 Hz."""
SOLIDS = {f"/solids/{name}" for name in ("ground/0", "goal/0", "wheels/0", "wheels/1", "body/0")}
TOPICS = SOLIDS | {"/scene", "/log", "/tf", "/state"}


@pytest.fixture(scope="module")
def visual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a rollout of the Segway with a visual part."""
    return simulated(tmp_path_factory.mktemp("visual"), "segway", "5,0")


@pytest.fixture(scope="module")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a rollout that holds its evidence alone: the test function shows nothing."""
    return simulated(tmp_path_factory.mktemp("evidence"), "test-function", "1,2")


@pytest.fixture(scope="module")
def plotted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a rollout of a function, whose columns are plots."""
    return simulated(tmp_path_factory.mktemp("plotted"), f"{CARS}:cars", "20,30")


@pytest.fixture(scope="module")
def side_by_side(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of several rollouts, a topic each, as `perfbound export --rollout` writes it."""
    path = tmp_path_factory.mktemp("side-by-side") / "rollouts.mcap"
    path.write_bytes(test_topics.encoded())
    return path


def simulated(folder: Path, system: str, x: str) -> Path:
    path = folder / f"{system.rpartition(':')[2]}.mcap"
    with processes.processes(folder) as started:
        ended = started.run("perfbound", "simulate", system, "--x", x, "--horizon", "3", "--out", path)
    assert ended.code == 0, ended.err
    return path


# rerun


@pytest.fixture
def rerun(started: Processes, tmp_path: Path) -> Any:
    """Runs `rerun`, whose reports of its use are switched off in a home of its own."""
    if not (BIN / "rerun").exists():
        pytest.skip("install rerun-sdk: make test")
    home = tmp_path / "home"
    home.mkdir()

    def run(*arguments: str | Path) -> Ended:
        return started.run("rerun", *arguments, HOME=str(home), XDG_CONFIG_HOME=str(home), NO_COLOR="1")

    assert run("analytics", "disable").code == 0
    return run


def test_rerun_finds_no_fault(rerun: Any, visual: Path, evidence: Path) -> None:
    found = rerun("mcap", "check", "--full", visual)
    assert found.code == 0, found.err
    lines = [line.split() for line in found.out.splitlines() if line.startswith(("ok", "warn", "err", "fail"))]
    assert {line[3]: (line[0], line[-1]) for line in lines} == dict.fromkeys(TOPICS, ("ok", "—"))
    assert rerun("mcap", "check", "--full", evidence).code == 0


def test_rerun_plots_the_columns_of_a_function(rerun: Any, plotted: Path, tmp_path: Path) -> None:
    """As Scalars, of which it makes time series unasked."""
    checked = rerun("mcap", "check", "--full", plotted)
    assert checked.code == 0, checked.err
    assert {line.split()[3] for line in checked.out.splitlines() if line.startswith("ok")} == PLOTS
    converted = tmp_path / "one.rrd"
    assert rerun("mcap", "convert", plotted, "-o", converted).code == 0
    printed = rerun("rrd", "print", "-v", converted).out
    series = re.findall(r"with (\d+) rows .* - (\S+) - data columns: \[\S+@Scalars:scalars\]", printed)
    assert sorted(series) == [("61", topic) for topic in sorted(PLOTS)]


def test_rerun_finds_no_fault_in_several_rollouts(rerun: Any, side_by_side: Path) -> None:
    checked = rerun("mcap", "check", "--full", side_by_side)
    assert checked.code == 0, checked.err
    assert {line.split()[3] for line in checked.out.splitlines() if line.startswith("ok")} == set(test_topics.TOPICS)


def test_rerun_draws_a_file(rerun: Any, visual: Path, evidence: Path, tmp_path: Path) -> None:
    """It finds poses, solids, lines of a log and numbers, each in the frame and at the time at which they belong."""
    expected = {visual: TOPICS, evidence: set()}
    for path, topics in expected.items():
        converted = tmp_path / f"{path.stem}.rrd"
        ended = rerun("mcap", "convert", path, "-o", converted)
        assert ended.code == 0, ended.err
        stats = rerun("rrd", "stats", converted).out
        entities = stats.split("Num chunks per entity")[1].split("Num chunks per index")[0]
        found = {line.split(":")[0] for line in entities.splitlines() if line.startswith("/")}
        assert found == topics | {"/__mcap_attachments", "/__mcap_metadata", "/__mcap_properties"}
        assert rerun("rrd", "verify", converted).code == 0
    printed = rerun("rrd", "print", "-v", tmp_path / f"{visual.stem}.rrd").out
    chunks = re.findall(r"with (\d+) rows .* - (\S+) - data columns: \[(.*)\]", printed)
    drawn = {(entity, int(rows), frozenset(re.findall(r"@(\S+?):", columns))) for rows, entity, columns in chunks}
    assert {chunk for chunk in drawn if not chunk[2] & {"McapChannel", "McapStatistics", "RecordingInfo"}} >= {
        ("/tf", 2 * FRAMES, frozenset({"Transform3D"})),
        ("/log", 2, frozenset({"TextLog"})),
        ("/state", FRAMES, frozenset({"perfbound.State"})),
        *((topic, 1, frozenset({"CoordinateFrame", "VoxelGridMap"})) for topic in SOLIDS),
    }


# @mcap/core


@pytest.fixture(scope="module")
def javascript(visual: Path, evidence: Path, plotted: Path, side_by_side: Path) -> dict[str, Any]:
    """Output of the JavaScript reader for these files, and the schemas that Foxglove publishes."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("install node")
    if not all((PACKAGES / "node_modules" / name).is_dir() for name in NEEDED):
        pytest.skip("install the JavaScript readers: make build/node/.installed, with npm")
    script = Path(__file__).with_name("read_mcap.mjs")
    line: list[str | Path] = [node, script, PACKAGES, visual, evidence, plotted, side_by_side]
    ended = subprocess.run(line, capture_output=True, text=True, check=False, timeout=PATIENCE)
    assert ended.returncode == 0, ended.stderr
    found: dict[str, Any] = json.loads(ended.stdout)
    return found


def test_javascript_plots_the_columns_of_a_function(javascript: Any, plotted: Path) -> None:
    found, trajectory = javascript["files"][2], decode(plotted.read_bytes())
    assert set(found["channels"]) == PLOTS
    times = [str(round(t * 1e9)) for t in trajectory.column("t").tolist()]
    for topic, channel in found["channels"].items():
        assert (channel["messageEncoding"], channel["encoding"]) == ("cdr", "ros2msg")
        numbers = trajectory.column(topic[1:]).tolist()
        assert channel["messages"] == [[t, t, [number]] for t, number in zip(times, numbers, strict=True)]
    assert found["streamed"] == {"messages": 2 * len(times), "done": True}


def test_javascript_reads_each_of_several_rollouts(javascript: Any) -> None:
    found = javascript["files"][3]
    assert list(found["channels"]) == test_topics.TOPICS
    for channel, trajectory in zip(found["channels"].values(), test_topics.ROLLOUTS.values(), strict=True):
        rows = [[body[name] for name in test_topics.COLUMNS] for _, _, body in channel["messages"]]
        assert rows == trajectory.samples.tolist()
        assert (channel["messageEncoding"], channel["schema"]) == ("protobuf", "perfbound.State")
    assert found["streamed"] == {"messages": 6, "done": True}


@pytest.mark.parametrize("number", [0, 1], ids=["visual", "evidence"])
def test_javascript_reads_what_python_reads(javascript: Any, visual: Path, evidence: Path, number: int) -> None:
    found, path = javascript["files"][number], (visual, evidence)[number]
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert (found["profile"], found["library"]) == ("", "perfbound")
        messages: dict[str, list[Any]] = {topic: [] for topic in found["channels"]}
        for schema, channel, message, body in reader.iter_decoded_messages():
            assert schema is not None
            theirs = found["channels"][channel.topic]
            assert (theirs["messageEncoding"], theirs["encoding"]) == ("protobuf", "protobuf")
            assert (theirs["schema"], theirs["remarks"]) == (schema.name, channel.metadata)
            times = (str(message.log_time), str(message.publish_time))
            messages[channel.topic].append([*times, as_javascript(body)])
        assert {topic: each["messages"] for topic, each in found["channels"].items()} == messages
        digests = {each.name: [each.media_type, _sha256(each.data)] for each in reader.iter_attachments()}
        assert found["attachments"] == digests
        assert found["metadata"] == {each.name: each.metadata for each in reader.iter_metadata()}
    assert set(digests) == {"trajectory.npy", "request.json"}
    count = sum(len(each) for each in messages.values())
    assert found["streamed"] == {"messages": count, "done": True}
    assert count == (0 if path == evidence else 2 * FRAMES + 3 + len(SOLIDS))


def test_messages_keep_to_the_schemas_that_foxglove_publishes(javascript: Any) -> None:
    """Every field that Foxglove knows is there with its type, and none besides."""
    channels = javascript["files"][0]["channels"].values()
    known = [channel for channel in channels if channel["schema"].startswith("foxglove.")]
    assert len(known) == 3 + len(SOLIDS)
    for channel in known:
        published = exact(javascript["published"][channel["schema"].removeprefix("foxglove.")])
        validator = jsonschema.Draft202012Validator(published)
        for _, _, message in channel["messages"]:
            validator.validate(with_times(message))


def test_times_are_those_of_the_messages(javascript: Any) -> None:
    for channel in javascript["files"][0]["channels"].values():
        for log_time, publish_time, message in channel["messages"]:
            assert log_time == publish_time
            stamps = [each["timestamp"] for each in message.get("transforms", [])]
            stamps += [message["timestamp"]] if "timestamp" in message else []
            assert {stamp["seconds"] * 10**9 + stamp["nanos"] for stamp in stamps} <= {int(log_time)}


def as_javascript(message: Message) -> dict[str, Any]:
    """Return what JavaScript makes of a message: every field, bytes as base64, None for a message that was not sent."""
    return {field.name: _as_javascript(message, field) for field in message.DESCRIPTOR.fields}


def _as_javascript(message: Message, field: Any) -> Any:
    value = getattr(message, field.name)
    if field.type == field.TYPE_BYTES:
        return base64.b64encode(value).decode()
    if field.type != field.TYPE_MESSAGE:
        return value
    if field.is_repeated:
        return [as_javascript(each) for each in value]
    return as_javascript(value) if message.HasField(field.name) else None


def with_times(value: Any) -> Any:
    """Return a message as Foxglove shows it: with times in its own names."""
    if isinstance(value, list):
        return [with_times(each) for each in value]
    if not isinstance(value, dict):
        return value
    if set(value) == {"seconds", "nanos"}:
        return {"sec": value["seconds"], "nsec": value["nanos"]}
    return {name: with_times(each) for name, each in value.items()}


def exact(schema: Any) -> Any:
    """Return a JSON schema that asks for every property it names, and allows no other."""
    if isinstance(schema, list):
        return [exact(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    whole = {key: exact(value) for key, value in schema.items()}
    if whole.get("type") == "object":
        whole |= {"required": sorted(whole["properties"]), "additionalProperties": False}
    return whole


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
