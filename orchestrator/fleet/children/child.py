"""Requests to a child process of `workers`, so that the orchestrator imports no simulator: its systems, one rollout."""

import fcntl
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from ....schemas.errors import CampaignError, PerfboundError, meant, one_line
from ....schemas.file.config import CampaignConfig
from ....schemas.file.reader import load_description
from ....schemas.file.space import KINDS, kind_named
from ....schemas.system import SystemSpec
from .family import GRACE, STACK_WRITER, end_family, held_signals, place_of_stack, without_stack

CHILD_TIMEOUT = 120.0
"""Seconds that a child may take to answer."""
POLL = 1.0
"""Seconds between two looks at the steps of a child."""
FAULT = "perfbound-worker: "
"""Begin of the line in which a child gives its fault, with exit code 1; every other line is one of the system."""


class HangError(PerfboundError):
    """The child gave no answer in its time."""

    def __init__(self, command: str, limit: float, place: str) -> None:
        self.place = f" in {place}" if place else ""
        super().__init__(
            f"`workers {command}` gave no answer within {limit:g} s, and was ended{self.place}; fix what does not end"
        )


CAMPAIGN_FILE = ".toml"
"""End of a reference that names a campaign file, whose `[system]` is meant."""


def resolved(reference: str) -> str:
    """Return a reference as a worker finds it: an installed name, `FILE.py:NAME`, or the campaign file of a program.

    Raises:
        CampaignError: it is a campaign file that cannot be read.

    """
    campaign = named_campaign(reference)
    return reference if campaign is None else campaign.system.reference(Path(reference))


def named_campaign(reference: str) -> CampaignConfig | None:
    """Return the campaign of a reference that is a campaign file; None for every other one.

    Raises:
        CampaignError: it cannot be read.

    """
    return load_description(Path(reference)) if reference.endswith(CAMPAIGN_FILE) else None


def in_file(reference: str) -> bool:
    """Whether a resolved reference names a system that is not installed: `FILE.py:NAME`, or a program."""
    return ".py:" in reference or reference.endswith(CAMPAIGN_FILE)


def system_options(reference: str | None) -> list[str]:
    """Return the options with which a worker knows a system; none for an installed one.

    Raises:
        CampaignError: it is a campaign file that cannot be read.

    """
    found = resolved(reference) if reference is not None else ""
    return ["--system", found] if in_file(found) else []


def ask(
    command: str,
    *arguments: str,
    limit: float = CHILD_TIMEOUT,
    loading: float | None = None,
    steps: Callable[[], int] = lambda: 0,
    on_line: Callable[[str], None] | None = None,
) -> str:
    """Return the answer of a command of a `workers` child; `on_line` gets what the system printed, line by line.

    After `limit` seconds, and when this process is stopped, the child and everything that it started is ended. A child
    that does several things may take `limit` seconds for each, for the first one `loading`; `steps` counts those that
    are done.

    Raises:
        HangError: it gives no answer in time.
        PerfboundError: the child fails; the text is that of its last lines.

    """
    # -P: a module of the current directory must not replace an installed one.
    line = [sys.executable, "-P", *STACK_WRITER, "-m", "perfbound.workers", "--guarded"]
    with (
        _above_stderr() as answer,
        held_signals() as release,
        subprocess.Popen(
            [*line, f"--answer={answer.fileno()}", command, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=[answer.fileno()],
            text=True,
            errors="replace",
        ) as child,
    ):
        try:
            release()
            errors = _printed(child, limit if loading is None else loading, limit, steps)
            answer.seek(0)
            output = answer.read().decode()
        except subprocess.TimeoutExpired:
            end_family(child, stack=True)
            raise HangError(command, limit, place_of_stack(_rest_of_errors(child))) from None
        except BaseException:
            end_family(child)
            raise
    lines = [text for text in without_stack(errors).splitlines() if text.strip()]
    known = child.returncode == 1 and lines and lines[-1].startswith(FAULT)
    reasons = [] if known else [f"`workers {command}` {_ended(child.returncode)}"]
    while known and lines and lines[-1].startswith(FAULT):
        reasons.insert(0, lines.pop().removeprefix(FAULT))
    if child.returncode and not known and (place := place_of_stack(errors)):
        reasons[0] += f" in {place}"
    if on_line is not None:
        for printed in lines:
            on_line(one_line(printed.removeprefix(FAULT)))
    if child.returncode:
        raise PerfboundError(*reasons)
    return output


def _above_stderr() -> IO[bytes]:
    """Return a temporary file whose descriptor is none of the three that a child has of its own.

    Where this process was started without a standard output, the next file that it opens has that number.
    """
    with tempfile.TemporaryFile() as found:
        return os.fdopen(fcntl.fcntl(found.fileno(), fcntl.F_DUPFD_CLOEXEC, 3), "r+b")


def _printed(child: "subprocess.Popen[str]", first: float, limit: float, steps: Callable[[], int]) -> str:
    """Return what a child that ends has printed.

    Raise TimeoutExpired after `limit` seconds without a step, or `first` seconds without the first one.
    """
    done, since, allowed = steps(), time.monotonic(), first
    while True:
        try:
            return child.communicate(timeout=min(allowed, POLL))[0]
        except subprocess.TimeoutExpired:
            if (now := steps()) != done:
                done, since, allowed = now, time.monotonic(), limit
            elif time.monotonic() - since >= allowed:
                raise


def _rest_of_errors(child: "subprocess.Popen[str]") -> str:
    """Return what a child that was ended printed; a process that has left its family may keep the pipe open."""
    try:
        return child.communicate(timeout=GRACE)[0]
    except subprocess.TimeoutExpired:
        return ""


def _ended(code: int) -> str:
    return f"crashed (signal {-code})" if code < 0 else f"ended with exit code {code}"


def system_specs() -> dict[str, SystemSpec]:
    """Return the installed systems that can be used here.

    Raises:
        PerfboundError: the child fails.

    """
    return {name: spec for name, spec in installed_systems().items() if isinstance(spec, SystemSpec)}


def installed_systems() -> dict[str, SystemSpec | str]:
    """Return the installed systems; in place of one that cannot be used here, the reason.

    Raises:
        PerfboundError: the child fails.

    """
    try:
        found = json.loads(ask("systems"))
        return {
            name: each if isinstance(each, str) else SystemSpec.model_validate_json(json.dumps(each))
            for name, each in found.items()
        }
    except (PerfboundError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise PerfboundError(f"the installed systems cannot be listed: {reason}; reinstall perfbound") from None


OTHER_KEYS = ("space: ", "system.", "system: ", "horizon: ")


def system_spec(reference: str, where: str, horizon: float | None = None) -> SystemSpec:
    """Return one system: an installed one, `FILE.py:NAME`, or that of a campaign file.

    `horizon` is that of the campaign in s, by default that of a campaign file.

    Raises:
        CampaignError: it is not installed, in which case the text names those that are; or it cannot be used here, or
            has a longer step than the horizon.

    """
    name = resolved(reference)
    if name.endswith(".py"):
        raise CampaignError(f"{where}: {name}: name the function in it, too: {name}:NAME")
    if in_file(name):
        try:
            if horizon is None:
                horizon = campaign.horizon if (campaign := named_campaign(reference)) else 0.0
            return SystemSpec.model_validate_json(ask("spec", name, "--horizon", str(horizon)))
        except PerfboundError as error:
            # The worker names the file, and the key that `where` may end with.
            file, _, key = where.rpartition(": ")
            texts = [line.removeprefix(f"{name}: ").removeprefix(f"{key}: ") for line in error.lines]
            # Another key of the file may be at fault.
            found = [f"{file or reference if text.startswith(OTHER_KEYS) else where}: {text}" for text in texts]
            raise CampaignError(*found) from None
    known = installed_systems()
    if name not in known:
        near = meant(name, known)
        allowed = ", ".join(sorted(known))
        if (kind := kind_named(name)) is not None:
            keys = ", ".join([f"{kind} = {Path(name).name!r}", *KINDS[kind].required])
            raise CampaignError(
                f"{where}: {name!r} is named by a file: write [system] with {keys} and [space] "
                "with the ranges of its parameters into a file beside it, and give that one"
            )
        raise CampaignError(f"{where}: {name!r} is not an installed system; {near}allowed are {allowed}")
    if isinstance(spec := known[name], str):
        raise CampaignError(f"{where}: {spec}")
    return spec
