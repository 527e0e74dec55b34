"""The request to stop: taken once, whatever is written there, and nothing of another kind is opened."""

import os
from pathlib import Path

import pytest

from perfbound.orchestrator.store.stop_request import (
    NAME,
    ask_to_stop,
    is_waiting,
    take_request,
    withdraw_request,
)


@pytest.mark.parametrize("manner", ["now", "drain"])
def test_a_request_is_taken_once(tmp_path: Path, manner: str) -> None:
    assert take_request(tmp_path) is None
    ask_to_stop(tmp_path, manner)  # type: ignore[arg-type]
    assert is_waiting(tmp_path)
    assert take_request(tmp_path) == manner
    assert not is_waiting(tmp_path)
    assert take_request(tmp_path) is None


def test_other_text_asks_for_a_stop_at_once(tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(b"\xff drain, please" * 100)
    assert take_request(tmp_path) == "now"


def test_a_withdrawn_request_stops_nothing(tmp_path: Path) -> None:
    ask_to_stop(tmp_path, "now")
    withdraw_request(tmp_path)
    withdraw_request(tmp_path)
    assert take_request(tmp_path) is None


def test_a_pipe_or_a_folder_of_this_name_does_not_hold_up_the_campaign(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / NAME)
    assert take_request(tmp_path) is None
    (tmp_path / NAME).unlink()
    (tmp_path / NAME).mkdir()
    assert take_request(tmp_path) is None
