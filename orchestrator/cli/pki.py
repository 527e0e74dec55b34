"""Commands of a private certificate authority, for links with TLS: make it, issue certificates, list them."""

import shlex
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ...schemas.errors import one_line
from .group import cli

if TYPE_CHECKING:
    from ...schemas.link.tls_files import Role
    from ..hosts.authority import Order
    from ..hosts.pki import Issued

PORT = 7447
FOLDER = click.Path(path_type=Path)

folder_option = click.option(
    "--folder",
    type=FOLDER,
    default=None,
    help="Folder of the authority.  [default: ~/.local/state/perfbound/pki]",
)


@cli.group()
def pki() -> None:
    """Make TLS certificates for routers, orchestrators and workers, with an authority of your own."""


@pki.command("init")
@folder_option
@click.option("--days", type=click.IntRange(1, 3650), default=365, show_default=True, help="Life of the authority.")
def init_pki(*, folder: Path | None, days: int) -> None:
    """Make the authority: a private key, which stays in its folder, and a certificate."""
    from ...schemas.link.tls_files import time_text  # noqa: PLC0415
    from ..hosts.pki import CA_KEY, init_folder, pki_folder  # noqa: PLC0415

    place = folder or pki_folder()
    end = init_folder(place, days)
    command = shlex.join(["perfbound", "pki", "issue", *([] if folder is None else ["--folder", str(folder)])])
    click.echo(f"authority    {place}, ends at {time_text(end)} ({days} days)")
    click.echo(f"private key  {place / CA_KEY}   keep it secret, on this machine: it lets hosts in")
    click.echo(f"next         {command} NAME --worker|--orchestrator|--router")


@pki.command("issue")
@click.argument("name")
@click.option("--worker", "role", flag_value="worker", help="For workers on one host, which connect.")
@click.option("--orchestrator", "role", flag_value="orchestrator", help="For an orchestrator: it connects or listens.")
@click.option("--router", "role", flag_value="router", help="For a router, which listens.")
@click.option(
    "--host",
    "hosts",
    multiple=True,
    help="Name or address of its host, under which others connect to it; may be repeated.  [default: NAME]",
)
@click.option("--days", type=click.IntRange(1, 397), default=30, show_default=True, help="Life of the certificate.")
@click.option("--out", type=FOLDER, default=None, help="New folder for its files.  [default: hosts/NAME in --folder]")
@folder_option
def issue_to(
    *, name: str, role: "Role | None", hosts: tuple[str, ...], days: int, out: Path | None, folder: Path | None
) -> None:
    """Issue the certificate of the worker, orchestrator or router NAME; to renew it, name a new folder with --out."""
    from ..certificate.signing.key_folder import work_tree  # noqa: PLC0415
    from ..hosts import pki as authority  # noqa: PLC0415
    from ..hosts.authority import checked_order  # noqa: PLC0415

    if role is None:
        raise click.UsageError("add --worker, --orchestrator or --router")
    place = folder or authority.pki_folder()
    written, made = authority.issue_files(place, checked_order(name, role, hosts), days, out)
    for line in _instructions(written, made, authority.issued(place)):
        click.echo(line)
    for path, key in ((written, "its private key"), (place, "the authority's key")):
        # Also of an authority that was made outside, and is in a work tree since.
        if (tree := work_tree(path)) is not None:
            warning = f"{path}: is in the git work tree {tree}, and {key} may be committed; move it elsewhere"
            click.echo(f"perfbound: {one_line(warning)}", err=True)


@pki.command("list")
@folder_option
def list_issued(*, folder: Path | None) -> None:
    """List the issued certificates, each with its end, and the options with which routers let them in."""
    from ...schemas.link.tls_files import time_text  # noqa: PLC0415
    from ..hosts.pki import issued, pki_folder  # noqa: PLC0415

    found = issued(folder or pki_folder())
    for each in found:
        verb = "ended at" if each.ended else "ends at"
        hosts = f"   {', '.join(each.order.hosts)}" if each.order.hosts else ""
        click.echo(f"{each.order.role:12} {each.order.name:24} {verb:8} {time_text(each.ends)}{hosts}")
    for router in dict.fromkeys(each.order.name for each in found if each.order.role == "router" and not each.ended):
        click.echo(f"options of the router {router}: {shlex.join(_allow_options(found, router))}")


def _instructions(folder: Path, made: "Issued", known: "Sequence[Issued]") -> list[str]:
    """Return what to do with an issued certificate: where its files go, and the command there."""
    from ...schemas.link.tls_files import time_text  # noqa: PLC0415
    from ..hosts.pki import CA  # noqa: PLC0415

    name, role, there = made.order.name, made.order.role, Path(folder.resolve().name)
    files = (("--tls-ca", CA), ("--tls-certificate", f"{name}.pem"), ("--tls-key", f"{name}-key.pem"))
    options = [part for option, file in files for part in (option, str(there / file))]
    hosts = f", at {', '.join(made.order.hosts)}" if made.order.hosts else ""
    return [
        f"certificate  {role} {name}{hosts}, ends at {time_text(made.ends)}",
        "",
        f"Copy its three files ({', '.join(file for _, file in files)}) to its host:",
        "",
        f"    {shlex.join(['scp', '-rp', str(folder.resolve())])} HOST:",
        "",
        f"and remove {files[2][1]} here. There:",
        "",
        *(f"    {shlex.join(line)}" for line in _commands(made.order, options, known)),
    ]


def _commands(order: "Order", options: list[str], known: "Sequence[Issued]") -> list[list[str]]:
    """Return the command of the host of a certificate; without a router, an orchestrator has one more."""
    routers = [each.order.hosts[0] for each in known if each.order.role == "router" and not each.ended]
    to_router = ["--connect", f"tls/{_bracketed(routers[-1])}:{PORT}" if routers else f"tls/ROUTER:{PORT}"]
    interfaces = f"tls/[::]:{PORT}" if order.hosts and ":" in order.hosts[0] else f"tls/0.0.0.0:{PORT}"
    listen, allowed = ["--listen", interfaces], _allow_options(known, order.name)
    if order.role == "worker":
        return [["perfbound-worker", *to_router, *options]]
    if order.role == "router":
        names = allowed or ["--allow-orchestrator", "ORCHESTRATOR", "--allow", "WORKER"]
        return [["perfbound", "router", *listen, *options, *names]]
    workers = [part for pair in pairwise(allowed) if pair[0] == "--allow" for part in pair]
    ways = [to_router] if routers else [to_router, [*listen, *workers]]
    return [["perfbound", "orchestrate", "CAMPAIGN.toml", *way, *options] for way in ways]


def _allow_options(known: "Sequence[Issued]", own: str) -> list[str]:
    """Return the options by which a router lets the issued names in; `own` is its name."""
    names = dict.fromkeys((each.order.role, each.order.name) for each in known if not each.ended)
    option = {"worker": "--allow", "orchestrator": "--allow-orchestrator", "router": "--allow-router"}
    return [part for role, name in names if name != own for part in (option[role], name)]


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host
