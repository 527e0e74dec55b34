"""Recorded rollouts in one file for a viewer, from the evidence alone: the system itself need not be there."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from ....schemas.amounts import amount
from ....schemas.errors import PerfboundError
from ....schemas.ranges import LARGEST_BATCH, MAX_FILE_BYTES
from ....schemas.trajectory.topics import encode_topics
from ...certificate.words.format import replay_command
from ...run.known import system_file
from .load import RecordedRollout, description, load_batch, load_recorded


def viewer_file(directory: Path, names: Sequence[str], *, batches: bool = False) -> tuple[bytes, int]:
    """Return a file with the named rollouts, and with `batches` those that share a file with them; and their number.

    Raises:
        JournalError: there is no campaign in `directory`, or it cannot be read.
        PerfboundError: a rollout is not there, has no samples, or they are too many.

    """
    found = {each.fact.rollout: each for name in names for each in _recorded(directory, name, batches=batches)}
    header = next(iter(found.values())).header
    shown = {rollout: each.trajectory for rollout, each in found.items() if each.trajectory is not None}
    size = sum(each.samples.nbytes for each in shown.values())
    if len(shown) > LARGEST_BATCH or size > MAX_FILE_BYTES:
        raise PerfboundError(
            f"--rollout: {len(shown):,} rollouts with {amount(size)} of samples; choose fewer, at most "
            f"{LARGEST_BATCH:,} with {amount(MAX_FILE_BYTES)}"
        )
    about = {"campaign": header.config.name, "config_sha256": header.config_sha256}
    descriptions = {str(rollout): description(each) for rollout, each in found.items()}
    units = {column.name: column.unit for column in header.spec.columns}
    return encode_topics(shown, units=units, metadata=about | descriptions), len(shown)


def _recorded(directory: Path, name: str, *, batches: bool) -> Iterator[RecordedRollout]:
    """Yield a rollout with its samples, and with `batches` the others in its file."""
    found = load_recorded(directory, name)
    if found.trajectory is None:
        again = replay_command(directory, found.header, str(found.fact.rollout), system_file(directory))
        remedy = f"; run `{again} --mcap FILE`, which simulates it again" if again and not found.fact.kept else ""
        raise PerfboundError(f"{found.damage}{remedy}")
    yield from load_batch(directory, found) if batches else (found,)
