"""The examples of systems of one's own: how much a newcomer writes for a system with its campaign file."""

import re
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
MODEL = re.compile(r"<mujoco>.*</mujoco>", re.DOTALL)
"""Of cartpole: what any program with MuJoCo has."""


def lines(name: str) -> int:
    """Count the lines of an example file that are neither empty nor a comment."""
    text = MODEL.sub("", (EXAMPLES / name).read_text())
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    code = [line.strip() for line in text.splitlines() if line.strip()]
    return sum(line.startswith("#include") or not line.startswith("#") for line in code)


@pytest.mark.parametrize(
    ("files", "most"),
    [
        (("cars/cars.py", "cars/cars.toml"), 35),
        (("pendulum/pendulum.c", "pendulum/pendulum.toml"), 40),
        (("follow/follow.py", "follow/follow.toml"), 45),
        (("cartpole/cartpole.py", "cartpole/cartpole.toml"), 40),
    ],
    ids=["function", "program", "input", "mujoco"],
)
def test_a_system_with_its_campaign_file_is_short(files: tuple[str, ...], most: int) -> None:
    assert sum(map(lines, files)) <= most
