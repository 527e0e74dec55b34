import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import sharing
from tests.end_to_end import processes
from tests.end_to_end.processes import Processes


@pytest.fixture(autouse=True, scope="session")
def interruptible() -> None:
    """A shell starts what it runs in the background with Ctrl-C ignored, and children inherit that."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Processes]:
    """Processes of one test, in its own folder."""
    with processes.processes(tmp_path) as found:
        yield found


@pytest.fixture(scope="session")
def calm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run directory of the small campaign, run by two workers without trouble; every process has its own copy."""
    made = sharing.made_once(sharing.shared_folder(tmp_path_factory) / "calm", run_calmly)
    return Path(shutil.copytree(made / "run", tmp_path_factory.mktemp("calm") / "run"))


def run_calmly(folder: Path) -> None:
    with processes.processes(folder) as found:
        ended = found.run("perfbound", "run", processes.write_campaign(folder / "c.toml"), "--out", folder / "run")
    assert ended.code == 0, ended.err
