"""The commands of the worker side, in a child of `perfbound`: a crash of a simulator stays out of the orchestrator."""

import contextlib
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ..schemas.atomic import replacing
from ..schemas.base import canonical_json
from ..schemas.errors import LinkError, PerfboundError
from ..schemas.host import host_fault
from ..schemas.link import key_expressions
from ..schemas.link.configuration import Tls, asks_for_secret
from ..schemas.link.secret import VARIABLE, WEB_VARIABLE, shared_secret
from ..schemas.link.tls_files import check_role, common_name
from ..schemas.platforms import one_blas_thread
from .answers import answer
from .ends import IDLE_EXIT, STOP_WITHIN, EndOptions
from .failing import fail
from .lifeline import adopt_orphans, die_with_parent
from .stopping import Stopping

OPENED = "perfbound.opened"
HELP = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


@click.group(context_settings=HELP)
def group() -> None:
    """Run a command in a child process of the orchestrator."""
    _begin()


def _add_files(_context: click.Context, _option: click.Parameter, references: tuple[str, ...]) -> tuple[str, ...]:
    """Load the systems in files; only those of this command line, never one that a message names."""
    for reference in references:
        _add_file(reference)
    return references


def _add_watched(context: click.Context, option: click.Parameter, references: tuple[str, ...]) -> tuple[str, ...]:
    """Load the systems in files, and watch which files are opened from then on."""
    from .opened import Opened  # noqa: PLC0415

    if references:
        context.meta[OPENED] = Opened.of(references)
    return _add_files(context, option, references)


def _add_file(reference: str) -> str:
    """Load a system in a file, and return its name; end with one line where it cannot be loaded."""
    from .systems import add_file  # noqa: PLC0415

    try:
        with contextlib.redirect_stdout(sys.stderr):  # what a file prints must not mix with the data
            return add_file(reference)
    except PerfboundError as error:
        fail(*error.lines)


system_option = click.option(
    "--system",
    "references",
    multiple=True,
    metavar="FILE.py:NAME",
    callback=_add_files,
    expose_value=False,
    help="A system in a file, beside those that are installed; may be repeated.",
)

watched_system_option = click.option(
    "--system", "references", multiple=True, metavar="FILE.py:NAME", callback=_add_watched, expose_value=False
)


@group.command(context_settings=HELP)  # again: `perfbound-worker` is this command alone
@system_option
@click.option(
    "--connect",
    "endpoints",
    required=True,
    multiple=True,
    help="Endpoint of the orchestrator or of a router, e.g. tcp/127.0.0.1:7447; repeat it for others to try.",
)
@click.option(
    "--name",
    default=None,
    help="Name in logs and database; gets a random suffix.  [default: worker; with TLS the certificate's common name]",
)
@click.option("--run", default=None, help="Serve only this run id; otherwise the oldest orchestrator there is.")
@click.option("--tls-ca", default=None, help="PEM file of the authority that signed both certificates.")
@click.option("--tls-certificate", default=None, help="PEM file of the certificate of this side.")
@click.option("--tls-key", default=None, help="PEM file of the private key of this side.")
@click.option("--insecure", is_flag=True, help="Connect without the secret of this user.")
@click.option(
    "--until-done",
    is_flag=True,
    help="Exit with 0 when the campaign has its certificate and no other one is announced.",
)
@click.option(
    "--idle-exit",
    type=click.FloatRange(0, 31_536_000),
    default=None,
    metavar="SECONDS",
    help="Exit after so long without a campaign: with 0, or with 1 if there has been none.  "
    f"[default: never, with --until-done {IDLE_EXIT:g}]",
)
@click.option(
    "--max-hours",
    type=click.FloatRange(0, 8784, min_open=True),
    default=None,
    metavar="HOURS",
    help="Take no new rollout after so long; finish the one under way, and exit with 0.",
)
@click.option(
    "--stop-within",
    type=click.FloatRange(0, 86_400),
    default=STOP_WITHIN,
    show_default=True,
    metavar="SECONDS",
    help="On SIGTERM, finish the rollout under way within this time, or hand it back; then exit with 143. A second "
    "SIGTERM ends the worker at once.",
)
@click.option(
    "--manual",
    type=click.Path(file_okay=False, path_type=Path),
    default=None,
    metavar="FOLDER",
    help="A person drives the rig of --system: a page on this machine shows each request and takes its log, which is "
    "kept in FOLDER.",
)
@click.option(
    "--manual-port",
    type=click.IntRange(0, 65_535),
    default=8790,
    show_default=True,
    help="Port of that page; 0 for any that is free.",
)
@click.option("--as", "identity", default=None, hidden=True, help="Whole name of a local worker.")
def serve(
    *,
    endpoints: tuple[str, ...],
    name: str | None,
    run: str | None,
    tls_ca: str | None,
    tls_certificate: str | None,
    tls_key: str | None,
    insecure: bool,
    identity: str | None,
    manual: Path | None,
    manual_port: int,
    **ends: Any,
) -> None:
    """Simulate rollouts for an orchestrator until stopped, or until one of the ends below."""
    options = EndOptions.of(**ends)
    stopping = Stopping(options.stop_within, end_programs)
    if identity is None:  # a local worker has a guardian
        stopping.watch()
    tls = None
    if tls_ca or tls_certificate or tls_key:
        if not (tls_ca and tls_certificate and tls_key):
            raise click.UsageError("--tls-ca, --tls-certificate and --tls-key belong together")
        tls = Tls(ca=tls_ca, certificate=tls_certificate, key=tls_key)
    try:
        secret = shared_secret(loopback=all(map(asks_for_secret, endpoints)) and not insecure)
        # The system under test, and the programs that it starts, have no use for it.
        os.environ.pop(VARIABLE, None)
        if tls and identity is None:  # local workers show the certificate of their orchestrator
            check_role(tls.certificate, "worker")
        own = common_name(tls.certificate) if tls else ""
        _open_desk(manual, manual_port)
        name = name or (own if key_expressions.NAME.fullmatch(own) else "worker")
        from .serving import Life, LinkOptions, serve_campaigns  # noqa: PLC0415

        link, life = LinkOptions(endpoints, tls, secret, own), Life(options, stopping)
        sys.exit(serve_campaigns(link, life, name, run=run, identity=identity))
    except (LinkError, ValueError) as error:
        fail(str(error))
    except KeyboardInterrupt:
        sys.exit(130)


def _open_desk(folder: Path | None, port: int) -> None:
    """Serve the page on which a person hands in the logs of a rig; a rig without one has no worker."""
    from .systems import add, rigs  # noqa: PLC0415

    found = rigs()
    if folder is None:
        if found:
            fail(f"{found[0].spec.name} is a rig: a person drives it; give --manual FOLDER, which gets its logs")
        return
    if len(found) != 1:
        fail("--manual: give the campaign file of one rig, --system CAMPAIGN.toml with [system] rig")
    from .manual.desk import Desk  # noqa: PLC0415
    from .manual.page import DeskPage  # noqa: PLC0415

    desk = Desk(found[0], folder)
    page = DeskPage(desk, port)
    add(desk)
    page.start()
    click.echo(f"tests by hand: {page.address}", err=True)


def end_programs() -> None:
    """End the programs of this process, if a system has loaded what starts them."""
    if (running := sys.modules.get(f"{__package__}.systems.running")) is not None:
        running.end_all()


@group.command()
def systems() -> None:
    """Print one JSON object: name to SystemSpec of every installed system, or to the reason why it cannot be used."""
    from .systems import usable  # noqa: PLC0415

    with contextlib.redirect_stdout(sys.stderr):  # the output of a plug-in must not mix with the data
        found = usable()
    plain = {name: each if isinstance(each, str) else each.model_dump(mode="json") for name, each in found.items()}
    answer(canonical_json(plain))


@group.command()
@click.argument("reference")
@click.option("--horizon", type=float, default=0.0, help="s; one that is shorter than a step is refused.")
def spec(reference: str, horizon: float) -> None:
    """Print the SystemSpec of a system in a file as JSON."""
    from .systems import load_system  # noqa: PLC0415
    from .systems.described import check_horizon  # noqa: PLC0415

    system = load_system(_add_file(reference))
    try:
        found = system.spec
        check_horizon(horizon or None, getattr(system, "step", None) or 0.0, reference)
    except PerfboundError as error:  # of two simulators that do not fit together, or of which one is missing here
        fail(*error.lines)
    answer(canonical_json(found.model_dump(mode="json")))


def _be_child() -> None:
    """Write no memory to the disk: a crash is reported by the parent."""
    os.environ.pop(VARIABLE, None)  # the system under test has no use for the secret
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


@group.command()
@system_option
@click.option("--request", required=True, help="RolloutRequest or BatchRequest as JSON, or @FILE with it.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="MCAP file to write.")
def simulate(request: str, out: Path) -> None:
    """Run one rollout without an orchestrator and write its trajectory."""
    _be_child()
    _write(out, _trajectory_file(request))


@group.command()
@system_option
@click.option("--file", "path", type=click.Path(dir_okay=False, path_type=Path), required=True, help="MCAP file.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), required=True, help="MCAP file to write.")
def visual(path: Path, out: Path) -> None:
    """Write the file of a rollout with the visual part that its system draws from the trajectory."""
    _be_child()
    from ..schemas.trajectory.trajectory import read_canonical  # noqa: PLC0415
    from .simulate import drawn  # noqa: PLC0415

    _write(out, _or_end(lambda: drawn(read_canonical(path.read_bytes(), visual=False))))


def _write(out: Path, data: bytes) -> None:
    try:
        with replacing([out]) as (file,):
            file.write(data)
    except OSError as error:
        fail(f"{out}: {error.strerror}")


@group.command()
@watched_system_option
@click.option("--requests", type=click.Path(dir_okay=False, path_type=Path), required=True, help="One JSON a line.")
@click.option("--seconds", type=float, required=True, help="No rollout starts later than this.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True, help="Folder of the files.")
def pilot(requests: Path, seconds: float, out: Path) -> None:
    """Run rollouts one after the other in this process; `K.mcap` is the file of the K-th request, from 0.

    A first file, `loaded`, says that the systems in files are loaded; at the end it has the memory of this process at
    most, in kB, and the files that the rollouts read and that are no part of the system.
    """
    _be_child()
    (out / "loaded").touch()
    end = time.monotonic() + seconds
    for number, request in enumerate(requests.read_text().splitlines()):
        if number and time.monotonic() > end:
            break
        (out / f"{number}.mcap").write_bytes(_trajectory_file(request))
    status = Path("/proc/self/status").read_text()  # `getrusage` counts the process that started this one as well
    found = {"memory": int(status.partition("VmHWM:")[2].split()[0]), "opened": _undeclared(requests)}
    (out / "loaded").write_text(json.dumps(found))


def _undeclared(requests: Path) -> tuple[str, ...]:
    """Return the files that rollouts have read, and that are no part of their system."""
    from .systems import load_system  # noqa: PLC0415

    opened = click.get_current_context().meta.get(OPENED)
    if opened is None:  # an installed system lists its files itself
        return ()
    name = json.loads(requests.read_text().partition("\n")[0])["system"]
    found: tuple[str, ...] = opened.undeclared(load_system(name).spec)
    return found


def _trajectory_file(request: str) -> bytes:
    """Return the file of one rollout, or of one batch; end with one line where there is none."""
    from ..schemas.batch import read_request  # noqa: PLC0415
    from .batch import run_on  # noqa: PLC0415
    from .simulate import requested_system  # noqa: PLC0415

    try:
        text = Path(request[1:]).read_text() if request.startswith("@") else request
    except (OSError, UnicodeDecodeError) as error:
        fail(f"--request {request}: {error}")

    def simulated() -> bytes:
        asked = read_request(text)
        return run_on(requested_system(asked), asked, lambda _: None)

    return _or_end(simulated)


def _or_end(made: Callable[[], bytes]) -> bytes:
    """Return what the code of a system makes; end with one line where it fails."""
    from pydantic import ValidationError  # noqa: PLC0415

    from .faults import NOT_OF_SYSTEMS, fault_text  # noqa: PLC0415

    try:
        with contextlib.redirect_stdout(sys.stderr):  # where a user of the command finds what a function prints
            return made()
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        fail(f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}")
    except PerfboundError as error:
        fail(str(error))
    except NOT_OF_SYSTEMS:
        raise
    except BaseException as error:  # noqa: BLE001  (any: the code of the system)
        fail(fault_text(error))


@group.command(hidden=True)
@watched_system_option
@click.option("--answers", type=int, required=True, help="Pipe for the measurements, a line of JSON each.")
@click.option("--begin", type=int, required=True, help="Pipe; the rollouts begin when its other end is closed.")
@click.option("--folder", default=None, help="Of a program, where it is started; default: the present one.")
@click.option("--keep", default=None, help="Folder that gets the file of each rollout.")
def measure(answers: int, begin: int, folder: str | None, keep: str | None) -> None:
    """Run the rollouts on stdin, a JSON list of trials, and measure each of them, for `perfbound check-system`."""
    from pydantic import TypeAdapter  # noqa: PLC0415

    from ..schemas.system_check import Trial  # noqa: PLC0415
    from .check_system import mark_files, measure_trials  # noqa: PLC0415
    from .opened import Opened  # noqa: PLC0415

    _be_child()
    die_with_parent()
    adopt_orphans()
    mark_files()
    os.set_inheritable(answers, False)
    os.set_inheritable(begin, False)
    trials = TypeAdapter(tuple[Trial, ...]).validate_json(sys.stdin.buffer.read())
    opened = click.get_current_context().meta.get(OPENED) or Opened.of((), trials[0].request.system)
    with os.fdopen(answers, "w") as stream:
        measure_trials(trials, stream, begin, folder=folder or os.getcwd(), opened=opened, keep=keep)


@group.command(hidden=True)
@click.option("--campaign", type=click.Path(dir_okay=False), required=True, help="Campaign file of a rig.")
@click.option("--tests", type=click.Path(dir_okay=False, path_type=Path), required=True, help="One JSON a line.")
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), required=True, help="Folder of the files.")
def logs(campaign: str, tests: Path, out: Path) -> None:
    """Write the log of each test as the file of its rollout, `K.mcap` for the K-th, from 0; a line for each fault."""
    from .logs.write import write_tests  # noqa: PLC0415

    _be_child()
    if faults := write_tests(_add_file(campaign), tests, out):
        fail(*faults)


def main() -> None:
    """`perfbound-worker`."""
    _begin()
    try:
        serve()
    except Exception as error:
        if (fault := host_fault(error)) is None:
            raise
        fail(fault)


def _begin() -> None:
    one_blas_thread()
    os.environ.pop(WEB_VARIABLE, None)  # where a user has set it for all programs: no system under test sees it
