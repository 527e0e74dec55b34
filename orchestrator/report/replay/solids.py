"""A film: the moving solids of a scene, projected on a plane as polygons.

| symbol | meaning | shape, unit |
|---|---|---|
| F | frames of the film, 30 per second | |
| k, m | corners of a solid, corners of its outline | |
| pose | rotation and translation from a frame of the scene to the world | (4, 4), m |
| view | right and up, the directions in the picture, and away from the eye | (3, 3) |

The outline of a convex solid is the convex hull of its projected corners. Cubes, cylinders and spheres are drawn;
the other primitives of a foxglove.SceneUpdate are not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Color = tuple[float, float, float, float]

ROUND = 48
"""Corners of a circle."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of the frame `child` in the frame `parent`."""

    parent: str
    child: str
    translation: Floats  # (F, 3), m
    rotation: Floats  # (F, 4), quaternion x, y, z, w


@dataclass(frozen=True, eq=False)
class Solid:
    """One convex solid, fixed to a frame."""

    frame: str
    corners: Floats  # (k, 3), m, in its frame
    color: Color


@dataclass(frozen=True, eq=False)
class Outline:
    """The visible outline of a solid."""

    frame: str
    polygon: Floats  # (m, 2), m, right and up
    color: Color
    distance: float  # from the eye, m


@dataclass(frozen=True, eq=False)
class Film:
    """The solids of a scene and the motions of their frames.

    Raises:
        ValueError: no frame moves.

    """

    solids: tuple[Solid, ...]
    motions: tuple[Motion, ...]

    def __post_init__(self) -> None:
        if not self.motions:
            raise ValueError("no frame moves")

    @property
    def moving(self) -> frozenset[str]:
        """The frames that move."""
        return frozenset(motion.child for motion in self.motions)

    @property
    def followed(self) -> str:
        """The frame that the picture follows: the first whose parent is the world."""
        return next((motion.child for motion in self.motions if motion.parent not in self.moving), self.outermost)

    @property
    def outermost(self) -> str:
        """The frame with the longest chain of parents, the last of equals: its motion is the sum of the others."""
        return max(reversed(self.motions), key=lambda motion: len(self._chain(motion.child))).child

    def _chain(self, frame: str) -> list[Motion]:
        """Return the motions from the frame to the world."""
        parents, chain = {motion.child: motion for motion in self.motions}, list[Motion]()
        while frame in parents and parents[frame] not in chain:  # a system may announce a cycle
            chain.append(parents[frame])
            frame = parents[frame].parent
        return chain

    def pose(self, frame: str, number: int) -> Floats:
        """Return the pose of a frame at one frame of the film; one without a motion is the world."""
        pose = np.eye(4)
        for motion in self._chain(frame):
            pose = _matrix(motion.translation[number], motion.rotation[number]) @ pose
        return pose

    def outlines(self, number: int) -> list[Outline]:
        """Return the view from the right of the followed frame, from far to near."""
        followed = self.pose(self.followed, number)
        view, eye = _view(followed), followed[:3, 3] * (1.0, 1.0, 0.0)
        found = [_outline(solid, self.pose(solid.frame, number), view, eye) for solid in self.solids]
        return sorted(found, key=lambda outline: -outline.distance)


def film(scene: Mapping[str, Any], transforms: Sequence[Mapping[str, Any]]) -> Film | None:
    """Return the film in the visual part of a trajectory, from its JSON; None if nothing moves."""
    motions = tuple(
        Motion(
            each["parent"],
            each["child"],
            np.array(each["translation"], dtype=np.float64),
            np.array(each["rotation"], dtype=np.float64),
        )
        for each in transforms
    )
    found = solids(scene)
    return Film(found, motions) if motions and found else None


def solids(scene: Mapping[str, Any]) -> tuple[Solid, ...]:
    """Return the solids of a foxglove.SceneUpdate."""
    return tuple(
        _solid(entity["frame_id"], primitive, kind)
        for entity in scene["entities"]
        for kind in ("cubes", "cylinders", "spheres")
        for primitive in entity.get(kind, ())
    )


_CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_ANGLES = np.arange(ROUND) * 2 * np.pi / ROUND
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(ROUND)]) / 2
_SPHERE = np.concatenate(
    [_CIRCLE * np.cos(tilt) + _UP * np.sin(tilt) / 2 for tilt in _ANGLES[: ROUND // 2 + 1] - np.pi / 2]
)


def _solid(frame: str, primitive: Mapping[str, Any], kind: str) -> Solid:
    unit = {"cubes": _CUBE, "spheres": _SPHERE}.get(kind)
    if unit is None:
        ends = ((primitive["bottom_scale"], -0.5), (primitive["top_scale"], 0.5))
        unit = np.concatenate([_CIRCLE * scale + _UP * height for scale, height in ends])
    position, orientation, size = (
        [part[name] for name in names]
        for part, names in (
            (primitive["pose"]["position"], "xyz"),
            (primitive["pose"]["orientation"], "xyzw"),
            (primitive["size"], "xyz"),
        )
    )
    corners = Rotation.from_quat(orientation).apply(unit * size) + position
    return Solid(frame, corners, tuple(primitive["color"][name] for name in "rgba"))


def _matrix(translation: Floats, rotation: Floats) -> Floats:
    """Return a pose from a translation (3,) and a quaternion x, y, z, w (4,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(rotation).as_matrix(), translation
    return pose


def _view(followed: Floats) -> Floats:
    """Return right, up and away for a view along the y axis of a frame, upright."""
    forward = followed[:3, 0] * (1.0, 1.0, 0.0)
    length = float(np.linalg.norm(forward))
    # A frame that points straight up has no heading.
    right = forward / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.array([right, _UP, np.cross(_UP, right)])


def _outline(solid: Solid, pose: Floats, view: Floats, eye: Floats) -> Outline:
    seen = (solid.corners @ pose[:3, :3].T + pose[:3, 3] - eye) @ view.T  # (k, 3): right, up, away
    try:
        polygon = seen[ConvexHull(seen[:, :2]).vertices, :2]
    except QhullError:  # flat and seen edge on: a line
        order = np.lexsort((seen[:, 1], seen[:, 0]))
        polygon = seen[order[[0, -1]], :2]
    return Outline(solid.frame, polygon, solid.color, float(seen[:, 2].mean()))
