"""The problems of a campaign file: one row of properties for each name.

A new problem is a name and a row. Modules ask for the properties and not for the name, so that a problem which is
measured like an older one needs nothing else; a new `Measured` needs a branch where mypy finds one missing.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from ..system import SystemSpec, Variant

ProblemName = Literal["nominal_robustness", "sim_gap", "true_risk", "robustness", "maximum"]
MethodName = Literal["paper", "rigorous", "kriging", "scenario", "sample"]
Sense = Literal["min", "max"]
Measured = Literal["robustness", "gap", "column"]
"""The number of one rollout, or of a pair: of the specification, of the comparison, or of one column."""
Reading = Literal["sign", "each", "mean", "risk"]
"""How a statement reads values: their signs, each by itself, their mean, or their mean less a multiple of their
deviation."""
Quantity = Literal[
    "rho_star",
    "J_star",
    "robustness",
    "expected_robustness",
    "safe_share",
    "failure_probability",
    "quantile",
    "cvar",
    "mean",
    "risk",
    "share_of_starts",
    "next_rollout",
]
"""The subject of a claim; those from `failure_probability` on are of drawn starts, see `claims`."""


@dataclass(frozen=True, slots=True)
class Statement:
    """The subject of a bound, in words and as the quantity of its claim."""

    words: str
    """`{gap}` is replaced by the kind of the gap in words."""
    quantity: Quantity | None = None
    """None for a term of a composition, which is no claim by itself."""


@dataclass(frozen=True, slots=True)
class Objective:
    """The properties of one problem."""

    sense: Sense
    measured: Measured
    statement: Statement
    variants: tuple[Variant, ...] = ()
    """Rolled out by a test; empty for a question about one simulator, see `rolled_out`."""
    methods: tuple[MethodName, ...] = ("paper", "rigorous")
    risk: bool = False
    """Whether E - r sd is bounded, and not E."""
    static: bool = False
    """Whether it can be asked of a function: at horizon 0, and without a clip where nothing is random."""
    exact: Statement | None = None
    """The statement where R = 0 and an observation is the value itself; None for the same one."""


OBJECTIVES: Mapping[ProblemName, Objective] = {
    "nominal_robustness": Objective(
        "min", "robustness", Statement("min over d of E[robustness of the nominal system]"), ("nominal",)
    ),
    "sim_gap": Objective(
        "max", "gap", Statement("max over d of E[{gap}]"), ("nominal", "true"), ("paper", "rigorous", "kriging")
    ),
    "true_risk": Objective(
        "min",
        "robustness",
        Statement("min over d of E[robustness] - r sd[robustness] of the true system", "rho_star"),
        ("true",),
        ("paper", "rigorous", "kriging", "scenario"),
        risk=True,
    ),
    "robustness": Objective(
        "min",
        "robustness",
        Statement("min over d of E[robustness]", "expected_robustness"),
        methods=("paper", "rigorous", "kriging", "scenario", "sample"),
        static=True,
        exact=Statement("min over d of robustness", "robustness"),
    ),
    "maximum": Objective("max", "column", Statement("max over d of E[column]", "J_star"), ("true",), static=True),
}
CLAIMS = tuple(name for name, each in OBJECTIVES.items() if each.statement.quantity)
"""The problems whose bound is a claim by itself; the others are terms of a composition."""
OF_ROBUSTNESS = tuple(name for name in CLAIMS if OBJECTIVES[name].measured == "robustness")
"""Those of them that say by how much the specification is met."""


def rolled_out(name: ProblemName, spec: SystemSpec) -> tuple[Variant, ...]:
    """Return the variants that a test of a problem simulates, of a gap the nominal one first."""
    # A question about one simulator: the variant `true`, or the only one.
    return OBJECTIVES[name].variants or (("true",) if "true" in spec.variants else spec.variants[:1])


def replicates_are_robustness(name: ProblemName, method: MethodName) -> bool:
    """Return whether the replicates of an observation are robustness and not J, see `values.Observation`."""
    return method in {"scenario", "sample"} or (method == "paper" and OBJECTIVES[name].risk)


def any_of(names: Iterable[str]) -> str:
    """Return quoted names as a choice.

    >>> any_of(("a", "b", "c"))
    "'a', 'b' or 'c'"
    """
    *first, last = map(repr, names)
    return " or ".join(filter(None, (", ".join(first), last)))
