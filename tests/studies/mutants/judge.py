"""Copies of the work tree, in which mutants are written and tests run; the user's own tree is only read.

Every copy has its own Git index and its own environment: the packages of the user's, but perfbound from the copy. So a
process that a test starts, wherever and with whatever variables, imports the mutant.
"""

import hashlib
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import venv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.util import cache_from_source
from pathlib import Path

import psutil

from tests.studies.mutants.results import CAUGHT, SURVIVED, TIMED_OUT, Judgement, Mutant
from tests.studies.mutants.stages import LAST, Stage

ROOT = Path(__file__).parents[3]
SHARED = ("build/node", "build/backend")
"""What make installs for the tests."""
JUDGED = ("orchestrator/", "schemas/", "workers/", "perfbound/", "deploy/", "tests/")
DRIVER = "tests/studies/mutants/"
PYTEST = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not rest and not slow")
MEMORY = 8 << 30
"""Bytes of one process of a test: a mutant may allocate without end."""
LONGER, SPARE = 4.0, 60.0
"""A run with a mutant may take so many times what the tests take without one, and so many seconds more."""
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
PASSED, FAILURES, NOTHING_COLLECTED = 0, 1, 5


class BaselineError(Exception):
    """Tests do not run without a mutant."""


@dataclass(frozen=True)
class Usual:
    """How tests run without a mutant."""

    seconds: float
    failing: list[str]
    """Those that are left out with a mutant."""


@dataclass(frozen=True)
class Ended:
    """A run of pytest."""

    code: int | None
    """None: it took too long."""
    failed: list[str]
    seconds: float


class StoppedError(Exception):
    """The driver ends, so what the tests said does not count."""


class Tree:
    """A copy of the work tree; for one thread, except `stop`."""

    def __init__(self, folder: Path) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        self.folder = folder
        self._stopped = False
        self._running: subprocess.Popen[bytes] | None = None
        _git("clone", "--quiet", "--no-checkout", "--shared", str(ROOT), str(folder))
        for name in work_tree():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
        _git("-C", str(folder), "reset", "--quiet")
        for name in SHARED:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).symlink_to(ROOT / name)
        _environment(folder / ".venv", folder)
        self._python = folder / ".venv" / "bin" / "python"
        self._check()

    @contextmanager
    def with_(self, mutant: Mutant) -> Iterator[None]:
        """Have the mutant in place of its module."""
        path = self.folder / mutant.path
        text = path.read_text()
        try:
            _write(path, mutant.text)
            yield
        finally:
            _write(path, text)

    def run(self, arguments: Sequence[str], limit: float | None) -> Ended:
        """Run pytest for at most `limit` seconds.

        Raises:
            StoppedError: `stop` was called.

        """
        start = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="mutant-", ignore_cleanup_errors=True) as folder:
            printed = Path(folder) / "printed"
            with printed.open("wb") as file:
                process = subprocess.Popen(
                    [self._python, *PYTEST, *arguments],
                    cwd=self.folder,
                    env={**os.environ, "TMPDIR": folder},
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
                self._running = process
                if self._stopped:
                    _end(process)
                resource.prlimit(process.pid, resource.RLIMIT_DATA, (MEMORY, MEMORY))
                try:
                    code: int | None = process.wait(limit)
                except subprocess.TimeoutExpired:
                    code = None
                finally:
                    _end(process)
            if self._stopped:
                raise StoppedError
            failed = FAILED.findall(printed.read_text(errors="replace"))
        return Ended(code, failed, time.monotonic() - start)

    def stop(self) -> None:
        """End what runs, and whatever is run later."""
        self._stopped = True
        if self._running is not None:
            _end(self._running)

    def _check(self) -> None:
        found = subprocess.check_output(
            [self._python, "-P", "-c", "import perfbound; print(perfbound.__file__)"], cwd="/", text=True
        )
        if not Path(found.strip()).is_relative_to(self.folder):
            raise RuntimeError(f"{self.folder}: perfbound is imported from {found.strip()}")


class Judge:
    """Runs the stages, and knows how long they take without a mutant; for several threads, each with its own tree."""

    def __init__(self, digest: str, file: Path) -> None:
        """Continue with the times in `file`, if they are those of the same product and tests."""
        self._digest, self._file = digest, file
        known = json.loads(file.read_text()) if file.exists() else {}
        times = known["usual"] if known.get("tree") == digest else {}
        self._usual = {tests: Usual(**each) for tests, each in times.items()}
        self._measuring = threading.Lock()

    def judge(self, tree: Tree, mutant: Mutant, stage: Stage) -> Judgement:
        """Return what the tests of a stage say.

        Raises:
            BaselineError: they do not run without the mutant either.

        """
        usual = self._without_mutant(tree, stage)
        limit = LONGER * usual.seconds + SPARE
        line = ["-x", *stage.arguments, *(f"--deselect={each}" for each in usual.failing)]
        with tree.with_(mutant):
            ended = tree.run(line, limit)
            # Tests with processes and clocks may fail on a busy machine: such a failure has to repeat itself.
            doubtful = stage.number == LAST and ended.code == FAILURES and ended.failed
            if doubtful and tree.run(ended.failed, limit).code == PASSED:
                ended = tree.run(line, limit)
        outcome = TIMED_OUT if ended.code is None else SURVIVED if ended.code in {PASSED, NOTHING_COLLECTED} else CAUGHT
        test = ended.failed[0] if ended.failed else ""
        return Judgement(mutant.key, stage.number, outcome, test, round(ended.seconds, 1), self._digest)

    def _without_mutant(self, tree: Tree, stage: Stage) -> Usual:
        tests = " ".join(stage.usual)
        with self._measuring:
            if tests not in self._usual:
                ended = tree.run(stage.usual, None)
                # With a failure that is no test's, as of a process that ends otherwise, every mutant would seem caught.
                of_tests = ended.code == FAILURES and ended.failed
                if not of_tests and ended.code not in {PASSED, NOTHING_COLLECTED}:
                    raise BaselineError(f"{tests}: pytest ends with {ended.code} without a mutant; fix that first")
                for each in ended.failed:
                    sys.stderr.write(f"left out, since it fails without a mutant: {each}\n")
                self._usual[tests] = Usual(round(ended.seconds, 1), ended.failed)
                usual = {name: asdict(each) for name, each in self._usual.items()}
                self._file.write_text(json.dumps({"tree": self._digest, "usual": usual}))
            return self._usual[tests]


def work_tree() -> list[str]:
    """Return the files of the work tree, as they are and without what Git ignores."""
    names = _git("-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard").split("\0")
    return sorted({name for name in names if name and os.path.lexists(ROOT / name)})


def digest(folder: Path) -> str:
    """Return the digest of product and tests, without this driver: a survivor of others is judged again."""
    found = hashlib.sha256()
    for name in work_tree():
        if name.startswith(JUDGED) and not name.startswith(DRIVER) and (folder / name).is_file():
            found.update(f"{name}\0".encode() + hashlib.sha256((folder / name).read_bytes()).digest())
    return found.hexdigest()[:16]


def _environment(folder: Path, tree: Path) -> None:
    """Make an environment with the packages and programs of the running one, but perfbound from `tree`."""
    venv.create(folder, symlinks=True)
    prefix = Path(sys.prefix)
    packages = next(folder.glob("lib/python*/site-packages"))
    for each in (prefix / packages.relative_to(folder)).iterdir():
        if not each.name.startswith("__editable__") and not (packages / each.name).exists():
            (packages / each.name).symlink_to(each)
    (packages / "perfbound.pth").write_text(f"{tree}\n")
    for each in (prefix / "bin").iterdir():
        program = folder / "bin" / each.name
        if program.exists() or not each.is_file():
            continue
        content = each.read_bytes()
        if content.startswith(line := f"#!{prefix}/bin/python".encode()):
            program.write_bytes(content.replace(line, f"#!{folder}/bin/python".encode(), 1))
            program.chmod(0o755)
        else:
            program.symlink_to(each)


def _write(path: Path, text: str) -> None:
    """Write a module; what Python compiled of it is dropped, since it may be as long, and from the same second."""
    path.write_text(text)
    Path(cache_from_source(str(path))).unlink(missing_ok=True)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process with all that it has started."""
    try:
        family = psutil.Process(process.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        family = []
    if process.poll() is None:
        process.kill()
    for each in family:
        try:
            each.kill()
        except psutil.NoSuchProcess:
            continue
    process.wait()


def _git(*arguments: str) -> str:
    return subprocess.check_output(["git", *arguments], text=True)
