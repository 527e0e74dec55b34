"""A listener that computes what a run has shown so far, writes it beside the database, and reports refutations."""

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Protocol

from ....schemas.amounts import amount
from ....schemas.errors import one_line
from ....schemas.file.config import CampaignConfig
from ....schemas.result.certificate import Assumption
from ....schemas.result.known import Expected, SoFar, Violations
from ...campaign import consistency
from ...campaign.bounded_parts import bounded_accounts
from ...campaign.closing.recheck import Recheck
from ...campaign.closing.spot_check import spot_check_plan
from ...campaign.ledger import Ledger
from ...campaign.methods import Methods
from ...campaign.plan import Plans
from ...campaign.series import Account
from ...certificate.so_far import AuditSoFar, Holding, claims_nothing_yet
from ...certificate.words.bound_text import parameter_units, with_named_start
from ...forecast.campaign_end import RolloutCounts, expected, expected_verdict
from ...forecast.evidence import evidence_bytes
from ...store import read
from ...store.export_tables import robustness_unit
from ...store.robustness import read_values, read_violations
from ...store.so_far import write_so_far
from ..routers import is_down
from ..service import RunStatus

PERIOD = 2.0
"""Seconds between two files at least."""
SHARE = 100.0
"""The audit pauses so many times as long as it took: it uses at most a hundredth of the time."""
PACE_SPAN = 120.0
"""Seconds over which the rate of a forecast is taken; the whole run where few rollouts end in them."""
FEW = 20
LOSS = 0.05
"""A progress bar falls by more than this only with a line that says so."""
QUIET = 60.0
"""Seconds between two such lines: a distance that comes close to its tolerance and leaves it again moves the forecast
back and forth."""


class Output(Protocol):
    """The terminal of a run, as far as this listener prints there."""

    def print_line(self, line: str) -> None:
        """Print a line."""
        ...

    def refuted(self, found: Assumption, then: str) -> None:
        """Report an assumption that the data refute; `then` is what follows."""
        ...

    def so_far(self, found: SoFar) -> None:
        """Show what the run has shown so far."""
        ...


class SoFarListener:
    """Computes at every tick what is due; `output` shows it."""

    def __init__(self, directory: Path, ledger: Ledger, output: Output) -> None:
        self._directory, self._ledger, self._output = directory, ledger, output
        self._audit = AuditSoFar(ledger)
        self._unit = robustness_unit(ledger.config, ledger.header.spec)
        self._work = _rollout_counts(ledger)
        self._holding: tuple[Holding, Violations] | None = None
        self._known: set[str] = set()
        """Ids of the refuted assumptions that were reported."""
        self._state: object = None
        """Of the last audit: the tests and ends of every series."""
        self._pace = Pace()
        self._share, self._fell = 0.0, -QUIET
        self._due = self._next = 0.0

    def print_line(self, line: str) -> None:
        """Drop the line: another listener prints it."""

    def show(self, status: RunStatus) -> None:
        """Audit the campaign if it has new tests and the last audit is long enough ago; then write the file."""
        rate, now = self._pace.of(status), time.monotonic()
        state = [(each.tests, each.stopped_by) for each in (*status.problems.values(), *status.closing.values())]
        ended = [each[1] for each in state]
        # At the end of a problem at once: it may be a refutation.
        if self._due < math.inf and state != self._state and (now >= self._due or ended != self._ends()):
            self._state = state
            try:
                self._holding = self._examined()
            except Exception as error:  # noqa: BLE001  (any: a view of a campaign must not stop it)
                self._output.print_line(
                    f"what holds so far cannot be computed, and is not shown: {one_line(repr(error))}"
                )
                self._due = math.inf
                self._holding = None
                return
            self._due = time.monotonic() + SHARE * (time.monotonic() - now)
            self._report_refutations(self._holding[0])
            self._next = 0.0
        if self._holding is None or now < self._next:
            return
        self._next = now + PERIOD
        # No time is left to estimate while nothing can arrive.
        found = self._found(status, 0.0 if is_down(status.link) else rate, *self._holding)
        # Computed here alone: a reader that does it would have to load the numerics and replay for minutes.
        write_so_far(self._directory, found)
        self._output.so_far(found)

    def _ends(self) -> list[object]:
        return [each[1] for each in self._state] if isinstance(self._state, list) else []

    def _examined(self) -> tuple[Holding, Violations]:
        header = self._ledger.header
        variant, problems = header.claimed_variant, [problem.name for problem in header.config.problems]
        violations = read_violations(self._directory, variant)
        holding = self._audit.holding(
            violations,
            partial(read_values, self._directory, variant, problems),
            unit=self._unit,
            irreproducible=read.irreproducible(self._directory),
        )
        return holding, violations

    def _report_refutations(self, holding: Holding) -> None:
        for each in holding.assumptions:
            if each.status == "refuted" and each.id not in self._known:
                self._known.add(each.id)
                then = "the first claim does not rest on it" if each.id in holding.others else self._consequence(each)
                self._output.refuted(with_named_start(each, parameter_units(self._ledger.header.spec)), then)

    def _consequence(self, found: Assumption) -> str:
        """Return what follows from a refutation in this run."""
        name = found.id.partition("/")[2].partition("/")[0]
        series = self._ledger.series.get(name)
        if series is not None and series.last_bound is not None and series.last_bound.stopped_by == "refuted":
            return f"{name} ends here"
        return "the campaign continues, and its certificate says so"

    def _found(self, status: RunStatus, rate: float, holding: Holding, violations: Violations) -> SoFar:
        verdict, config = holding.verdict, status.config
        forecast = self._never_falling(
            expected(config, status.problems, status.closing, self._work, rate), status.seconds
        )
        sense = verdict.sense if verdict else ">=" if config.sense_of(config.problems[0]) == "min" else "<="
        required = config.required_margin if sense == ">=" else config.required_at_most
        word = verdict.verdict if verdict else "NOT SHOWN"
        then = expected_verdict(forecast, word, required, refuted=holding.refuted)
        return SoFar(
            run=self._ledger.header.run,
            at=time.time(),
            tests=sum(each.tests for each in status.problems.values()),
            rollouts=sum(each.rollouts for each in (*status.problems.values(), *status.closing.values())),
            verdict=word,
            claim=verdict.claim if verdict else "",
            reasons=verdict.reasons if verdict else (claims_nothing_yet(self._ledger.header),),
            bound=verdict.bound if verdict else None,
            refuted=holding.refuted,
            sense=sense,
            required=required,
            probability=verdict.probability if verdict else None,
            unit=self._unit,
            bound_unit=verdict.bound_unit if verdict else self._unit,
            violations=violations,
            assumptions=holding.assumptions,
            others=holding.others,
            on_refuted=config.on_refuted,
            expected=forecast.model_copy(update={"verdict": then}),
            link_down_since=_link_down_since(status),
        )

    def _never_falling(self, found: Expected, seconds: float) -> Expected:
        """Return a forecast whose share never falls by little, and by much only with a line, now and then."""
        if found.share < self._share - LOSS and seconds - self._fell >= QUIET:
            self._output.print_line(
                f"the forecast has grown: {100 * found.share:.0f} % of the work is done, and not "
                f"{100 * self._share:.0f} %"
            )
            self._share, self._fell = found.share, seconds
        self._share = max(self._share, found.share)
        return found.model_copy(update={"share": self._share})


def _link_down_since(status: RunStatus) -> float | None:
    down = status.link.down_for if status.link is not None else None
    return None if down is None else time.time() - down


def _rollout_counts(ledger: Ledger) -> RolloutCounts:
    header, plans = ledger.header, ledger.plans
    spot = spot_check_plan(header, plans.values())
    checked = (spot.count(header.config.spot_check), spot.count(spot.most_tests)) if spot else (0, 0)
    repeated = header.config.recheck if Recheck.wanted(header) else 0
    return RolloutCounts({name: len(plan.rollouts) for name, plan in plans.items()}, checked, repeated)


class Pace:
    """Rollouts per second, over a span in which enough of them have ended."""

    def __init__(self) -> None:
        self._points: list[tuple[float, int]] = []

    def of(self, status: RunStatus) -> float:
        """Return the rate now; 0 before the first rollout."""
        self._points.append((status.seconds, status.recorded))
        while len(self._points) > 2 and self._may_forget(status):
            del self._points[0]
        (first, count), (last, total) = self._points[0], self._points[-1]
        return (total - count) / (last - first) if last > first else 0.0

    def _may_forget(self, status: RunStatus) -> bool:
        """Whether the span without its first point is still long, and has enough rollouts."""
        seconds, count = self._points[1]
        return status.seconds - seconds >= PACE_SPAN and status.recorded - count >= FEW


# Constants that contradict the data, reported as soon as they do

GROWTH = 1.1
"""The tests of a problem are examined again once they are so many times as many: the cost stays proportional."""


class Contradictions:
    """A listener that prints a line for every contradiction, once in a run."""

    def __init__(self, accounts: Mapping[str, Account], methods: Methods, print_line: Callable[[str], None]) -> None:
        self._accounts, self._methods, self._print_line = accounts, methods, print_line
        self._examined = dict.fromkeys(accounts, 0)
        self._printed: set[tuple[str, str]] = set()

    def print_line(self, line: str) -> None:
        """Drop the line: another listener prints it."""

    def show(self, status: RunStatus) -> None:
        """Examine the problems with enough new tests, and each once more at its end."""
        for name, account in self._accounts.items():
            tests, ended = len(account.observations), status.problems[name].stopped_by is not None
            if tests == self._examined[name] or (tests < GROWTH * self._examined[name] and not ended):
                continue
            self._examined[name] = tests
            for key, each in bounded_accounts({name: account}, self._methods).items():
                self._examine(key, each)

    def _examine(self, name: str, account: Account) -> None:
        found = consistency.of_tests(account.plan, account.observations, account.each, account.robustness)
        for key, line in found.items():
            if (name, key) not in self._printed:
                self._printed.add((name, key))
                self._print_line(line)


class EvidenceSize:
    """A listener that prints once how many bytes the trajectory files will take, when the first rollouts are there."""

    def __init__(self, ledger: Ledger, print_line: Callable[[str], None]) -> None:
        self._ledger, self._print_line = ledger, print_line
        self._printed = False

    def print_line(self, line: str) -> None:
        """Drop the line: another listener prints it."""

    def show(self, status: RunStatus) -> None:  # noqa: ARG002
        """Print the line, once something has arrived."""
        if self._ledger.arrived and not self._printed:
            self._printed = True
            self._print_line(size_of_evidence(self._ledger.config, self._ledger.plans, self._size))

    @property
    def _size(self) -> float:
        return self._ledger.received / self._ledger.arrived


def size_of_evidence(config: CampaignConfig, plans: Plans, size: float) -> str:
    """Return the line on the files of a campaign that spends its budget, a rollout's trajectory having `size` bytes."""
    counts = [(plan, plan.machine.count(plan.budget)) for plan in plans.values()]
    total = sum(evidence_bytes(config, plan, count, size) for plan, count in counts)
    beside = {"all": "", "failures": ", beside the failures"}.get(config.keep, f', with keep = "{config.keep}"')
    return f"evidence: {amount(size)} a rollout, at most about {amount(total)} in all{beside}"
