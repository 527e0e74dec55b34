"""The sentences beside a claim that rests on refuted assumptions: what refutes them, and whether it is false itself."""

from collections.abc import Mapping, Sequence
from decimal import ROUND_FLOOR, Context

from ....schemas.amounts import counted, some_of
from ....schemas.result.certificate import (
    Counterexample,
    DrawnValue,
    FailureAtStart,
    LikeliestFailure,
    RiskAtStart,
    Simplest,
)
from ..assumptions.statements import statement
from .bound_text import DIGITS, in_unit, outward

BY_DERIVATION = {"centred_noise"}
"""Assumptions that are refuted without any data; all others are refuted by data."""


def refutation_sentence(refuted: Sequence[str]) -> str:
    """Return why nobody should rely on a claim; `refuted` are the ids of its refuted assumptions, at least one.

    >>> refutation_sentence(("rkhs_norm/nominal_robustness", "rkhs_norm/sim_gap"))
    'REFUTED by its own data: rkhs_norm of nominal_robustness and sim_gap. Do not rely on it.'
    >>> refutation_sentence(("centred_noise/true_risk", "workers_honest"))
    'REFUTED by its own data: workers_honest; by derivation: centred_noise of true_risk. Do not rely on it.'
    """
    derived = [each for each in refuted if each.partition("/")[0] in BY_DERIVATION]
    sources = {"by its own data": [each for each in refuted if each not in derived], "by derivation": derived}
    found = "; ".join(f"{source}: {_listed(those)}" for source, those in sources.items() if those)
    return f"REFUTED {found}. Do not rely on it."


def refutation_words(refuted: Sequence[str]) -> str:
    """Return what is refuted in plain words, with the ids behind each statement.

    >>> refutation_words(("rkhs_norm/nominal_robustness", "rkhs_norm/sim_gap"))
    'The data refute that the norm bound B is large enough for this kernel and prior mean (rkhs_norm of \
nominal_robustness and sim_gap).'
    >>> refutation_words(("workers_honest", "centred_noise/true_risk"))
    'The data refute that worker processes send what they simulated (workers_honest). By derivation it is \
wrong that an observation is right on average (centred_noise of true_risk).'
    """
    derived = [each for each in refuted if each.partition("/")[0] in BY_DERIVATION]
    sources = {
        "The data refute": [each for each in refuted if each not in derived],
        "By derivation it is wrong": derived,
    }
    return " ".join(f"{source} {_stated(those)}." for source, those in sources.items() if those)


def risk_sentence(subject: str, at_start: RiskAtStart, risk: str, limit: str) -> str:
    """Return whether the risk at a start is below a bound that is refuted there, with the rounded bounds of both."""
    if at_start.status == "below":
        shown = f"at most {risk}, below the bound {limit}, by {at_start.rollouts:,} further rollouts"
        return f"{subject}: {shown}: the claim is false."
    open_question = f"whether the risk itself is below the bound {limit}"
    rollouts = f"{at_start.rollouts:,} further rollouts (it is at most {risk})"
    return f"{subject}: the claim has lost its grounds; {open_question} is not decided by {rollouts}."


def _stated(refuted: Sequence[str]) -> str:
    """Return the statements of refuted assumptions, each once, with their ids."""
    found: dict[str, list[str]] = {}
    for each in refuted:
        found.setdefault(statement(each), []).append(each)
    return ", and ".join(f"that {words} ({_listed(those)})" for words, those in found.items())


def _listed(refuted: Sequence[str]) -> str:
    """Return ids as words, each name once: `rkhs_norm/a`, `rkhs_norm/b` as `rkhs_norm of a and b`."""
    problems: dict[str, list[str]] = {}
    for each in refuted:
        name, _, problem = each.partition("/")
        problems.setdefault(name, []).extend([problem] if problem else [])
    return ", ".join(f"{name} of {' and '.join(those)}" if those else name for name, those in problems.items())


# The counterexample, and what a bisection made of it, if it was sought


def counterexample_parts(found: Counterexample, unit: str, units: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """Return what a counterexample is, and what followed it, in a part each.

    `unit` is that of the robustness, `units` those of the parameters.
    """
    start = named_start(found.start, units)
    others = f", the worst of its {found.rollouts:,} rollouts" if found.rollouts > 1 else ""
    margin = margin_words(found.robustness, unit)
    drawn = f" ({values_words(found.disturbances)})" if found.disturbances else ""
    words = f"test {found.test:,} violates the specification: robustness {margin} at {start}{drawn}, seed {found.seed}"
    after = (
        _shrunk_words(found, unit, units),
        _likeliest_words(found, unit, units),
        _at_start_words(found.likeliest),
        simplest_words(found.simplest, unit, units),
    )
    return (f"{words} (rollout {found.rollout}{others})", *filter(None, after))


def simplest_words(found: Simplest | None, unit: str, units: Mapping[str, str] | None) -> str:
    """Return with how few parameters away from their nominal values the system still fails; empty for None.

    >>> near = Simplest(
    ...     nominal={"throttle_3": 0.5, "brake_1": 0.5, "wind": 0.0},
    ...     start={"throttle_3": 0.9, "brake_1": 0.1, "wind": 0.0},
    ...     away=("throttle_3", "brake_1"),
    ...     robustness=-0.25,
    ...     rollout="simplest.9.nominal.0",
    ...     rollouts=12,
    ... )
    >>> simplest_words(near, "", {})
    'it fails with only throttle_3 = 0.9, brake_1 = 0.1 away from their nominal values, robustness -0.2500 (rollout \
simplest.9.nominal.0), after 12 rollouts with this seed'
    """
    if found is None:
        return ""
    after = f"after {counted(found.rollouts, 'rollout')} with this seed"
    margin = f"robustness {margin_words(found.robustness, unit)} (rollout {found.rollout})"
    if not found.away:
        return f"it fails with every parameter at its nominal value, {margin}, {after}"
    if len(found.away) == len(found.start):
        return f"it fails with none of the groups of parameters at their nominal values that were tried, {after}"
    their = "their nominal values" if len(found.away) > 1 else "its nominal value"
    left = named_start({name: found.start[name] for name in found.away}, units)
    return f"it fails with only {left} away from {their}, {margin}, {after}"


def _likeliest_words(found: Counterexample, unit: str, units: Mapping[str, str] | None) -> str:
    """Return the likeliest failure that was found after a counterexample; empty where it was not sought."""
    near = found.likeliest
    if near is None:
        return ""
    where = f"{named_start(near.start, units)} ({values_words(near.disturbances)})"
    return (
        f"the likeliest failure of {counted(near.rollouts, 'further rollout')} is {near.distance:.2f} sd from the "
        f"medians: {where}, robustness {margin_words(near.robustness, unit)} (rollout {near.rollout})"
    )


def _at_start_words(near: LikeliestFailure | None) -> str:
    """Return how likely a failure is at the start of the likeliest one; empty where that was not asked."""
    return "" if near is None or near.at_start is None else at_start_words(near.at_start)


def at_start_words(found: FailureAtStart) -> str:
    """Return how likely a failure is at a start.

    >>> sampled = FailureAtStart(bound=1.239e-5, probability=0.95, rollouts=200, failures=81, share=0.1)
    >>> at_start_words(sampled)
    'from this one start, with disturbances as declared, a rollout fails with probability at least 1.23e-05 (right \
with probability 0.9500, from 200 rollouts around this failure, of which 81 fail)'
    """
    shown = f"{counted(found.rollouts, 'rollout')} around this failure, of which {found.failures:,} fail"
    if not found.bound:
        return f"{shown}, show no probability of a failure"
    # Down, and not to so many digits after the point: a rare failure is one of 1e-9 as well.
    bound = Context(prec=3, rounding=ROUND_FLOOR).create_decimal(repr(found.bound))
    right = outward(found.probability, ">=")
    return (
        f"from this one start, with disturbances as declared, a rollout fails with probability at least "
        f"{float(bound):g} (right with probability {right}, from {shown})"
    )


def _shrunk_words(found: Counterexample, unit: str, units: Mapping[str, str] | None) -> str:
    """Return where the system still fails nearer to the nominal start; empty where that was not sought."""
    near = found.shrunk
    if near is None:
        return ""
    tried = f"{counted(near.rollouts, 'rollout')} towards {named_start(near.nominal, units)}"
    if near.rollout == found.rollout:
        return f"after {tried} no start that was tried on the line there fails"
    where = (
        f"{named_start(near.start, units)}, robustness {margin_words(near.robustness, unit)} (rollout {near.rollout})"
    )
    return f"on the line there, with this seed, the failing start next to one that passes, after {tried}: {where}"


def values_words(disturbances: Mapping[str, DrawnValue]) -> str:
    """Return the values of disturbances.

    >>> values_words({"gust": DrawnValue(value=5.80000001, unit="m/s"), "drag": DrawnValue(value=1.0, unit="")})
    'gust = 5.8 m/s, drag = 1'
    """
    return ", ".join(in_unit(f"{name} = {each.value:.4g}", each.unit) for name, each in disturbances.items())


def margin_words(robustness: float, unit: str) -> str:
    """Return a robustness with its unit, if it has one; it is a value, and no bound.

    >>> margin_words(-0.05, "rad"), margin_words(-1e-9, "rad"), margin_words(0.0, "")
    ('-0.0500 rad', '-1e-09 rad', '0.0000')
    """
    rounded = f"{robustness:.{DIGITS}f}"
    # A failure next to the border is one.
    return in_unit(f"{robustness:.2g}" if robustness and not float(rounded) else rounded, unit)


def named_start(start: Mapping[str, float], units: Mapping[str, str] | None = None) -> str:
    """Return a start with the names of its parameters; where units are given, with these, and in their order.

    >>> named_start({"mass": 0.25, "gap": 5.0}, {"gap": "m", "mass": "1"})
    'gap = 5 m, mass = 0.25'
    """
    shown = units or {}
    names = [name for name in shown if name in start] + [name for name in start if name not in shown]
    return some_of([in_unit(f"{name} = {start[name]:.7g}", shown.get(name, "")) for name in names])
