"""The visual part of a trajectory: what Foxglove or rerun draws; no evidence.

| symbol | meaning |
|---|---|
| F | frames of the visual part |
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # the types of foxglove take a twentieth of a second, and few workers have a scene
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Transform:
    """Pose of the frame `child` in the frame `parent`, one row per frame of the visual part.

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
    """The visual part: a scene sent once, moving frames, and lines of a log as (seconds, text).

    `Visual(plots=True)` has a channel of numbers for each column instead.

    Raises:
        ValueError: it has both.

    """

    scene: "SceneUpdate | None" = None
    transforms: tuple[Transform, ...] = ()
    log: tuple[tuple[float, str], ...] = ()
    plots: bool = False

    def __post_init__(self) -> None:
        if self.plots and (self.scene is not None or self.transforms or self.log):
            raise ValueError("a visual part has either plots, or a scene with its transforms and its log")
