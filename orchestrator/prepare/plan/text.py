"""The plan of a campaign in words: a table of what it needs, each with its range, and what limits it."""

import json
from collections.abc import Callable
from dataclasses import asdict

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ....schemas.amounts import amount, counted
from ....schemas.values import Guess
from ...certificate.words.format import duration
from .fleet_need import FleetPlan, PilotFigures, ProblemSize

Row = tuple[str, str, str, str]
"""What, the expected value, its range, what it rests on."""


def print_plan(found: FleetPlan, name: str, console: Console) -> None:
    """Print the plan of a campaign."""
    console.print(Text(f"{name} with {counted(found.workers, 'worker')}", "bold"), soft_wrap=True)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("", "expected", "range"):
        table.add_column(title, justify="left" if not title else "right", no_wrap=True)
    table.add_column("rests on", overflow="fold")
    for row in plan_rows(found):
        table.add_row(*row[:3], Text(row[3], "dim"))
    console.print(table)
    for line in plan_limits(found):
        console.print(Text(line), soft_wrap=True)


def plan_rows(found: FleetPlan) -> list[Row]:
    """Return the rows of the table."""
    pilot = found.pilot
    return [
        (
            "rollouts",
            _whole_number(found.rollouts.middle),
            _range(found.rollouts, _whole_number),
            "what follows, added up",
        ),
        *map(_size_row, (*found.problems, *found.checks)),
        *_second_opinion_rows(found),
        (
            "time",
            duration(found.seconds.middle),
            _range(found.seconds, duration),
            f"{pilot.seconds:.2g} s a rollout, of {pilot.rollouts:,} here{_added(pilot)}",
        ),
        (
            "storage",
            amount(found.storage.middle),
            _range(found.storage, amount),
            f"{amount(pilot.size)} a rollout, and the database",
        ),
        ("memory of a worker", amount(pilot.memory), "", "the process of the pilot"),
        (
            "memory of the orchestrator",
            amount(found.memory.middle),
            _range(found.memory, amount),
            "a base, and matrices of the methods",
        ),
        (
            "network at the router",
            f"{amount(found.network)}/s",
            "",
            "each way, while the problems run",
        ),
        (
            "load of the orchestrator",
            _percent(found.load.whole),
            "",
            f"of a core: {_rate(found.load.results_per_second)} results/s and "
            f"{_rate(found.load.heartbeats_per_second)} heartbeats/s",
        ),
    ]


def plan_limits(found: FleetPlan) -> list[str]:
    """Return what limits the campaign."""
    useful = found.useful_workers
    what = "batch" if any(each.batch > 1 for each in found.problems) else "rollout"
    result = [
        f"While the problems run, at most {counted(useful, what)} can run side by side: more workers than that "
        "have nothing to do."
    ]
    if found.useful_in_checks > useful:
        result[0] += f" In the closing checks it is {found.useful_in_checks:,}."
    if found.workers > useful:
        waiting = counted(found.workers - useful, "worker")
        more = "smaller `batch`" if what == "batch" else "larger `window` or `replicates`"
        result.append(f"{waiting} of {found.workers:,} will wait: a {more} gives them work.")
    if found.load.limits:
        result.append(
            f"The orchestrator limits the campaign: it would need {_percent(found.load.whole)} of a core, and has one; "
            "the time above is with that limit. Fewer workers take as long; several "
            "campaigns, each with its own orchestrator, do not share this limit."
        )
    return [*result, *found.notes]


def plan_json(found: FleetPlan, name: str) -> str:
    """Return the plan as JSON; times in s, sizes in bytes."""
    return json.dumps({"campaign": name, **asdict(found), "orchestrator_limits": found.load.limits})


def _added(pilot: PilotFigures) -> str:
    return "" if pilot.added is None else f"; {pilot.in_batch:.2g} s in a batch"


def _second_opinion_rows(found: FleetPlan) -> list[Row]:
    more = found.second_opinions
    if not more.high:
        return []
    return [
        (
            "second opinions",
            _whole_number(more.middle),
            _range(more, _whole_number),
            "the share in the campaign file, and the first results of each worker",
        )
    ]


def _size_row(size: ProblemSize) -> Row:
    per_test = "" if size.per_test == 1 else f", {size.per_test:,} a test"
    per_test += "" if size.batch == 1 else f", in batches of {size.batch:,}"
    return (
        f"  {size.name}",
        _whole_number(size.rollouts.middle),
        _range(size.rollouts, _whole_number),
        f"{size.basis}{per_test}",
    )


def _range(guess: Guess, word: Callable[[float], str]) -> str:
    low, high = word(guess.low), word(guess.high)
    return "" if low == high else f"{low} to {high}"


def _whole_number(number: float) -> str:
    return f"{round(number):,}"


def _rate(number: float) -> str:
    return f"{number:,.0f}" if number >= 100 else f"{number:.3g}"


def _percent(share: float) -> str:
    return f"{100 * share:,.0f} %" if share >= 0.01 else "below 1 %"
