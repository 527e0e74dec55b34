"""The generated part of docs/falsification.md: for each instance, how often and how soon each search falsified."""

import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

from perfbound.orchestrator.report.paper.table_text import markdown
from perfbound.schemas import atomic
from tests.studies.falsification.benchmark import Benchmark
from tests.studies.falsification.registry import benchmarks
from tests.studies.falsification.study import OURS, SEARCHES, Row
from tests.studies.pages import page_text, with_part

BEGIN, END = "<!-- falsification: begin -->", "<!-- falsification: end -->"
NEAR = 1.1
"""A median at most so many times the least one is as good."""


def found_in(rows: Sequence[Row]) -> int:
    """Return how many searches falsified."""
    return sum(row.found for row in rows)


def middle(rows: Sequence[Row]) -> float:
    """Return the median of the simulations, where a search that did not falsify counts as its budget."""
    return statistics.median(row.simulations if row.found else row.run.budget for row in rows)


def median(rows: Sequence[Row], most: int) -> str:
    """Return the median, and how many searches falsified unless all of at least `most` did."""
    falsified = found_in(rows)
    words = f"{middle(rows):g}" if falsified else "-"
    return words if falsified == len(rows) >= most else f"{words} ({falsified}/{len(rows)})"


def mean(rows: Sequence[Row]) -> str:
    """Return the mean over the searches that falsified, as the competition has it."""
    found = [row.simulations for row in rows if row.found]
    return f"{statistics.mean(found):.1f}" if found else "-"


def overhead(rows: Sequence[Row]) -> str:
    """Return the CPU time of the search per simulation in ms, as a median."""
    return f"{statistics.median(row.cpu_ms for row in rows):.1f}"


def by_search(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows of each search that has some, in the order of the page."""
    each = {search: [row for row in rows if row.run.search == search] for search in SEARCHES}
    return {search: of for search, of in each.items() if of}


def by_benchmark(rows: Sequence[Row]) -> dict[Benchmark, list[Row]]:
    """Return the rows of each benchmark that has some."""
    each = {
        system: [row for row in rows if (row.run.benchmark, row.run.instance) == (system.name, system.instance)]
        for system in benchmarks()
    }
    return {system: of for system, of in each.items() if of}


def table(rows: Sequence[Row], words: Callable[[Sequence[Row]], str]) -> str:
    """Return a table: a line for each benchmark of the rows, a column for each search."""
    searches, lines = list(by_search(rows)), []
    for system, of in by_benchmark(rows).items():
        found = by_search(of)
        cells = (words(found[search]) if search in found else "" for search in searches)
        lines.append([system.name, str(system.dimension), *cells])
    return markdown(["benchmark", "p", *searches], lines)


def medians(rows: Sequence[Row]) -> str:
    """Return the table of the medians."""
    seeds = len({row.run.seed for row in rows})
    return table(rows, lambda of: median(of, seeds))


def verdict(rows: Sequence[Row]) -> str:
    """Return where our median is least, and where another search has a smaller one: a sentence for each."""
    first, near, behind, seldom, nobody = [], [], [], [], []
    for system, of in by_benchmark(rows).items():
        of_search = by_search(of)
        ours = of_search.pop(OURS, [])
        others = {search: middle(found) for search, found in of_search.items() if found_in(found)}
        if not ours or not of_search:
            continue
        best = min(others, key=lambda search: others[search], default=None)
        if not found_in(ours) and best is None:
            nobody.append(system.name)
        elif min([middle(ours), *others.values()]) >= ours[0].run.budget:
            # All medians are the budget: equal medians would say more than was seen.
            counts = {OURS: ours, **of_search}
            seldom.append(
                f"{system.name} ({', '.join(_count(name, of) for name, of in counts.items() if found_in(of))})"
            )
        elif best is None or middle(ours) <= others[best]:
            first.append(system.name)
        elif middle(ours) <= NEAR * others[best]:
            near.append(system.name)
        else:
            behind.append(f"{system.name} ({middle(ours):g}; {best} {others[best]:g})")
    lines = {
        "perfbound has the least median, or an equal one, on": first,
        "Within 10 % of the least:": near,
        "Behind on": behind,
        "Falsified by fewer than half of the searches of any kind:": seldom,
        "Falsified by none:": nobody,
    }
    return " ".join(f"{words} {', '.join(names)}." for words, names in lines.items() if names)


def _count(name: str, rows: Sequence[Row]) -> str:
    return f"{name} {found_in(rows)} of {len(rows)}"


def section(rows: Sequence[Row]) -> str:
    """Return the generated part of the page, with its marks."""
    parts = []
    for instance, budget in sorted(
        {(row.run.instance, row.run.budget) for row in rows}, key=lambda of: (-of[0], of[1])
    ):
        of = [row for row in rows if (row.run.instance, row.run.budget) == (instance, budget)]
        seeds = sorted({row.run.seed for row in of})
        parts.append(f"## Instance {instance}, {budget} simulations, seeds {seeds[0]} to {seeds[-1]}\n")
        parts.append(f"{verdict(of)}\n\n{medians(of)}")
        parts.append(f"Mean over the searches that falsified:\n\n{table(of, mean)}")
        parts.append(f"CPU time of the search for a simulation in ms:\n\n{table(of, overhead)}")
    body = "\n".join(parts)
    return f"{BEGIN}\n\n{body}\n{END}"


def write(page: Path, rows: Sequence[Row]) -> None:
    """Put the tables between the marks of the page.

    Raises:
        PageError: the page cannot be read, or lacks the marks.

    """
    text = page_text(page, (BEGIN, END))
    atomic.write_whole(page, with_part(text, BEGIN, END, section(rows)).encode())
