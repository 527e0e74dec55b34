"""The product says what is in the files of this folder."""

import difflib

import pytest

from tests.texts import FOLDER, written
from tests.texts.subjects import SUBJECTS


@pytest.mark.parametrize("name", SUBJECTS)
def test_every_sentence_is_the_one_on_record(name: str) -> None:
    recorded, found = (FOLDER / f"{name}.txt").read_text(), written(SUBJECTS[name])
    changes = difflib.unified_diff(recorded.splitlines(), found.splitlines(), "on record", "now", lineterm="")
    if recorded != found:
        pytest.fail("\n".join([*changes, f"{name}.txt: run `make texts` and review the diff"]), pytrace=False)


def test_every_file_has_its_subject() -> None:
    assert {path.stem for path in FOLDER.glob("*.txt")} == set(SUBJECTS)
