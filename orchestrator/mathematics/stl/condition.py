"""The truth of a formula without time at points: a condition on starts.

| symbol | name      | meaning                                            | shape  | unit       |
|--------|-----------|----------------------------------------------------|--------|------------|
| x      | `points`  | points, a column for each name                     | (n, p) | per column |
| mu_j   |           | margin of predicate j at every point               | (n,)   | of the predicate |
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .errors import FormulaError
from .predicates import Floats, Signals
from .text import operator
from .tree import And, Comparison, Formula, Implies, Not, Or, Temporal, walk

Truth = NDArray[np.bool_]


def check_timeless(tree: Formula) -> None:
    """Refuse an operator over time.

    Raises:
        FormulaError: the formula has one.

    """
    for node in walk(tree):
        if isinstance(node, Temporal):
            raise FormulaError(
                f"a condition on starts has no time; leave out {operator(node)} and the other operators over time"
            )


def holds(tree: Formula, columns: Sequence[str], points: Floats) -> Truth:
    """Return whether a formula without time holds at each of `points` (n, p), shape (n,).

    Unlike robustness this tells `<` from `<=`. A point at which some predicate has no finite value, as 1/x at 0, is
    none at which the formula holds.

    >>> from perfbound.orchestrator.mathematics.stl.parser import parse_formula
    >>> tree = parse_formula("x^2 + y^2 <= 25 and not (1/x > 1)")
    >>> holds(tree, ("x", "y"), np.array([[3.0, 4.0], [3.0, 4.1], [0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])).tolist()
    [True, False, False, False, True]

    """
    signals = Signals(columns, points)
    finite = np.ones(len(points), dtype=np.bool_)

    def truth(node: Formula) -> Truth:
        match node:
            case Comparison():
                margins = signals.any_margins(node)
                np.logical_and(finite, np.isfinite(margins), out=finite)
                return margins >= 0 if node.operator in {"<=", ">="} else margins > 0  # of == and != it is never 0
            case Not():
                return ~truth(node.operand)
            case And():
                return truth(node.left) & truth(node.right)
            case Or():
                return truth(node.left) | truth(node.right)
            case Implies():
                return ~truth(node.left) | truth(node.right)
        check_timeless(node)
        raise AssertionError("every other formula has time")

    found = truth(tree)
    return found & finite
