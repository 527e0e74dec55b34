"""The table of checks, for people and for programs."""

import json
from collections.abc import Callable

from rich.console import Console
from rich.progress import Progress
from rich.table import Table as Lines
from rich.text import Text

from ....schemas.certificate import Certificate
from .. import text
from .checks import Table

COLOURS = {"passed": "green", "failed": "bold red", "skipped": "yellow"}


def show(table: Table, certificate: Certificate | None, console: Console) -> None:
    """Print every check, and what the certificate then says."""
    lines = Lines(box=None, pad_edge=False, header_style="bold")
    lines.add_column("check")
    lines.add_column("", no_wrap=True)
    lines.add_column("what it means, and what was found", overflow="fold")
    for check in table.lines():
        found = Text(check.meaning)
        found.append(f"\n{check.detail}", "bold red" if check.status == "failed" else "dim")
        lines.add_row(check.name, Text(check.status, COLOURS[check.status]), found)
    console.print(lines)
    counts = {status: sum(check.status == status for check in table.lines()) for status in COLOURS}
    signed = table.found["signature"].status == "passed" if "signature" in table.found else False
    verdict = f"VERIFIED{'' if signed else ' (the signature was not checked)'}" if table.good else "NOT VERIFIED"
    told = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    console.print(Text(f"\n{verdict}: {told}", "bold" if table.good else "bold red"))
    if table.good and certificate is not None:
        text.first_claim(certificate, console)


def as_json(table: Table) -> str:
    """Return the table as JSON."""
    checks = [
        {"check": check.name, "status": check.status, "detail": check.detail, "meaning": check.meaning}
        for check in table.lines()
    ]
    return json.dumps({"verified": table.good, "checks": checks}, indent=1)


def teller(progress: Progress) -> Callable[[str, int, int], None]:
    """Return what draws a bar for every stage."""
    bars = {}

    def tell(stage: str, done: int, total: int) -> None:
        if stage not in bars:
            bars[stage] = progress.add_task(stage, total=total)
        progress.update(bars[stage], completed=done)

    return tell
