"""The file of what a run has shown so far: nothing depends on it, so other content is as good as none."""

import os
from pathlib import Path

import pytest

from perfbound.orchestrator.store.so_far import LONGEST, NAME, read_so_far, remove_so_far


@pytest.mark.parametrize("text", [b"", b"{}", b"null", b"\xff\xfe", b"[" * 100_000, b" " * (LONGEST + 1)])
def test_what_is_no_report_is_nothing(tmp_path: Path, text: bytes) -> None:
    assert read_so_far(tmp_path) is None
    (tmp_path / NAME).write_bytes(text)
    assert read_so_far(tmp_path) is None
    remove_so_far(tmp_path)
    assert not (tmp_path / NAME).exists()


def test_a_pipe_or_a_folder_of_this_name_holds_nobody_up(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / NAME)
    assert read_so_far(tmp_path) is None
    (tmp_path / NAME).unlink()
    (tmp_path / NAME).mkdir()
    assert read_so_far(tmp_path) is None
