"""What a person sees of a trajectory, as the JSON messages of four channels: /scene, /log, /tf and /state.

| symbol | meaning |
|---|---|
| F | frames a person sees |
| n | columns of the trajectory |

Messages are templates filled with %: a json.dumps for each costs three times as much.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.base import canonical_json

Floats = NDArray[np.float64]
Messages = Iterator[tuple[int, str]]
"""Pairs of a time in nanoseconds and a JSON text."""


@dataclass(frozen=True, eq=False)
class Transform:
    """Pose of the frame `child` in the frame `parent`, one row per frame a person sees.

    Raises:
        ValueError: a shape is wrong or a number is not finite.

    """

    parent: str
    child: str
    translation: Floats  # (F, 3), m
    rotation: Floats  # (F, 4), quaternion x, y, z, w

    def __post_init__(self) -> None:
        if self.translation.shape != (len(self), 3) or self.rotation.shape != (len(self), 4):
            raise ValueError(f"transform {self.child}: shapes {self.translation.shape}, {self.rotation.shape}")
        if not (np.isfinite(self.translation).all() and np.isfinite(self.rotation).all()):
            raise ValueError(f"transform {self.child}: a number is not finite")

    def __len__(self) -> int:
        return len(self.translation)


@dataclass(frozen=True, eq=False)
class Visual:
    """What a person sees: a foxglove.SceneUpdate sent once, moving frames, and lines of a log as (seconds, text)."""

    scene: Mapping[str, Any]
    transforms: tuple[Transform, ...]
    log: tuple[tuple[float, str], ...] = ()


class Channel(NamedTuple):
    """One channel of a file: its topic, the name and the JSON schema of its messages, the messages."""

    topic: str
    schema: str
    definition: Mapping[str, Any]
    messages: Messages


def channels(visual: Visual, rows: Floats, units: Mapping[str, str]) -> tuple[Channel, ...]:
    """Return the channels of a trajectory of which a person sees `rows`, shape (F, n).

    `units` holds the columns of `rows`, in their order, with their units; the first one is the time in s.
    """
    times = _nanoseconds(rows[:, 0])
    scene = iter([(times[0], canonical_json(dict(visual.scene)))])
    return (
        Channel("/scene", "foxglove.SceneUpdate", _SCENE, scene),
        Channel("/log", "foxglove.Log", _LOG, _log_messages(visual.log)),
        Channel("/tf", "foxglove.FrameTransforms", _TRANSFORMS, _transform_messages(times, visual.transforms)),
        Channel("/state", "perfbound.State", _state_schema(units), _state_messages(times, rows, units)),
    )


def _nanoseconds(seconds: Floats) -> list[int]:
    times: list[int] = np.rint(seconds * 1e9).astype(np.int64).tolist()
    return times


def _text(value: str) -> str:
    """Return `value` as JSON text inside a template."""
    return json.dumps(value).replace("%", "%%")


def _log_messages(lines: tuple[tuple[float, str], ...]) -> Messages:
    for seconds, message in lines:
        time = round(seconds * 1e9)
        stamp = {"sec": time // 10**9, "nsec": time % 10**9}
        line = {"timestamp": stamp, "level": 2, "message": message, "name": "perfbound", "file": "", "line": 0}
        yield time, canonical_json(line)


def _stamp(time: int) -> str:
    return f'{{"sec":{time // 10**9},"nsec":{time % 10**9}}}'


def _transform_messages(times: list[int], transforms: tuple[Transform, ...]) -> Messages:
    if not transforms:
        return
    one = (
        '{"timestamp":%%s,"parent_frame_id":%s,"child_frame_id":%s,'
        '"translation":{"x":%%.6g,"y":%%.6g,"z":%%.6g},"rotation":{"x":%%.6g,"y":%%.6g,"z":%%.6g,"w":%%.6g}}'
    )
    each = ",".join(one % (_text(transform.parent), _text(transform.child)) for transform in transforms)
    template = f'{{"transforms":[{each}]}}'
    stamps = np.array([[_stamp(time)] for time in times], dtype=object)  # (F, 1)
    blocks = [block for pose in transforms for block in (stamps, pose.translation, pose.rotation)]
    for time, values in zip(times, np.hstack(blocks).tolist(), strict=True):
        yield time, template % tuple(values)


def _state_messages(times: list[int], rows: Floats, columns: Iterable[str]) -> Messages:
    each = ",".join(f"{_text(name)}:%.6g" for name in columns)
    template = f"{{{each}}}"
    for time, numbers in zip(times, rows.tolist(), strict=True):
        yield time, template % tuple(numbers)


def _state_schema(units: Mapping[str, str]) -> dict[str, Any]:
    return _object(**{name: {"type": "number", "description": f"unit: {unit}"} for name, unit in units.items()})


def _object(**properties: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _numbers(names: str) -> dict[str, Any]:
    return _object(**{name: {"type": "number"} for name in names})


def _array(items: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


# The parts of foxglove's schemas (https://docs.foxglove.dev/docs/sdk/schemas) that our files use.
_STRING, _INTEGER, _BOOLEAN = {"type": "string"}, {"type": "integer"}, {"type": "boolean"}
_TIME = _object(sec=_INTEGER, nsec=_INTEGER)
_POSE = _object(position=_numbers("xyz"), orientation=_numbers("xyzw"))
_SOLID = _object(pose=_POSE, size=_numbers("xyz"), color=_numbers("rgba"))
_CYLINDER = _object(**_SOLID["properties"], bottom_scale={"type": "number"}, top_scale={"type": "number"})
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_STRING,
    id=_STRING,
    lifetime=_TIME,
    frame_locked=_BOOLEAN,
    metadata=_array(_object(key=_STRING, value=_STRING)),
    cubes=_array(_SOLID),
    spheres=_array(_SOLID),
    cylinders=_array(_CYLINDER),
    **{kind: _array(_object()) for kind in ("arrows", "lines", "triangles", "texts", "models")},
)
_SCENE = _object(deletions=_array(_object()), entities=_array(_ENTITY))
_TRANSFORMS = _object(
    transforms=_array(
        _object(
            timestamp=_TIME,
            parent_frame_id=_STRING,
            child_frame_id=_STRING,
            translation=_numbers("xyz"),
            rotation=_numbers("xyzw"),
        )
    )
)
_LOG = _object(timestamp=_TIME, level=_INTEGER, message=_STRING, name=_STRING, file=_STRING, line=_INTEGER)
