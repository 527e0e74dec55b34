"""The replay of a recorded rollout: simulated in a child of `workers`, compared with its file, and drawn."""

import hashlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ....schemas import atomic
from ....schemas.errors import PerfboundError, TrajectoryError
from ....schemas.trajectory.batch import digest_of, read_batch
from ....schemas.trajectory.trajectory import Floats, Trajectory, decode
from ....schemas.values import Beyond
from ...fleet.children.simulate import draw_to, simulate_to
from ...mathematics.stl.over_time import robustness_signal, worst_moment
from ...mathematics.stl.tree import Formula
from . import curves, over_time
from .comparison import Deviation, compare, lines
from .load import RecordedRollout, description, load_recorded


def replay_rollout(
    directory: Path, rollout: str, *, out: Path | None = None, mcap: Path | None = None, system: str | None = None
) -> Iterator[str]:
    """Simulate a rollout of the campaign in `directory` again, and yield the result as lines of text.

    Writes its picture to `out`. Writes the recorded trajectory, or the new one where its file is damaged, with its
    visual part to `mcap`. `system` is FILE.py:NAME, for a system in a file.

    Raises:
        PerfboundError: there is no such rollout, the system is missing or of another version, or the new trajectory
            differs from the recorded one; in the last case the files are written nevertheless.

    """
    found = load_recorded(directory, rollout)
    if found.header.spec.repeated != "anywhere":
        raise PerfboundError(
            f"{found.header.spec.name}: its rollouts cannot be simulated again; the recorded file stays"
        )
    # As in `verify`: a run directory may be untrusted, and must not name code that runs here.
    if found.header.config.system.kind != "name" and system is None:
        raise PerfboundError(f"{found.header.spec.name} is a system in a file: name it with --system")
    yield _title(found)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "again.mcap"
        again, digest = _resimulated(found, path, system)
        if found.trajectory is None:
            yield found.damage
            fault = _digest_fault(found, digest)
            what = "trajectory" if found.fact.batch else "file"
            yield fault or f"simulated again, the {what} is bitwise the same as the recorded one"
        else:
            deviation = compare(again, found.trajectory)
            yield from lines(deviation, {column.name: column.unit for column in found.header.spec.columns})
            fault = _fault(found, deviation)
        if mcap is not None:
            drawn = found.trajectory or again
            draw_to(path, drawn, found.request, found.header.spec, system, limit=found.header.config.deadline)
            atomic.write_whole(mcap.absolute(), path.read_bytes())
            yield f"file: {mcap}"
        if out is not None:
            atomic.write_whole(out.absolute(), _picture(found, again))
            yield f"picture: {out}"
    if fault:
        raise PerfboundError(f"{found.fact.rollout}: {fault}")


def _resimulated(found: RecordedRollout, path: Path, system: str | None) -> tuple[Trajectory, str]:
    """Simulate a rollout again and return its trajectory, and the digest that a fact has of it."""
    spec, request = found.header.spec, found.batch or found.request
    simulate_to(path, request, spec, system, limit=found.header.config.deadline)
    data = path.read_bytes()
    try:
        again = decode(data) if found.batch is None else read_batch(data).alone(found.fact.rollout).trajectory
    except TrajectoryError as error:
        raise PerfboundError(f"the system returned no trajectory: {error}; fix the system") from None
    return again, digest_of(again).hex() if found.fact.batch else hashlib.sha256(data).hexdigest()


def _title(found: RecordedRollout) -> str:
    return f"{found.fact.rollout}: {description(found)}"


def _digest_fault(found: RecordedRollout, digest: str) -> str:
    """Return the fault of a rollout whose file is damaged, once it is simulated again; empty if it is the same one."""
    if digest == found.fact.sha256:
        return ""
    what = "trajectory" if found.fact.batch else "file"
    return f"simulated again, the {what} has the sha256 {digest[:12]}..., not the recorded {found.fact.sha256[:12]}..."


def _fault(found: RecordedRollout, deviation: Deviation) -> str:
    if deviation.within_tolerance:
        return ""
    if deviation.worst is None:
        return f"simulated again, {deviation.mismatch}"
    worst = deviation.worst
    unit = curves.quantity_unit(found.header, worst.column)
    return (
        f"simulated again, {worst.column} differs by up to {worst.largest:.3g} {unit} at t = {worst.at:.3f} s: "
        "the rollout does not follow from its seed alone, or this machine computes other floating-point results "
        "than the one that recorded it"
    )


def _picture(found: RecordedRollout, again: Trajectory) -> bytes:
    """Return the PNG of a rollout."""
    from . import picture  # noqa: PLC0415  (late: matplotlib takes a second to load)

    header = found.header
    problems = header.config.problems
    # A closing check has no columns of its own: those of the first problem.
    problem = next((each for each in problems if each.name == found.fact.rollout.problem), problems[0])
    tree, beyond = curves.formula(header), header.config.beyond
    deciding = over_time.deciding_quantities(again, tree, beyond)
    names = curves.relevant_quantities(header, problem, deciding) or again.columns[1:2]
    limits = curves.limits(header, names)
    return picture.drawn(
        picture.Picture(
            title=_title(found),
            again=again,
            recorded=found.trajectory,
            panels=tuple(
                picture.Panel(
                    name,
                    curves.quantity_unit(header, name),
                    tuple(limit for of, limit in limits if of == name),
                    marked=name in deciding or not deciding,
                )
                for name in names
            ),
            worst=_worst(tree, again, beyond),
        )
    )


def _worst(tree: Formula | None, trajectory: Trajectory, beyond: Beyond) -> int | None:
    """Return the sample at which the robustness is attained, the first one of several; None if there is none."""
    if tree is None:
        return None
    moment = worst_moment(tree, trajectory.columns, trajectory.samples, beyond)
    margin = margins(tree, trajectory, beyond) if moment is None else None
    if moment is not None:
        return moment.first
    return None if margin is None else int(margin.argmin())


def margins(tree: Formula | None, trajectory: Trajectory, beyond: Beyond = "refuse") -> Floats | None:
    """Return the robustness of the condition at every sample, (T,) in the unit of the predicates; None without one.

    Only `always f` over the whole trajectory, or a conjunction of such, has one; its least value is the robustness.
    """
    if tree is None:
        return None
    found = robustness_signal(tree, trajectory.columns, trajectory.samples, beyond)
    return found.values if found.attained == "least" and not np.isnan(found.values).any() else None
