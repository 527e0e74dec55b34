"""The picture of one rollout."""

import io

import numpy as np
import pytest
from PIL import Image

from perfbound.orchestrator.report.rollout.panels import MOST, drawn_rollout
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.requests import RequestTemplate
from perfbound.schemas.system import Column, Parameter, SystemSpec
from perfbound.schemas.trajectory.trajectory import Trajectory


def picture(columns: int, samples: int = 50, unit: str = "m/s", parameters: int = 2) -> Image.Image:
    return Image.open(io.BytesIO(drawn(columns, samples, unit, parameters)))


def drawn(columns: int, samples: int = 50, unit: str = "m/s", parameters: int = 2) -> bytes:
    spec = SystemSpec(
        name="robot",
        doc="",
        parameters=tuple(Parameter(name=f"p{k}", unit=unit, low=0, high=1) for k in range(parameters)),
        columns=tuple(Column(name=name, unit=unit) for name in ("t", *(f"c{k}" for k in range(columns)))),
        max_horizon=10.0,
    )
    request = RequestTemplate.of(spec, {}, horizon=5.0, visual=False).request(
        RolloutId("simulate", 0, "true", 0), [0.5] * parameters, 7
    )
    t = np.linspace(0, 5, samples) if samples > 1 else np.zeros(1)
    values = np.column_stack([t, *(np.sin(t + k) for k in range(columns))])
    trajectory = Trajectory(tuple(column.name for column in spec.columns), values)
    return drawn_rollout(spec, request, trajectory)


def test_equal_rollouts_give_equal_bytes() -> None:
    assert drawn(2) == drawn(2)


@pytest.mark.parametrize("unit", ["m", "1", "", "$\\frac{m$", "ä\n\x1b"])
def test_any_unit_is_drawn(unit: str) -> None:
    assert picture(2, unit=unit).format == "PNG"


def test_one_sample_is_a_point() -> None:
    pixels = np.asarray(picture(1, samples=1).convert("RGB"))
    assert (pixels.reshape(-1, 3) == (0, 0x72, 0xB2)).all(axis=1).any()


@pytest.mark.rest
def test_many_columns_are_beside_one_another_and_the_first_of_very_many_are_drawn() -> None:
    one, two, most = picture(10), picture(11), picture(MOST)
    assert two.width == 2 * one.width
    assert most.size == picture(MOST + 60).size


def test_a_long_start_makes_more_lines_of_title() -> None:
    assert picture(1, parameters=30).height > picture(1).height
