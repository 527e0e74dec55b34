"""Modules outside the folder of a system: they are part of its code under a name that every machine gives them."""

import importlib
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.schemas.system import SystemSpec, differences
from perfbound.workers.opened import Opened
from perfbound.workers.systems import files
from perfbound.workers.systems.elsewhere import forget
from perfbound.workers.systems.files import load_file

TANK = """
{imports}
import perfbound as pb
@pb.system(parameters={{"x": pb.Parameter(0, 1)}}, columns={{"y": ""}})
def tank(x):
    {late}
    return x
"""


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    """Have no test meet the modules of another one."""
    path = list(sys.path)
    yield
    forget(files._ELSEWHERE)
    files._ELSEWHERE.clear()
    sys.path[:] = path


@pytest.fixture
def lib(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of PYTHONPATH, with a module and a package behind it."""
    found = tmp_path / "lib"
    (found / "inner").mkdir(parents=True)
    (found / "gearbox.py").write_text("from inner import shift\nimport numpy\n")
    (found / "inner" / "__init__.py").write_text("")
    (found / "inner" / "shift.py").write_text("def late():\n    from . import rare\n")
    (found / "inner" / "rare.py").write_text("")
    (found / "unused.py").write_text("")
    monkeypatch.syspath_prepend(found)
    return found


def spec(tmp_path: Path, imports: str = "", late: str = "pass", folder: str = "plant") -> SystemSpec:
    (tmp_path / folder).mkdir(exist_ok=True)
    file = tmp_path / folder / "tank.py"
    file.write_text(TANK.format(imports=imports, late=late))
    return load_file(f"{file}:tank").spec


ALL = ["tank.py", "module gearbox", "module inner", "module inner.rare", "module inner.shift"]


@pytest.mark.usefixtures("lib")
@pytest.mark.parametrize(
    ("imports", "late"),
    [("import gearbox", "pass"), ("from gearbox import shift", "pass"), ("", "import gearbox")],
    ids=["at-import", "from", "in-a-function"],
)
def test_modules_of_pythonpath_are_code(tmp_path: Path, imports: str, late: str) -> None:
    found = spec(tmp_path, imports, late)
    assert list(found.code) == ALL
    assert "numpy" in found.versions


def test_another_folder_of_the_same_modules_is_the_same_system(
    lib: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = spec(tmp_path, "import gearbox")
    lib.rename(tmp_path / "moved")
    monkeypatch.syspath_prepend(tmp_path / "moved")
    assert spec(tmp_path, "import gearbox").digest == one.digest
    (tmp_path / "moved" / "inner" / "rare.py").write_text("x = 1\n")
    other = spec(tmp_path, "import gearbox")
    assert differences(one, other) == ["module inner.rare is another one here"]
    assert str(tmp_path) not in other.model_dump_json()


@pytest.mark.usefixtures("lib")
def test_a_computed_name_is_found_whatever_the_process_has_loaded(tmp_path: Path) -> None:
    computed = 'import importlib\nimportlib.import_module("gear" + "box")'
    one = spec(tmp_path, computed)
    spec(tmp_path, "import gearbox", folder="other")
    assert spec(tmp_path, computed).code == one.code
    assert list(one.code) == ALL


def test_a_folder_of_another_system_gives_no_modules(tmp_path: Path) -> None:
    late = "import helper_of_one"
    alone = spec(tmp_path, late=late, folder="two")
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "helper_of_one.py").write_text("")
    spec(tmp_path, "import helper_of_one", folder="one")
    assert spec(tmp_path, late=late, folder="two").code == alone.code


def test_modules_in_an_archive_are_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with zipfile.ZipFile(tmp_path / "lib.zip", "w") as archive:
        archive.writestr("zipped.py", "import behind_zipped\n")
        archive.writestr("behind_zipped.py", "")
    monkeypatch.syspath_prepend(tmp_path / "lib.zip")
    assert list(spec(tmp_path, "import zipped").code) == ["tank.py", "module behind_zipped", "module zipped"]


@pytest.mark.usefixtures("lib")
def test_what_a_distribution_records_has_a_version_instead(lib: Path, tmp_path: Path) -> None:
    information = lib / "gearbox-1.2.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: gearbox\nVersion: 1.2\n")
    # An editable installation records none of its modules.
    (information / "RECORD").write_text("gearbox-1.2.dist-info/METADATA,,\n")
    editable = spec(tmp_path, "import gearbox")
    assert ("module gearbox" in editable.code, editable.versions["gearbox"]) == (True, "1.2")
    other = tmp_path / "target"
    lib.rename(other)
    (other / information.name / "RECORD").write_text("gearbox.py,sha256=a,1\ninner/__init__.py,,\ninner/shift.py,,\n")
    sys.path.insert(0, str(other))
    installed = spec(tmp_path, "import gearbox")
    assert (list(installed.code), installed.versions["gearbox"]) == (["tank.py"], "1.2")


def test_what_a_rollout_imports_by_a_computed_name_is_reported(
    lib: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    opened = Opened(tmp_path / "plant")
    found = spec(tmp_path, "import gearbox")
    assert opened.undeclared(found) == ()
    for cached in (False, True):
        assert bool([*lib.glob("__pycache__/unused*")]) is cached
        importlib.import_module("unused")
        assert opened.undeclared(found) == ("../lib/unused.py",)
        del sys.modules["unused"]
        opened = Opened(tmp_path / "plant")
