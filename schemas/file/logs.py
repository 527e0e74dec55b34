"""Logs of a rig or a vehicle: how they become columns, and the tests that were imported from them."""

import re
from collections.abc import Mapping
from typing import Literal

from pydantic import Field, model_validator

from ..base import Model
from ..ranges import Magnitude

TITLE = re.compile(r"\s*(.*?)\s*(?:\(([^()]*)\)|\[([^\[\]]*)\])?\s*")
"""A title of a table: its name, and its unit in brackets."""
MAX_LOGS = 10_000
"""Logs of one campaign; the certificate contains all their starts."""
ROUNDING = 1e-9
"""A distance may exceed its tolerance by so large a share of it: both are differences of decimal numbers."""


def name_and_unit(title: str) -> tuple[str, str | None]:
    """Return the name that the title of a column is, and its unit in brackets.

    >>> name_and_unit(" speed (m/s)"), name_and_unit("Time [ms]"), name_and_unit("t")
    (('speed', 'm/s'), ('Time', 'ms'), ('t', None))
    """
    match = TITLE.fullmatch(title)
    return (title.strip(), None) if match is None else (match[1], match[2] if match[2] is not None else match[3])


def driven_column(parameter: str) -> str:
    """Return the column of the start that was driven, constant during a rollout."""
    return f"driven_{parameter}"


def driven_fault(asked: Mapping[str, float], driven: Mapping[str, float], tolerance: Mapping[str, float]) -> str | None:
    """Return why a start that was driven does not count for the one that was asked for; None where it does.

    >>> driven_fault({"speed": 20.0}, {"speed": 20.5}, {"speed": 0.2})
    'speed = 20.5 was driven, 0.5 from the 20 that was asked for, and the tolerance is 0.2; drive it again'
    """
    for name, most in tolerance.items():
        away = abs(driven[name] - asked[name])
        if not away <= most * (1.0 + ROUNDING):  # in this way also for a NaN
            return (
                f"{name} = {driven[name]:.9g} was driven, {away:.3g} from the {asked[name]:.9g} that was asked for, "
                f"and the tolerance is {most:g}; drive it again"
            )
    return None


class LogMapping(Model):
    """What the columns of the system are in the logs of others; for all of them the same."""

    columns: dict[str, str] = Field(
        default_factory=dict,
        max_length=1000,
        description='of a column: the title in a table, or topic and field of messages, "/odom.twist.linear.x"; by '
        "default its own name",
    )
    time: str | None = Field(
        default=None,
        min_length=1,
        max_length=1000,
        description='the title of the time in a table, by default `t`; of messages a field with the time, such as "'
        'header.stamp", by default when they were logged',
    )
    factors: dict[str, float] = Field(
        default_factory=dict,
        max_length=1000,
        description="of a column, or of `t`: what the numbers of the log are multiplied by to get its unit",
    )
    offset: Literal["first"] | Magnitude = Field(
        default=0.0,
        description='the time in the log at which a rollout begins, in s; "first": that of the first sample of all '
        "columns. The column `offset` of the starts has one for each log",
    )
    resample: float | None = Field(
        default=None,
        gt=0,
        le=1e6,
        description="s between two samples of a rollout; required where columns have unlike times",
    )
    between: Literal["linear", "previous"] = Field(
        default="linear", description="with `resample`: values between two samples of a log"
    )
    max_gap: float | None = Field(
        default=None,
        gt=0,
        description="longest s between two samples of a log; by default ten times the median of that log",
    )
    limits: dict[str, tuple[Magnitude, Magnitude]] = Field(
        default_factory=dict,
        max_length=1000,
        description="of a column: the values that it can have, [low, high]; a log with others, as of another unit, is "
        "refused",
    )
    delimiter: str = Field(default=",", min_length=1, max_length=1, description="between two cells of a CSV file")
    decimal: Literal[".", ","] = Field(default=".", description="decimal sign of a CSV file")
    extra: Literal["refuse", "ignore"] = Field(
        default="refuse", description="what happens to columns of a table that nothing above names"
    )

    @model_validator(mode="after")
    def _readable(self) -> "LogMapping":
        if self.delimiter == self.decimal:
            raise ValueError(f'delimiter: {self.delimiter!r} is the decimal sign as well; give delimiter = ";"')
        for name, factor in self.factors.items():
            if not factor or abs(factor) > 1e100:
                raise ValueError(f"factors.{name}: {factor:g} is not allowed; give a number other than 0")
        for name, (low, high) in self.limits.items():
            if not low < high:
                raise ValueError(f"limits.{name}: {low:g} must be less than {high:g}")
        return self

    def title(self, column: str) -> str:
        """Return where a log has a column."""
        return self.columns.get(column, column)

    def check_columns(self, columns: dict[str, str]) -> None:
        """Refuse keys for columns that the system does not have; raises ValueError."""
        for key in ("columns", "factors", "limits"):
            known = [*columns, "t"] if key == "factors" else list(columns)
            for name in getattr(self, key):
                if name not in known:
                    raise ValueError(f"logs.{key}.{name}: the system has the columns {', '.join(known)}")


class RecordedTest(Model):
    """One test of a campaign that was imported: its log and its start."""

    log: str = Field(min_length=1, max_length=1000, description="its file, below the folder of the logs")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$", description="of the file")
    start: dict[str, Magnitude] = Field(min_length=1, description="the start that was driven, by parameter")
    offset: Magnitude | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="time in the log at which the test begins, in s, where it is not that of all logs",
    )
