"""The system of the README's first screen, copied and run as it stands."""

import re
from pathlib import Path

import pytest

from perfbound.orchestrator.report.glossary import entries_of, glossary
from tests.end_to_end.processes import Processes

ROOT = Path(__file__).parents[3]
README = (ROOT / "README.md").read_text()


@pytest.mark.journey
def test_the_system_of_the_first_screen_runs_as_it_stands(started: Processes) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (printed,) = re.findall(r"After a few seconds it prints:\n\n```text\n(.*?)```", README, re.DOTALL)
    (started.folder / "brake.py").write_text(code)
    ended = started.run("python", "brake.py")
    assert ended.code == 0, ended.err
    assert ended.out.strip() == printed.strip()
    assert (started.folder / "runs/brake/report.html").exists()


def test_its_words_are_those_of_the_glossary() -> None:
    words = re.findall(r"^- \*\*(\w+)\*\*[^:]*: (.+)$", README, re.MULTILINE)
    assert len(words) == 9
    for word, meaning in words:
        (entry,) = entries_of(word)
        assert " ".join(meaning.split()) == glossary()[entry], word
