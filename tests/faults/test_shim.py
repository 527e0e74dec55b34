"""The shim that is loaded into the processes of a fault run does what it is told to, once, and nothing else."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.faults.machine import HOUR, shim

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler (cc)")
CALLS = """
import os, sys
from pathlib import Path

def call(name, folder):
    file = Path(folder, "file")
    handle = os.open(file, os.O_RDWR | os.O_CREAT)
    try:
        if name == "read": os.pread(handle, 4, 0)
        if name == "write": os.write(handle, b"12345678")
        if name == "fsync": os.fsync(handle)
        if name == "rename": file.rename(file)
        return "done"
    except OSError as error:
        return error.strerror
    finally:
        os.close(handle)

for name in ("read", "write", "fsync", "rename"):
    Path("plan", name).touch()
    print(name, *(call(name, folder) for folder in ("outside", "below", "below")))
print(*sorted(file.name.partition("-")[0] for file in Path("plan/taken").iterdir()))
"""


def test_an_error_comes_once_and_below_the_folder_alone(tmp_path: Path) -> None:
    for folder in ("plan/taken", "below", "outside"):
        (tmp_path / folder).mkdir(parents=True)
    environment = {"SHIM_EIO": str(tmp_path / "plan"), "SHIM_BELOW": f"{tmp_path}/below"}
    # A rename is known by the path that it is given.
    text = CALLS.replace('"below"', repr(f"{tmp_path}/below"))
    assert _run(text, tmp_path, environment).splitlines() == [
        *(f"{name} done Input/output error done" for name in ("read", "write", "fsync", "rename")),
        "fsync read rename write",
    ]
    assert (tmp_path / "below" / "file").read_bytes() == b"12345678", "the write after the one that failed"


@pytest.mark.parametrize("wrong", [HOUR, -HOUR])
def test_a_clock_is_wrong_by_an_hour(wrong: int, tmp_path: Path) -> None:
    (tmp_path / "clock").write_text(str(wrong))
    text = "import time; print(time.time(), time.monotonic())"
    before, since = time.time(), time.monotonic()
    wall, monotonic = map(float, _run(text, tmp_path, {"SHIM_CLOCK": str(tmp_path / "clock")}).split())
    assert before <= wall - wrong <= time.time()
    assert since <= monotonic <= time.monotonic()


def _run(text: str, folder: Path, environment: dict[str, str]) -> str:
    preloaded = {**os.environ, **environment, "LD_PRELOAD": str(shim(folder))}
    line = [sys.executable, "-I", "-c", text]
    return subprocess.run(line, cwd=folder, env=preloaded, capture_output=True, text=True, check=True).stdout
