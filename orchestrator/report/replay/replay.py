"""Simulate a recorded rollout again in a child of `workers`, compare, and draw it."""

import hashlib
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ....schemas import atomic
from ....schemas.campaign import Problem
from ....schemas.errors import PerfboundError, TrajectoryError
from ....schemas.rollout import RolloutRequest
from ....schemas.trajectory import Trajectory, decode
from ...fleet.child import ask
from .. import curves
from .comparison import Comparison, compare, lines
from .load import RecordedRollout, load_recorded
from .moments import Moment, margins, moments
from .solids import Film, film

MOMENTS = 8
"""Pictures on a strip."""


def replay(directory: Path, rollout: str, *, out: Path | None = None, mcap: Path | None = None) -> Iterator[str]:
    """Simulate a rollout of the campaign in `directory` again, and yield what a person should know.

    Writes its picture to `out` and its file, with what a person sees, to `mcap`.

    Raises:
        PerfboundError: there is no such rollout, the system is missing or of another version, or what is simulated
            now is not what was recorded; then the files are written none the less.

    """
    found = load_recorded(directory, rollout)
    yield _described(found)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "again.mcap"
        data = _simulated(found.request.model_copy(update={"visual": True}), path)
        again = _decoded(data)
        if found.trajectory is None:
            yield found.damage
            fault = _digest_fault(found, data, Path(folder))
            yield fault or "simulated again, the file is bitwise the one that was recorded"
        else:
            comparison = compare(again, found.trajectory)
            yield from lines(comparison, {column.name: column.unit for column in found.header.spec.columns})
            fault = _fault(found, comparison)
        if mcap is not None:
            atomic.write(mcap.absolute(), data)
            yield f"file: {mcap}"
        if out is not None:
            atomic.write(out.absolute(), _picture(found, again, path))
            yield f"picture: {out}"
    if fault:
        raise PerfboundError(f"{found.fact.rollout}: {fault}")


def _described(found: RecordedRollout) -> str:
    """Return one line that says what the rollout is."""
    request, spec = found.request, found.header.spec
    start = ", ".join(
        f"{each.name} = {value:g} {each.unit}".removesuffix(" 1")
        for each, value in zip(spec.parameters, request.x, strict=True)
    )
    score = "" if found.fact.robustness is None else f", robustness {found.fact.robustness:.6g}"
    return f"{found.fact.rollout}: {spec.name}, {request.variant}, {start}, seed {request.seed}{score}"


def _simulated(request: RolloutRequest, path: Path) -> bytes:
    ask("simulate", "--request", request.model_dump_json(), "--out", str(path))
    return path.read_bytes()


def _decoded(data: bytes) -> Trajectory:
    try:
        return decode(data)
    except TrajectoryError as error:
        raise PerfboundError(f"the system returned no trajectory: {error}") from None


def _digest_fault(found: RecordedRollout, data: bytes, folder: Path) -> str:
    """Return what is wrong with a file that takes the place of a damaged one; nothing, if it is the same file."""
    if not found.request.visual:
        data = _simulated(found.request, folder / "exact.mcap")
    digest = hashlib.sha256(data).hexdigest()
    if digest == found.fact.sha256:
        return ""
    return f"simulated again, the file has the sha256 {digest[:12]}..., not the recorded {found.fact.sha256[:12]}..."


def _fault(found: RecordedRollout, comparison: Comparison) -> str:
    if comparison.same:
        return ""
    if comparison.worst is None:
        return f"simulated again, {comparison.grids}"
    worst = comparison.worst
    unit = curves.column_unit(found.header, worst.column)
    return (
        f"simulated again, {worst.column} differs by up to {worst.largest:.3g} {unit} at t = {worst.at:.3f} s: "
        "this machine computes other digits than the one that recorded it"
    )


def _picture(found: RecordedRollout, again: Trajectory, path: Path) -> bytes:
    """Return the PNG of a rollout whose file is at `path`."""
    from . import picture  # noqa: PLC0415

    header, clip = found.header, found.header.config.clip
    problem = _problem(found)
    columns = curves.shown(header, problem) or again.columns[1:2]
    margin = margins(curves.formula(header), again)
    seen = _film(path)
    chosen: tuple[Moment, ...] = moments(again, margin, MOMENTS)
    return picture.png(
        picture.Picture(
            title=_described(found),
            again=again,
            before=found.trajectory,
            curves=picture.curves(
                columns, {name: curves.column_unit(header, name) for name in columns}, curves.limits(header, columns)
            ),
            moments=chosen,
            film=seen,
            ample=1.0 if clip is None else clip[1],
        )
    )


def _problem(found: RecordedRollout) -> Problem:
    return next(each for each in found.header.config.problems if each.name == found.fact.rollout.problem)


def _film(path: Path) -> Film | None:
    seen = json.loads(ask("look", "--file", str(path)))
    return None if seen is None else film(seen["scene"], seen["transforms"])
