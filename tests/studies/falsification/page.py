"""The generated part of docs/falsification.md: for each instance, how often and how soon each search falsified."""

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

from perfbound.orchestrator.report.paper.table_text import markdown
from perfbound.schemas import atomic
from tests.studies.falsification.registry import benchmarks
from tests.studies.falsification.study import SEARCHES, Row
from tests.studies.pages import page_text, with_part

BEGIN, END = "<!-- falsification: begin -->", "<!-- falsification: end -->"


def rate(rows: Sequence[Row]) -> str:
    """Return how many searches falsified: `9 of 10`."""
    return f"{sum(row.found for row in rows)} of {len(rows)}"


def median(rows: Sequence[Row]) -> str:
    """Return the median of the simulations, where a search that did not falsify counts as its budget."""
    middle = statistics.median(row.simulations if row.found else row.run.budget for row in rows)
    return f"{middle:g}" if any(row.found for row in rows) else "-"


def mean(rows: Sequence[Row]) -> str:
    """Return the mean over the searches that falsified, as the competition has it."""
    found = [row.simulations for row in rows if row.found]
    return f"{statistics.mean(found):.1f}" if found else "-"


def overhead(rows: Sequence[Row]) -> str:
    """Return the CPU time of the search per simulation in ms, as a median."""
    return f"{statistics.median(row.cpu_ms for row in rows):.1f}"


def cell(rows: Sequence[Row]) -> str:
    """Return what a table has of one search on one benchmark."""
    return f"{median(rows)} ({mean(rows)}; {rate(rows)})"


def table(rows: Sequence[Row], words: Callable[[Sequence[Row]], str]) -> str:
    """Return a table: a line for each benchmark of the rows, a column for each search."""
    searches = [search for search in SEARCHES if any(row.run.search == search for row in rows)]
    lines = []
    for each in benchmarks():
        of = [row for row in rows if (row.run.benchmark, row.run.instance) == (each.name, each.instance)]
        if of:
            by_search = ([row for row in of if row.run.search == search] for search in searches)
            lines.append([each.name, str(each.dimension), *(words(found) if found else "" for found in by_search)])
    return markdown(["benchmark", "p", *searches], lines)


def section(rows: Sequence[Row]) -> str:
    """Return the generated part of the page, with its marks."""
    parts = []
    for instance, budget in sorted({(row.run.instance, row.run.budget) for row in rows}):
        of = [row for row in rows if (row.run.instance, row.run.budget) == (instance, budget)]
        seeds = sorted({row.run.seed for row in of})
        shown = f"seeds {seeds[0]} to {seeds[-1]}"
        parts.append(f"## Instance {instance}, {budget} simulations\n\n{shown}:\n\n{table(of, cell)}")
        parts.append(f"CPU time of the search per simulation in ms:\n\n{table(of, overhead)}")
    body = "\n".join(parts)
    return f"{BEGIN}\n\n{body}\n{END}"


def write(page: Path, rows: Sequence[Row]) -> None:
    """Put the tables between the marks of the page.

    Raises:
        PageError: the page cannot be read, or lacks the marks.

    """
    text = page_text(page, (BEGIN, END))
    atomic.write_whole(page, with_part(text, BEGIN, END, section(rows)).encode())
