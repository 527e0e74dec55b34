"""The side view of a scene of solids, and the moments that are drawn of it."""

import math
from typing import Any

import numpy as np
import pytest
from google.protobuf.json_format import MessageToDict
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from perfbound.orchestrator.report.replay.moments import margins, moments
from perfbound.orchestrator.report.replay.solids import Film, Floats, Motion, film, solids
from perfbound.schemas.trajectory import Trajectory
from perfbound.workers.systems.segway.bullet import CENTRE_OF_MASS, WHEEL_RADIUS
from perfbound.workers.systems.segway.system import UNITS
from perfbound.workers.systems.segway.visual import visual

COLOR = {"r": 0.1, "g": 0.2, "b": 0.3, "a": 1.0}
HERE = {"x": 0.0, "y": 0.0, "z": 0.0}
UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def a_scene(kind: str, size: tuple[float, float, float], frame: str = "world", **more: Any) -> dict[str, Any]:
    solid = {"pose": {"position": HERE, "orientation": UPRIGHT}, "size": dict(zip("xyz", size, strict=True))}
    return {"entities": [{"frame_id": frame, kind: [{**solid, "color": COLOR, **more}]}]}


def turned(angle: float, axis: int) -> Floats:
    quaternion = np.zeros(4)
    quaternion[axis], quaternion[3] = math.sin(angle / 2), math.cos(angle / 2)
    return quaternion


def a_film(scene: dict[str, Any], *motions: Motion) -> Film:
    still = Motion("world", "base", np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    return Film(solids(scene), motions or (still,))


def area(polygon: Floats) -> float:
    x, y = polygon.T
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)


@pytest.mark.parametrize(
    ("kind", "size", "more", "expected"),
    [
        ("cubes", (1.0, 2.0, 3.0), {}, 3.0),
        ("cylinders", (1.0, 2.0, 3.0), {"bottom_scale": 1.0, "top_scale": 1.0}, 3.0),
        ("cylinders", (1.0, 2.0, 3.0), {"bottom_scale": 1.0, "top_scale": 0.0}, 1.5),
        ("spheres", (1.0, 2.0, 3.0), {}, math.pi * 3 / 4),
    ],
)
def test_a_solid_covers_its_area(kind: str, size: Any, more: Any, expected: float) -> None:
    (outline,) = a_film(a_scene(kind, size, **more)).outlines(0)
    assert area(outline.polygon) == pytest.approx(expected, rel=0.01)
    assert outline.color == (0.1, 0.2, 0.3, 1.0)


def test_what_is_seen_edge_on_is_a_line() -> None:
    (outline,) = a_film(a_scene("cubes", (2.0, 1.0, 0.0))).outlines(0)
    assert outline.polygon.tolist() == [[-1.0, 0.0], [1.0, 0.0]]


def test_other_primitives_are_left_out() -> None:
    assert solids({"entities": [{"frame_id": "world", "arrows": [{}], "texts": [{}]}]}) == ()
    assert film({"entities": []}, []) is None


def a_segway(phi: float, heading: float = 0.3, x: float = 1.0) -> Film:
    """The Segway in one pose."""
    row = dict.fromkeys(UNITS, 0.0) | {"x": x, "y": -2.0, "heading": heading, "phi": phi}
    seen = visual(Trajectory(tuple(UNITS), np.array([list(row.values())])))
    motions = (Motion(each.parent, each.child, each.translation, each.rotation) for each in seen.transforms)
    scene = MessageToDict(seen.scene, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
    return Film(solids(scene), tuple(motions))


def body(film: Film) -> Floats:
    (found,) = (outline.polygon for outline in film.outlines(0) if outline.frame == film.outermost)
    return found


@pytest.mark.parametrize("phi", [-0.7, 0.0, 0.4, 1.5])
def test_the_segway_tilts_forwards_to_the_right(phi: float) -> None:
    segway = a_segway(phi)
    assert (segway.followed, segway.outermost) == ("base_link", "pendulum")
    centre = body(segway).mean(axis=0)
    assert centre.tolist() == pytest.approx(
        [CENTRE_OF_MASS * math.sin(phi), WHEEL_RADIUS + CENTRE_OF_MASS * math.cos(phi)], abs=1e-9
    )


@given(heading=st.floats(-10, 10), x=st.floats(-20, 20))
def test_the_picture_follows_the_segway(heading: float, x: float) -> None:
    corners, elsewhere = (
        np.array(sorted(map(tuple, body(each)))) for each in (a_segway(0.4), a_segway(0.4, heading, x))
    )
    assert elsewhere == pytest.approx(corners, abs=1e-9)


def test_the_near_wheel_is_drawn_last() -> None:
    frames = [outline.frame for outline in a_segway(0.0).outlines(0) if outline.frame != "world"]
    assert frames == ["base_link", "pendulum", "base_link"]
    distances = [outline.distance for outline in a_segway(0.0).outlines(0) if outline.frame == "base_link"]
    assert distances == pytest.approx([0.25, -0.25])


def test_poses_follow_the_chain_of_frames() -> None:
    quarter = turned(math.pi / 2, axis=2)[None]
    arm = Motion("world", "arm", np.array([[1.0, 0.0, 0.0]]), quarter)
    hand = Motion("arm", "hand", np.array([[1.0, 0.0, 0.0]]), quarter)
    chain = Film((), (hand, arm))  # in any order
    assert chain.pose("hand", 0)[:3, 3].tolist() == pytest.approx([1.0, 1.0, 0.0])
    assert chain.pose("hand", 0)[:3, 0].tolist() == pytest.approx([-1.0, 0.0, 0.0])
    assert chain.pose("nowhere", 0).tolist() == np.eye(4).tolist()
    assert (chain.followed, chain.outermost) == ("arm", "hand")


def test_a_film_needs_a_moving_frame() -> None:
    with pytest.raises(ValueError, match="no frame moves"):
        Film((), ())


# Moments


def swinging(samples: int = 601) -> Trajectory:
    t = np.arange(samples) / 120
    return Trajectory(("t", "x"), np.column_stack([t, np.exp(-t) * np.sin(4 * t)]))


@pytest.mark.parametrize(
    "text",
    ["eventually x <= 1", "always[0,1] x <= 1", "x <= 1", "x <= 1 until x >= 0", "not always x <= 1"],
)
def test_a_specification_of_another_form_has_no_margins(text: str) -> None:
    assert margins(parse_formula(text), swinging()) is None


@pytest.mark.parametrize(
    "text", ["always abs(x) <= 1", "always (x <= 1 or x >= 2) and always x >= -0.9", "not eventually x > 0.5"]
)
def test_the_least_margin_is_the_robustness(text: str) -> None:
    tree, trajectory = parse_formula(text), swinging()
    found = margins(tree, trajectory)
    assert found is not None
    assert found.shape == (601,)
    assert found.min() == robustness(tree, trajectory.columns, trajectory.samples)


@given(samples=st.integers(1, 601), number=st.integers(2, 9), scale=st.floats(0, 5))
def test_moments_are_in_order_with_the_worst_among_them(samples: int, number: int, scale: float) -> None:
    trajectory = swinging(samples)
    margin = 1 - scale * np.abs(trajectory.column("x"))
    found = moments(trajectory, margin, number)
    assert 1 <= len(found) <= number
    frames = [moment.frame for moment in found]
    assert frames == sorted(set(frames))
    assert 0 <= frames[0] <= frames[-1] < len(trajectory.frames)
    (worst,) = (moment for moment in found if moment.worst)
    assert worst.margin == margin.min()
    assert worst.t == trajectory.samples[int(margin.argmin()), 0]


def test_moments_without_margins_are_evenly_spaced() -> None:
    found = moments(swinging(), None, 6)
    assert [moment.t for moment in found] == pytest.approx([0, 1, 2, 3, 4, 5], abs=0.04)
    assert not any(moment.worst or moment.margin is not None for moment in found)


def test_moments_are_closer_where_more_happens() -> None:
    trajectory = swinging()
    found = moments(trajectory, 1 - np.abs(trajectory.column("x")), 8)
    steps = np.diff([moment.t for moment in found])
    assert steps[0] < steps[-1]
