"""What Foxglove needs of our files, and the layout that opens them: every topic and column that it names is there."""

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from schemas.rollout import RolloutRequest
from workers.simulate import run_on
from workers.systems.segway import SegwaySystem

LAYOUT = json.loads((Path(__file__).parents[2] / "deploy" / "foxglove" / "segway.json").read_text())
PANELS: dict[str, Any] = LAYOUT["configById"]

Schemas = dict[str, Any]
"""Topic -> (name, JSON schema, first message)."""


@pytest.fixture(scope="module")
def topics() -> Schemas:
    """The channels of a real rollout's file."""
    segway = SegwaySystem()
    request = RolloutRequest(
        campaign="c",
        config_sha256="0" * 64,
        problem="p",
        test=0,
        variant="nominal",
        replicate=0,
        seed=0,
        system="segway",
        spec_sha256=segway.spec.digest,
        x=(5.0, 0.0),
        horizon=0.1,
        visual=True,
    )
    reader = make_reader(io.BytesIO(run_on(segway, request, lambda _: None)))
    found: Schemas = {}
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        found.setdefault(channel.topic, (schema.name, json.loads(schema.data), json.loads(message.data)))
    return found


def plotted(panel: Any) -> list[str]:
    """Return the message paths of a plot; a number is a line across it."""
    paths = [panel["xAxisPath"]] if "xAxisPath" in panel else []
    values = [path["value"] for path in [*panel["paths"], *paths]]
    return [value for value in values if value.lstrip("-").replace(".", "", 1).isdigit() is False]


def panels(kind: str) -> list[Any]:
    return [panel for name, panel in PANELS.items() if name.startswith(f"{kind}!")]


def leaves(node: Any) -> Iterator[str]:
    """Yield the panels that a tree of splits shows."""
    if isinstance(node, str):
        yield node
        return
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    yield from leaves(node["first"])
    yield from leaves(node["second"])


def test_the_layout_shows_every_panel_once() -> None:
    assert set(LAYOUT) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert sorted(leaves(LAYOUT["layout"])) == sorted(PANELS)


def test_what_the_plots_draw_is_in_the_file(topics: Schemas) -> None:
    paths = [path for panel in panels("Plot") for path in plotted(panel)]
    assert "/state.phi" in paths
    for path in paths:
        topic, _, field = path.partition(".")
        assert topics[topic][1]["properties"][field]["type"] == "number"
        assert isinstance(topics[topic][2][field], int | float)


def test_the_three_dimensional_panel_follows_the_segway(topics: Schemas) -> None:
    (panel,) = panels("3D")
    moving = {each["child_frame_id"] for each in topics["/tf"][2]["transforms"]}
    roots = {each["parent_frame_id"] for each in topics["/tf"][2]["transforms"]} - moving
    assert panel["followTf"] in moving
    assert set(panel["transforms"]) == {f"frame:{name}" for name in moving | roots}
    assert {layer["frameId"] for layer in panel["layers"].values()} == roots
    assert [topics[name][0] for name in panel["topics"]] == ["foxglove.SceneUpdate"]
    assert {entity["frame_id"] for entity in topics["/scene"][2]["entities"]} <= moving | roots


def test_table_and_log_read_their_topics(topics: Schemas) -> None:
    assert [topics[panel["topicPath"]][0] for panel in panels("Table")] == ["perfbound.State"]
    assert [topics[panel["topicToRender"]][0] for panel in panels("RosOut")] == ["foxglove.Log"]


def objects(schema: Any) -> Iterator[Any]:
    if schema["type"] == "array":
        yield from objects(schema["items"])
    if schema["type"] == "object":
        yield schema
        for each in schema.get("properties", {}).values():
            yield from objects(each)


@pytest.mark.parametrize("topic", ["/scene", "/tf", "/log", "/state"])
def test_foxglove_can_parse_the_schemas(topics: Schemas, topic: str) -> None:
    """Its parser walks the properties of every object, and drops a topic with an object that has none."""
    assert [each for each in objects(topics[topic][1]) if "properties" not in each] == []
