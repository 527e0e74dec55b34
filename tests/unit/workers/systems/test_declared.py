"""Files that a system declares: what counts as one, what changes the identity of the system, and what is refused."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from perfbound.schemas.errors import DefinitionError, PerfboundError, ReplacedError
from perfbound.schemas.failure import Failure
from perfbound.schemas.ids import RolloutId
from perfbound.schemas.requests import RequestTemplate
from perfbound.schemas.system import SystemSpec, differences
from perfbound.workers import systems
from perfbound.workers.simulate import run_request
from perfbound.workers.systems import declared
from perfbound.workers.systems.declared import declared_files
from perfbound.workers.systems.files import load_reference
from perfbound.workers.worker import WorkerProcess
from tests.facts import facts

TANK = """
from pathlib import Path
import perfbound as pb
HERE = Path(__file__).parent
@pb.system(parameters={{"x": pb.Parameter(0, 1)}}, columns={{"y": ""}}{files})
def tank(x):
    return x + len((HERE / "Tank.fmu").read_bytes())
"""
SPACE = "[space]\nx = [0, 1]\n"
PROGRAM = """#!/bin/sh
read line
path=$(echo "$line" | sed 's/.*"path": "\\([^"]*\\)".*/\\1/')
cat data/table.csv > "$path"
echo '{"done": true}'
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with what systems read, and a target of a link outside."""
    here = tmp_path / "plant"
    (here / "tables" / "deep").mkdir(parents=True)
    (here / "data").mkdir()
    (tmp_path / "outside.bin").write_bytes(b"v1")
    (here / "Tank.fmu").write_bytes(b"PK1")
    (here / "policy.pt").symlink_to(tmp_path / "outside.bin")
    (here / "tables" / "a.csv").write_text("1")
    (here / "tables" / "deep" / "b.csv").write_text("2")
    (here / "data" / "table.csv").write_text("1\n")
    (here / "set[1].csv").write_text("3")
    return here


def in_decorator(folder: Path) -> str:
    files = ["Tank.fmu", "policy.pt", "tables", "data/*.csv", "set[1].csv"]
    (folder / "tank.py").write_text(TANK.format(files=f", files={files}"))
    return f"{folder / 'tank.py'}:tank"


def in_class(folder: Path) -> str:
    (folder / "tank.py").write_text(
        "import perfbound as pb\nfrom perfbound.systems import *\n"
        "class Tank(SystemUnderTest):\n"
        '    files = ("Tank.fmu", "policy.pt", "tables", "data/table.csv", "set[1].csv")\n'
        "    spec = SystemSpec(name='tank', doc='', parameters=(Parameter(0, 1, name='x'),), max_horizon=1,\n"
        "                      columns=(Column(name='t', unit='s'), Column(name='y', unit='')))\n"
        "    def rollout(self, x, **_):\n        return Trajectory(('t', 'y'), [[0.0, 1.0]])\n"
    )
    return f"{folder / 'tank.py'}:Tank"


def in_campaign(folder: Path) -> str:
    (folder / "tank.py").write_text(TANK.format(files=""))
    files = '["Tank.fmu", "policy.pt", "tables", "data/*.csv", "set[1].csv"]'
    (folder / "tank.toml").write_text(f'[system]\npython = "tank.py:tank"\nfiles = {files}\n{SPACE}')
    return str(folder / "tank.toml")


def in_campaign_elsewhere(folder: Path) -> str:
    (folder / "tank.py").write_text(TANK.format(files=', files=["set[1].csv"]'))
    (folder / "tests").mkdir()
    files = '["../Tank.fmu", "../policy.pt", "../tables", "../data/*.csv"]'
    text = f'[system]\npython = "../tank.py:tank"\nfiles = {files}\n{SPACE}'
    (folder / "tests" / "tank.toml").write_text(text)
    return str(folder / "tests" / "tank.toml")


def of_program(folder: Path) -> str:
    (folder / "tank").write_text(PROGRAM)
    (folder / "tank").chmod(0o755)
    files = '["Tank.fmu", "policy.pt", "tables", "data/table.csv", "set[1].csv"]'
    text = f'[system]\nprogram = ["./tank"]\nstep = 1.0\ncolumns = {{ y = "" }}\nfiles = {files}\n{SPACE}'
    (folder / "tank.toml").write_text(text)
    return str(folder / "tank.toml")


WAYS = (in_decorator, in_class, in_campaign, in_campaign_elsewhere, of_program)
NAMES = {"Tank.fmu", "policy.pt", "tables/a.csv", "tables/deep/b.csv", "data/table.csv", "set[1].csv"}
ways = pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)


def replaced(path: Path, data: bytes) -> None:
    """Replace a file as most programs do, by another one of the same size."""
    new = path.with_name("new")
    new.write_bytes(data)
    new.replace(path)


def swapped_link(folder: Path) -> None:
    (folder / "policy.pt").unlink()
    (folder.parent / "other.bin").write_bytes(b"v2")
    (folder / "policy.pt").symlink_to(folder.parent / "other.bin")


CHANGES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "replaced": ("Tank.fmu is another one here", lambda folder: replaced(folder / "Tank.fmu", b"PK2")),
    "in place": (
        "tables/deep/b.csv is another one here",
        lambda folder: (folder / "tables/deep/b.csv").write_text("9"),
    ),
    "behind a link": ("policy.pt is another one here", lambda folder: replaced(folder.parent / "outside.bin", b"v2")),
    "another link": ("policy.pt is another one here", swapped_link),
    "brackets": ("set[1].csv is another one here", lambda folder: (folder / "set[1].csv").write_text("9")),
    "one more": ("tables/c.csv is new here", lambda folder: (folder / "tables" / "c.csv").write_text("9")),
    "one less": ("tables/a.csv is missing here", lambda folder: (folder / "tables" / "a.csv").unlink()),
}


@pytest.mark.rest
@ways
@pytest.mark.parametrize("change", CHANGES)
def test_another_file_is_another_system_and_has_a_name(folder: Path, way: Callable[[Path], str], change: str) -> None:
    reference = way(folder)
    before = load_reference(reference).spec
    assert set(before.code) - {"tank.py", "./tank"} == NAMES
    assert load_reference(reference).spec.digest == before.digest
    words, make = CHANGES[change]
    make(folder)
    after = load_reference(reference).spec
    assert after.digest != before.digest
    assert differences(before, after) == [words]


def test_without_files_the_identity_is_that_of_the_sources(folder: Path) -> None:
    (folder / "tank.py").write_text(TANK.format(files=""))
    assert set(load_reference(f"{folder / 'tank.py'}:tank").spec.code) == {"tank.py"}


def test_a_run_directory_in_a_declared_folder_is_no_part_of_the_system(folder: Path) -> None:
    reference = in_decorator(folder)
    before = load_reference(reference).spec
    (folder / "tables" / "runs").mkdir()
    (folder / "tables" / "runs" / "campaign.db").write_text("")
    assert load_reference(reference).spec == before


def test_a_circle_of_links_ends(folder: Path) -> None:
    (folder / "tables" / "deep" / "up").symlink_to(folder / "tables")
    assert set(declared_files(["tables"], folder)) == {"tables/a.csv", "tables/deep/b.csv"}


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ('["Pump.fmu"]', "tank.py: files: 'Pump.fmu'"),
        ('["*.onnx"]', "'*.onnx' plant"),
        ('["empty"]', "'empty' plant"),
        ('["pipe"]', "pipe regular file"),
        ('["big.bin"]', "big.bin 3000 GB most 20 GB"),
        ('"Tank.fmu"', "files: 'Tank.fmu' files=["),
        ("[7]", "files: 7 path"),
        ('[""]', "files: '' path"),
        ("None", "files: None list"),
    ],
)
def test_what_cannot_be_hashed_is_refused_in_one_line(folder: Path, files: str, words: str) -> None:
    (folder / "empty").mkdir()
    os.mkfifo(folder / "pipe")
    with (folder / "big.bin").open("wb") as file:
        file.truncate(3 * 10**12)
    (folder / "tank.py").write_text(TANK.format(files=f", files={files}"))
    with pytest.raises(DefinitionError, match=facts(words)) as fault:
        load_reference(f"{folder / 'tank.py'}:tank")
    assert "\n" not in str(fault.value)


def test_too_many_files_are_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(declared, "MOST_FILES", 1)
    with pytest.raises(DefinitionError, match="they are more than 1 files"):
        declared_files(["tables"], folder)


# While a worker lives


def request_of(spec: SystemSpec) -> RequestTemplate:
    return RequestTemplate.of(spec, {}, horizon=0.0, visual=False, campaign="c")


def rollout(reference: str) -> Callable[[], bytes | Failure]:
    """Return a rollout of a worker that has loaded the system."""
    name = systems.add_file(reference)
    template = request_of(systems.load_system(name).spec)
    return lambda: run_request(template.request(RolloutId("p", 0, "nominal", 0), (0.5,), 1), lambda _: None)


@pytest.mark.integration
@ways
def test_a_file_that_is_replaced_while_a_worker_runs_ends_its_rollouts(
    folder: Path, way: Callable[[Path], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(systems, "_FROM_FILES", {})
    simulate = rollout(way(folder))
    first = simulate()
    replaced(folder / "Tank.fmu", b"PK1")
    assert simulate() == first, "the same content"
    replaced(folder / "Tank.fmu", b"PK2")
    with pytest.raises(ReplacedError, match=facts("Tank.fmu: file worker")):
        simulate()
    (folder / "Tank.fmu").unlink()
    with pytest.raises(ReplacedError, match=r"Tank\.fmu: this file is gone"):
        simulate()
    replaced(folder / "Tank.fmu", b"PK1")
    assert simulate() == first


@pytest.mark.integration
def test_a_file_that_is_replaced_in_a_rollout_ends_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither its trajectory nor its exception is one of the system."""
    monkeypatch.setattr(systems, "_FROM_FILES", {})
    for ending in ("return 1.0", "raise ValueError('half a file')"):
        text = TANK.format(files=', files=["Tank.fmu"]')
        text = text.replace("    return", f"    (HERE / 'Tank.fmu').write_bytes(b'PK3')\n    {ending}\n    return")
        (folder / "Tank.fmu").write_bytes(b"PK1")
        (folder / "tank.py").write_text(text)
        with pytest.raises(ReplacedError):
            rollout(f"{folder / 'tank.py'}:tank")()


def test_a_worker_with_another_file_blames_itself_and_not_the_system(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(systems, "_FROM_FILES", {})
    name = systems.add_file(in_decorator(folder))
    template = request_of(systems.load_system(name).spec)
    replaced(folder / "Tank.fmu", b"PK2")
    worker = WorkerProcess.__new__(WorkerProcess)
    found = worker._run(template.request(RolloutId("p", 0, "nominal", 0), (0.5,), 1), ("p.0.nominal.0", 1))
    assert isinstance(found, Failure)
    assert found.kind == "infrastructure"
    assert "Tank.fmu: this file was replaced" in found.reason


@pytest.mark.parametrize("key", ["files", "stamps", "after_end"])
def test_an_installed_system_takes_nothing_of_it_from_a_campaign(tmp_path: Path, key: str) -> None:
    value = {"files": '["a"]', "stamps": '"float32"', "after_end": '"hold"'}[key]
    (tmp_path / "c.toml").write_text(f'[system]\nname = "segway"\n{key} = {value}\n[space]\nx = [0, 1]\n')
    with pytest.raises(PerfboundError, match=facts(f"{key}: class: {key} =")):
        load_reference(str(tmp_path / "c.toml"))


TWO = """
import perfbound as pb
keys = {"parameters": {"x": pb.Parameter(0, 1)}, "columns": {"y": "m"}, "step": 0.1}
@pb.system(**keys)
def f(x): return [x, x]
@pb.system(**keys, after_end="fail")
def g(x): return [x, x]
"""
SAYING = """
specification = "always (y >= 0)"
max_tests = 10
claims = [{ quantity = "failure_probability" }]
[system]
python = "two.py:f"
stamps = "float32"
after_end = "hold"
[space]
x = [0, 1]
"""


def test_a_campaign_says_more_of_a_function_in_a_file(tmp_path: Path) -> None:
    (tmp_path / "two.py").write_text(TWO)
    file = tmp_path / "c.toml"
    file.write_text(SAYING)
    found = load_reference(str(file)).spec
    assert (found.stamps, found.after_end, found.columns[-1].name) == ("float32", "hold", "ended")
    assert found.digest != load_reference(f"{tmp_path / 'two.py'}:f").spec.digest
    file.write_text(SAYING.replace("two.py:f", "two.py:g"))
    with pytest.raises(PerfboundError, match=facts("c.toml: system.after_end: 'hold'")):
        load_reference(str(file))
