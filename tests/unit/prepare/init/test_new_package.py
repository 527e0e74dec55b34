"""The files of a new package, and the names that it may have."""

from pathlib import Path

import pytest

from perfbound.orchestrator.prepare.init.new_package import package_files, write_package
from perfbound.schemas.errors import PerfboundError
from tests.facts import facts


def test_its_code_is_python_and_its_name_everywhere_the_same() -> None:
    files = package_files("my-robot")
    assert sorted(files) == ["README.md", "my_robot/__init__.py", "pyproject.toml", "tests/test_my_robot.py"]
    for path, text in files.items():
        assert "$" not in text
        if path.endswith(".py"):
            compile(text, path, "exec")
    assert 'my-robot = "my_robot:my_robot"' in files["pyproject.toml"]


@pytest.mark.parametrize("name", ["", "My", "my_robot", "-a", "a-", "1a", "a b", "../a", "a" * 65, "a\n"])
def test_a_name_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(PerfboundError, match="is no name of a system; choose words"):
        package_files(name)


@pytest.mark.parametrize("name", ["class", "json", "numpy", "perfbound", "segway", "tests"])
def test_a_name_of_something_else_is_refused(name: str) -> None:
    with pytest.raises(PerfboundError, match=facts(f"another one: my-{name}")):
        package_files(name)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "robot"
    list(write_package("robot", folder))
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    (folder / "robot" / "__init__.py").write_text("mine")
    with pytest.raises(PerfboundError, match="exists already and stays as it is"):
        list(write_package("robot", folder))
    assert (folder / "robot" / "__init__.py").read_text() == "mine"
    assert {path for path in folder.rglob("*") if path.is_file()} == set(before)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(PerfboundError, match="exists already"):
        list(write_package("robot", tmp_path / "file"))
    assert (tmp_path / "file").read_text() == "mine"
