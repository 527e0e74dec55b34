"""What was skipped, in one line at the end; in CI a skip for any other reason than these is a failure."""

import os
from collections import Counter
from collections.abc import Iterable

import pytest

from tests.missing import for_want_of_pybullet

STRICT = "PERFBOUND_STRICT_SKIPS"
"""Environment variable that CI sets."""
ALLOWED = (
    "fish is not installed",
    "zsh is not installed",
    "mkdocs is not installed",
    "JAX is not installed",
    "to build the images",
    "Slurm",
)
"""Parts of the reasons that CI accepts: what its machine may lack."""


def reasons(reports: Iterable[pytest.TestReport | pytest.CollectReport]) -> Counter[str]:
    """Return how many tests were skipped for each reason."""
    return Counter(
        str(each.longrepr[2] if isinstance(each.longrepr, tuple) else each.longrepr).removeprefix("Skipped: ")
        for each in reports
    )


def not_allowed(found: Iterable[str]) -> list[str]:
    """Return the reasons that CI does not accept; none where it is not CI."""
    if STRICT not in os.environ:
        return []
    return [each for each in found if not for_want_of_pybullet(each) and not any(part in each for part in ALLOWED)]


def summary(found: Counter[str]) -> str:
    """Return the one line."""
    if not found:
        return "no test was skipped"
    return f"{found.total()} tests were skipped: " + "; ".join(f"{count} {each}" for each, count in found.items())
