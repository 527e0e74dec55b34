"""The visual part of the files for Foxglove, and the layout that opens them: every topic and column in it exists."""

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from perfbound.schemas.rollout import RolloutRequest
from perfbound.workers.simulate import run_request_on
from perfbound.workers.systems.segway import SegwaySystem
from tests.fakes.segway import STILL

LAYOUT = json.loads((Path(__file__).parents[4] / "deploy" / "foxglove" / "segway.json").read_text())
PANELS: dict[str, Any] = LAYOUT["configById"]

Messages = dict[str, Any]
"""Topic -> first message, decoded by the type that the file holds."""


@pytest.fixture(scope="module")
def topics() -> Messages:
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
        disturbances=tuple(STILL.values()),
    )
    file = io.BytesIO(run_request_on(segway, request, lambda _: None))
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    found: Messages = {}
    for _, channel, _, message in reader.iter_decoded_messages():
        found.setdefault(channel.topic, message)
    return found


def plotted(panel: Any) -> list[str]:
    """Return the message paths of a plot; a number is a line across it."""
    paths = [panel["xAxisPath"]] if "xAxisPath" in panel else []
    values = [path["value"] for path in [*panel["paths"], *paths]]
    return [value for value in values if value.lstrip("-").replace(".", "", 1).isdigit() is False]


def panels(name: str) -> list[Any]:
    return [panel for full, panel in PANELS.items() if full.startswith(f"{name}!")]


def kind(message: Any) -> str:
    """Return the name of a message's type, by which Foxglove knows what to draw."""
    return str(message.DESCRIPTOR.full_name)


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


def test_what_the_plots_draw_is_in_the_file(topics: Messages) -> None:
    paths = [path for panel in panels("Plot") for path in plotted(panel)]
    assert "/state.phi" in paths
    for path in paths:
        topic, _, field = path.partition(".")
        assert isinstance(getattr(topics[topic], field), float)


def test_the_three_dimensional_panel_follows_the_segway(topics: Messages) -> None:
    (panel,) = panels("3D")
    moving = {each.child_frame_id for each in topics["/tf"].transforms}
    roots = {each.parent_frame_id for each in topics["/tf"].transforms} - moving
    assert panel["followTf"] in moving
    assert set(panel["transforms"]) == {f"frame:{name}" for name in moving | roots}
    assert {layer["frameId"] for layer in panel["layers"].values()} == roots
    assert [kind(topics[name]) for name in panel["topics"]] == ["foxglove.SceneUpdate"]
    assert {entity.frame_id for entity in topics["/scene"].entities} <= moving | roots


def test_table_and_log_read_their_topics(topics: Messages) -> None:
    assert [kind(topics[panel["topicPath"]]) for panel in panels("Table")] == ["perfbound.State"]
    assert [kind(topics[panel["topicToRender"]]) for panel in panels("RosOut")] == ["foxglove.Log"]
