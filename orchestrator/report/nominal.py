"""Nominal curves beside true ones that were recorded alone: simulated for a report, and no evidence of anything."""

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ...schemas.errors import PerfboundError
from ...schemas.facts import Header
from ...schemas.ids import RolloutId
from ...schemas.trajectory import Trajectory, decode
from ..fleet.child import ask, system_specs
from ..store.read import read_header, reading
from . import curves
from .data import Curve, ReportData, Rollout, RolloutsOfTest

MOST = 8
"""Scenes that get one."""
LABEL = "nominal, simulated for this report"


def with_nominal(directory: Path, story: ReportData) -> ReportData:
    """Return the story with nominal curves; where the system cannot be simulated here, a label says so.

    Raises:
        JournalError: the database cannot be read.

    """
    lonely = [scene for scene in story.scenes if {trace.variant for trace in scene.traces} == {"true"}][:MOST]
    if not lonely:
        return story
    with reading(directory) as connection:
        header = read_header(connection, directory)
    known: dict[tuple[float, ...], Trajectory] = {}
    try:
        _check(header)
        for scene in lonely:
            start = scene.rollouts[0].x
            known[start] = known.get(start) or _simulated(header, scene.rollouts[0])
    except PerfboundError as error:
        note = f" (no nominal curve: {error})"
        return _changed(story, {id(scene): _noted(scene, note) for scene in lonely})
    return _changed(story, {id(scene): _joined(header, scene, known[scene.rollouts[0].x]) for scene in lonely})


def _check(header: Header) -> None:
    """Refuse to simulate another system than the campaign's, or one whose nominal variant depends on the seed."""
    found, spec = system_specs().get(header.spec.name), header.spec
    if found is None or found.digest != spec.digest:
        raise PerfboundError(f"{spec.name} is not installed here as it was in the campaign")
    if "nominal" not in spec.variants or "nominal" in spec.noisy:
        raise PerfboundError(f"{spec.name} has no single nominal rollout of a start")


def _simulated(header: Header, rollout: Rollout) -> Trajectory:
    rollout_id = RolloutId(rollout.problem, rollout.test, "nominal", 0)
    request = replace(header.template, visual=False).request(rollout_id, rollout.x, rollout.seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "nominal.mcap"
        ask("simulate", "--request", request.model_dump_json(), "--out", str(file))
        return decode(file.read_bytes())


def _joined(header: Header, scene: RolloutsOfTest, trajectory: Trajectory) -> RolloutsOfTest:
    added = []
    for column in dict.fromkeys(trace.column for trace in scene.traces):
        t, values = curves.thinned(trajectory.samples[:, 0], trajectory.column(column))
        added.append(Curve(LABEL, "nominal", column, curves.column_unit(header, column), t, values))
    return replace(scene, traces=(*added, *scene.traces))


def _noted(scene: RolloutsOfTest, note: str) -> RolloutsOfTest:
    first, *others = scene.traces
    return replace(scene, traces=(replace(first, label=first.label + note), *others))


def _changed(story: ReportData, scenes: Mapping[int, RolloutsOfTest]) -> ReportData:
    return replace(story, scenes=tuple(scenes.get(id(scene), scene) for scene in story.scenes))
