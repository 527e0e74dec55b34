"""A benchmark of the competition: a model, the parameters of its inputs, and a requirement."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from perfbound.orchestrator.mathematics.stl.parser import Formula, parse_formula

Floats = NDArray[np.float64]
Rollout = tuple[Floats, Mapping[str, Floats]]
"""Times (T,) in s and the values (T,) of each column."""


@dataclass(frozen=True)
class Benchmark:
    """A requirement on a model whose inputs follow from a point of a box; a failure is a robustness below 0."""

    name: str
    """As the competition has it: `AT1`."""
    instance: int
    """1: inputs of any form, here with the knots that the module of the model names; 2: of the prescribed form."""
    low: tuple[float, ...]
    high: tuple[float, ...]
    formula: str
    """In the language of perfbound."""
    simulate: Callable[[Floats], Rollout]
    """From a point (p,) of the box, in the units of the inputs."""
    simulate_each: Callable[[Floats], Rollout] | None = None
    """From points (R, p): columns (R, T), where the model has more than one rollout at once."""
    inputs: tuple[int, ...] = ()
    """Knots of each input over time, in the order of the parameters; those after them are numbers."""

    @cached_property
    def parsed(self) -> Formula:
        """The tree of the formula."""
        return parse_formula(self.formula)

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.low)

    @property
    def signals(self) -> list[range]:
        """The parameters of each input over time.

        >>> Benchmark("B", 1, (0.0,) * 6, (1.0,) * 6, "x > 0", lambda _: ({}, {}), inputs=(2, 3)).signals
        [range(0, 2), range(2, 5)]
        """
        ends = list(accumulate(self.inputs))
        return [range(end - knots, end) for knots, end in zip(self.inputs, ends, strict=True)]
