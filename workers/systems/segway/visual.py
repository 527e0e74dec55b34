"""The visual part of a Segway trajectory: solids, their frames world -> base_link -> pendulum, a log of the tilt."""

from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.duration_pb2 import Duration
from google.protobuf.timestamp_pb2 import Timestamp

from ....schemas.trajectory.trajectory import Floats, Trajectory, Transform, Visual
from .bullet import CENTRE_OF_MASS, FALLEN, WHEEL_RADIUS
from .controller import GOAL

Vector = tuple[float, ...]

_STEEL, _BLUE, _GREEN, _GREY = (0.25, 0.25, 0.28, 1.0), (0.1, 0.4, 0.9, 1.0), (0.1, 0.7, 0.3, 0.7), (0.8, 0.8, 0.8, 1.0)
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)
_ALONG_AXLE = (0.7071067811865476, 0.0, 0.0, 0.7071067811865476)  # z of the cylinder onto y of the frame


def visual(trajectory: Trajectory) -> Visual:
    """Return the scene, the two moving frames and a log with the largest tilt and a fall."""
    rows = trajectory.samples[trajectory.frames]
    x, y, heading, phi = (rows[:, trajectory.columns.index(name)] for name in ("x", "y", "heading", "phi"))
    axle = np.column_stack([x, y, np.full(len(rows), WHEEL_RADIUS)])
    base = Transform("world", "base_link", axle, _rotation(heading, axis=2))
    pendulum = Transform("base_link", "pendulum", np.zeros((len(rows), 3)), _rotation(phi, axis=1))
    return Visual(_scene(), (base, pendulum), _log_lines(trajectory))


def _rotation(angle: Floats, *, axis: int) -> Floats:
    """Return the quaternions x, y, z, w of turns about one axis, shape (F, 4)."""
    quaternions = np.zeros((len(angle), 4))
    quaternions[:, axis], quaternions[:, 3] = np.sin(angle / 2), np.cos(angle / 2)
    return quaternions


def _log_lines(trajectory: Trajectory) -> tuple[tuple[float, str], ...]:
    t, phi = trajectory.column("t"), np.abs(trajectory.column("phi"))
    worst = int(np.argmax(phi))
    lines = [(float(t[0]), "start"), (float(t[worst]), f"largest tilt {phi[worst]:.4f} rad")]
    if phi[worst] > FALLEN:
        lines.append((float(t[worst]), "fallen; the last state is held"))
    return tuple(lines)


def _scene() -> SceneUpdate:
    ground = _solid_cube((2.5, 2.5, -0.01), (10.0, 10.0, 0.02), _GREY)
    goal = _solid_cylinder((*GOAL, 0.005), 0.4, 0.01, _UPRIGHT, _GREEN)
    wheels = [_solid_cylinder((0.0, side, 0.0), 2 * WHEEL_RADIUS, 0.06, _ALONG_AXLE, _STEEL) for side in (0.25, -0.25)]
    body = _solid_cube((0.0, 0.0, CENTRE_OF_MASS), (0.1, 0.3, 0.7), _BLUE)
    return SceneUpdate(
        entities=[
            _entity("ground", "world", cubes=[ground]),
            _entity("goal", "world", cylinders=[goal]),
            _entity("wheels", "base_link", cylinders=wheels),
            _entity("body", "pendulum", cubes=[body]),
        ]
    )


def _entity(name: str, frame: str, **solids: Any) -> SceneEntity:
    return SceneEntity(id=name, frame_id=frame, frame_locked=True, timestamp=Timestamp(), lifetime=Duration(), **solids)


def _solid_cube(centre: Vector, size: Vector, color: Vector) -> CubePrimitive:
    return CubePrimitive(pose=_pose_message(centre, _UPRIGHT), size=_vector(size), color=_color(color))


def _solid_cylinder(centre: Vector, diameter: float, length: float, turn: Vector, color: Vector) -> CylinderPrimitive:
    return CylinderPrimitive(
        pose=_pose_message(centre, turn),
        size=_vector((diameter, diameter, length)),
        color=_color(color),
        bottom_scale=1.0,
        top_scale=1.0,
    )


def _pose_message(position: Vector, orientation: Vector) -> Pose:
    return Pose(position=_vector(position), orientation=Quaternion(**dict(zip("xyzw", orientation, strict=True))))


def _vector(values: Vector) -> Vector3:
    return Vector3(**dict(zip("xyz", values, strict=True)))


def _color(values: Vector) -> Color:
    return Color(**dict(zip("rgba", values, strict=True)))
