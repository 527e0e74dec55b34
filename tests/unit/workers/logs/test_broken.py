"""A log that is none is refused in one line, with the file and the time; nothing is repaired."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.file.logs import LogMapping
from perfbound.schemas.file.space import SystemChoice
from perfbound.schemas.system import Parameter
from perfbound.workers.logs.read import LogReader
from perfbound.workers.systems.rig import rig_spec
from tests.fakes.logs import OF_MESSAGES, Floats, write_bag, write_csv, write_json_mcap, write_mat, write_parquet

T = np.asarray(np.arange(41) * 0.05, dtype=np.float64)
D: Floats = 30.0 - 4.0 * T
V: Floats = 20.0 - 6.0 * T
SPEC = rig_spec(
    SystemChoice(rig="test-car", columns={"distance": "m", "speed": "m/s"}), (Parameter(name="gap", low=5, high=50),)
)
Write = Callable[[Path], Path]


def csv(**changed: object) -> Write:
    columns: dict[str, Any] = {"t": T, "distance": D, "speed": V} | changed
    return lambda folder: write_csv(folder / "a.csv", {key: each for key, each in columns.items() if each is not None})


def text(name: str, content: bytes) -> Write:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return write


def pipe(folder: Path) -> Path:
    os.mkfifo(folder / "a.csv")
    return folder / "a.csv"


def cut(write: Write, share: float) -> Write:
    def shortened(folder: Path) -> Path:
        path = write(folder)
        inner = path if path.is_file() else next(path.glob("*.db3"))
        data = inner.read_bytes()
        inner.write_bytes(data[: int(len(data) * share)])
        return path

    return shortened


def json_mcap(**changed: Floats) -> Write:
    given = {"times": T, "distance": D, "speed": V} | changed
    return lambda folder: write_json_mcap(folder / "a.mcap", **given)


def with_value(place: int, value: float, of: Floats = D) -> Floats:
    found = of.copy()
    found[place] = value
    return found


MESSAGES = {"columns": OF_MESSAGES, "offset": "first"}
BROKEN: dict[str, tuple[Write, Mapping[str, Any], str]] = {
    "unsorted": (csv(t=np.r_[T[:20], T[21], T[20], T[22:]]), {}, "distance has a sample at 1 s after 1.05 s"),
    "a stamp twice": (csv(t=with_value(20, 0.95, T)), {}, "a sample at 0.95 s twice"),
    "a gap": (csv(t=T + 0.6 * (T > 0.5)), {}, "distance has no sample for 0.65 s after 0.5 s; allowed are 0.5 s"),
    "not a number": (csv(distance=with_value(13, np.nan)), {}, "distance is nan at 0.65 s"),
    "infinite": (csv(speed=with_value(13, -np.inf, V)), {}, "speed is -inf at 0.65 s"),
    "another base time": (
        csv(t=T + 1.7e9),
        {},
        "it begins 1.7e+09 s after the rollout; give offset =",
    ),
    "milliseconds": (csv(t=T * 1000), {}, "if its time is in another unit, give logs.factors = { t = 0.001 }"),
    "before its begin": (csv(), {"offset": 60.0}, "ends at 2 s, before the rollout begins, at 60 s of this log; give"),
    "another unit": (
        csv(distance=D * 1000),
        {"limits": {"distance": (-5, 200)}},
        "distance is 30000 at 0 s, outside the limits [-5, 200] of the mapping; is the unit m?",
    ),
    "another unit in its title": (
        csv(speed=None, **{"speed (km/h)": V}),
        {},
        "speed is in 'km/h', and the system has it in 'm/s'",
    ),
    "too short": (csv(t=T / 2), {"resample": 0.05}, "has samples from 0 to 1 s of the rollout, not from 0 to 2 s"),
    "a late begin": (csv(t=T + 0.3), {}, "its first sample is 0.3 s after the begin"),
    "a word": (csv(distance=[*D[:13], "n/a", *D[14:]]), {}, "line 15: distance: 'n/a' is no number"),
    "a short line": (text("a.csv", b"t,distance,speed\n0,1,2\n1,2\n"), {}, "line 3 has 2 cells, and the first line 3"),
    "no line": (text("a.csv", b""), {}, "it is empty"),
    "no sample": (text("a.csv", b"t,distance,speed\n"), {}, "it has no sample"),
    "no text": (text("a.csv", bytes(range(256))), {}, "not UTF-8"),
    "no column": (csv(distance=None, distanc=D), {}, "there is no column 'distance'; did you mean 'distanc'? it has"),
    "one column more": (csv(note=V), {}, "its column 'note' is none of the system; remove it, or give extra"),
    "no time": (csv(t=None), {}, "there is no column 't'; name that of the time"),
    "another delimiter": (csv(), {"delimiter": ";"}, "there is no column"),
    "a truncated table": (
        cut(lambda folder: write_parquet(folder / "a.parquet", {"t": T, "distance": D, "speed": V}), 0.7),
        {},
        "it cannot be read",
    ),
    "complex numbers": (
        lambda folder: write_mat(folder / "a.mat", {"t": T, "distance": D + 1j, "speed": V}),
        {"time": "log.t", "columns": {"distance": "log.distance", "speed": "log.speed"}, "extra": "ignore"},
        "log.distance has complex numbers",
    ),
    "a table with rows of arrays": (
        lambda folder: write_mat(folder / "a.mat", {"t": T, "distance": np.outer(D, D), "speed": V}),
        {"time": "log.t", "columns": {"distance": "log.distance", "speed": "log.speed"}, "extra": "ignore"},
        "log.distance has the shape (41, 41)",
    ),
    "a truncated MCAP file": (cut(json_mcap(), 0.6), MESSAGES, "it is truncated"),
    "an MCAP file without its end": (cut(json_mcap(), 0.98), MESSAGES, "it is truncated"),
    "no MCAP file": (text("a.mcap", b"hello" * 100), MESSAGES, "it cannot be read"),
    "a truncated bag": (
        cut(lambda folder: write_bag(folder / "a", T, D, V, form="sqlite3"), 0.5),
        MESSAGES,
        "it cannot be read",
    ),
    "a stamp twice among messages": (
        json_mcap(times=with_value(20, 0.95, T)),
        MESSAGES,
        "distance has a sample at 0.95 s twice",
    ),
    "a gap among messages": (json_mcap(times=T + 3.0 * (T > 0.5)), MESSAGES, "no sample for 3.05 s after 0.5 s"),
    "not a number in a message": (json_mcap(speed=with_value(7, np.nan, V)), MESSAGES, "speed is nan at 0.35 s"),
    "no such topic": (
        json_mcap(),
        {"columns": {"distance": "/rader.range", "speed": "/odom.linear.x"}, "offset": "first"},
        "distance: no topic is named in '/rader.range'; did you mean '/radar'? give",
    ),
    "no such field": (
        json_mcap(),
        {"columns": {"distance": "/radar.distance", "speed": "/odom.linear.x"}},
        "/radar.distance: a message has no 'distance'; it has range",
    ),
    "no number in a message": (
        json_mcap(),
        {"columns": {"distance": "/radar.range", "speed": "/odom.name"}},
        "speed is 'car' in place of a number",
    ),
    "unlike times": (
        json_mcap(times=T),
        {"columns": OF_MESSAGES, "offset": 1.7e9 + 2**-6, "resample": 0.05},
        "has samples from -0.015625 to 1.98438 s of the rollout",
    ),
    "no log": (text("a.txt", b"hello"), {}, "a log is a CSV, Parquet, MAT, MCAP, bag file or a folder of rosbag2"),
    "a pipe": (pipe, {}, "not a file"),
    "messages without an offset": (json_mcap(), {"columns": OF_MESSAGES}, "it begins 1.7e+09 s after the rollout"),
    "nothing": (lambda folder: folder / "b.csv", {}, "No such file"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_log_is_one_line(tmp_path: Path, name: str) -> None:
    write, keys, words = BROKEN[name]
    path = write(tmp_path)
    with pytest.raises(PerfboundError) as error:
        LogReader(SPEC, LogMapping(**keys)).trajectory(path, 2.0)
    assert str(error.value).startswith(str(path))
    assert words in str(error.value)
    assert "\n" not in str(error.value)
