"""What a person sees of the Segway: simple solids that follow the frames world -> base_link -> pendulum."""

from typing import Any

import numpy as np

from schemas.trajectory import Floats, Trajectory, Transform, Visual
from workers.systems.segway.bullet import CENTRE_OF_MASS, FALLEN, WHEEL_RADIUS
from workers.systems.segway.controller import GOAL

_STEEL, _BLUE, _GREEN, _GREY = (0.25, 0.25, 0.28, 1.0), (0.1, 0.4, 0.9, 1.0), (0.1, 0.7, 0.3, 0.7), (0.8, 0.8, 0.8, 1.0)
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)
_ALONG_AXLE = (0.7071067811865476, 0.0, 0.0, 0.7071067811865476)  # z of the cylinder onto y of the frame
_EMPTY = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models", "metadata")


def visual(trajectory: Trajectory) -> Visual:
    """Return the scene, the two moving frames and a log that says whether it fell."""
    rows = trajectory.samples[trajectory.frames]
    x, y, heading, phi = (rows[:, trajectory.columns.index(name)] for name in ("x", "y", "heading", "phi"))
    axle = np.column_stack([x, y, np.full(len(rows), WHEEL_RADIUS)])
    base = Transform("world", "base_link", axle, _rotation(heading, axis=2))
    pendulum = Transform("base_link", "pendulum", np.zeros((len(rows), 3)), _rotation(phi, axis=1))
    return Visual(_scene(), (base, pendulum), _log(trajectory))


def _rotation(angle: Floats, *, axis: int) -> Floats:
    """Return the quaternions x, y, z, w of turns about one axis, shape (F, 4)."""
    quaternions = np.zeros((len(angle), 4))
    quaternions[:, axis], quaternions[:, 3] = np.sin(angle / 2), np.cos(angle / 2)
    return quaternions


def _log(trajectory: Trajectory) -> tuple[tuple[float, str], ...]:
    t, phi = trajectory.column("t"), np.abs(trajectory.column("phi"))
    worst = int(np.argmax(phi))
    lines = [(float(t[0]), "start"), (float(t[worst]), f"largest tilt {phi[worst]:.4f} rad")]
    if phi[worst] > FALLEN:
        lines.append((float(t[worst]), "fallen; the last state is held"))
    return tuple(lines)


def _scene() -> dict[str, Any]:
    ground = {"cubes": [_solid((2.5, 2.5, -0.01), (10.0, 10.0, 0.02), _GREY)]}
    goal = {"cylinders": [_cylinder((*GOAL, 0.005), 0.4, 0.01, _UPRIGHT, _GREEN)]}
    wheels = [_cylinder((0.0, side, 0.0), 2 * WHEEL_RADIUS, 0.06, _ALONG_AXLE, _STEEL) for side in (0.25, -0.25)]
    body = {"cubes": [_solid((0.0, 0.0, CENTRE_OF_MASS), (0.1, 0.3, 0.7), _BLUE)]}
    entities = [
        _entity("ground", "world", ground),
        _entity("goal", "world", goal),
        _entity("wheels", "base_link", {"cylinders": wheels}),
        _entity("body", "pendulum", body),
    ]
    return {"deletions": [], "entities": entities}


def _entity(name: str, frame: str, solids: dict[str, Any]) -> dict[str, Any]:
    never = {"sec": 0, "nsec": 0}
    empty: dict[str, Any] = {kind: [] for kind in _EMPTY}
    return {"id": name, "frame_id": frame, "frame_locked": True, "timestamp": never, "lifetime": never} | empty | solids


def _solid(centre: tuple[float, ...], size: tuple[float, ...], color: tuple[float, ...]) -> dict[str, Any]:
    return {"pose": _pose(centre, _UPRIGHT), "size": _named("xyz", size), "color": _named("rgba", color)}


def _cylinder(
    centre: tuple[float, ...], diameter: float, length: float, turn: tuple[float, ...], color: tuple[float, ...]
) -> dict[str, Any]:
    solid = _solid(centre, (diameter, diameter, length), color)
    return solid | {"pose": _pose(centre, turn), "bottom_scale": 1.0, "top_scale": 1.0}


def _pose(position: tuple[float, ...], orientation: tuple[float, ...]) -> dict[str, Any]:
    return {"position": _named("xyz", position), "orientation": _named("xyzw", orientation)}


def _named(names: str, values: tuple[float, ...]) -> dict[str, float]:
    return dict(zip(names, values, strict=True))
