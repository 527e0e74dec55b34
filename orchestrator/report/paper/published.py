"""The printed results of the method paper: Table I, the claims below it, and the numbers of tests in its text."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Printed:
    """One result of the paper, as text, because it rounds."""

    symbol: str
    bound: str
    probability: str = ""
    tests: str = ""


THEOREM_2 = "theorem 2"
"""Row of the composed claim; the other rows are named after their problem."""

TABLE = {
    "true_risk": Printed("rho* >=", "0.31", "0.92", "385"),
    "nominal_robustness": Printed("rho~ =", "0.46"),
    "sim_gap": Printed("e~ =", "0.38"),
    THEOREM_2: Printed("rho* >=", "0", "0.84", "128"),
    "maximum": Printed("eps =", "(0.5, 0.53]"),
}
"""The rows of Table I, then those of the text: both problems together, and the test function."""
