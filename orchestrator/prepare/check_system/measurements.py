"""What was measured of a system."""

import math
from dataclasses import dataclass

from ....schemas.system import SystemSpec
from ....schemas.system_check import ChildRun, Measured, Trial

Rolled = tuple[Trial, Measured]


@dataclass(frozen=True)
class Measurements:
    """What was measured of one system: the runs of the child processes `fresh`, `first` and `second`.

    Behind them stand those that ended at the start of another `fresh`.
    """

    spec: SystemSpec
    runs: tuple[ChildRun, ...]
    limit: float  # s
    processors: int
    together: tuple[ChildRun, ...] = ()
    """Processes that ran at the same time; empty if none did."""
    batched: ChildRun | None = None
    """The batches of a vectorised system."""
    undecided: float = math.inf
    """Rollouts of the campaign whose starts no rollout decides."""
    own_horizon: bool = False
    program: str = ""
    """Of the campaign file, with its arguments; empty for a system in Python."""

    @property
    def horizon(self) -> float:
        """Length of the rollouts in s; a few are shorter."""
        return self.runs[0].trials[0].request.horizon

    @property
    def rolled(self) -> list[Rolled]:
        """Every measured rollout of the horizon, in the order of the processes."""
        return [pair for pair in self._all if pair[0].request.horizon == self.horizon]

    @property
    def good(self) -> list[Rolled]:
        """Those with a trajectory."""
        return [(trial, found) for trial, found in self.rolled if not found.error]

    @property
    def shorter(self) -> list[Rolled]:
        """The measured rollouts of a shorter horizon; nothing rests on them."""
        return [pair for pair in self._all if pair[0].request.horizon < self.horizon]

    @property
    def _all(self) -> list[Rolled]:
        return [pair for run in self.runs for pair in zip(run.trials, run.measured, strict=False)]

    def rows(self, run: int) -> list[Rolled]:
        """Return the rollouts of one process; none if it was not started."""
        return list(zip(self.runs[run].trials, self.runs[run].measured, strict=False)) if run < len(self.runs) else []
