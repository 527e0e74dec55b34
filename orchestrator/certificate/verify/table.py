"""The table of checks, as text and as JSON."""

import json

from rich.console import Console
from rich.table import Table as Lines
from rich.text import Text

from ...store.export_tables import robustness_unit
from ..words import text
from ..words.bound_text import parameter_units, with_named_starts
from ..words.console_lines import heading
from .run import Verification

REFUTED = "its claim is REFUTED, do not rely on it"
COLOURS = {"passed": "green", "failed": "bold red", "skipped": "yellow"}


def print_verification(found: Verification, console: Console) -> None:
    """Print every check, the first claim, the assumptions in the words of this perfbound, and the result last."""
    lines = Lines(box=None, pad_edge=False, header_style="bold")
    lines.add_column("check")
    lines.add_column("", no_wrap=True)
    lines.add_column("statement and finding", overflow="fold")
    for check in found.checks.lines():
        meaning = Text(check.meaning)
        meaning.append(f"\n{check.detail}", "bold red" if check.status == "failed" else "dim")
        lines.add_row(check.name, Text(check.status, COLOURS[check.status]), meaning)
    console.print(lines)
    if found.checks.good and found.certificate is not None and found.reissued is not None:
        spec = found.header and found.header.spec
        unit = robustness_unit(found.header.config, found.header.spec) if found.header else ""
        text.first_claim(found.certificate, console, unit)
        text.print_assumptions(with_named_starts(found.reissued, parameter_units(spec) if spec else {}), console)
    result = _conclusion(found)
    heading(console, result, "bold" if found.checks.good and REFUTED not in result else "bold red")


def _conclusion(found: Verification) -> str:
    """Return whether the certificate is verified, by how many checks, and what that does not say of its claim."""
    counts = {status: sum(check.status == status for check in found.checks.lines()) for status in COLOURS}
    good, signature = found.checks.good, found.checks.found.get("signature")
    signed = signature is not None and signature.status == "passed"
    record = found.checks.found.get("attempts")
    missing = [] if signed else ["the signature"]
    if "bundle" in found.checks.found and not signed:
        missing.append("the report")
    missing += ["the record of attempts"] if record is not None and record.status == "skipped" else []
    rollouts = found.checks.found.get("files")
    if rollouts is not None and rollouts.status == "skipped":
        missing = [*([] if signed else missing[:2]), "what follows from the trajectories, which are not here,"]
    unchecked = f" ({' and '.join(missing)} {'was' if len(missing) == 1 else 'were'} not checked)" if missing else ""
    verdict = f"VERIFIED{unchecked}" if good else "NOT VERIFIED"
    total = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    refuted = good and found.certificate is not None and found.certificate.predicate.claims[0].refuted
    return f"{verdict}: {total}{f'; {REFUTED}' if refuted else ''}"


def as_json(found: Verification) -> str:
    """Return the checks as JSON, and the assumptions in the words of this perfbound."""
    checks = [
        {"check": check.name, "status": check.status, "detail": check.detail, "meaning": check.meaning}
        for check in found.checks.lines()
    ]
    own = [] if found.reissued is None else found.reissued.predicate.assumptions
    assumptions = [each.model_dump(mode="json") for each in own]
    return json.dumps({"verified": found.checks.good, "checks": checks, "assumptions": assumptions}, indent=1)
