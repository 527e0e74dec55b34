"""Nominal curves beside true ones that were recorded alone: simulated for a report, and no part of the evidence."""

import tempfile
from dataclasses import replace
from pathlib import Path

from ....schemas.errors import PerfboundError
from ....schemas.ids import RolloutId
from ....schemas.result.facts import Header
from ....schemas.trajectory.trajectory import Trajectory, decode
from ...certificate.verify.stages import Report
from ...fleet.children.child import system_specs
from ...fleet.children.simulate import simulate_to
from ...store.read import read_header, reading
from ..data.page import ReportData
from ..data.rollouts import Rollout, RolloutsOfTest
from ..stages import unreported
from . import curves

MOST = 8
"""Tests that get a nominal curve; a child process simulates each."""
LABEL = "nominal, simulated for this report"


def with_nominal(directory: Path, data: ReportData, report: Report = unreported) -> ReportData:
    """Return the data with nominal curves; where the system cannot be simulated here, a label gives the reason.

    Raises:
        JournalError: the database cannot be read.

    """
    true_only = [each for each in data.scenes if {trace.variant for trace in each.traces} == {"true"}][:MOST]
    if not true_only:
        return data
    with reading(directory) as connection:
        header = read_header(connection, directory)
    try:
        _check_system(header)
        starts = {each.rollouts[0].x: each.rollouts[0] for each in true_only}
        nominal = {}
        for done, (x, rollout) in enumerate(starts.items()):
            report("nominal curves", done, len(starts))
            nominal[x] = _simulated(header, rollout)
        report("nominal curves", len(starts), len(starts))
        added = {id(each): _joined(header, each, nominal[each.rollouts[0].x]) for each in true_only}
    except PerfboundError as error:
        added = {id(each): _noted(each, f" (no nominal curve: {error})") for each in true_only}
    return replace(data, scenes=tuple(added.get(id(each), each) for each in data.scenes))


def _check_system(header: Header) -> None:
    """Refuse another system than the campaign's, or one whose nominal variant depends on the seed.

    A system in a file is refused too: a run directory may be untrusted, and must not name code that runs here.
    """
    found, spec = system_specs().get(header.spec.name), header.spec
    if found is None or found.digest != spec.digest:
        raise PerfboundError(f"{spec.name} is not installed here as it was in the campaign")
    if "nominal" not in spec.variants or "nominal" in spec.noisy:
        raise PerfboundError(f"{spec.name} has no single nominal rollout of a start")


def _simulated(header: Header, rollout: Rollout) -> Trajectory:
    # Without noise the nominal rollout does not depend on the seed; that of a true one serves.
    nominal = RolloutId(rollout.problem, rollout.test, "nominal", 0)
    request = replace(header.template, visual=False).request(nominal, rollout.x, rollout.seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "nominal.mcap"
        simulate_to(path, request, header.spec, None, limit=header.config.deadline)
        return decode(path.read_bytes())


def _joined(header: Header, scene: RolloutsOfTest, trajectory: Trajectory) -> RolloutsOfTest:
    columns = list(dict.fromkeys(trace.column for trace in scene.traces))
    added = curves.of_trajectory(header, columns, trajectory, LABEL, "nominal")
    return replace(scene, traces=(*added, *scene.traces))


def _noted(scene: RolloutsOfTest, note: str) -> RolloutsOfTest:
    first, *others = scene.traces
    return replace(scene, traces=(replace(first, label=first.label + note), *others))
