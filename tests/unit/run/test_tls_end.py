"""Lines about the end of a certificate while a link is open."""

import queue
import threading
from datetime import timedelta
from pathlib import Path

import pytest

from perfbound.orchestrator.run.tls_end import end_announced
from perfbound.schemas.link.tls_files import read_certificates
from tests.facts import says
from tests.fakes.certificates import DAY, Site, now
from tests.patience import PATIENCE


@pytest.mark.parametrize("days", [1, 3])
def test_a_certificate_that_ends_soon_is_announced(tmp_path: Path, days: int) -> None:
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    tls = Site(tmp_path).tls("main", "orchestrator", days=days)
    with end_announced(tls.certificate, lines.put):
        if days == 1:
            line = lines.get(timeout=PATIENCE)
            assert line.startswith(f"{tls.certificate}: this certificate ends at {now() + DAY:%Y-%m-%d}")
    assert lines.empty()


def test_the_end_itself_is_announced(tmp_path: Path) -> None:
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    tls = Site(tmp_path).tls("main", "orchestrator", at=timedelta(seconds=2) - DAY, days=1)
    over = threading.Event()
    with end_announced(tls.certificate, lines.put, over.set):
        assert over.wait(PATIENCE)
        assert now() >= read_certificates(tls.certificate)[0].not_valid_after_utc
        found = {lines.get(timeout=PATIENCE) for _ in range(2)}
    assert any(says(line, "ended link more start again new") for line in found)


def test_a_link_without_certificates_has_nothing_to_announce() -> None:
    with end_announced(None, print):
        pass
