"""One rollout without a campaign: simulated, tabulated, drawn, and compared with what a campaign accepts."""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from ....schemas import atomic
from ....schemas.errors import PerfboundError, UnusableTrajectoryError
from ....schemas.trajectory.trajectory import decode
from ...campaign.admission import check_whole
from ...fleet.children.simulate import WantedRollout, column_lines, simulate_to


def simulate_once(
    wanted: WantedRollout, *, out: Path | None, plot: Path | None, on_line: Callable[[str], None]
) -> Iterator[str]:
    """Run one rollout, write its file to `out` and its picture to `plot`, and yield lines that describe it.

    `on_line` gets what the system prints, line by line.

    Raises:
        PerfboundError: the rollout fails, or a campaign would refuse it; in the latter case the files are written.

    """
    spec, request, limit = wanted.request()
    with tempfile.TemporaryDirectory() as folder:
        path = out or Path(folder) / "rollout.mcap"
        simulate_to(path, request, spec, wanted.system, limit=limit, on_line=on_line)
        trajectory = decode(path.read_bytes())
    yield from column_lines(spec, trajectory)
    if wanted.horizon is None:
        yield f"horizon {request.horizon:g} s, because --horizon is not given"
    if request.disturbances:
        yield f"disturbances: {request.disturbance_words(spec)}"
    if out is not None:
        yield f"{len(trajectory.samples)} samples in {out}"
    if plot is not None:
        from .panels import drawn_rollout  # noqa: PLC0415  (late: matplotlib takes a second to load)

        atomic.write_whole(plot.absolute(), drawn_rollout(spec, request, trajectory))
        yield f"picture: {plot}"
    try:
        check_whole(trajectory, tuple(column.name for column in spec.columns), request.horizon)
    except UnusableTrajectoryError as fault:
        raise PerfboundError(f"a campaign would refuse this rollout: {fault}; or choose another --horizon") from None
