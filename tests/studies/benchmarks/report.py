"""The table of `make bench`, on stdout, and the same as JSON."""

import json
import os
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

PACKAGES = {"numpy", "scipy", "scikit-learn", "pybullet", "eclipse-zenoh", "mcap", "pydantic", "sqlalchemy"}
HEAD = ("measured", "value", "unit", "peer", "ratio", "target")
RIGHT = (False, True, False, False, True, False)


@dataclass(frozen=True)
class Row:
    """One number, perhaps beside a peer's in the same unit, and perhaps with a target."""

    name: str
    value: float
    unit: str
    """Times are CPU times unless the unit contains `wall`; higher is better for units with `/s` and for `times`."""
    peer: str = ""
    peer_value: float | None = None
    ratio_at_least: float | None = None
    at_most: float | None = None

    @property
    def more_is_better(self) -> bool:
        """Whether a larger value is the better one."""
        return self.unit.endswith("/s") or self.unit == "times"

    @property
    def ratio(self) -> float | None:
        """Factor by which it is better than the peer: below 1 the peer is better."""
        if not self.peer_value or not self.value:
            return None
        return self.value / self.peer_value if self.more_is_better else self.peer_value / self.value

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without one, or without the peer that it needs."""
        if self.ratio_at_least is not None:
            return None if self.ratio is None else self.ratio >= self.ratio_at_least
        return None if self.at_most is None else self.value <= self.at_most

    @property
    def target(self) -> str:
        """The target in words, with whether it is met."""
        goal = f"ratio >= {self.ratio_at_least:g}" if self.ratio_at_least is not None else ""
        goal = f"<= {self.at_most:g}" if self.at_most is not None else goal
        return goal and f"{goal}: {({True: 'met', False: 'MISSED', None: 'no peer'})[self.met]}"

    @property
    def cells(self) -> tuple[str, ...]:
        """Text of the cell in the table."""
        peer = f"{number(self.peer_value)} {self.peer}" if self.peer_value is not None else self.peer
        ratio = "" if self.ratio is None else f"{number(self.ratio)}"
        return (self.name, number(self.value), self.unit, peer, ratio, self.target)


def number(value: float) -> str:
    """Return `value` with about four digits.

    >>> number(0.012345), number(123456.0), number(0.0)
    ('0.01235', '123456', '0')
    """
    return (
        f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}" if abs(value) >= 1e-4 or not value else f"{value:.1e}"
    )


def table(rows: Sequence[Row]) -> str:
    """Return the lines of the table."""
    cells = [HEAD, *(row.cells for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(HEAD))]
    lines = ["  ".join(map(_padded, line, widths, RIGHT)) for line in cells]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _padded(cell: str, width: int, right: bool) -> str:
    return cell.rjust(width) if right else cell.ljust(width)


def document(rows: Sequence[Row], surroundings: dict[str, Any]) -> dict[str, Any]:
    """Return what is written as JSON."""
    derived = [{"ratio": row.ratio, "met": row.met, "more_is_better": row.more_is_better} for row in rows]
    return {**surroundings, "rows": [asdict(row) | extra for row, extra in zip(rows, derived, strict=True)]}


def surroundings() -> dict[str, Any]:
    """Return commit, date, load, machine and versions."""
    installed = {each.name: each.version for each in distributions() if each.name in PACKAGES}
    return {
        "commit": _git("rev-parse", "HEAD"),
        "changed_files": len(_git("status", "--porcelain").splitlines()),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "load": os.getloadavg()[0],
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "versions": {"python": platform.python_version(), **installed},
    }


def _git(*arguments: str) -> str:
    """Return the output of git, or nothing outside a checkout."""
    try:
        return subprocess.check_output(["git", *arguments], text=True, stderr=subprocess.DEVNULL).strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def write(path: Path, content: dict[str, Any]) -> None:
    """Write the JSON file."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n")
