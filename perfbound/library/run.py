"""The run of a campaign: its certificate, tables, trajectories and posterior, while it runs and afterwards."""

import html
import io
from collections.abc import Collection, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rich.console import Console

from ..orchestrator.certificate import files
from ..orchestrator.certificate.words import console_lines, text
from ..orchestrator.certificate.words.bound_text import parameter_units
from ..orchestrator.run import directory as places
from ..orchestrator.run import session
from ..orchestrator.run.known import verdict_of
from ..orchestrator.run.link import Link
from ..orchestrator.run.options import RunOptions, check_workers
from ..orchestrator.store import export, read
from ..orchestrator.store.export_tables import robustness_unit
from ..orchestrator.store.rows import DATABASE, existing
from ..schemas.amounts import counted
from ..schemas.errors import EvidenceError, PerfboundError
from ..schemas.file.config import CampaignConfig
from ..schemas.ids import closing_check
from ..schemas.link.configuration import LOCAL
from ..schemas.real_numbers import real_array
from ..schemas.result.certificate import Predicate
from ..schemas.result.facts import Header
from ..schemas.result.known import CampaignVerdict
from ..schemas.system import differences
from ..schemas.trajectory.trajectory import Trajectory
from ..schemas.values import DISCRETE, Beyond
from .forked import Forked
from .process import interruptible, output, reproducible
from .system_argument import GivenSystem, given_system

if TYPE_CHECKING:
    from ..orchestrator.certificate.verify.run import Verification
    from .plot import Plot
    from .study import Study

MOST_WORKERS = 256


class BandAt(NamedTuple):
    """A problem's objective at N starts, by its method: mean and band, (N,) each, in the unit of the objective."""

    mean: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]


class _Shown:
    """A run as a session shows it."""

    directory: Path

    def __repr__(self) -> str:
        """Return the verdict and the claim, or the number of tests so far."""
        return _in_words(self.directory).rstrip()

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(_in_words(self.directory))}</pre>"


class Run(_Shown):
    """A run directory, read from its files at every access; it changes nothing there."""

    def __init__(self, directory: Path) -> None:
        # Absolute: a later chdir must not lead to another run.
        self.directory = Path(directory).absolute()
        existing(directory)

    @cached_property
    def header(self) -> Header:
        """The first fact: the campaign, its system and its software."""
        with read.reading(self.directory) as connection:
            return read.read_header(connection, self.directory)

    @property
    def finished(self) -> bool:
        """Whether there is a certificate."""
        return files.read(self.directory) is not None

    @property
    def certificate(self) -> Predicate:
        """The content of the certificate: claims, problems, assumptions.

        Raises:
            PerfboundError: there is none yet, or it is damaged.

        """
        found = files.read(self.directory)
        if found is None:
            raise PerfboundError(f"{self.directory}: no certificate yet; perfbound.resume continues the campaign")
        return found.predicate

    @property
    def verdict(self) -> CampaignVerdict:
        """Whether the first claim shows what the campaign file requires.

        Raises:
            PerfboundError: there is no certificate yet, or it is damaged.

        """
        return verdict_of(self.directory, self.header, places.finished_certificate(self.directory))

    @property
    def tests(self) -> NDArray[Any]:
        """A row for each test of a problem: its start, its observation, and the bounds after it."""
        return _of_series(self.table("tests"), closing=False)

    @property
    def closing_checks(self) -> NDArray[Any]:
        """A row for each test of the closing checks, as in `tests`.

        `problem` is `spot_check`, `risk_check`, `shrink`, `simplest` or `recheck`; after an extension `spot_check_b`
        and so on.
        """
        return _of_series(self.table("tests"), closing=True)

    @property
    def rollouts(self) -> NDArray[Any]:
        """A row for each rollout: its id, seed, start, robustness, file and worker."""
        return self.table("rollouts")

    def table(self, name: str) -> NDArray[Any]:
        """Return a table that `perfbound export` has: also observations, counterexamples and failures.

        `table["x"]` is a column, `table[3]` a row, `pandas.DataFrame(table)` the same in pandas. A missing number is
        NaN, a missing text None. Fields have the titles of a CSV file, with the unit: "x (m)".

        Raises:
            PerfboundError: there is no such table, or the campaign cannot be read.

        """
        return export.table_array(self.directory, name)

    def trajectory(self, rollout: int | np.integer[Any] | str) -> Trajectory:
        """Return the trajectory of a rollout by its id, "robustness.7.nominal.0", or the first one of a test.

        A number is that of a test of the first problem.

        Raises:
            PerfboundError: there is no such rollout, or its file is damaged.

        """
        from ..orchestrator.campaign.plan import plans  # noqa: PLC0415
        from ..orchestrator.report.rollout.load import load_recorded  # noqa: PLC0415

        if not isinstance(rollout, str):
            name, plan = next(iter(plans(self.header.config, self.header.spec).items()))
            variant, replicate = plan.rollouts[0]
            rollout = f"{name}.{rollout}.{variant}.{replicate}"
        found = load_recorded(self.directory, rollout)
        if found.trajectory is None:
            raise EvidenceError(found.damage)
        return found.trajectory

    def posterior(self, x: ArrayLike, problem: str | None = None) -> BandAt:
        """Return mean and band of a problem's objective, by default the first one's, at the starts `x` (N, p).

        They follow from all observations so far. Method `rigorous` has a band anywhere in the box, the others at their
        candidates: the nodes of the lattice, or the listed starts.

        Raises:
            PerfboundError: there is no such problem, it has no observation, or a start is not one of its method.

        """
        from ..orchestrator.report.collect.posterior import posterior  # noqa: PLC0415  (late: it loads the numerics)

        try:
            starts = np.atleast_2d(real_array(x))
        except ValueError as error:
            raise PerfboundError(f"posterior: x {error}") from None
        with reproducible():
            return BandAt(*posterior(self.directory, problem, starts))

    def verify(self, *, resimulate: int = 0, system: object = None, key: str | Path | None = None) -> "Verification":
        """Check the certificate against its evidence, as `perfbound verify`; `.checks.good` is the result.

        `resimulate` rollouts are simulated again. A system in a file has to be given for that, as a function or
        "FILE.py:NAME": no run directory names code that runs here.

        Raises:
            PerfboundError: there is no certificate, or the key cannot be read.

        """
        from ..orchestrator.certificate.verify.run import verify_certificate  # noqa: PLC0415

        found = None if system is None else given_system(system, "verify")
        # A function of a session has no reference, and its rollouts are not simulated again.
        reference = found.reference if found is not None and found.here is None else None
        with reproducible():
            return verify_certificate(
                self.directory,
                key=None if key is None else Path(key),
                again=resimulate,
                report=lambda _stage, _done, _total: None,
                system=reference,
            )

    @property
    def plot(self) -> "Plot":
        """Figures of the problems, as matplotlib axes."""
        from .plot import Plot  # noqa: PLC0415  (late: matplotlib takes a second to load)

        return Plot(self.directory)

    def ask_tell(self) -> "Study":
        """Continue a campaign whose rollouts are handed in; see `Campaign.ask_tell`."""
        from .study import open_study  # noqa: PLC0415

        return open_study(self.directory)


def _of_series(tests: NDArray[Any], *, closing: bool) -> NDArray[Any]:
    """Return the tests of the closing checks, or those of the problems."""
    wanted = [(closing_check(str(name)) is not None) == closing for name in tests["problem"]]
    return np.asarray(tests[np.array(wanted, dtype=bool)])


def open_run(directory: str | Path) -> Run:
    """Return the run in a directory: running, stopped or finished.

    Raises:
        JournalError: there is no campaign, or it cannot be read.

    """
    return Run(Path(directory))


def resume_run(
    directory: str | Path,
    *,
    system: object = None,
    max_tests: int | None = None,
    workers: int = 2,
    progress: bool = True,
) -> Run:
    """Continue a campaign to its certificate; a finished one is left as it is.

    With `max_tests` a finished campaign that ended by its budget gets this larger one, and continues; not with method
    `paper`, and not where a number of samples was fixed.

    `system` is the function, where it was typed into a notebook, or "FILE.py:NAME" where the file is elsewhere now.

    Raises:
        PerfboundError: there is no campaign, its software or its system is another one, or the run fails.
        KeyboardInterrupt: it was interrupted.

    """
    found = None if system is None else given_system(system, "resume")
    own = Forked(found.here, found.spec) if found is not None and found.here is not None else None
    reference = found.reference if found is not None and own is None else None
    path, console = Path(directory).absolute(), output(progress=progress)
    with reproducible(), interruptible(path, console):
        if session.resume_campaign(path, _run_options(workers, reference, own), console, max_tests):
            _write_page(path, console)
    return Run(path)


def run_campaign(
    config: CampaignConfig, source: Path, system: GivenSystem, directory: Path, workers: int, *, progress: bool
) -> Run:
    """Run a new campaign; see `Campaign.run`."""
    own = Forked(system.here, system.spec) if system.here is not None else None
    check_workers(system.spec, own, directory, workers)
    if (directory / DATABASE).exists():
        # A system whose code has changed is another one: its old result must not be read as that of the new code.
        changed = differences(Run(directory).header.spec, system.spec)
        found = places.stored_differently(directory, config) or ", ".join(changed[:1])
        differing = f"another campaign is here ({found})" if found else "this campaign is here already"
        remedy = "choose another `out`" if found else _of_this(directory)
        raise PerfboundError(f"{directory}: {differing}; {remedy}")
    console = output(progress=progress)
    if system.here is not None:
        console.print(f"{system.spec.name}: one worker, forked from this process: {system.reason}", markup=False)
    with reproducible(), interruptible(directory, console):
        session.start_campaign(config, source, directory, _run_options(workers, system.reference, own), console)
        _write_page(directory, console)
    return Run(directory)


def _of_this(directory: Path) -> str:
    """Return what to do with a campaign that was started before."""
    name = repr(str(directory))
    if Run(directory).finished:
        return f"read it with perfbound.open({name}), or choose another `out` to run it again"
    return f"continue it with perfbound.resume({name})"


def _write_page(directory: Path, console: Console) -> None:
    from ..orchestrator.report.write import finish_page  # noqa: PLC0415  (late: only a run draws)

    if line := finish_page(directory):
        console.print(line, markup=False)


def _run_options(workers: int, reference: str | None, own: Forked | None) -> RunOptions:
    if not 1 <= workers <= MOST_WORKERS:
        raise PerfboundError(f"workers: {workers} is not allowed: allowed is a whole number from 1 to {MOST_WORKERS}")
    return RunOptions(workers, Link(LOCAL), system=reference, own=own)


def robustness(
    specification: str,
    trajectory: Trajectory | dict[str, Sequence[float]],
    *,
    discrete: Collection[str] = (),
    beyond: Beyond = "refuse",
) -> float:
    """Return the robustness of a trajectory, in the unit of the predicates: above 0 it satisfies the formula.

    `trajectory` may be a dict of columns, (T,) each; without `t` it is one sample. `discrete` are the columns of whole
    numbers, which may be compared with == and !=. With `beyond` = "truncate" windows end with the trajectory.

    Raises:
        PerfboundError: the formula cannot be read, or not be evaluated on this trajectory.

    >>> robustness("always (x <= 1)", {"t": [0.0, 0.5], "x": [0.2, 0.75]})
    0.25

    """
    from ..orchestrator.mathematics.stl.parser import parse_formula  # noqa: PLC0415
    from ..orchestrator.mathematics.stl.robustness import robustness as evaluated  # noqa: PLC0415
    from .handed_in import of_columns  # noqa: PLC0415

    trajectory = of_columns(trajectory)
    try:
        units = {name: DISCRETE if name in discrete else "" for name in trajectory.columns}
        return evaluated(parse_formula(specification, units), trajectory.columns, trajectory.samples, beyond)
    except ValueError as error:
        raise PerfboundError(f"robustness: {error}") from None


def _in_words(directory: Path) -> str:
    """Return what `perfbound run` prints of the first claim; names in it may be anybody's text."""
    run, found = Run(directory), files.read(directory)
    if found is None:
        rollouts = counted(len(run.rollouts), "rollout")
        return f"{directory}: not finished, {rollouts} so far; perfbound.resume continues it\n"
    console = Console(file=io.StringIO(), width=console_lines.WIDTH, force_terminal=False, color_system=None)
    unit = robustness_unit(run.header.config, run.header.spec)
    with console.capture() as captured:
        text.print_counterexample(found.predicate, console, unit, parameter_units(run.header.spec))
        text.first_claim(found, console, unit)
    return f"VERDICT  {run.verdict.verdict}\n{captured.get().lstrip()}"
