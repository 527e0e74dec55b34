"""Requests to a child process of `workers`, so that the orchestrator imports no simulator: its systems, one rollout."""

import json
import subprocess
import sys

from ...schemas.errors import CampaignError, PerfboundError
from ...schemas.system import SystemSpec

CHILD_TIMEOUT = 120
"""Seconds that a child may take to answer."""


def in_file(reference: str) -> bool:
    """Whether a reference names a system in a file, `FILE.py:NAME`, and not an installed one."""
    return ".py:" in reference


def system_options(reference: str | None) -> list[str]:
    """Return the options with which a worker knows a system; none for an installed one."""
    return ["--system", reference] if reference is not None and in_file(reference) else []


def ask(command: str, *arguments: str) -> str:
    """Return the output of a command of a `workers` child.

    Raises:
        PerfboundError: the child fails; the text is its last line.

    """
    # -P: a module of the current directory must not replace an installed one.
    line = [sys.executable, "-P", "-m", "perfbound.workers", command, *arguments]
    try:
        child = subprocess.run(line, capture_output=True, text=True, timeout=CHILD_TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        raise PerfboundError(f"`workers {command}` did not answer within {CHILD_TIMEOUT} s") from None
    lines = [text.removeprefix("perfbound-worker: ") for text in child.stderr.splitlines() if text.strip()]
    if child.returncode:
        raise PerfboundError(lines[-1] if lines else f"`workers {command}` ended with code {child.returncode}")
    return child.stdout


def system_specs() -> dict[str, SystemSpec]:
    """Return the installed systems.

    Raises:
        PerfboundError: the child fails.

    """
    try:
        specs = json.loads(ask("systems"))
        return {name: SystemSpec.model_validate_json(json.dumps(spec)) for name, spec in specs.items()}
    except (PerfboundError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise PerfboundError(f"the installed systems cannot be listed: {reason}; reinstall perfbound") from None


def system_spec(name: str, where: str) -> SystemSpec:
    """Return one system: an installed one, or `FILE.py:NAME`.

    Raises:
        CampaignError: it is not installed, in which case the text names those that are; or its file cannot be used.

    """
    if in_file(name):
        try:
            return SystemSpec.model_validate_json(ask("spec", name))
        except PerfboundError as error:
            raise CampaignError(f"{where}: {error}") from None
    specs = system_specs()
    if name not in specs:
        raise CampaignError(f"{where}: {name!r} is not an installed system; allowed are {', '.join(sorted(specs))}")
    return specs[name]
