"""Every border takes any input: it ends with a documented error or a value, never with another exception.

`PERFBOUND_FUZZ` is the number of inputs for each border (see `tests.fuzz.amount`), `PERFBOUND_FUZZ_SEED` the first of
their seeds; a failure prints the seed of its input.
"""

import io
import os
import random
import resource
import shutil
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from perfbound.orchestrator.campaign.checks import check
from perfbound.orchestrator.campaign.ledger import Ledger
from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.verify.checks import CheckFailed, Checks
from perfbound.orchestrator.certificate.verify.input import parsed
from perfbound.orchestrator.certificate.verify.manifest import parse_manifest, split_manifest
from perfbound.orchestrator.certificate.verify.run import verify_certificate
from perfbound.orchestrator.certificate.words import text
from perfbound.orchestrator.mathematics.stl.errors import FormulaError
from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from perfbound.orchestrator.store import facts as recorded_facts
from perfbound.orchestrator.store import read
from perfbound.orchestrator.store.changes import ChangeReader
from perfbound.orchestrator.store.journal import Journal
from perfbound.orchestrator.store.progress import read_progress
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.orchestrator.store.untrusted import read_untrusted
from perfbound.schemas.errors import PerfboundError, TrajectoryError
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.trajectory.trajectory import Trajectory, Visual, encode, read_canonical, read_mcap
from perfbound.workers.systems import load_system
from tests.campaigns import FOLDER, config
from tests.fakes.inmemory import campaign
from tests.fuzz.amount import inputs
from tests.fuzz.mutations import flipped, mutated, rewritten

FIRST = int(os.environ.get("PERFBOUND_FUZZ_SEED", "0"))
FIXTURES = Path(__file__).parents[1] / "fixtures"
MEMORY = 400 * 2**20
"""Bytes that a run may add to the memory of the process."""


@pytest.fixture(autouse=True)
def bounded() -> Iterator[None]:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 < MEMORY


def each(attempt: Callable[[random.Random], None], *, one_in: int = 1) -> None:
    """Make an attempt for every seed; name that of a failure."""
    for seed in inputs(one_in, FIRST):
        try:
            attempt(random.Random(seed))
        except Exception as error:
            raise AssertionError(f"seed {seed}: {type(error).__name__}: {error}") from error


# Trajectory files


def a_file(*, visual: bool) -> bytes:
    t = np.arange(40) / 10
    trajectory = Trajectory(("t", "x"), np.column_stack([t, np.sin(t)]))
    if visual:
        trajectory = trajectory.showing(Visual(plots=True))
    return encode(trajectory, request={"seed": 7, "x": [0.5]}, metadata={"seed": "7"}, units={"t": "s", "x": "m"})


def sealed(data: bytes) -> bytes:
    """Return the bytes with true checksums of data and summary, where the file is long enough to have them."""
    footer = len(data) - 37
    if footer < 64:
        return data
    summary = struct.unpack_from("<Q", data, footer + 9)[0]
    if not 64 <= summary <= footer:
        return data
    end = summary - 13
    inside = data[:end] + struct.pack("<BQI", 0x0F, 4, zlib.crc32(data[:end])) + data[summary:-12]
    return inside + struct.pack("<I", zlib.crc32(inside[summary:])) + data[-8:]


@pytest.mark.parametrize("visual", [False, True], ids=["plain", "plots"])
def test_trajectory_files(visual: bool) -> None:
    whole = a_file(visual=visual)

    def attempt(luck: random.Random) -> None:
        data = luck.choice((mutated, flipped))(luck, whole)
        for each in (data, sealed(data)):  # the second one passes the checksums
            accepted = 0
            for reader in (read_mcap, lambda given: read_canonical(given, visual=visual)):
                try:
                    found = reader(each)
                    accepted += 1
                except TrajectoryError:
                    continue
                assert np.isfinite(found.trajectory.samples).all()
            if accepted == 2 and not visual:  # then it is the canonical file of what is in it
                metadata = {key: value for key, value in found.metadata.items() if key != "columns"}
                units = dict.fromkeys(found.trajectory.columns, "1")
                assert encode(found.trajectory, request=found.request, metadata=metadata, units=units) == each

    each(attempt)


# Certificates


def test_certificates(tmp_path: Path) -> None:
    whole = (FIXTURES / "finished" / "rigorous" / files.CERTIFICATE).read_bytes()
    path = tmp_path / files.CERTIFICATE

    def attempt(luck: random.Random) -> None:
        data = luck.choice((mutated, flipped, rewritten, rewritten))(luck, whole)
        with suppress(CheckFailed):
            parsed(data, Checks())
        path.write_bytes(data)
        try:
            found = files.read(tmp_path)
        except PerfboundError:
            return
        if found is not None:
            text.print_certificate(found, Console(file=io.StringIO()))

    each(attempt)


def test_manifests() -> None:
    whole = (FIXTURES / "finished" / "rigorous" / files.MANIFEST).read_bytes()

    def attempt(luck: random.Random) -> None:
        given = mutated(luck, whole).decode(errors="replace")
        with suppress(CheckFailed):
            parse_manifest(split_manifest(given)[0])

    each(attempt)


# Databases


def opened(directory: Path) -> None:
    """Read a database in every way."""
    readers: tuple[Callable[[Path], object], ...] = (
        read_progress,
        read_untrusted,
        read.observed,
        read.attempts,
        read.irreproducible,
        recorded_facts.history,
        read.system_reference,
        lambda path: ChangeReader(path).read(),
        replayed,
    )
    for reader in readers:
        refused = ""
        try:
            reader(directory)
        except PerfboundError as error:
            refused = str(error)
        assert "\n" not in refused


def replayed(directory: Path) -> None:
    with closing(Journal.open(directory)) as journal:
        ledger = Ledger(directory, journal)
        ledger.replay()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run directory with its certificate."""
    directory = tmp_path_factory.mktemp("finished") / "run"
    campaign(directory, config("test-function", resolution=5, max_tests=3))
    return directory


def test_databases(tmp_path: Path, finished: Path) -> None:
    whole = (finished / DATABASE).read_bytes()

    def attempt(luck: random.Random) -> None:
        directory = tmp_path / "run"
        directory.mkdir()
        (directory / DATABASE).write_bytes(luck.choice((flipped, flipped, mutated))(luck, whole))
        opened(directory)
        shutil.rmtree(directory)

    each(attempt, one_in=3)


def test_every_byte_of_the_schema_of_a_database(tmp_path: Path, finished: Path) -> None:
    """The first page, which has the header of the file and the texts of the schema, in steps."""
    whole = (finished / DATABASE).read_bytes()

    def attempt(luck: random.Random) -> None:
        directory, changed = tmp_path / "run", bytearray(whole)
        changed[luck.randrange(4096 * 2)] = luck.randrange(256)
        directory.mkdir()
        (directory / DATABASE).write_bytes(changed)
        opened(directory)
        shutil.rmtree(directory)

    each(attempt, one_in=3)


def test_verify(tmp_path: Path, finished: Path) -> None:
    def attempt(luck: random.Random) -> None:
        directory = tmp_path / "run"
        shutil.copytree(finished, directory)
        chosen = luck.choice(sorted(path for path in directory.rglob("*") if path.is_file()))
        chosen.write_bytes(luck.choice((flipped, mutated))(luck, chosen.read_bytes()))
        with suppress(PerfboundError):
            verify_certificate(directory, key=None, again=0, report=lambda *_: None)
        shutil.rmtree(directory)

    each(attempt, one_in=10)


# Campaign files and formulas


@pytest.mark.parametrize("name", ["test-function", "segway-paper"])
def test_campaign_files(name: str) -> None:
    whole = (FOLDER / f"{name}.toml").read_bytes()
    spec = load_system("test-function").spec

    def attempt(luck: random.Random) -> None:
        refused = "campaign.toml"
        try:
            check(parse_campaign(mutated(luck, whole), "campaign.toml"), spec, "campaign.toml")
        except PerfboundError as error:
            refused = str(error)
        assert refused.startswith("campaign.toml")

    each(attempt)


def test_formulas() -> None:
    columns = ("t", "phi", "omega")
    samples = np.column_stack([np.arange(50) / 10, np.ones(50), np.zeros(50)])
    whole = (
        b"always[0,2] (abs(phi) <= 1.5 implies eventually[0.5,1] (omega^2 / (phi + 1) < 3 and phi < 2)) until phi > 0"
    )

    def attempt(luck: random.Random) -> None:
        given = mutated(luck, whole).decode(errors="replace")
        try:
            tree = parse_formula(given, columns)
        except FormulaError:
            return
        with suppress(ValueError):
            assert np.isfinite(robustness(tree, columns, samples))

    each(attempt)
