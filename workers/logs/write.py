"""The logs of the tests of a campaign, each as the file of its rollout."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import cast

from ...schemas.base import canonical_json
from ...schemas.errors import PerfboundError
from ...schemas.rollout import RolloutRequest
from ..handed_in import constants_of, file_of
from ..systems import load_system
from ..systems.rig import DescribedRig
from .read import LogReader

MOST = 50
"""Faults that are listed."""


def write_tests(system: str, tests: Path, out: Path) -> list[str]:
    """Write `K.mcap` for the test in line K of a file, from 0, and return a line for each log that is none.

    A line has the `request`, the `log` and its `offset`.
    """
    rig = cast(DescribedRig, load_system(system))
    reader = LogReader(rig.spec, rig.mapping, rig.step)
    faults: dict[str, list[str]] = {}
    """What is wrong -> the logs of which it is."""
    for number, line in enumerate(tests.read_text().splitlines()):
        asked = json.loads(line)
        request = RolloutRequest.model_validate_json(canonical_json(asked["request"]))
        log = Path(asked["log"])
        try:
            constants = constants_of(rig.spec, request.x)
            trajectory = reader.trajectory(log, request.horizon, asked["offset"], constants)
            (out / f"{number}.mcap").write_bytes(file_of(trajectory, request, rig.spec))
        except PerfboundError as error:
            text = str(error)
            what = text.removeprefix(f"{log}: ")
            faults.setdefault(what if what != text else text, []).append(str(log))
            (out / f"{number}.fault").touch()
    lines = [_line(what, logs) for what, logs in faults.items()]
    more = len(lines) - MOST
    return [*lines[:MOST], *([f"and {more:,} further faults"] if more > 0 else [])]


def _line(what: str, logs: Sequence[str]) -> str:
    others = f" and {len(logs) - 1:,} further logs" if len(logs) > 1 else ""
    return f"{logs[0]}{others}: {what}"
