"""`perfbound slurm`: the jobs of a campaign on a cluster, written as files and submitted."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import click

from ...schemas.errors import PerfboundError
from .early import check_campaign
from .group import RUN_DIRECTORY, cli

MOST_WORKERS = 10_000
"""An orchestrator takes no more of them."""


@cli.command()
@click.argument("campaign", type=click.Path(path_type=Path), callback=check_campaign)
@click.option("--workers", type=click.IntRange(1, MOST_WORKERS), required=True, help="Jobs of the array, a core each.")
@click.option("--out", type=RUN_DIRECTORY, default=None, help="Run directory.  [default: runs/<name>]")
@click.option("--folder", type=RUN_DIRECTORY, default=None, help="Of the job files.  [default: slurm/<name>]")
@click.option("--dry-run", is_flag=True, help="Write the job files, and submit nothing.")
@click.option("--time", default="4:00:00", show_default=True, help="Time limit of each job, as sbatch takes it.")
@click.option("--memory", default="2G", show_default=True, help="Memory of each job, as sbatch takes it.")
@click.option("--partition", default=None, help="Partition of the jobs.")
@click.option("--account", default=None, help="Account of the jobs.")
@click.option(
    "--router", default=None, metavar="ENDPOINT", help="Endpoint of a router that runs already: no job for one."
)
@click.option(
    "--tls",
    type=RUN_DIRECTORY,
    default=None,
    metavar="FOLDER",
    help="Folder with the folders orchestrator, worker and, without --router, router that `perfbound pki issue` has "
    "written.",
)
def slurm(
    *, campaign: Path, workers: int, out: Path | None, folder: Path | None, dry_run: bool, tls: Path | None, **jobs: str
) -> None:
    """Run the campaign of a CAMPAIGN file on a Slurm cluster: a router, the orchestrator, and an array of workers.

    Folders must be on a file system that all nodes share. The command again continues the campaign.
    """
    from ...schemas.file.reader import load_campaign  # noqa: PLC0415
    from ...schemas.link.secret import given_secret, secret_file, user_secret  # noqa: PLC0415
    from ..fleet.children.child import system_options  # noqa: PLC0415
    from ..hosts.slurm_files import ORCHESTRATOR, SlurmOptions, job_files, missing_files  # noqa: PLC0415

    config = load_campaign(campaign)
    if jobs["router"] is not None:
        _check_router(jobs["router"], tls)
    sealed = tls is None and given_secret() is None
    if sealed:
        user_secret()  # made here, before jobs on several nodes make one each
    options = SlurmOptions(
        config.name,
        campaign.resolve(),
        (out or Path("runs") / config.name).resolve(),
        (folder or Path("slurm") / config.name).resolve(),
        Path(sys.executable).parent,
        workers,
        secret=secret_file() if sealed else None,
        tls=None if tls is None else tls.resolve(),
        system=tuple(system_options(config.system.reference(campaign))),
        **jobs,
    )
    for path in missing_files(options):
        raise PerfboundError(f"--tls: {path}: no such file; write it with `perfbound pki issue`")
    command = ["bash", str(options.folder / "submit.sh")]
    kept = _write(options.folder, job_files(options))
    if kept:
        click.echo(
            f"perfbound: {options.folder}: job files that differ are written anew, and the old ones kept as "
            f"{', '.join(kept)}; to submit job files as they are, with changes of your own: {shlex.join(command)}",
            err=True,
        )
    if dry_run:
        click.echo(f"written to {options.folder}; submit with: {shlex.join(command)}")
        return
    _submit(command)
    click.echo(
        f"once the job {ORCHESTRATOR} runs: {shlex.join(['perfbound', 'status', str(options.directory)])}; before, "
        "there is no campaign"
    )


def _check_router(endpoint: str, tls: Path | None) -> None:
    from ...schemas.link.configuration import ENCRYPTED, split  # noqa: PLC0415

    protocol, _ = split(endpoint)
    if protocol in ENCRYPTED and tls is None:
        raise click.UsageError(
            f"--router {endpoint}: {protocol} needs certificates; write them with `perfbound pki issue`, and add "
            "--tls FOLDER"
        )
    if protocol not in ENCRYPTED and tls is not None:
        raise click.UsageError(f"--router {endpoint}: {protocol} does not encrypt; with --tls write tls/HOST:PORT")


def _write(folder: Path, texts: dict[str, str]) -> list[str]:
    from ..hosts.slurm_files import write_job_files  # noqa: PLC0415

    try:
        return write_job_files(folder, {name: os.fsencode(text) for name, text in texts.items()})
    except OSError as error:
        raise PerfboundError(f"{folder}: {error.strerror}; choose another --folder") from None


def _submit(command: list[str]) -> None:
    ended = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, check=False)
    click.echo(ended.stdout, nl=False)
    if ended.returncode:
        raise PerfboundError("the jobs were not submitted; see what sbatch says above")
