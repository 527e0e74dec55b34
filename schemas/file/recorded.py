"""Tests that were made before there was a campaign: their logs and their starts."""

from typing import TYPE_CHECKING

from pydantic import Field

from ..base import Model
from ..ranges import Magnitude
from .parameters import parameter_ranges
from .space import Range, Scenarios

if TYPE_CHECKING:
    from .keys import CampaignKeys

MAX_LOGS = 10_000
"""Logs of one campaign; the certificate contains all their starts."""


class RecordedTest(Model):
    """One test of a campaign that was imported: its log and its start."""

    log: str = Field(min_length=1, max_length=1000, description="its file, below the folder of the logs")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$", description="of the file")
    start: tuple[Magnitude, ...] = Field(min_length=1, description="the start that was driven")
    offset: Magnitude | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="time in the log at which the test begins, in s, where it is not that of all logs",
    )


def check_recorded(config: "CampaignKeys") -> None:
    """Refuse imported tests where something else than the logs would have to decide which tests there are.

    Raises:
        ValueError: the key, and what it cannot be.

    """
    tests = config.recorded
    if not tests:
        return
    if config.system.kind != "rig":
        raise ValueError('recorded: logs are imported for a rig alone; give [system] rig = "NAME"')
    for problem in config.problems:
        if problem.method != "sample":
            raise ValueError(
                f"method: {problem.method!r} chooses its starts, and logs have theirs; "
                'give method = "sample", or ask for the tests by ask_tell'
            )
        size = config.max_tests_of(problem)
        if size != len(tests):
            raise ValueError(
                f"max_tests: {size:,} is not allowed: there are {len(tests):,} logs, and to leave some out would be a "
                "choice; remove this key"
            )
    for key in ("falsify", "until_counterexample"):
        if getattr(config, key):
            raise ValueError(f"{key}: all logs are there before the first one is read; remove this key")
    if config.replicates != 1:
        raise ValueError("replicates: a log is one rollout; remove this key")
    if isinstance(config.space, dict):
        for number, each in enumerate(tests, start=1):
            _check_start(each, number, parameter_ranges(config.space))
    elif isinstance(config.space, Scenarios):
        raise ValueError("space.scenarios: the starts of logs follow a law; give ranges, or a table of starts")


def _check_start(test: RecordedTest, number: int, ranges: dict[str, Range]) -> None:
    if len(test.start) != len(ranges):
        raise ValueError(f"recorded: {test.log}: {len(test.start)} numbers for {len(ranges)} parameters")
    for value, (name, box) in zip(test.start, ranges.items(), strict=True):
        if not box.low <= value <= box.high:
            raise ValueError(
                f"space.{name}: test {number}, {test.log}, was driven from {value:g}, outside [{box.low:g}, "
                f"{box.high:g}]; a start that the law does not have shows that it is another law"
            )
