"""What a person sees while a campaign runs, and at its end. stderr is talk; stdout is for data."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from orchestrator.ledger import Account
from orchestrator.service import Seen
from schemas.campaign import SENSES
from schemas.certificate import Assumption, Certificate, Claim, ProblemResult

PLAIN_PERIOD = 10.0
"""Seconds between two progress lines where there is no terminal."""
MINIMA = tuple(name for name, sense in SENSES.items() if sense == "min")


def figure(value: float | None, digits: int = 4) -> str:
    """Return a number for people, or a dash."""
    return "-" if value is None else f"{value:.{digits}f}"


def bound_in_sense(account: Account) -> float | None:
    """Return the bound so far in the unit and sense of the problem: -eps for a minimum."""
    bound = account.last_bound.epsilon if account.last_bound else None
    return -bound if bound is not None and account.problem.name in MINIMA else bound


def time_left(account: Account, rate: float, rollouts_per_test: float) -> float | None:
    """Guess the seconds until F_i reaches alpha; None where the decay of F cannot tell yet.

    F falls roughly like a power of the number of tests; the power is taken from the first to the last proposal.
    """
    proposal, tests = account.last_proposal, len(account.observations)
    if proposal is None or proposal.F is None or proposal.beta is None or tests < 10 or rate <= 0:
        return None
    start = 2 * proposal.beta
    if not 0 < proposal.F < start:
        return None
    power = math.log(start / proposal.F) / math.log(tests)
    needed = tests * (proposal.F / account.problem.alpha) ** (1 / power)
    return max(0.0, min(needed, 1e7) - tests) * rollouts_per_test / rate


class Terminal:
    """Progress on a terminal."""

    def __init__(self, console: Console, live: Live) -> None:
        self._console, self._live = console, live
        self._rate = Rate()

    def say(self, line: str) -> None:
        """Print a line above the table."""
        self._console.print(escape(line), style="yellow", highlight=False)

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
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)

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
    proposal = account.last_proposal
    decay = figure(proposal.F if proposal else None)
    return (
        f"{account.problem.name}: test {len(account.observations)}, F {decay} (alpha {account.problem.alpha:g}), "
        f"bound so far {figure(bound_in_sense(account), 3)}"
    )


def problem_table(seen: Seen, rate: float) -> Table:
    """Return one row per problem."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("problem", "tests", "F_i", "alpha", "bound so far", "rollouts", "about left"):
        table.add_column(name, justify="left" if name == "problem" else "right")
    running = [a for a in seen.ledger.accounts.values() if not (a.last_bound and a.last_bound.stopped_by)]
    for account in seen.ledger.accounts.values():
        proposal, bound = account.last_proposal, account.last_bound
        tests, rollouts = len(account.observations), sum(account.counts.values())
        per_test = rollouts / tests if tests else 1.0
        left = time_left(account, rate / max(1, len(running)), per_test)
        end = bound.stopped_by if bound and bound.stopped_by else "-" if left is None else duration(left)
        colour = "green" if bound and bound.stopped_by == "converged" else ""
        table.add_row(
            account.problem.name,
            str(tests),
            figure(proposal.F if proposal else None),
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


def duration(seconds: float) -> str:
    """Return a time span for people.

    >>> duration(75), duration(7200), duration(3)
    ('1 min 15 s', '2 h 0 min', '3 s')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


@contextmanager
def view(console: Console) -> Iterator[Terminal | Plain]:
    """Return the view that fits: a live table on a terminal, log lines elsewhere."""
    if not console.is_terminal:
        yield Plain(console)
        return
    with Live(console=console, refresh_per_second=4, transient=True) as live:
        yield Terminal(console, live)


def summary(certificate: Certificate, console: Console) -> None:
    """Print what the certificate says; refuted assumptions first."""
    predicate = certificate.predicate
    refuted = [each for each in predicate.assumptions if each.status == "refuted"]
    console.print()
    if refuted:
        console.print(f"[bold red]REFUTED by this campaign's own data or by derivation: {len(refuted)} assumption(s)[/]")
        for each in refuted:
            _assumption(each, console)
        console.print()
    for number, claim in enumerate(predicate.claims):
        _claim(claim, {each.id for each in refuted}, console, first=number == 0)
    composition = predicate.composition
    if composition is not None:
        console.print(
            f"  = {composition.nominal_bound:.4f} (nominal) - {composition.gap_term:.4f} (gap) "
            f"- {composition.risk_term:.4f} (risk)",
            highlight=False,
        )
    console.print()
    for problem in predicate.problems:
        _problem(problem, console)
    console.print("\nAssumptions that the data do not refute:", style="bold")
    for each in predicate.assumptions:
        if each.status != "refuted":
            _assumption(each, console)


def written(directory: Path, console: Console) -> None:
    """Print where everything is."""
    console.print()
    for name, what in (
        ("certificate.json", "certificate"),
        ("manifest.sha256", "digests of the evidence (sha256sum --check)"),
        ("trajectories", "evidence, one MCAP file a rollout"),
        ("campaign.db", "database"),
    ):
        console.print(f"{directory / name}  {what}", highlight=False)


def _claim(claim: Claim, refuted: set[str], console: Console, *, first: bool) -> None:
    quantity = {"rho_star": "rho* (minimum risk of the true system)", "J_star": "J* (maximum)"}[claim.quantity]
    broken = sorted(set(claim.assumptions) & refuted)
    mark = "[bold]CLAIM[/]" if first else "[bold]also[/]"
    console.print(
        f"{mark}  {quantity} {claim.sense} [bold]{claim.bound:.4f}[/] with probability at least "
        f"[bold]{claim.probability:.4f}[/]  (method {claim.method}, rule {claim.rule})",
        highlight=False,
    )
    if broken:
        console.print(f"  It rests on {len(broken)} refuted assumption(s): do not rely on it.", style="red")


def _problem(problem: ProblemResult, console: Console) -> None:
    sign = ">=" if problem.sense == "min" else "<="
    console.print(
        f"[bold]{problem.name}[/]  {problem.objective} {sign} {problem.bound:.4f} (probability {problem.probability:.4f}); "
        f"{problem.tests} tests, {problem.rollouts.nominal} nominal and {problem.rollouts.true} true rollouts, "
        f"stopped by {problem.stopped_by} at F = {problem.last_F:.4f}",
        highlight=False,
    )


def _assumption(assumption: Assumption, console: Console) -> None:
    colour = {"refuted": "red", "derived": "green"}.get(assumption.status, "yellow")
    console.print(
        f"  [{colour}]{assumption.status:<11}[/] [bold]{escape(assumption.id)}[/]: {escape(assumption.detail)}",
        highlight=False,
    )
