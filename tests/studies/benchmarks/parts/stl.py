"""CPU microseconds of the robustness of one trajectory, ours against rtamt, and whether the two agree.

Both run in the environment of the peers, one after the other; this prints JSON:

.venv-bench/bin/python -m tests.studies.benchmarks.parts.stl

rtamt pins an old antlr4 runtime, so it stays out of our lock.

rtamt (discrete time, offline) reads the left side of `until` up to, but without, the moment of the right side, and
cuts intervals at the end of the trajectory instead of refusing them. `f until g` of ours is its `f until (f and g)`;
the reading of [ARA] is that, from a on. At time 0 of a trajectory that is long enough the two must agree.
"""

import importlib
import importlib.util
import json
import random
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from perfbound.orchestrator.mathematics.stl.horizon import check_horizon
from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.orchestrator.mathematics.stl.predicates import Floats, predicate_sup
from perfbound.orchestrator.mathematics.stl.robustness import robustness
from perfbound.orchestrator.mathematics.stl.text import operator, text
from perfbound.orchestrator.mathematics.stl.tree import (
    REST,
    Always,
    And,
    Comparison,
    Edge,
    Eventually,
    Fall,
    Formula,
    Historically,
    Implies,
    Interval,
    Next,
    Not,
    Once,
    Or,
    Previous,
    Rise,
    Since,
    Temporal,
    Until,
)
from tests.studies.benchmarks.report import Row

Results = dict[str, Any]

COLUMNS = ("t", "phi", "x", "y")
STEP = 10  # ms; rtamt wants intervals that are multiples of it
SAMPLES = 1801
AGREEMENTS = 300
LONGEST = 0.5
"""s; no trajectory of the random formulas is longer."""
TIMED = {
    "always": "always (abs(phi) <= 0.95)",
    "always[0,15]": "always[0,15] (abs(phi) <= 0.95)",
    "issue": "always[0,15] (abs(phi) <= 0.95 and (x - 2.5) * (x - 2.5) + (y - 2.5) * (y - 2.5) <= 9)",
    "response": "always[0,10] (phi >= 0.5 implies eventually[0,2] phi <= 0.4)",
    "until until": "(phi <= 0.9 until x >= 0.5) until (y <= 1 until x <= 0.5)",
    "until[] until[]": "(phi <= 0.9 until[0,0.3] x >= 0.5) until[0.1,0.4] (y <= 1 until[0.1,0.3] x <= 0.5)",
    "until_from[] until_from[]": (
        "(phi <= 0.9 until_from[0,0.3] x >= 0.5) until_from[0.1,0.4] (y <= 1 until_from[0.1,0.3] x <= 0.5)"
    ),
}
LIMITS = {"always": 6, "wide": 600}
"""Limit of a formula, as a multiple of the reference; measured were 3 and 150."""
WIDE = "(phi <= 0.9 until[0,3] x >= 0.5) until[2,8] (y <= 1 until[1,4] x <= 0.5)"  # hours in rtamt


def measured() -> Results:
    """Return (ours, rtamt's) best CPU us per evaluation by formula, and the largest disagreement.

    Without rtamt, which is then None, as it is for a formula that takes it hours.
    """
    samples = _samples(SAMPLES)
    rtamt = importlib.util.find_spec("rtamt") is not None
    times: dict[str, tuple[float, float | None]] = {}
    differences = [0.0]
    for name, line in {**TIMED, "wide": WIDE}.items():
        ours = _ours(line, samples)
        theirs = Rtamt(parse_formula(line), samples).robustness if rtamt and name in TIMED else None
        times[name] = (_microseconds(ours), theirs and _microseconds(theirs, batch=1, repeats=2))
        if theirs:
            differences.append(abs(theirs() - ours()))
    tree = parse_formula(TIMED["issue"])
    times["predicate_sup of issue"] = (_microseconds(lambda: predicate_sup(tree, COLUMNS, samples, samples)), None)
    reference = _microseconds(lambda: np.minimum.accumulate(np.abs(samples[:, 1])))
    return {
        "times": times,
        "reference": reference,
        "difference": max(*differences, _largest_difference()) if rtamt else None,
    }


def main(found: Results) -> list[Row]:
    """Return the rows of what `measured` has found, here or in the environment of the peers."""
    rows = [
        Row(f"STL on {SAMPLES} instants: {name}", ours, "us", "rtamt" if theirs else "", theirs)
        for name, (ours, theirs) in found["times"].items()
    ]
    rows += [
        Row(
            f"STL on {SAMPLES} instants: {name}",
            found["times"][name][0],
            "us",
            "|x| and its running minimum in numpy",
            found["reference"],
            ratio_at_least=1 / limit,
        )
        for name, limit in LIMITS.items()
    ]
    if found["difference"] is not None:
        rows.append(Row(f"STL, {AGREEMENTS} random formulas: largest difference", found["difference"], "1", "rtamt"))
    return rows


def _samples(size: int, seed: int = 0) -> Floats:
    """Return a trajectory (size, 4) at multiples of STEP."""
    rng = np.random.default_rng(seed)
    return np.column_stack([np.arange(size) * (STEP / 1000), rng.normal(size=(size, 3)).cumsum(axis=0) / 20])


def _ours(line: str, samples: Floats) -> Callable[[], float]:
    tree = parse_formula(line, COLUMNS)
    return lambda: robustness(tree, COLUMNS, samples)


def _microseconds(call: Callable[[], object], *, batch: int = 100, repeats: int = 15) -> float:
    """Return the least CPU time of a call over `repeats` batches."""
    times = []
    for _ in range(repeats):
        start = time.process_time_ns()
        for _ in range(batch):
            call()
        times.append((time.process_time_ns() - start) / 1000 / batch)
    return round(min(times), 1)


class Rtamt:
    """One formula in rtamt, parsed beforehand as ours is."""

    def __init__(self, tree: Formula, samples: Floats) -> None:
        rtamt: Any = importlib.import_module("rtamt")
        self._specification = rtamt.StlDiscreteTimeOfflineSpecification()
        for name in COLUMNS[1:]:
            self._specification.declare_var(name, "float")
        self._specification.set_sampling_period(STEP, "ms", 0.1)
        self._specification.spec = translate(tree)
        self._specification.parse()
        self._data = {("time" if name == "t" else name): samples[:, i].tolist() for i, name in enumerate(COLUMNS)}

    def robustness(self) -> float:
        """Return the robustness of rtamt at the first sample."""
        return float(self._specification.evaluate(self._data)[0][1])


def translate(tree: Formula) -> str:
    """Return the formula as rtamt reads it, with our meaning."""
    match tree:
        case Comparison():
            return f"({text(tree)})"
        case Not(operand):
            return f"(not {translate(operand)})"
        case And(left, right):
            return f"({translate(left)} and {translate(right)})"
        case Or(left, right):
            return f"({translate(left)} or {translate(right)})"
        case Implies(left, right):
            return f"({translate(left)} -> {translate(right)})"
        case _:
            return _over_time(tree)


def _over_time(tree: Temporal) -> str:
    match tree:
        case Always(operand, interval):
            return _from(interval, lambda between: f"(always{between} {translate(operand)})")
        case Eventually(operand, interval):
            return _from(interval, lambda between: f"(eventually{between} {translate(operand)})")
        case Until():
            return _until(tree)
        case Historically(operand, interval) | Once(operand, interval):
            return f"({operator(tree)}{_past(interval)} {translate(operand)})"
        case Since(left, right, interval):
            return f"({translate(left)} since{_past(interval)} ({translate(left)} and {translate(right)}))"
        case Next(operand):
            return f"(not (next (not {translate(operand)})))"
        case Previous(operand):
            return f"(not (prev (not {translate(operand)})))"
        case Rise() | Fall():
            return translate(changed(tree))


def changed(tree: Edge) -> And:
    """Return what `rise` and `fall` mean, in other operators."""
    before, now = tree.operand, Not(tree.operand)
    return And(Previous(now), before) if isinstance(tree, Rise) else And(Previous(before), now)


def _past(interval: Interval) -> str:
    """Write an interval of the past; rtamt has none that ends with the trajectory."""
    return "" if interval == REST else _between(interval.low, min(interval.high, LONGEST))


def _until(tree: Until) -> str:
    left, right, interval = translate(tree.left), translate(tree.right), tree.interval
    both = f"({left} and {right})"
    if tree.reading == "standard" and interval.bounded:
        return f"({left} until{_between(interval.low, interval.high)} {both})"
    later = Interval(0.0, interval.high - interval.low)
    rest = _from(later, lambda between: f"({left} until{between} {both})")
    from_start = f"(eventually{_between(interval.low, interval.low)} {rest})"
    return from_start if tree.reading == "paper" else f"((always{_between(0.0, interval.low)} {left}) and {from_start})"


def _from(interval: Interval, write: Callable[[str], str]) -> str:
    """Write an operator over `interval`; rtamt has no [a,inf)."""
    if interval == REST:
        return write("")
    if interval.bounded:
        return write(_between(interval.low, interval.high))
    return f"(eventually{_between(interval.low, interval.low)} {write('')})"


def _between(low: float, high: float) -> str:
    return f"[{round(low * 1000)}ms:{round(high * 1000)}ms]"


def _largest_difference() -> float:
    rng, differences = random.Random(0), [0.0]
    while len(differences) <= AGREEMENTS:
        tree, samples = _draw(rng, 3), _samples(rng.randint(5, 40), rng.randrange(2**32))
        try:
            check_horizon(tree, float(samples[-1, 0]))
            ours = robustness(tree, COLUMNS, samples)
        except ValueError:  # too long, or decided by what is before the start
            continue
        differences.append(abs(ours - Rtamt(tree, samples).robustness()))
    return max(differences)


def _draw(rng: random.Random, depth: int) -> Formula:
    if depth == 0:
        signal = rng.choice(["abs(phi)", "x - 2 * y", "x * x + y", "phi / 2 + 1"])
        return parse_formula(f"{signal} {rng.choice(['<=', '<', '>', '>='])} {rng.randint(0, 9) / 10}")
    left, right = _draw(rng, rng.randrange(depth)), _draw(rng, rng.randrange(depth))
    low, high = sorted(rng.randrange(8) * STEP / 1000 for _ in range(2))
    interval = rng.choice([REST, Interval(low), Interval(low, high), Interval(low, high)])
    options: list[Formula] = [Not(left), And(left, right), Or(left, right), Implies(left, right)]
    options += [Always(left, interval), Eventually(left, interval)]
    options += [Until(left, right, interval), Until(left, right, interval, "paper")] * 2
    options += [Historically(left, interval), Once(left, interval), Since(left, right, interval)]
    options += [Previous(left), Rise(left), Fall(left)]
    return rng.choice(options)


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measured()) + "\n")
