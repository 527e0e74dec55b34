"""`perfbound new-system`: an installable package with a small system, its test and a README."""

import keyword
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from string import Template

from ....schemas import atomic
from ....schemas.errors import PerfboundError

NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
TAKEN = frozenset({"numpy", "perfbound", "pytest", "segway", "test-function", "tests"})
"""Names of packages that the new one imports, of its folder of tests, and of installed systems."""

PYPROJECT = """\
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"

[project]
name = "$name"
version = "0.1.0"
description = "A system under test for perfbound"
requires-python = ">=3.11"
dependencies = ["numpy", "perfbound"]

[project.optional-dependencies]
test = ["pytest"]

# The name before the equals sign is the one in campaign files; it has to be that of the system.
[project.entry-points."perfbound.systems"]
$name = "$module:$module"

[tool.setuptools]
packages = ["$module"]
"""
CODE = '''\
"""A cart that brakes in front of a wall. Put your simulator in its place."""

from importlib.metadata import version

import numpy as np

import perfbound as pb

STEP = 0.02


@pb.system(
    parameters={"distance": pb.Parameter(8, 20, unit="m"), "speed": pb.Parameter(1, 5, unit="m/s")},
    columns={"distance": "m", "speed": "m/s"},
    step=STEP,
    # Another version of this package, or of what decides its numbers, is another system: its campaigns do not mix.
    versions={"$name": version("$name"), "numpy": np.__version__},
)
def $module(distance, speed, *, seed, horizon=8.0, deceleration=2.0):
    """Brake at once, with a deceleration that varies by a tenth."""
    t = np.arange(round(horizon / STEP) + 1) * STEP
    real = deceleration * np.random.default_rng(seed).uniform(0.9, 1.1)
    braking = np.minimum(t, speed / real)
    return distance - speed * braking + real * braking**2 / 2, speed - real * braking
'''
TEST = '''\
"""What a certificate rests on: a rollout follows from its arguments alone, and covers its whole time."""

import numpy as np
from $module import $module

START = (10.0, 4.0)


def rollout(seed=1, horizon=8.0):
    return $module.rollout(
        START, variant="nominal", seed=seed, horizon=horizon, options={}, progress=lambda _step: None
    ).samples


def test_equal_arguments_give_equal_bytes_whatever_ran_before():
    first = rollout()
    rollout(seed=2)
    assert rollout().tobytes() == first.tobytes()


def test_the_seed_matters():
    assert not np.array_equal(rollout(seed=1), rollout(seed=2))


def test_it_covers_the_time_from_0_to_the_horizon():
    for horizon in (0.5, 8.0):
        t = rollout(horizon=horizon)[:, 0]
        assert (t[0], round(t[-1], 9)) == (0.0, horizon)
'''
README = """\
# $name

A system under test for perfbound, in `$module/__init__.py`.

    pip install --editable '.[test]'
    python -m pytest
    perfbound systems $name
    perfbound simulate $name --x 10,4 --plot one.png
    perfbound init $name --specification "always (distance >= 0)"
    perfbound run $name.toml

After a change of its numbers, raise the version in `pyproject.toml` and install again.
"""
FILES = {
    "pyproject.toml": PYPROJECT,
    "README.md": README,
    "$module/__init__.py": CODE,
    "tests/test_$module.py": TEST,
}


def package_files(name: str) -> dict[str, str]:
    """Return the files of a package by their paths in it.

    Raises:
        PerfboundError: the name is not allowed.

    """
    module = name.replace("-", "_")
    if not NAME.fullmatch(name) or len(name) > 64:
        raise PerfboundError(f"{name!r} is no name of a system; choose words of a-z and 0-9, joined by '-': my-robot")
    if keyword.iskeyword(module) or module in sys.stdlib_module_names or name in TAKEN:
        raise PerfboundError(f"{name!r} is the name of something else; choose another one: my-{name}")
    return {
        Template(path).substitute(module=module): Template(text).substitute(name=name, module=module)
        for path, text in FILES.items()
    }


def write_package(name: str, folder: Path) -> Iterator[str]:
    """Write a package into a folder that is empty or new, and yield lines that say what to do next.

    Raises:
        PerfboundError: the name is not allowed, or the folder has files.

    """
    contents = package_files(name)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise PerfboundError(f"{folder}: exists already and stays as it is; choose another --out")
    paths = {folder.absolute() / path: text for path, text in contents.items()}
    for parent in {path.parent for path in paths}:
        atomic.make_folder(parent)
    atomic.write_new({path: (text.encode(), 0o666) for path, text in paths.items()})
    yield from (str(folder / path) for path in contents)
    yield f"Next: cd {folder}, and the commands of README.md"
