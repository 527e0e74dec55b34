"""What MuJoCo warns of in this process: by itself it writes that into a file beside the campaign."""

from typing import Any

WARNINGS: list[str] = []
"""Since the beginning of a rollout, which empties it: MuJoCo has one listener for all models of a process."""


def listen(mujoco: Any) -> None:
    """Hear the warnings from now on."""
    mujoco.set_mju_user_warning(WARNINGS.append)
