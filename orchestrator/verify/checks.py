"""The checks of a verification, and what became of each."""

from dataclasses import dataclass, field
from typing import Literal

Status = Literal["passed", "failed", "skipped"]

CHECKS = {
    "signature": "the certificate was signed with this key",
    "certificate": "the certificate is one, written as perfbound writes it",
    "header": "campaign and system are those that the certificate names",
    "manifest": "the manifest is the one that the certificate names",
    "files": "every trajectory file is the one in the manifest",
    "requests": "every rollout is one that the campaign asks for: start, seed, options",
    "trajectories": "every file holds one whole trajectory of this system",
    "proposals": "every test is the maximiser of what was known before it",
    "observations": "every y follows from its trajectories: robustness, gap, risk",
    "stop": "every problem goes on until its rule stops it, and no longer",
    "evidence": "the manifest lists the rollouts of the observed tests, all and no others",
    "chain": "the hash chain over proposals, digests and observations ends where the certificate says",
    "problems": "the bounds of the problems follow from the observations",
    "probabilities": "the probabilities follow from what was fixed beforehand",
    "composition": "the terms of the composition follow from the bounds",
    "claims": "the claims follow, and name what they rest on",
    "audit": "the assumptions and their status follow from the data",
    "software": "this machine has the software of the campaign",
    "database": "the tables of the database say the same as the evidence",
    "resimulation": "rollouts that are simulated again give the same trajectory",
}
"""Every check in the order of the table, and what it means that it passes."""


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the table."""

    name: str
    status: Status
    detail: str

    @property
    def meaning(self) -> str:
        """Return what it means that this check passes."""
        return CHECKS[self.name]


class FailedError(Exception):
    """A check failed in a way that those behind it cannot be made; the text is the detail."""

    def __init__(self, name: str, detail: str) -> None:
        super().__init__(detail)
        self.name = name


@dataclass(slots=True)
class Table:
    """The checks so far."""

    found: dict[str, Check] = field(default_factory=dict)

    def passed(self, name: str, detail: str) -> None:
        """Add a check that passed."""
        self._add(Check(name, "passed", detail))

    def failed(self, name: str, detail: str) -> None:
        """Add a check that failed."""
        self._add(Check(name, "failed", detail))

    def skipped(self, name: str, detail: str) -> None:
        """Add a check that could not be made, or was not asked for."""
        self._add(Check(name, "skipped", detail))

    def judge(self, name: str, fault: str | None, detail: str) -> None:
        """Add a check that failed if there is a fault."""
        if fault is None:
            self.passed(name, detail)
        else:
            self.failed(name, fault)

    def _add(self, check: Check) -> None:
        assert check.name in CHECKS
        self.found.setdefault(check.name, check)

    def lines(self) -> tuple[Check, ...]:
        """Return every check in the order of the table; those that were never reached are skipped."""
        broken = next((name for name in CHECKS if name in self.found and self.found[name].status == "failed"), None)
        reason = f"not reached: `{broken}` failed" if broken else "not reached"
        return tuple(self.found.get(name) or Check(name, "skipped", reason) for name in CHECKS)

    @property
    def good(self) -> bool:
        """Whether no check failed."""
        return all(check.status != "failed" for check in self.found.values())
