"""Every form of a log gives the same rollout."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.schemas.file.logs import LogMapping
from perfbound.schemas.file.space import SystemChoice
from perfbound.schemas.system import Parameter
from perfbound.workers.logs.read import LogReader
from perfbound.workers.systems.rig import rig_spec
from tests.fakes.logs import (
    OF_MESSAGES,
    Floats,
    write_bag,
    write_csv,
    write_json_mcap,
    write_mat,
    write_parquet,
    write_protobuf_mcap,
    write_ros_mcap,
)

TIMES = np.asarray(np.arange(41) * 0.05, dtype=np.float64)
# Numbers of single precision: the message of a range finder has no more.
DISTANCE: Floats = np.asarray(30.0 - 4.0 * TIMES + 0.1 * np.sin(TIMES), dtype=np.float32).astype(np.float64)
SPEED: Floats = 20.0 - 6.0 * TIMES
SPEC = rig_spec(
    SystemChoice(rig="test-car", columns={"distance": "m", "speed": "m/s"}), (Parameter(name="gap", low=5, high=50),)
)
TABLE: dict[str, Floats] = {"t": TIMES, "distance": DISTANCE, "speed": SPEED}
MESSAGES = {"columns": OF_MESSAGES, "offset": "first"}

FORMS: dict[str, tuple[Callable[[Path], Path], dict[str, Any]]] = {
    "csv": (lambda folder: write_csv(folder / "a.csv", TABLE), {}),
    "csv of Excel": (
        lambda folder: write_csv(
            folder / "a.csv",
            {name: [f"{value!r}".replace(".", ",") for value in each.tolist()] for name, each in TABLE.items()},
            ";",
        ),
        {"delimiter": ";", "decimal": ","},
    ),
    "csv of a logger": (
        lambda folder: write_csv(
            folder / "a.csv",
            {"Time [ms]": 1000 * TIMES + 5000, "radar.range (m)": DISTANCE, "v": SPEED * 3.6, "note": ["-"] * 41},
        ),
        {
            "time": "Time",
            "columns": {"distance": "radar.range", "speed": "v"},
            "factors": {"t": 0.001, "speed": 1 / 3.6},
            "offset": 5.0,
            "extra": "ignore",
        },
    ),
    "parquet": (lambda folder: write_parquet(folder / "a.parquet", TABLE), {}),
    "parquet with stamps": (
        lambda folder: write_parquet(
            folder / "a.parquet", TABLE | {"t": (1e9 * TIMES + 1.7e18).round().astype("datetime64[ns]")}
        ),
        {"offset": "first"},
    ),
    "mat": (
        lambda folder: write_mat(folder / "a.mat", TABLE),
        {"time": "log.t", "columns": {"distance": "log.distance", "speed": "log.speed"}, "extra": "ignore"},
    ),
    "json in mcap": (lambda folder: write_json_mcap(folder / "a.mcap", TIMES, DISTANCE, SPEED), MESSAGES),
    "protobuf in mcap": (lambda folder: write_protobuf_mcap(folder / "a.mcap", TIMES, DISTANCE, SPEED), MESSAGES),
    **{
        f"{form} in mcap": (
            partial(lambda form, folder: write_ros_mcap(folder / "a.mcap", TIMES, DISTANCE, SPEED, form=form), form),
            MESSAGES,
        )
        for form in ("ros1", "ros2")
    },
    **{
        f"{form} bag": (
            partial(
                lambda form, folder: write_bag(
                    folder / ("a.bag" if form == "ros1" else "a"), TIMES, DISTANCE, SPEED, form=form
                ),
                form,
            ),
            MESSAGES,
        )
        for form in ("ros1", "sqlite3", "mcap")
    },
}


@pytest.mark.parametrize("form", FORMS)
def test_a_form_gives_the_rollout(tmp_path: Path, form: str) -> None:
    write, keys = FORMS[form]
    reader = LogReader(SPEC, LogMapping(**keys))
    found = reader.trajectory(write(tmp_path), 2.0)
    assert found.columns == ("t", "distance", "speed")
    assert found.samples.shape == (41, 3)
    np.testing.assert_allclose(found.samples, np.column_stack([TIMES, DISTANCE, SPEED]), rtol=1e-12, atol=3e-7)


def test_the_stamp_of_a_message_is_its_time_where_it_is_named(tmp_path: Path) -> None:
    path = write_ros_mcap(tmp_path / "a.mcap", TIMES, DISTANCE, SPEED, form="ros2")
    spec = rig_spec(SystemChoice(rig="radar", columns={"distance": "m"}), SPEC.parameters)
    mapping = LogMapping(columns={"distance": "/radar.range"}, time="header.stamp", offset="first")
    assert np.allclose(LogReader(spec, mapping).trajectory(path, 2.0).samples[:, 0], TIMES, atol=1e-9)


def test_an_offset_that_is_a_stamp_is_found_whatever_was_rounded(tmp_path: Path) -> None:
    """71103080 us times 1e-6 is a little less than 71.10308."""
    stamps = 71_103_080 + np.arange(41) * 50_000
    path = write_csv(tmp_path / "a.csv", {"t": stamps, "distance": DISTANCE, "speed": SPEED})
    assert 71_103_080 * 1e-6 < 71.10308
    found = LogReader(SPEC, LogMapping(factors={"t": 1e-6})).trajectory(path, 2.0, 71.10308)
    assert found.samples[0].tolist() == [0.0, DISTANCE[0], SPEED[0]]


def test_columns_of_unlike_times_are_resampled(tmp_path: Path) -> None:
    """A radar at 20 Hz and an odometer 10 ms later: by a rule that the file names."""
    late = tmp_path / "a.mcap"
    write_json_mcap(late, TIMES, DISTANCE, SPEED)
    columns = {"t": TIMES, "distance": DISTANCE, "speed": SPEED}
    path = write_csv(tmp_path / "a.csv", columns)
    linear = LogReader(SPEC, LogMapping(resample=0.02)).trajectory(path, 2.0).samples
    assert len(linear) == 101
    np.testing.assert_allclose(linear[:, 2], 20.0 - 6.0 * linear[:, 0], atol=1e-12)
    previous = LogReader(SPEC, LogMapping(resample=0.02, between="previous")).trajectory(path, 2.0).samples
    np.testing.assert_allclose(previous[:6, 2], SPEED[[0, 0, 0, 1, 1, 2]])
