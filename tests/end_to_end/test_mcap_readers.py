"""The files of rollouts in the hands of others: rerun's own check, and the reader that Foxglove is made of."""

import hashlib
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from mcap.reader import make_reader

from tests.end_to_end import processes
from tests.end_to_end.processes import BIN, Ended, Processes

ROOT = Path(__file__).parents[2]
PACKAGES = ROOT / "build" / "node"
NEEDED = ("@mcap/core", "fzstd", "@foxglove/schemas")
INSTALL = "npm install --no-save --prefix build/node @mcap/core@2.2.2 fzstd@0.1.1 @foxglove/schemas@2.1.0"
FRAMES = 91
"""Of three seconds at 30 Hz."""


@pytest.fixture(scope="module")
def visual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a rollout of the Segway that a person can look at."""
    return simulated(tmp_path_factory.mktemp("visual"), "segway", "5,0")


@pytest.fixture(scope="module")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a rollout that holds its evidence alone: the test function shows nothing."""
    return simulated(tmp_path_factory.mktemp("evidence"), "test-function", "1,2")


def simulated(folder: Path, system: str, x: str) -> Path:
    path = folder / f"{system}.mcap"
    with processes.processes(folder) as started:
        ended = started.run("perfbound", "simulate", system, "--x", x, "--horizon", "3", "--out", path)
    assert ended.code == 0, ended.err
    return path


# rerun


@pytest.fixture
def rerun(started: Processes, tmp_path: Path) -> Any:
    """Runs `rerun`, whose reports of its use are switched off in a home of its own."""
    if not (BIN / "rerun").exists():
        pytest.skip("install rerun-sdk: make .venv/.installed-dev")
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
    assert {line[3]: (line[0], line[-1]) for line in lines} == dict.fromkeys(
        ("/scene", "/log", "/tf", "/state"), ("ok", "—")
    )
    assert rerun("mcap", "check", "--full", evidence).code == 0


def test_rerun_converts_a_file(rerun: Any, visual: Path, evidence: Path, tmp_path: Path) -> None:
    """Its 0.41 decodes no JSON: the channels arrive as they are, the evidence as attachments."""
    expected = {visual: {"/scene", "/log", "/tf", "/state"}, evidence: set()}
    for path, topics in expected.items():
        converted = tmp_path / f"{path.stem}.rrd"
        ended = rerun("mcap", "convert", path, "-o", converted)
        assert ended.code == 0, ended.err
        stats = rerun("rrd", "stats", converted).out
        entities = stats.split("Num chunks per entity")[1].split("Num chunks per index")[0]
        found = {line.split(":")[0] for line in entities.splitlines() if line.startswith("/")}
        assert found == topics | {"/__mcap_attachments", "/__mcap_metadata", "/__mcap_properties"}
        assert rerun("rrd", "verify", converted).code == 0


# @mcap/core


@pytest.fixture(scope="module")
def javascript(visual: Path, evidence: Path) -> dict[str, Any]:
    """What the JavaScript reader finds in both files, and the schemas that Foxglove publishes."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("install node")
    if not all((PACKAGES / "node_modules" / name).is_dir() for name in NEEDED):
        pytest.skip(INSTALL)
    script = Path(__file__).with_name("read_mcap.mjs")
    line: list[str | Path] = [node, script, PACKAGES, visual, evidence]
    ended = subprocess.run(line, capture_output=True, text=True, check=False, timeout=60)
    assert ended.returncode == 0, ended.stderr
    found: dict[str, Any] = json.loads(ended.stdout)
    return found


@pytest.mark.parametrize("number", [0, 1], ids=["visual", "evidence"])
def test_javascript_reads_what_python_reads(javascript: Any, visual: Path, evidence: Path, number: int) -> None:
    found, path = javascript["files"][number], (visual, evidence)[number]
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert (found["profile"], found["library"]) == ("", "perfbound")
        messages: dict[str, list[Any]] = {topic: [] for topic in found["channels"]}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            theirs = found["channels"][channel.topic]
            assert (theirs["messageEncoding"], theirs["encoding"]) == ("json", "jsonschema")
            assert (theirs["schema"], theirs["definition"]) == (schema.name, json.loads(schema.data))
            times = (str(message.log_time), str(message.publish_time))
            messages[channel.topic].append([*times, json.loads(message.data)])
        assert {topic: each["messages"] for topic, each in found["channels"].items()} == messages
        digests = {each.name: [each.media_type, _sha256(each.data)] for each in reader.iter_attachments()}
        assert found["attachments"] == digests
        assert found["metadata"] == {each.name: each.metadata for each in reader.iter_metadata()}
    assert set(digests) == {"trajectory.npy", "request.json"}
    count = sum(len(each) for each in messages.values())
    assert found["streamed"] == {"messages": count, "done": True}
    assert count == (0 if path == evidence else 2 * FRAMES + 3)


def test_messages_keep_to_the_schemas_that_foxglove_publishes(javascript: Any) -> None:
    """Every field that Foxglove knows is there with its type, and none besides."""
    channels = javascript["files"][0]["channels"].values()
    known = [channel for channel in channels if channel["schema"].startswith("foxglove.")]
    assert len(known) == 3
    for channel in known:
        published = exact(javascript["published"][channel["schema"].removeprefix("foxglove.")])
        validator = jsonschema.Draft202012Validator(published)
        for _, _, message in channel["messages"]:
            validator.validate(message)


def test_times_are_those_of_the_messages(javascript: Any) -> None:
    for topic, channel in javascript["files"][0]["channels"].items():
        for log_time, publish_time, message in channel["messages"]:
            assert log_time == publish_time
            stamps = [each["timestamp"] for each in message.get("transforms", [])]
            stamps += [message["timestamp"]] if topic == "/log" else []
            assert {stamp["sec"] * 10**9 + stamp["nsec"] for stamp in stamps} <= {int(log_time)}


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
