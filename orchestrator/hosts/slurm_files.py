"""The job files of a campaign for Slurm: a router, the orchestrator, and an array of workers.

The three find one another in one folder that all nodes share: the router writes its endpoint there, the orchestrator
that it has ended for good. Every value is quoted, so that no path or name becomes code. Slurm reads the lines `#SBATCH`
by rules of its own, without a shell: they contain checked words and numbers alone.
"""

import itertools
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from ...schemas.atomic import write_new, write_whole
from ...schemas.errors import PerfboundError

ROUTER, ORCHESTRATOR, WORKERS = JOBS = "router", "orchestrator", "workers"
SHARED, SUBMIT = "common.sh", "submit.sh"
"""What the three have in common, and what submits them."""
WORD = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.,-]{0,99}")
"""A partition, an account, or a quality of service."""
NO_LIMIT = "UNLIMITED"
TIME = re.compile(rf"[0-9]{{1,6}}|[0-9]{{1,3}}(-[0-9]{{1,2}}(:[0-9]{{2}}){{0,2}}|(:[0-9]{{2}}){{1,2}})|{NO_LIMIT}")
"""Minutes, MM:SS, H:MM:SS or DAYS-H[:MM[:SS]] with two digits behind each colon; 0 is no limit."""
MEMORY = re.compile(r"[1-9][0-9]{0,8}[KMGT]?")
WARNING = 120
"""Seconds before its time limit at which Slurm warns a job: a rollout under way ends, and the job is queued again."""
LEAST_TIME = WARNING + 60
"""Seconds of a time limit with which a job comes to work: Slurm sends the warning up to a minute early."""


@dataclass(frozen=True, slots=True)
class SlurmOptions:
    """What the job files are made of; folders and files are absolute, and the same on all nodes."""

    name: str
    """Of the campaign."""
    campaign: Path
    directory: Path
    """The run directory."""
    folder: Path
    """Of the job files."""
    programs: Path
    """Folder of `perfbound` and `perfbound-worker`."""
    workers: int
    secret: Path | None = None
    """File of the secret of this user; None with TLS, or with PERFBOUND_SECRET in the environment of the jobs."""
    tls: Path | None = None
    """Folder with the folders `orchestrator`, `worker` and, for a job of its own, `router` of their certificates."""
    router: str | None = None
    """Endpoint of a router that runs elsewhere."""
    system: tuple[str, ...] = ()
    """Options of a worker for a system in a file."""
    time: str = "4:00:00"
    memory: str = "2G"
    """Of each job."""
    partition: str | None = None
    account: str | None = None

    def __post_init__(self) -> None:
        """Refuse what a line #SBATCH could not take.

        Raises:
            PerfboundError: a word, a time or a size is not one, the time is too short, or a path has a line break.

        """
        for option, text, form in (
            ("--partition", self.partition, WORD),
            ("--account", self.account, WORD),
            ("--time", self.time, TIME),
            ("--memory", self.memory, MEMORY),
        ):
            if text is not None and not form.fullmatch(text):
                raise PerfboundError(f"{option} {text!r}: not a word that sbatch takes; see `man sbatch`")
        if 0 < seconds_of(self.time) <= LEAST_TIME:
            raise PerfboundError(
                f"--time {self.time}: too short, since Slurm warns a job {WARNING} s before its time limit, which then "
                f"ends and is queued again; choose more than {LEAST_TIME // 60} minutes"
            )
        for path in (self.campaign, self.directory, self.folder, self.programs, self.secret, self.tls):
            # Of a shell file every line is read on its own by sbatch, which would find #SBATCH at its beginning.
            if path is not None and not str(path).isprintable():
                raise PerfboundError(f"{str(path)!r}: contains a character that is not printed; choose another path")

    @property
    def jobs(self) -> tuple[str, ...]:
        """The jobs in the order in which they are submitted."""
        return JOBS if self.router is None else (ORCHESTRATOR, WORKERS)


def seconds_of(limit: str) -> int:
    """Return the seconds of a time limit as sbatch reads it; 0 for none.

    >>> [seconds_of(limit) for limit in ("30", "4:00", "4:00:00", "2-12", "2-12:30")]
    [1800, 240, 14400, 216000, 217800]
    """
    if limit == NO_LIMIT:
        return 0
    days, dash, rest = limit.rpartition("-")
    parts = [int(part) for part in rest.split(":")]
    # Hours come first behind days, and before two further parts; else minutes.
    hours, minutes, seconds = [*([] if dash or len(parts) == 3 else [0]), *parts, 0, 0][:3]
    return ((int(days or 0) * 24 + hours) * 60 + minutes) * 60 + seconds


def job_name(campaign: str, job: str) -> str:
    """Return the name of a job in the queue: of a campaign's name the harmless characters.

    >>> job_name("segway; rm -rf $HOME", "router")
    'segway-rm-rf-HOME-router'
    """
    plain = re.sub(r"[^A-Za-z0-9_.]+", "-", campaign).strip("-.")[:60]
    return f"{plain or 'campaign'}-{job}"


def job_files(options: SlurmOptions) -> dict[str, str]:
    """Return file name and content of every job file."""
    submit = ["#!/bin/bash", "set -eu", "", _assigned("folder", options.folder), _assigned("jobs", options.jobs), ""]
    found = {SHARED: _published(SHARED), SUBMIT: "\n".join((*submit, _published(SUBMIT)))}
    for job in options.jobs:
        found[f"{job}.sh"] = "\n".join(
            (*_directives(options, job), "", *_variables(options, job), "", _published(f"{job}.sh"))
        )
    return found


def _directives(options: SlurmOptions, job: str) -> list[str]:
    array = job == WORKERS
    lines: list[tuple[str, str | int | None]] = [
        ("job-name", job_name(options.name, job)),
        ("array", f"1-{options.workers}" if array else None),
        ("ntasks", 1),
        ("cpus-per-task", 1),
        ("mem", options.memory),
        ("time", options.time),
        ("partition", options.partition),
        ("account", options.account),
        # Relative to the folder of the submission, which is that of the job files.
        ("output", "%x-%A_%a.log" if array else "%x-%j.log"),
        ("open-mode", "append"),
        # Not B:TERM: a shell that hands it on would send a second one at scancel, which ends a worker at once.
        ("signal", f"B:USR1@{WARNING}"),
    ]
    given = [f"#SBATCH --{name}={value}" for name, value in lines if value is not None]
    return ["#!/bin/bash", *given, "#SBATCH --requeue"]


def _variables(options: SlurmOptions, job: str) -> list[str]:
    values: dict[str, str | Path | Sequence[str]] = {
        "folder": options.folder,
        "campaign": options.campaign,
        "directory": options.directory,
        "programs": options.programs,
        "secret": options.secret or "",
        "router": options.router or "",
        "tls": _tls_options(options, job),
        "system": options.system,
    }
    wanted: Mapping[str, tuple[str, ...]] = {
        ROUTER: ("folder", "programs", "secret", "tls"),
        ORCHESTRATOR: ("folder", "programs", "secret", "tls", "router", "campaign", "directory"),
        WORKERS: ("folder", "programs", "secret", "tls", "router", "directory", "system"),
    }
    return [_assigned(name, values[name]) for name in wanted[job]]


def _assigned(name: str, value: str | Path | Sequence[str]) -> str:
    if isinstance(value, (str, Path)):
        return f"{name}={shlex.quote(str(value))}"
    return f"{name}=({shlex.join(value)})"


def _tls_options(options: SlurmOptions, job: str) -> list[str]:
    if options.tls is None:
        return []
    found = tls_files(options.tls, "worker" if job == WORKERS else job)
    return [part for option, path in found.items() for part in (option, str(path))]


def missing_files(options: SlurmOptions) -> list[Path]:
    """Return the files of certificates that are not there."""
    roles = () if options.tls is None else tuple("worker" if job == WORKERS else job for job in options.jobs)
    found = [path for role in roles for path in tls_files(options.tls or Path(), role).values()]
    return [path for path in found if not path.is_file()]


def tls_files(folder: Path, role: str) -> dict[str, Path]:
    """Return the options and files of a certificate, as `perfbound pki issue` writes them."""
    there = folder / role
    names = {"--tls-ca": "ca.pem", "--tls-certificate": f"{role}.pem", "--tls-key": f"{role}-key.pem"}
    return {option: there / name for option, name in names.items()}


def write_job_files(folder: Path, contents: Mapping[str, bytes]) -> list[str]:
    """Write the job files that differ, and return the names under which the old ones of them are kept.

    Raises:
        OSError: the disk is full or the folder cannot be written; every job file there is whole, and none is lost.

    """
    old = {name: _content(folder / name) for name in contents}
    new = {name: data for name, data in contents.items() if data != old[name]}
    kept = [_keep(folder / name, data) for name in new if (data := old[name]) is not None]
    for name, data in new.items():
        write_whole(folder / name, data)  # jobs in the queue may read them now
    return kept


def _content(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        return None


def _keep(path: Path, data: bytes) -> str:
    """Keep the content of a file beside it, under the first name that is free or has it already."""
    names = (f"{path.name}.before{'' if number == 1 else f'-{number}'}" for number in itertools.count(1))
    name = next(each for each in names if _content(path.with_name(each)) in (None, data))
    if _content(path.with_name(name)) is None:
        write_new({path.with_name(name): (data, 0o666)})
    return name


def _published(name: str) -> str:
    return (files(__package__) / "slurm" / name).read_text()
