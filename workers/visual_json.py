"""The visual part of a trajectory for programs that draw it: the scene and the moving frames as JSON."""

from typing import Any

from google.protobuf.json_format import MessageToDict

from ..schemas.trajectory import Transform, read_mcap
from .systems import load_system


def visual_json(data: bytes) -> dict[str, Any] | None:
    """Return the scene and the frames of a trajectory's file, one pose per visible frame; None without a scene.

    Poses are in the frame `parent`: translations (F, 3) in m, rotations (F, 4) as quaternions x, y, z, w.

    Raises:
        TrajectoryError: `data` is no trajectory file.
        UnknownSystemError: its system is not installed.

    """
    file = read_mcap(data)
    visual = load_system(str(file.request.get("system"))).visual(file.trajectory)
    if visual is None or visual.plots:
        return None
    scene = MessageToDict(visual.scene, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
    return {"scene": scene, "transforms": [_pose(each) for each in visual.transforms]}


def _pose(transform: Transform) -> dict[str, Any]:
    return {
        "parent": transform.parent,
        "child": transform.child,
        "translation": transform.translation.tolist(),
        "rotation": transform.rotation.tolist(),
    }
