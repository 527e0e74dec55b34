"""The closing checks of a campaign: spot check, risk, what follows a failure, the recheck, each if it is wanted."""

from collections.abc import Mapping

from ....schemas.file.against_system import searched
from ....schemas.file.problem_models import MOST_CLUSTERS
from ....schemas.ids import RECHECK, SIMPLEST, RolloutId, closing_check
from ....schemas.result.facts import Header, first_link
from .. import state
from ..assumption_tests import is_dominated
from ..bounded_parts import bounded_accounts
from ..counterexample import counterexample, found_failures
from ..methods import Methods
from ..observation import Observer
from ..plan import ProblemPlan
from ..ports import Recorded
from ..series import Account, Series
from .importance import ImportanceSampling
from .likeliest import LikeliestFailure
from .recheck import Recheck
from .risk_check import RiskCheck
from .shrink import Shrink
from .simplest import SimplestFailures
from .spot_check import SpotCheck, SpotSeries, spot_check_plan

Check = SpotCheck | RiskCheck | Shrink | LikeliestFailure | ImportanceSampling | SimplestFailures | Recheck


class ClosingChecks:
    """The checks that have begun since the last extension; `spot_check` and `recheck` are None before."""

    def __init__(
        self,
        header: Header,
        accounts: Mapping[str, Account],
        methods: Methods,
        observer: Observer,
        recorded: Recorded,
    ) -> None:
        self._header, self._accounts, self._methods = header, accounts, methods
        self._observer, self._recorded = observer, recorded
        self.spot_check: SpotCheck | None = None
        self.risk_check: RiskCheck | None = None
        self.shrink: Shrink | LikeliestFailure | None = None
        self.importance: ImportanceSampling | None = None
        self.simplest: SimplestFailures | None = None
        self.recheck: Recheck | None = None
        self._rechecks: dict[str, Recheck] = {}
        """Those of before the extensions as well."""
        self._extensions = 0

    def extend(self) -> None:
        """Begin anew after an extension: what a check has shown of earlier bounds is no test of later ones."""
        self.spot_check = self.risk_check = self.simplest = self.recheck = None
        self._extensions += 1

    @property
    def fault(self) -> str | None:
        """What the checks since the last extension have refuted, in words; None if nothing."""
        if self.spot_check is not None and self.spot_check.refuted:
            return f"the {self.spot_check.name} refutes a bound"
        if self.spot_check is not None and not is_dominated(self.spot_check.excess):
            return f"the {self.spot_check.name} refutes that the gap dominates the difference in robustness"
        if self.recheck is not None and self.recheck.differing:
            return f"the {self.recheck.name} found a rollout that does not follow from its seed"
        return None

    def next(self, reached: state.State, series: Mapping[str, Series]) -> tuple[Check, Series] | None:
        """Begin the next check of a campaign whose series have all stopped; None after the last one."""
        header = self._header
        # In this order: a recheck repeats rollouts of the spot check as well.
        if self.recheck is None and self.spot_check is None and SpotCheck.wanted(header, self._accounts):
            tested = bounded_accounts(self._accounts, self._methods)
            self.spot_check = SpotCheck(header, tested, self._observer, self._recorded, self._extensions)
            return self.spot_check, SpotSeries(first_link(header, self.spot_check.name))
        # A series of its own, which begins only where a risk is refuted: facts of the spot check stay what they are.
        if (risk := self._risk_check(series)) is not None:
            self.risk_check = risk
            return risk, Series(first_link(header, risk.name))
        if self.recheck is None and self.shrink is None and (shrink := self._shrink()) is not None:
            self.shrink = shrink
            return shrink, Series(first_link(header, Shrink.name))
        if self.recheck is None and self.importance is None and (importance := self._importance()) is not None:
            self.importance = importance
            return importance, Series(first_link(header, importance.name))
        if self.recheck is None and self.simplest is None and (simplest := self._simplest()) is not None:
            self.simplest = simplest
            return simplest, Series(first_link(header, simplest.name))
        if self.recheck is None and Recheck.wanted(header):
            plans = {each.plan.problem: each.plan for each in reached.problems}
            # No claim rests on the rollouts that improve a failure, and those of an earlier recheck are repetitions.
            unclaimed = (Shrink.name, SIMPLEST, RECHECK)
            checked = {
                name: (each, plans[name]) for name, each in series.items() if closing_check(name) not in unclaimed
            }
            self.recheck = Recheck(header, checked, self._recorded, self._extensions)
            self._rechecks[self.recheck.name] = self.recheck
            return self.recheck, Series(first_link(header, self.recheck.name))
        return None

    def _risk_check(self, series: Mapping[str, Series]) -> RiskCheck | None:
        """Return the check that follows the spot check; None where that has left nothing to decide, or is past."""
        spot = self.spot_check
        if spot is None or self.risk_check is not None or self.recheck is not None:
            return None
        return RiskCheck.of(self._header, spot, len(series[spot.name].observations), self._extensions)

    def _shrink(self) -> Shrink | LikeliestFailure | None:
        """Return what follows a counterexample; None without one, and where nothing is left to try."""
        falsify, over = self._header.config.falsify, searched(self._header.config)
        if falsify is None or not (falsify.shrink or over):
            return None
        (account,) = self._accounts.values()  # a search is for one problem
        found = counterexample(account)
        if found is None:
            return None
        sought = LikeliestFailure if over else Shrink
        shrink = sought(self._header, found.rollout, found.start, self._observer)
        return shrink if shrink.plan.max_tests else None

    def _importance(self) -> ImportanceSampling | None:
        """Return what follows the likeliest failure; None without one, or where the file leaves it out."""
        falsify, sought = self._header.config.falsify, self.shrink
        if falsify is None or not falsify.sampled_tests or not isinstance(sought, LikeliestFailure):
            return None
        return ImportanceSampling(self._header, sought, self._observer)

    def _simplest(self) -> SimplestFailures | None:
        """Return what simplifies the failures that a search found; None without one, and where it cannot be simpler."""
        falsify = self._header.config.falsify
        if falsify is None or not falsify.simplifying_tests or not isinstance(self._header.config.space, dict):
            return None
        (account,) = self._accounts.values()  # a search is for one problem
        failures = found_failures(account)
        if not failures:
            return None
        simplest = SimplestFailures(self._header, failures[:MOST_CLUSTERS], self._observer, self._extensions)
        return simplest if simplest.plan.max_tests else None

    def original(self, rollout: RolloutId) -> RolloutId | None:
        """Return the rollout that a rollout of the recheck repeats; None for every other rollout."""
        check = self._rechecks.get(rollout.problem)
        return None if check is None else check.rollouts[rollout.test]


def cost(header: Header, plans: Mapping[str, ProblemPlan]) -> list[str]:
    """Return a line about the rollouts that follow the problems; none where there are none."""
    parts = []
    if (spot := spot_check_plan(header, plans.values())) is not None:
        starts = header.config.spot_check
        least = spot.count(starts)
        more = spot.count(spot.most_tests) - least
        followups = f" and at most {more:,} that follow up" if more else ""
        unless = " (not after a counterexample)" if header.config.may_end_early else ""
        parts.append(f"a spot check of {starts:,} starts with {least:,} rollouts{followups}{unless}")
    if Recheck.wanted(header):
        parts.append(f"a recheck of at most {header.config.recheck:,} rollouts")
    return [f"after the problems: {', '.join(parts)}"] if parts else []
