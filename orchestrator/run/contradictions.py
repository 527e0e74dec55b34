"""Lines about constants that contradict the data, printed during a run as soon as they do."""

from collections.abc import Callable, Mapping

from ..campaign import consistency
from ..campaign.bounded_parts import bounded_accounts
from ..campaign.methods import Methods
from ..campaign.series import Account
from .service import RunStatus

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
