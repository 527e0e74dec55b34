"""A scene of solids seen from the side, as polygons on a plane.

| symbol | meaning | shape, unit |
|---|---|---|
| F | frames of the film, 30 per second | |
| k, m | corners of a solid, corners of its outline | |
| pose | rotation and translation from a frame of the scene to the world | (4, 4), m |
| view | right and up, the directions on the picture, and away from the eye | (3, 3) |

The outline of a convex solid is the convex hull of its projected corners. Cubes, cylinders and spheres are drawn;
the other primitives of a foxglove.SceneUpdate are not.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

Floats = NDArray[np.float64]
Color = tuple[float, float, float, float]

ROUND = 48
"""Corners of a circle."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Motion:
    """How the frame `child` moves in the frame `parent`."""

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
    """What is seen of a solid."""

    frame: str
    polygon: Floats  # (m, 2), m, right and up
    color: Color
    distance: float  # from the eye, m


@dataclass(frozen=True, eq=False)
class Film:
    """The solids of a scene and how their frames move.

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
        """The frame that the picture follows: the first one that stands in the world."""
        return next((motion.child for motion in self.motions if motion.parent not in self.moving), self.outermost)

    @property
    def outermost(self) -> str:
        """The frame that hangs on the longest chain, the last of equals: it shows what moves most."""
        return max(reversed(self.motions), key=lambda motion: len(self._chain(motion.child))).child

    def _chain(self, frame: str) -> list[Motion]:
        """Return the motions from the frame to the world."""
        parents, chain = {motion.child: motion for motion in self.motions}, list[Motion]()
        while frame in parents and parents[frame] not in chain:
            chain.append(parents[frame])
            frame = parents[frame].parent
        return chain

    def pose(self, frame: str, number: int) -> Floats:
        """Return the pose of a frame at one frame of the film; one that nothing moves stands in the world."""
        pose = np.eye(4)
        for motion in self._chain(frame):
            pose = _matrix(motion.translation[number], motion.rotation[number]) @ pose
        return pose

    def outlines(self, number: int) -> list[Outline]:
        """Return what is seen from the right of the followed frame, from far to near."""
        followed = self.pose(self.followed, number)
        view, eye = _view(followed), followed[:3, 3] * (1.0, 1.0, 0.0)
        seen = [_outline(solid, self.pose(solid.frame, number), view, eye) for solid in self.solids]
        return sorted(seen, key=lambda outline: -outline.distance)


def solids(scene: Mapping[str, Any]) -> tuple[Solid, ...]:
    """Return the solids of a foxglove.SceneUpdate."""
    return tuple(solid for entity in scene["entities"] for solid in _of_entity(entity))


def _of_entity(entity: Mapping[str, Any]) -> Iterator[Solid]:
    corners: dict[str, Callable[[Mapping[str, Any]], Floats]] = {
        "cubes": lambda _: _CUBE,
        "cylinders": _cylinder,
        "spheres": lambda _: _SPHERE,
    }
    for kind, unit in corners.items():
        for each in entity.get(kind, ()):
            pose = _matrix(_numbers(each["pose"]["position"], "xyz"), _numbers(each["pose"]["orientation"], "xyzw"))
            sized = unit(each) * _numbers(each["size"], "xyz")
            yield Solid(entity["frame_id"], _moved(sized, pose), tuple(each["color"][name] for name in "rgba"))


_CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_TURN = np.arange(ROUND) * 2 * np.pi / ROUND
_CIRCLE = np.column_stack([np.cos(_TURN), np.sin(_TURN), np.zeros(ROUND)]) / 2
_SPHERE = np.concatenate(
    [
        _CIRCLE * (np.cos(tilt), np.cos(tilt), 0) + _UP * np.sin(tilt) / 2
        for tilt in (_TURN[: ROUND // 2 + 1] - np.pi / 2)
    ]
)


def _cylinder(primitive: Mapping[str, Any]) -> Floats:
    ends = ((primitive["bottom_scale"], -0.5), (primitive["top_scale"], 0.5))
    return np.concatenate([_CIRCLE * scale + _UP * height for scale, height in ends])


def _numbers(named: Mapping[str, float], names: str) -> Floats:
    return np.array([named[name] for name in names], dtype=np.float64)


def _matrix(translation: Floats, rotation: Floats) -> Floats:
    """Return a pose from a translation (3,) and a quaternion x, y, z, w (4,)."""
    x, y, z, w = rotation / np.linalg.norm(rotation)
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = translation
    return pose


def _moved(points: Floats, pose: Floats) -> Floats:
    moved: Floats = points @ pose[:3, :3].T + pose[:3, 3]
    return moved


def _view(followed: Floats) -> Floats:
    """Return right, up and away for an eye that looks along the y axis of a frame, upright."""
    forward = followed[:3, 0] * (1.0, 1.0, 0.0)
    length = float(np.linalg.norm(forward))
    right = forward / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.array([right, _UP, np.cross(_UP, right)])


def _outline(solid: Solid, pose: Floats, view: Floats, eye: Floats) -> Outline:
    seen = (_moved(solid.corners, pose) - eye) @ view.T  # (k, 3): right, up, away
    try:
        polygon = seen[ConvexHull(seen[:, :2]).vertices, :2]
    except QhullError:  # flat: seen edge on
        order = np.lexsort((seen[:, 1], seen[:, 0]))
        polygon = seen[order[[0, -1]], :2]
    return Outline(solid.frame, polygon, solid.color, float(seen[:, 2].mean()))


def film(scene: Mapping[str, Any], transforms: Sequence[Mapping[str, Any]]) -> Film | None:
    """Return what a system shows of a trajectory, from its JSON; None if nothing moves."""
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
