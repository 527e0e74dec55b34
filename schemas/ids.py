"""Names of a rollout and of an attempt at it: the only reader and writer of their text form."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

SPOT_CHECK, RISK_CHECK, SHRINK, IMPORTANCE, SIMPLEST, RECHECK = CLOSING = (
    "spot_check",
    "risk_check",
    "shrink",
    "importance_sampling",
    "simplest",
    "recheck",
)
"""The closing checks: series of tests that follow those of the problems, in this order."""


def of_extension(check: str, number: int) -> str:
    """Return the name of a closing check after so many extensions of the campaign.

    The number is in letters, the only characters of a series besides `_` in messages and file names.

    >>> [of_extension("recheck", number) for number in (0, 1, 2, 26)]
    ['recheck', 'recheck_b', 'recheck_c', 'recheck_ba']
    """
    letters = ""
    while number:
        number, digit = divmod(number, 26)
        letters = chr(ord("a") + digit) + letters
    return f"{check}_{letters}" if letters else check


def closing_check(series: str) -> str | None:
    """Return the closing check that a series is, whichever extension it follows; None for a problem.

    >>> closing_check("spot_check_b"), closing_check("sim_gap")
    ('spot_check', None)
    """
    found = check_of_extension(series)
    return found and found[0]


def check_of_extension(series: str) -> tuple[str, int] | None:
    """Return the closing check that a series is, and after how many extensions; None for a problem.

    >>> check_of_extension("recheck"), check_of_extension("spot_check_b"), check_of_extension("sim_gap")
    (('recheck', 0), ('spot_check', 1), None)
    """
    if series in CLOSING:
        return series, 0
    check, _, letters = series.rpartition("_")
    number = 0
    # In letters, since messages, manifest and page take names of a to z and _ alone.
    for letter in letters:
        number = 26 * number + ord(letter) - ord("a")
    return (check, number) if check in CLOSING else None


def series_order(problems: Sequence[str], series: str) -> tuple[int, int]:
    """Return what sorts series: problems as in the campaign file, then the closing checks, round by round."""
    found = check_of_extension(series)
    return (-1, problems.index(series)) if found is None else (found[1], CLOSING.index(found[0]))


class RolloutId(NamedTuple):
    """One rollout of the campaign."""

    problem: str
    test: int
    variant: str
    replicate: int

    def __str__(self) -> str:
        return f"{self.problem}.{self.test}.{self.variant}.{self.replicate}"

    @classmethod
    def parse(cls, text: str) -> "RolloutId":
        """Read the text form.

        Raises:
            ValueError: `text` is not of the form problem.test.variant.replicate.

        >>> RolloutId.parse("sim_gap.3.true.0")
        RolloutId(problem='sim_gap', test=3, variant='true', replicate=0)

        """
        problem, test, variant, replicate = text.split(".")
        found = cls(problem, int(test), variant, int(replicate))
        if str(found) != text:  # `int` takes 0_1 and digits of other scripts: one rollout has one name
            raise ValueError(f"{text!r} is no name of a rollout")
        return found


def rollout_at(first: RolloutId, place: int, replicates: int) -> RolloutId:
    """Return the rollout in a place of the batch that begins with `first`, with so many replicates of each test.

    >>> str(rollout_at(RolloutId("gap", 8, "true", 0), 5, replicates=2))
    'gap.10.true.1'
    """
    test, number = divmod(place, replicates)
    return RolloutId(first.problem, first.test + test, first.variant, first.replicate + number)


class FileId(NamedTuple):
    """A file of trajectories: that of a rollout, or of a batch, which has so many `places` from a rollout on."""

    rollout: RolloutId
    places: int = 0

    def __str__(self) -> str:
        return f"{self.rollout}.{self.places}" if self.places else str(self.rollout)

    @classmethod
    def parse(cls, text: str) -> "FileId":
        """Read the text form.

        Raises:
            ValueError: `text` has another form.

        >>> FileId.parse("sim_gap.3.true.0.256")
        FileId(rollout=RolloutId(problem='sim_gap', test=3, variant='true', replicate=0), places=256)

        """
        parts = text.split(".")
        found = cls(RolloutId.parse(".".join(parts[:4])), int("".join(parts[4:5]) or 0))
        if str(found) != text:
            raise ValueError(f"{text!r} is no name of a file")
        return found


WorkId = RolloutId | FileId
"""What is assigned: a rollout, or a batch by its file, which the retry of its first rollout does not share."""


def parse_work(text: str) -> WorkId:
    """Return the rollout or the batch of this name; raises ValueError as `FileId.parse`.

    >>> parse_work("mean.3.true.0") == RolloutId.parse("mean.3.true.0")
    True
    >>> str(parse_work("mean.3.true.0.256"))
    'mean.3.true.0.256'
    """
    found = FileId.parse(text)
    return found if found.places else found.rollout


def rollouts_of(work: WorkId) -> int:
    """Return the number of rollouts: 1, or those of the batch."""
    return work.places if isinstance(work, FileId) else 1


def first_of(work: WorkId) -> RolloutId:
    """Return the rollout, or the first one of the batch."""
    return work.rollout if isinstance(work, FileId) else work


@dataclass(frozen=True, slots=True)
class Attempt:
    """One try of a rollout or of a batch; numbered from 1."""

    rollout: WorkId
    number: int
