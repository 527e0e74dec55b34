"""Which campaigns reproduce the paper, and running what is still missing of them, one after the other."""

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.text import Text

from ....schemas.campaign import CampaignConfig, MethodName, ProblemName
from ....schemas.errors import PerfboundError
from ....schemas.link import LOCAL
from ...certificate import files
from ...run import session
from ...run.format import duration
from ...store.rows import DATABASE

SHIPPED = Path(str(resources.files("perfbound") / "campaigns"))


@dataclass(frozen=True, slots=True)
class Preset:
    """A campaign file of the study, and what its numbers are read from."""

    name: str
    method: MethodName
    problems: tuple[ProblemName, ...]
    cost: float
    """Relative to the others; about seconds on two cores."""


FUNCTION = Preset("test-function", "paper", ("maximum",), 1)
PAPER = Preset("segway-paper", "paper", ("nominal_robustness", "sim_gap"), 30)
DIRECT = Preset("segway-direct", "paper", ("true_risk",), 120)
RIGOROUS = Preset("segway-rigorous", "rigorous", ("nominal_robustness", "sim_gap"), 300)
SCENARIO = Preset("segway-scenario", "scenario", ("true_risk",), 240)


@dataclass(frozen=True, slots=True)
class Extent:
    """How many seeds of each kind; `ours` says whether our own two claims are made as well."""

    functions: int
    seeds: int
    direct_seeds: int
    ours: bool

    def __iter__(self) -> Iterator[tuple[Preset, range | None]]:
        """Yield every preset with its seeds; None stands for the one in the file."""
        yield FUNCTION, range(self.functions)
        yield PAPER, range(self.seeds)
        if self.ours:
            yield RIGOROUS, None
            yield SCENARIO, None
        yield DIRECT, range(self.direct_seeds)


@dataclass(frozen=True, slots=True)
class Planned:
    """One campaign of the study, and the run directory that is its own."""

    preset: Preset
    source: Path
    config: CampaignConfig
    directory: Path

    @property
    def label(self) -> str:
        """What a person calls it."""
        return self.directory.name


def plan(extent: Extent, folder: Path, out: Path) -> tuple[Planned, ...]:
    """Return the campaigns of a study in the order in which they run.

    Raises:
        CampaignError: a campaign file is missing or wrong.
        PerfboundError: a campaign file lacks a problem that the study needs.

    """
    if not folder.is_dir():
        raise PerfboundError(f"{folder}: no such folder; name the one that holds the campaign files with --campaigns")
    return tuple(
        _planned(preset, folder / f"{preset.name}.toml", out, {} if seed is None else {"seed": seed})
        for preset, seeds in extent
        for seed in ((None,) if seeds is None else seeds)
    )


def _planned(preset: Preset, source: Path, out: Path, overrides: dict[str, int]) -> Planned:
    config = session.load(source, **overrides)
    for name in preset.problems:
        if not any((each.name, each.method) == (name, preset.method) for each in config.problems):
            raise PerfboundError(
                f"{source}: problems: the study needs {name!r} with method {preset.method!r}; add it, or take the file "
                "of deploy/campaigns"
            )
    return Planned(preset, source, config, out / "campaigns" / f"{preset.name}-{config.seed}")


def check_stored(campaigns: Iterable[Planned]) -> None:
    """Refuse results of another campaign file under the name of one of ours.

    Raises:
        PerfboundError: a stored campaign differs from its file; the text names both.
        JournalError: a stored campaign cannot be read.

    """
    for each in campaigns:
        if (each.directory / DATABASE).exists():
            found = session.stored_differently(each.directory, each.config)
            if found:
                raise PerfboundError(
                    f"{each.directory}: was run with another {each.source}: {found}; restore that file, "
                    "or choose another --out"
                )


def finished(campaign: Planned) -> bool:
    """Whether its certificate is there.

    Raises:
        EvidenceError: it is there, but damaged.

    """
    return files.read(campaign.directory) is not None


class Follower(Protocol):
    """Is told what runs."""

    def begin(self, number: int, campaign: Planned, left: float | None) -> None:
        """Campaign `number` (from 1) begins; all that is left takes about `left` seconds."""
        ...


def conduct(campaigns: Sequence[Planned], *, workers: int, follower: Follower) -> None:
    """Run what is not finished, one campaign after the other; what is half done is resumed.

    Raises:
        PerfboundError, CampaignError: what is wrong, in one line.
        Stopped: a signal arrived.

    """
    done: list[tuple[float, float]] = []
    missing = [(number, each) for number, each in enumerate(campaigns, 1) if not finished(each)]
    for position, (number, each) in enumerate(missing):
        rest = (one.preset.cost for _, one in missing[position:])
        follower.begin(number, each, time_left(done, rest))
        begun = time.monotonic()
        _run(each, workers)
        done.append((each.preset.cost, time.monotonic() - begun))


def time_left(done: Sequence[tuple[float, float]], costs: Iterable[float]) -> float | None:
    """Return the seconds that campaigns of these `costs` take, from (cost, seconds) of those that ran.

    >>> time_left([(3, 6.0), (30, 60.0)], [30, 120])
    300.0
    """
    if not done:
        return None
    per_cost = sum(seconds for _, seconds in done) / sum(cost for cost, _ in done)
    return per_cost * sum(costs)


def _run(campaign: Planned, workers: int) -> None:
    options, console = session.RunOptions(workers, session.Link(LOCAL)), Console(quiet=True, force_terminal=False)
    directory = campaign.directory
    if (directory / DATABASE).exists():
        session.resume(directory, options, console)
    else:
        session.start(campaign.config, campaign.source, directory, options, console)


class Lines:
    """Progress as one line a campaign."""

    def __init__(self, console: Console, total: int) -> None:
        self._console, self._total = console, total

    def begin(self, number: int, campaign: Planned, left: float | None) -> None:
        """As `Follower`."""
        text = f"campaign {number} of {self._total}: {campaign.label}{_about(left)}"
        self._console.print(Text(text), soft_wrap=True)


class Bar:
    """Progress as one line that is redrawn."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress = progress
        self._task = progress.add_task("", total=total, left="")

    def begin(self, number: int, campaign: Planned, left: float | None) -> None:
        """As `Follower`."""
        self._progress.update(self._task, completed=number - 1, description=campaign.label, left=_about(left))


def _about(left: float | None) -> str:
    return "" if left is None else f", about {duration(left)} left"


@contextmanager
def following(console: Console, total: int) -> Iterator[Follower]:
    """Return the view that fits: a redrawn line on a terminal, plain lines elsewhere."""
    if not console.is_terminal:
        yield Lines(console, total)
        return
    count = MofNCompleteColumn()
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), count, TextColumn("{task.fields[left]}"))
    with Progress(*columns, console=console, transient=True) as progress:
        yield Bar(progress, total)
