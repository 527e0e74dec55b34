"""A campaign of tests that were made before: their logs, and the starts from which they were driven."""

import csv
import hashlib
import io
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from ...schemas.base import canonical_json
from ...schemas.errors import CampaignError, EvidenceError, PerfboundError
from ...schemas.file.config import CampaignConfig
from ...schemas.file.logs import MAX_LOGS, name_and_unit
from ...schemas.file.reader import MAX_STARTS_FILE, load_campaign, load_description
from ...schemas.ids import RolloutId
from ...schemas.number_text import number_in
from ...schemas.outside import read_outside
from ...schemas.ranges import MAX_FILE_BYTES
from ...schemas.result.facts import Header
from ...schemas.rollout import RolloutRequest
from ...schemas.system import SystemSpec
from ..campaign.checks import check_new
from ..campaign.seeds import rollout_seed
from ..campaign.software import software
from ..campaign.starts import drawn_starts
from ..fleet.children import child
from ..store import files as evidence
from ..store.rows import DATABASE
from .directory import check_vacant
from .told import Admitted, ToldRollouts, journal_in

Report = Callable[[str, int, int], None]
"""Called with the stage, and how much of it is done."""
LOG, OFFSET = "log", "offset"
"""Titles of the starts beside those of the parameters."""
LOG_SUFFIXES = frozenset({".csv", ".parquet", ".mat", ".mcap", ".bag", ".db3"})
CHUNK = 2**20
MOST_NAMED = 20
"""Faults of starts that a message lists."""


class Start(NamedTuple):
    """A row of the starts."""

    log: str
    start: dict[str, float]
    offset: float | None


def import_logs(campaign: Path, folder: Path, starts: Path, directory: Path | None, report: Report) -> Path:
    """Make a campaign of the logs in a folder, issue its certificate, and return its run directory.

    Nothing is made before every log has been read; after an interruption the same call continues.

    Raises:
        CampaignError: the campaign file or the starts cannot be used.
        PerfboundError: a line for each log that is none, or there is another campaign in `directory`.

    """
    description = load_description(campaign)
    if description.system.kind != "rig":
        raise CampaignError(
            f'{campaign}: {description.system.place}: logs are imported for a rig; give [system] rig = "NAME" and its '
            "columns"
        )
    spec = child.system_spec(str(campaign), f"{campaign}: system")
    rows = read_starts(starts, [each.name for each in spec.parameters])
    tests = list(_recorded(rows, folder, starts, description.horizon, report))
    config = load_campaign(campaign, recorded=tests)
    check_new(config, spec, str(campaign))
    directory = directory or Path("runs") / config.name
    with ExitStack() as stack:
        if not (directory / DATABASE).exists():
            check_vacant(directory, config)
        place = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="perfbound-import-")))
        requests = _requests(config, spec)
        read_logs(campaign, folder, list(zip(requests, rows, strict=True)), place, partial(report, "logs"))
        # The run directory comes into being behind the last check of a log.
        journal = stack.enter_context(journal_in(directory, config, spec, str(campaign.absolute())))
        _tell(ToldRollouts(directory, journal), place, len(rows), partial(report, "tests"))
    return directory


def read_starts(path: Path, names: Sequence[str]) -> list[Start]:
    """Return the rows of a CSV file with the columns `log`, each of `names`, and `offset` if it has it.

    Raises:
        CampaignError: it cannot be read, or a row is none.

    """
    try:
        text = read_outside(path, MAX_STARTS_FILE).decode("utf-8-sig")
        head, *rows = [row for row in csv.reader(io.StringIO(text, newline="")) if row] or [[]]
    except OSError as error:
        raise CampaignError(f"--starts: {path}: {error.strerror}; give a CSV file of {_titles(names)}") from None
    except UnicodeDecodeError:
        raise CampaignError(f"--starts: {path}: not UTF-8; save it as UTF-8") from None
    except csv.Error as error:
        raise CampaignError(f"--starts: {path}: not CSV: {error}") from None
    titles = [name_and_unit(title)[0] for title in head]
    places = {name: titles.index(name) for name in (LOG, *names, OFFSET) if name in titles}
    missing = [name for name in (LOG, *names) if name not in places]
    if unknown := [title for title in titles if title not in places and not missing]:
        raise CampaignError(
            f"--starts: {path}: {unknown[0][:80]!r} is no parameter of [space]; remove this column; it may have "
            f"{_titles(names)},{OFFSET}"
        )
    if missing or len(set(titles)) < len(titles):
        fault = f"without {missing[0]!r}" if missing else "with one title twice"
        raise CampaignError(
            f"--starts: {path}: its first line is {','.join(titles)[:120]!r}, {fault}; give "
            f"{_titles(names)}, with commas between them"
        )
    if not 0 < len(rows) <= MAX_LOGS:
        raise CampaignError(f"--starts: {path}: {len(rows):,} rows; allowed are 1 to {MAX_LOGS:,}, one for each log")
    found, faults = [], []
    for number, row in enumerate(rows, start=2):
        try:
            found.append(_start(row, places, names, len(titles)))
        except ValueError as error:
            faults.append(f"--starts: {path}: line {number}: {error}")
    if faults:
        raise CampaignError(*_first(faults, "lines"))
    return found


def _titles(names: Sequence[str]) -> str:
    return ",".join((LOG, *names))


def _start(row: Sequence[str], places: dict[str, int], names: Sequence[str], width: int) -> Start:
    if len(row) != width:
        raise ValueError(f"{len(row)} cells, and the first line has {width}")
    numbers = {}
    for name in (*names, *([OFFSET] if OFFSET in places else [])):
        cell = row[places[name]]
        try:
            numbers[name] = number_in(cell)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        if not math.isfinite(numbers[name]):
            raise ValueError(f"{name}: {cell.strip()} is not finite")
    log = row[places[LOG]].strip()
    if not log or log.startswith("/") or ".." in Path(log).parts:
        raise ValueError(f"log: {log!r} is no file below the folder of the logs")
    return Start(log, {name: numbers[name] for name in names}, numbers.get(OFFSET))


def _recorded(
    rows: Sequence[Start], folder: Path, starts: Path, horizon: float, report: Report
) -> Iterator[dict[str, object]]:
    """Yield the tests of a campaign; refuse a log that is missing, that is there twice, or that has no row."""
    named = {row.log.rstrip("/") for row in rows}
    faults = [
        f"{folder / row.log}: there is no such log, which {starts} names"
        for row in rows
        if not (folder / row.log).exists()
    ]
    faults += [
        f"{folder / name}: {starts} has no row for this log; to leave out a test that was made would be a choice by "
        "its outcome"
        for name in _logs_below(folder)
        if named.isdisjoint((name, *map(str, PurePosixPath(name).parents)))
    ]
    if faults:
        raise PerfboundError(*_first(faults, "logs"))
    seen: dict[tuple[str, float | None], str] = {}
    digests: dict[str, str] = {}
    for number, row in enumerate(rows):
        report("digests", number, len(rows))
        if row.log not in digests:
            digests[row.log] = _digest(folder / row.log)
        key = digests[row.log], row.offset
        if key in seen:
            faults.append(
                f"{folder / row.log}: the same log as {seen[key]}: a test counts once; correct {starts}, or give each "
                "test in one log its `offset`"
            )
        seen[key] = row.log
        offset = {} if row.offset is None else {"offset": row.offset}
        yield {"log": row.log, "sha256": digests[row.log], "start": row.start, **offset}
    faults += _overlapping(rows, digests, horizon, folder)
    if faults:
        raise PerfboundError(*_first(faults, "logs"))


def _overlapping(rows: Sequence[Start], digests: Mapping[str, str], horizon: float, folder: Path) -> Iterator[str]:
    """Yield the tests that share a part of one log: they are no samples of their own."""
    by_log: dict[str, list[Start]] = {}
    for row in rows:
        by_log.setdefault(digests[row.log], []).append(row)
    for tests in by_log.values():
        ordered = sorted(tests, key=lambda row: row.offset or 0.0)
        for one, other in pairwise(ordered):
            apart = (other.offset or 0.0) - (one.offset or 0.0)
            if 0.0 < apart < horizon * (1.0 - 1e-9):
                yield (
                    f"{folder / other.log}: the tests at {one.offset:g} and {other.offset:g} s overlap, since each "
                    f"lasts {horizon:g} s: what they share would count twice"
                )


def _logs_below(folder: Path) -> list[str]:
    """Return the logs in a folder and below, sorted; of rosbag2 its files."""
    if not folder.is_dir():
        raise PerfboundError(f"{folder}: no such folder; name that of the logs")
    found = (each for each in folder.rglob("*") if each.suffix.lower() in LOG_SUFFIXES and each.is_file())
    return sorted(each.relative_to(folder).as_posix() for each in found)


def _digest(path: Path) -> str:
    """Return the sha256 of a log; of a folder that of its files with their names."""
    whole = hashlib.sha256()
    try:
        if path.is_dir():
            for each in sorted(each for each in path.rglob("*") if each.is_file()):
                whole.update(f"{each.relative_to(path).as_posix()} {_digest(each)}\n".encode())
        else:
            with path.open("rb") as file:
                while piece := file.read(CHUNK):
                    whole.update(piece)
    except OSError as error:
        raise PerfboundError(f"{path}: {error.strerror}") from None
    return whole.hexdigest()


def _requests(config: CampaignConfig, spec: SystemSpec) -> list[RolloutRequest]:
    """Return the request that each log answers: it is the same whatever a log shows."""
    header = Header.new(config, spec, software(spec))
    problem, variant = config.problems[0].name, header.spec.variants[0]
    rollouts = [RolloutId(problem, number, variant, 0) for number in range(len(config.recorded))]
    start = drawn_starts(header, problem)
    return [
        header.template.request(rollout, start(rollout.test), rollout_seed(header, rollout)) for rollout in rollouts
    ]


def read_logs(
    campaign: Path,
    folder: Path,
    tests: Sequence[tuple[RolloutRequest, Start]],
    place: Path,
    done: Callable[[int, int], None] = lambda *_: None,
) -> None:
    """Write the file of each test, NUMBER.mcap, into an empty folder.

    In a child process: readers of many forms of files see what anybody wrote.

    Raises:
        PerfboundError: a line for each log that is none.

    """
    listed = place / "tests"
    listed.write_bytes(
        b"".join(
            canonical_json(
                {"request": request.model_dump(mode="json"), "log": str(folder / row.log), "offset": row.offset}
            ).encode()
            + b"\n"
            for request, row in tests
        )
    )

    def steps() -> int:
        count = len(list(place.glob("*.*")))
        done(count, len(tests))
        return count

    child.ask("logs", "--campaign", str(campaign), "--tests", str(listed), "--out", str(place), steps=steps)


def _tell(told: ToldRollouts, place: Path, count: int, done: Callable[[int, int], None]) -> None:
    while (rollout := next(iter(told.wanted), None)) is not None:
        done(count - len(told.wanted), count)
        payload = evidence.contents(place / f"{rollout.test}.mcap", MAX_FILE_BYTES)
        try:
            found = Admitted.of(payload, told.request(rollout), told.spec)
            told.check(rollout, found)
        except EvidenceError as fault:  # the folder was changed meanwhile
            raise PerfboundError(f"{rollout}: {fault}") from None
        told.record(rollout, found)


def _first(faults: Sequence[str], what: str) -> list[str]:
    more = len(faults) - MOST_NAMED
    return [*faults[:MOST_NAMED], *([f"and {more:,} further {what}"] if more > 0 else [])]
