"""What a person sees while a campaign runs. stderr is talk; stdout is for data."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from orchestrator import forecast
from orchestrator.ledger import Account
from orchestrator.notify import Systemd
from orchestrator.service import Seen
from orchestrator.talk import JsonLines
from orchestrator.words import MINIMA, duration, figure

PLAIN_PERIOD = 10.0
"""Seconds between two progress lines where there is no terminal."""


def bound_in_sense(account: Account) -> float | None:
    """Return the bound so far in the unit and sense of the problem: -eps for a minimum."""
    bound = account.last_bound.upper if account.last_bound else None
    return -bound if bound is not None and account.problem.name in MINIMA else bound


def distance(account: Account) -> float | None:
    """Return what has to fall to alpha: F_i, or upper - lower."""
    proposal, bound = account.last_proposal, account.last_bound
    if bound is None:
        return None
    return forecast.distance(account.problem, proposal.F if proposal else None, bound.upper, bound.lower)


def time_left(seen: Seen, account: Account, rate: float) -> float | None:
    """Guess the seconds until a problem ends; None where its decay cannot tell yet."""
    tests, rollouts = len(account.observations), sum(account.counts.values())
    left = forecast.tests_left(seen.ledger.config, account.problem, distance(account), tests)
    return None if left is None or rate <= 0 else left * rollouts / tests / rate


class Terminal:
    """Progress on a terminal."""

    def __init__(self, console: Console, live: Live) -> None:
        self._console, self._live = console, live
        self._rate = Rate()

    def say(self, line: str) -> None:
        """Print a line above the table."""
        self._console.print(Text(line, "yellow"), soft_wrap=True)

    def show(self, seen: Seen) -> None:
        """Redraw the table."""
        rate = self._rate.of(seen)
        self._live.update(Group(problem_table(seen, rate), worker_line(seen, rate)))


class Plain:
    """Progress as log lines."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._rate = Rate()
        self._last = time.monotonic()
        self._stopped: set[str] = set()

    def say(self, line: str) -> None:
        """Print a line."""
        self._console.print(Text(line), soft_wrap=True)

    def show(self, seen: Seen) -> None:
        """Print a line per problem that stopped, and one line now and then."""
        rate = self._rate.of(seen)
        for name, account in seen.ledger.accounts.items():
            if name not in self._stopped and account.last_bound and account.last_bound.stopped_by:
                self._stopped.add(name)
                self.say(f"{_status(account)}; stopped by {account.last_bound.stopped_by}")
        if time.monotonic() - self._last >= PLAIN_PERIOD:
            self._last = time.monotonic()
            running = [a for name, a in seen.ledger.accounts.items() if name not in self._stopped]
            problems = " | ".join(_status(account) for account in running)
            self.say(f"{problems} | {worker_line(seen, rate).plain}")


class Lines:
    """Progress as JSON lines, with the numbers as fields."""

    def __init__(self, stream: JsonLines) -> None:
        self._stream = stream
        self._rate = Rate()
        self._last = time.monotonic()
        self._stopped: set[str] = set()

    def say(self, line: str) -> None:
        """Write a line."""
        self._stream.line(line)

    def show(self, seen: Seen) -> None:
        """Write a line per problem that stopped, and one line now and then."""
        rate, due = self._rate.of(seen), time.monotonic() - self._last >= PLAIN_PERIOD
        for name, account in seen.ledger.accounts.items():
            ended = bool(account.last_bound and account.last_bound.stopped_by)
            if ended and name not in self._stopped:
                self._stopped.add(name)
                self._stream.line("problem ended", **numbers(account))
            elif due and not ended:
                self._stream.line("progress", **numbers(account))
        if due:
            self._last = time.monotonic()
            phases = dict(sorted(seen.workers.items()))
            self._stream.line("workers", workers=phases, rollouts=seen.recorded, rollouts_per_second=round(rate, 2))


def numbers(account: Account) -> dict[str, Any]:
    """Return how far a problem is, by name."""
    bound = account.last_bound
    return {
        "problem": account.problem.name,
        "tests": len(account.observations),
        "rollouts": sum(account.counts.values()),
        "distance": distance(account),
        "alpha": account.problem.alpha,
        "bound": bound_in_sense(account),
        "stopped_by": bound.stopped_by if bound else None,
    }


class Watched:
    """A view that also tells systemd."""

    def __init__(self, inner: "Terminal | Plain | Lines", systemd: Systemd) -> None:
        self._inner, self._systemd = inner, systemd

    def say(self, line: str) -> None:
        """Pass it on."""
        self._inner.say(line)

    def show(self, seen: Seen) -> None:
        """Pass it on, and show that the loop turns."""
        self._inner.show(seen)
        tests = ", ".join(f"{name} {len(account.observations)} tests" for name, account in seen.ledger.accounts.items())
        self._systemd.alive(f"{tests}; {len(seen.workers)} workers")


class Rate:
    """Rollouts per second over the last quarter of a minute."""

    def __init__(self) -> None:
        self._points: list[tuple[float, int]] = []

    def of(self, seen: Seen) -> float:
        """Return the rate now."""
        self._points.append((seen.seconds, seen.recorded))
        self._points = [point for point in self._points if seen.seconds - point[0] <= 15]
        (first, count), (last, total) = self._points[0], self._points[-1]
        return (total - count) / (last - first) if last > first else 0.0


def _status(account: Account) -> str:
    name = "F" if account.problem.method == "paper" else "upper - lower"
    return (
        f"{account.problem.name}: test {len(account.observations)}, "
        f"{name} {figure(distance(account))} (alpha {account.problem.alpha:g}), "
        f"bound so far {figure(bound_in_sense(account), 3)}"
    )


def problem_table(seen: Seen, rate: float) -> Table:
    """Return one row per problem."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("problem", "tests", "F or U-L", "alpha", "bound so far", "rollouts", "about left"):
        table.add_column(name, justify="left" if name == "problem" else "right")
    running = [a for a in seen.ledger.accounts.values() if not (a.last_bound and a.last_bound.stopped_by)]
    for account in seen.ledger.accounts.values():
        bound, rollouts = account.last_bound, sum(account.counts.values())
        left = time_left(seen, account, rate / max(1, len(running)))
        end = f"ended: {bound.stopped_by}" if bound and bound.stopped_by else "-" if left is None else duration(left)
        colour = "green" if bound and bound.stopped_by == "converged" else ""
        table.add_row(
            account.problem.name,
            str(len(account.observations)),
            figure(distance(account)),
            f"{account.problem.alpha:g}",
            figure(bound_in_sense(account), 3),
            str(rollouts),
            end,
            style=colour,
        )
    return table


def worker_line(seen: Seen, rate: float) -> Text:
    """Return the workers and the throughput."""
    busy = sum(1 for phase in seen.workers.values() if phase in ("sent", "busy"))
    trouble = [name for name, phase in seen.workers.items() if phase in ("shunned", "gone")]
    text = f"workers {len(seen.workers)} ({busy} busy), {rate:.1f} rollouts/s, {duration(seen.seconds)} so far"
    return Text(text + (f", in trouble: {', '.join(trouble)}" if trouble else ""), style="dim")


@contextmanager
def view(console: Console) -> Iterator[Terminal | Plain | Lines]:
    """Return the view that fits: a live table on a terminal, lines elsewhere."""
    if isinstance(console.file, JsonLines):
        yield Lines(console.file)
        return
    if not console.is_terminal:
        yield Plain(console)
        return
    with Live(console=console, refresh_per_second=4, transient=True) as live:
        yield Terminal(console, live)
