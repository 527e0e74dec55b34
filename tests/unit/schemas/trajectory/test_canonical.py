"""The canonical writer: to the byte what the library of MCAP writes for the same evidence."""

import io

import pytest
from mcap.writer import Writer

from perfbound.schemas.errors import TrajectoryError
from perfbound.schemas.trajectory.canonical import (
    FAILURES,
    LIBRARY,
    OF_BATCH,
    OF_ROLLOUT,
    Layout,
    canonical_evidence,
    canonical_file,
)

METADATA = {"b": "two", "a": "one", "columns": "[]"}


def contents(layout: Layout, *, whole: bool = True) -> dict[str, bytes]:
    names = [name for name, _ in layout.media_types if whole or name != layout.optional]
    return {name: name.encode() * (place + 1) for place, name in enumerate(names)}


def by_library(layout: Layout, attachments: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    writer = Writer(out, enable_data_crcs=True)
    writer.start(profile="", library=LIBRARY)
    writer.add_metadata(layout.record, dict(sorted(METADATA.items())))
    for name, media_type in layout.media_types:
        if name in attachments:
            writer.add_attachment(0, 0, name, media_type, attachments[name])
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("layout", [OF_ROLLOUT, OF_BATCH], ids=["rollout", "batch"])
def test_it_writes_what_the_library_writes_and_reads_it(layout: Layout, whole: bool) -> None:
    attachments = contents(layout, whole=whole)
    file = canonical_file(layout, METADATA, attachments)
    assert file == by_library(layout, attachments)
    assert canonical_evidence(file, layout, visual=False) == (dict(sorted(METADATA.items())), attachments)


def test_only_the_optional_attachment_may_be_missing() -> None:
    attachments = contents(OF_BATCH)
    for name in attachments.keys() - {FAILURES}:
        rest = {each: content for each, content in attachments.items() if each != name}
        with pytest.raises(TrajectoryError, match="its attachments are not"):
            canonical_evidence(canonical_file(OF_BATCH, METADATA, rest), OF_BATCH, visual=False)


def test_a_file_of_the_other_kind_is_refused() -> None:
    for layout, other in ((OF_ROLLOUT, OF_BATCH), (OF_BATCH, OF_ROLLOUT)):
        file = canonical_file(layout, METADATA, contents(layout))
        with pytest.raises(TrajectoryError, match="as perfbound writes them"):
            canonical_evidence(file, other, visual=False)
