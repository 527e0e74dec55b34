"""The other claims about the Segway, as the table of docs/paper.md has them."""

import re
from typing import NamedTuple

from tests.studies.pages import PageError

NUMBER = r"-?\d[\d,]*\.?\d*"
OTHERS = {
    "printed, Theorem 2": "segway-paper",
    "segway-paper": "segway-paper",
    "printed, direct": "segway-direct",
    "segway-direct": "segway-direct",
    "segway-pair": "segway-pair",
    "segway-scenario": "segway-scenario",
}
"""Rows of the table, and the row that has their number of true rollouts: the paper prints none."""


class Claim(NamedTuple):
    """A lower bound of the risk: the median over the seeds, and least and greatest."""

    bound: float
    least: float
    greatest: float
    rollouts: float
    is_refuted: bool
    """Whether the data of the campaign, or of its reproduction, refute an assumption."""


def other_claims(page: str) -> dict[str, Claim]:
    """Return the claims of the page's table by the names of `OTHERS`.

    Raises:
        PageError: a row is missing, or has another form.

    """
    rows = dict(_rows(page))
    missing = [name for name in OTHERS if name not in rows]
    if missing:
        raise PageError(f"the page has no claim of {', '.join(missing)}; restore its table 'Claims compared'")
    return {name: _claim(rows[name], rows[same]) for name, same in OTHERS.items()}


def _rows(page: str) -> list[tuple[str, list[str]]]:
    table = page.partition("## Claims compared")[2]
    lines = [line for line in table.splitlines() if line.startswith("| ")]
    cells = [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in lines]
    return [(each[0], each[1:]) for each in cells if len(each) == 7]


def _claim(row: list[str], same: list[str]) -> Claim:
    bound, least, greatest = _numbers(row[1])
    return Claim(bound, least, greatest, _numbers(same[4])[0], same[5] != "none")


def _numbers(cell: str) -> tuple[float, float, float]:
    """Return median, least and greatest.

    >>> _numbers("0.079 (-0.107 to 0.223)"), _numbers("6,400")
    ((0.079, -0.107, 0.223), (6400.0, 6400.0, 6400.0))
    """
    found = [float(each.replace(",", "")) for each in re.findall(NUMBER, cell)]
    if len(found) not in {1, 3}:
        raise PageError(f"{cell!r} is no number, and no median with least and greatest; fix the table")
    return (found[0], found[1], found[2]) if len(found) == 3 else (found[0],) * 3
