"""The examples of systems of one's own: how much a newcomer writes for a system with its campaign file."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import perfbound as pb

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
        (("cars/many_cars.py", "cars/cars-rare.toml"), 35),
        (("pendulum/pendulum.c", "pendulum/pendulum.toml"), 40),
        (("follow/follow.py", "follow/follow.toml"), 45),
        (("cartpole/cartpole.py", "cartpole/cartpole.toml"), 40),
        (("swing/swing.py", "swing/swing.toml"), 45),
        (("satellite/satellite.py", "satellite/satellite.toml"), 60),
    ],
    ids=["function", "vectorised", "program", "input", "mujoco", "mujoco, vectorised", "jax"],
)
def test_a_system_with_its_campaign_file_is_short(files: tuple[str, ...], most: int) -> None:
    assert sum(map(lines, files)) <= most


def test_the_vectorised_cars_are_the_cars() -> None:
    one, many = (runpy.run_path(str(EXAMPLES / "cars" / f"{name}.py"))["cars"] for name in ("cars", "many_cars"))
    gaps, speeds, seeds = np.array([5.0, 30.0, 60.0]), np.array([35.0, 20.0, 5.0]), np.array([1, 2, 2**53 - 1])
    found = many(gaps, speeds, seeds=seeds, horizon=8.0, reaction=0.6)
    for place, (gap, speed, seed) in enumerate(zip(gaps, speeds, seeds, strict=True)):
        # The two draw other numbers from a seed: both get the reaction time of the batch.
        drawn = 0.8 + 0.4 * pb.uniform([seed], 1)[0, 0]
        own = np.random.default_rng(seed).uniform(0.8, 1.2)
        expected = one(gap, speed, seed=seed, horizon=8.0, reaction=0.6 * drawn / own)
        for column, values in zip(found, expected, strict=True):
            np.testing.assert_allclose(column[place], values, rtol=0, atol=1e-9)
