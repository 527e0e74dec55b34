"""The checks of a verification and their results."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Literal

from ....schemas.errors import PerfboundError, one_line

Status = Literal["passed", "failed", "skipped"]

CHECKS = {
    "signature": "the certificate was signed with this key",
    "certificate": "the certificate has the form and the bytes that perfbound writes",
    "header": "the campaign file and the specification of the system are those of the certificate, and fit each other",
    "manifest": "the manifest is the one that the certificate names",
    "files": "every file of the manifest exists and is unchanged",
    "requests": "every rollout is one that the campaign requests: start, seed, options",
    "trajectories": "every file is intact and has the columns of the system from 0 to the horizon",
    "proposals": "the first test follows from the seed, every other is a maximiser given the observations before it",
    "observations": "every y follows from its trajectories: robustness, gap, risk",
    "stop": "every problem continues until its rule stops it, and no longer",
    "evidence": "the manifest lists the rollouts of the observed tests, all and no others",
    "chain": "the hash chain over proposals, digests and observations ends in the digest that the certificate names",
    "problems": "bounds, parameters and the counterexample follow from the campaign file and the observations",
    "probabilities": "the probabilities follow from the campaign file",
    "composition": "the terms of the composition follow from the bounds",
    "spot check": "what fresh starts showed after the campaign follows from their trajectories",
    "recheck": "the repeated rollouts are the drawn ones, and agree as often as the certificate says",
    "regions": "the regions follow from the observations, and regions.csv is the table that the certificate names",
    "claims": "the claims follow, with these and with other constants, and name their assumptions",
    "audit": "the assumptions, their status and their numbers follow from the data",
    "software": "this machine has the numerical software of the campaign",
    "database": "the tables of facts agree: tests, rollouts, observations, bounds",
    "attempts": "attempts, their outcomes and opinions are those that were recorded with the certificate",
    "resimulation": "rollouts that are simulated again give the same trajectory",
}
"""Every check in the order of the table, and the statement that it proves."""
OF_BUNDLE = {
    "bundle": "the bundle has the files of its list, unchanged, and no others",
    "documents": "the safety case in the bundle follows from the certificate",
}
"""The checks that a bundle has besides."""
ABSENT = {
    "composition": "no composition",
    "spot check": "no spot check",
    "recheck": "no recheck",
    "regions": "no regions",
}
"""Parts that not every certificate has, and the detail of their checks where neither it nor the evidence has one."""


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the table."""

    name: str
    status: Status
    detail: str

    @property
    def meaning(self) -> str:
        """The statement that this check proves."""
        return {**CHECKS, **OF_BUNDLE}[self.name]


class CheckFailed(Exception):  # noqa: N818  (an outcome of a verification, and no error of perfbound)
    """A check failed so that later ones cannot be made; the text is the detail."""

    def __init__(self, name: str, detail: str) -> None:
        super().__init__(detail)
        self.name = name


@dataclass(slots=True)
class Checks:
    """The checks of one verification so far."""

    found: dict[str, Check] = field(default_factory=dict)

    def passed(self, name: str, detail: str) -> None:
        """Add a check that passed."""
        self._add(Check(name, "passed", detail))

    def failed(self, name: str, detail: str) -> None:
        """Add a check that failed."""
        self._add(Check(name, "failed", detail))

    def skipped(self, name: str, detail: str) -> None:
        """Add a check that was impossible or not requested."""
        self._add(Check(name, "skipped", detail))

    def judge(self, name: str, fault: str | None, detail: str) -> None:
        """Add a check, which failed if there is a fault; without one it is skipped where nothing was there to check."""
        if fault is None and detail == ABSENT.get(name):
            self.skipped(name, detail)
        else:
            self._add(Check(name, "failed" if fault else "passed", fault or detail))

    @contextmanager
    def making(self, name: str) -> Iterator[None]:
        """Turn any exception while reading untrusted input into a failed check.

        Raises:
            CheckFailed: an exception was raised inside.

        """
        try:
            yield
        except CheckFailed:
            raise
        # Fail closed: a forger controls every byte that is read inside, and so every exception.
        except Exception as error:
            text = str(error).partition("\n")[0][:200]
            known = isinstance(error, PerfboundError)
            raise CheckFailed(name, text if known else f"{type(error).__name__}: {text}") from error

    def _add(self, check: Check) -> None:
        assert check.name in CHECKS or check.name in OF_BUNDLE
        # One line: a detail may quote untrusted text, and could forge further lines of the table.
        # A check may have several parts: a failure of any of them counts, else the first result.
        known = self.found.get(check.name)
        if known is None or (check.status == "failed" and known.status != "failed"):
            self.found[check.name] = replace(check, detail=one_line(check.detail))

    def lines(self) -> tuple[Check, ...]:
        """Return every check in the order of the table; those that were not reached are skipped."""
        broken = next(
            (name for name in (*CHECKS, *OF_BUNDLE) if name in self.found and self.found[name].status == "failed"), None
        )
        reason = f"not reached: `{broken}` failed" if broken else "not reached"
        asked = [*CHECKS, *(name for name in OF_BUNDLE if name in self.found)]
        return tuple(self.found.get(name) or Check(name, "skipped", reason) for name in asked)

    @property
    def good(self) -> bool:
        """Whether no check failed."""
        return all(check.status != "failed" for check in self.found.values())
