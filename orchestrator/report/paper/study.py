"""The campaigns that reproduce the paper, and the runs of those that are not finished."""

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ....schemas.errors import PerfboundError
from ....schemas.file.config import CampaignConfig
from ....schemas.file.objectives import MethodName, ProblemName
from ....schemas.file.reader import load_campaign
from ....schemas.link.configuration import LOCAL
from ...certificate import files
from ...certificate.words.format import duration
from ...run import session
from ...run.directory import stored_differently
from ...run.link import Link
from ...run.options import RunOptions
from ...store.rows import DATABASE

SHIPPED = Path(str(resources.files("perfbound") / "campaigns"))


@dataclass(frozen=True, slots=True)
class Preset:
    """A campaign file of the study, and the problems that its numbers are read from."""

    name: str
    method: MethodName
    problems: tuple[ProblemName, ...]
    cost: float
    """Relative to the others; about seconds on two cores."""


FUNCTION = Preset("test-function", "paper", ("maximum",), 1)
PAPER = Preset("segway-paper", "paper", ("nominal_robustness", "sim_gap"), 30)
DIRECT = Preset("segway-direct", "paper", ("true_risk",), 120)
RIGOROUS = Preset("segway-rigorous", "kriging", ("true_risk",), 180)
SCENARIO = Preset("segway-scenario", "scenario", ("true_risk",), 240)


@dataclass(frozen=True, slots=True)
class Extent:
    """Number of seeds of each kind; `ours` adds the claims of the methods kriging and scenario."""

    functions: int
    seeds: int
    direct_seeds: int
    ours: bool

    def __iter__(self) -> Iterator[tuple[Preset, int | None]]:
        """Yield every campaign as preset and seed; None is the seed of the file."""
        yield from ((FUNCTION, seed) for seed in range(self.functions))
        yield from ((PAPER, seed) for seed in range(self.seeds))
        if self.ours:
            yield RIGOROUS, None
            yield SCENARIO, None
        yield from ((DIRECT, seed) for seed in range(self.direct_seeds))


@dataclass(frozen=True, slots=True)
class Planned:
    """One campaign of the study with its run directory."""

    preset: Preset
    source: Path
    config: CampaignConfig
    directory: Path

    @property
    def label(self) -> str:
        """Preset and seed."""
        return self.directory.name

    @property
    def finished(self) -> bool:
        """Whether there is a certificate.

        Raises:
            EvidenceError: there is one, but it is damaged.

        """
        return files.read(self.directory) is not None


def planned(extent: Extent, folder: Path, out: Path) -> tuple[Planned, ...]:
    """Return the campaigns of a study in the order in which they run.

    Raises:
        CampaignError: a campaign file is missing or wrong.
        PerfboundError: a campaign file lacks a problem that the study needs.

    """
    if not folder.is_dir():
        raise PerfboundError(f"{folder}: no such folder; choose the one with the campaign files with --campaigns")
    return tuple(_planned(preset, folder / f"{preset.name}.toml", out, seed) for preset, seed in extent)


def _planned(preset: Preset, source: Path, out: Path, seed: int | None) -> Planned:
    config = load_campaign(source) if seed is None else load_campaign(source, seed=seed)
    for name in preset.problems:  # --campaigns may name any folder
        if not any((each.name, each.method) == (name, preset.method) for each in config.problems):
            raise PerfboundError(
                f"{source}: problems: the study needs {name!r} with method {preset.method!r}; add it, or take the file "
                "of deploy/campaigns"
            )
    return Planned(preset, source, config, out / "campaigns" / f"{preset.name}-{config.seed}")


def check_stored(campaigns: Iterable[Planned]) -> None:
    """Refuse results of another campaign file in the run directory of a planned campaign.

    Raises:
        PerfboundError: a stored campaign differs from its file; the text names both.
        JournalError: a stored campaign cannot be read.

    """
    for each in campaigns:
        if (each.directory / DATABASE).exists():
            found = stored_differently(each.directory, each.config)
            if found:
                raise PerfboundError(
                    f"{each.directory}: was run with another {each.source}: {found}; restore that file, "
                    "or choose another --out"
                )


def run_unfinished(campaigns: Sequence[Planned], *, workers: int, console: Console) -> None:
    """Run or resume the unfinished campaigns one after the other, with one line of progress for each.

    Raises:
        PerfboundError, CampaignError: a campaign fails; the text has one line.
        Stopped: a signal arrived.

    """
    done: list[tuple[float, float]] = []
    missing = [(number, each) for number, each in enumerate(campaigns, 1) if not each.finished]
    for position, (number, each) in enumerate(missing):
        left = time_left(done, (one.preset.cost for _, one in missing[position:]))
        forecast = "" if left is None else f", about {duration(left)} left"
        line = f"campaign {number} of {len(campaigns)}: {each.label}{forecast}"
        console.print(Text(line), soft_wrap=True)
        begun = time.monotonic()
        _run_or_resume(each, workers)
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


def _run_or_resume(campaign: Planned, workers: int) -> None:
    options, console = RunOptions(workers, Link(LOCAL)), Console(quiet=True, force_terminal=False)
    directory = campaign.directory
    if (directory / DATABASE).exists():  # interrupted: its facts stay, so its certificate is that of a calm run
        session.resume_campaign(directory, options, console)
    else:
        session.start_campaign(campaign.config, campaign.source, directory, options, console)
