"""Folders and ports that several processes of the tests share."""

from itertools import islice
from multiprocessing import get_context
from pathlib import Path

import pytest

from tests.sharing import PORTS, SHARE, made_once, own_ports


def make(folder: Path) -> None:
    with (folder.parent / "times").open("a") as file:
        file.write("made\n")
    (folder / "content").write_text("whole")


@pytest.mark.integration
def test_a_folder_is_made_once_by_many_processes(tmp_path: Path) -> None:
    context = get_context("fork")
    processes = [context.Process(target=made_once, args=(tmp_path / "shared", make)) for _ in range(4)]
    for each in processes:
        each.start()
    for each in processes:
        each.join()
    assert [each.exitcode for each in processes] == [0] * 4
    assert (tmp_path / "times").read_text() == "made\n"
    assert (made_once(tmp_path / "shared", make) / "content").read_text() == "whole"


def test_what_could_not_be_made_is_tried_again_from_nothing(tmp_path: Path) -> None:
    def fail(folder: Path) -> None:
        (folder / "half").touch()
        raise OSError("no room")

    with pytest.raises(OSError, match="no room"):
        made_once(tmp_path / "shared", fail)
    assert [each.name for each in made_once(tmp_path / "shared", make).iterdir()] == ["content"]


def test_no_two_processes_get_one_port() -> None:
    known: set[int] = set()
    for process in range(len(PORTS) // SHARE):
        own = set(islice(own_ports(process, 4711 * process), 2 * SHARE))
        assert len(own) == SHARE
        assert not own & known
        known |= own
    assert known == set(PORTS)
