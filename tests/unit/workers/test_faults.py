"""The text of an exception of a system names the line that the author of the system wrote."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from perfbound.workers.faults import LONGEST_TEXT, fault_text
from perfbound.workers.systems.base import checked_options
from perfbound.workers.systems.test_function import TestFunctionSystem

CODE = """import json

import numpy as np

def divide(x):
    return helper(x)

def helper(x):
    return 1 / x

def in_a_library(x):
    return json.loads("{")

def silent(x):
    assert not x

class Mute(Exception):
    def __str__(self):
        raise ValueError

def mute(x):
    raise Mute

def long(x):
    raise ValueError("a" * 10_000)
"""


def compiled(path: Path, name: str) -> ModuleType:
    """Return the module of these lines as if it were in the file `path`."""
    module = ModuleType(name)
    exec(compile(CODE, str(path), "exec"), module.__dict__)
    return module


def text_of(function: Callable[..., object], *arguments: object, **keywords: object) -> str:
    try:
        function(*arguments, **keywords)
    except Exception as fault:  # noqa: BLE001  (any: it is the subject of these tests)
        frames = fault.__traceback__
        # Without the frame of this test, in whose place a worker has one of perfbound.
        return fault_text(fault.with_traceback(frames and frames.tb_next))
    raise AssertionError("it raises nothing")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("divide", "ZeroDivisionError: division by zero (cars.py, line 9)"),
        ("in_a_library", "JSONDecodeError: Expecting property name enclosed in double quotes: line 1 column 2 (char 1) "
         "(cars.py, line 12)"),
        ("silent", "AssertionError (cars.py, line 15)"),
        ("mute", "Mute (cars.py, line 22)"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("folder", ["/home/me", f"{sys.prefix}/lib/python3/site-packages/robot"])
def test_an_exception_has_the_place_in_the_code_of_the_system(folder: str, name: str, expected: str) -> None:
    argument = {"silent": 1}.get(name, 0)
    function = getattr(compiled(Path(folder, "cars.py"), "robot"), name)
    assert text_of(function, argument) == expected


def test_a_long_text_keeps_its_place() -> None:
    found = text_of(compiled(Path("/home/me/cars.py"), "robot").long, 0)
    assert found.endswith("aaa (cars.py, line 25)")
    assert len(found) < LONGEST_TEXT + 50


def test_perfbound_itself_is_no_place() -> None:
    arguments = {"variant": "nominal", "horizon": 0.0, "options": {}}
    found = text_of(checked_options, TestFunctionSystem().spec, (9.0, 0.0), **arguments)
    assert found == "SimulationError: z1 = 9.0 is outside [0.0, 5.0]"
