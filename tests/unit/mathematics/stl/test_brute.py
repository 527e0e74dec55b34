"""Random formulas on random traces, against an evaluator that shares nothing with ours: the definition, with loops."""

import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.stl.parser import FormulaError, parse_formula
from perfbound.orchestrator.mathematics.stl.predicates import predicate_sup
from perfbound.orchestrator.mathematics.stl.reach import reach
from perfbound.orchestrator.mathematics.stl.robustness import robustness

NAMES = ("t", "x", "y")
Trace = list[tuple[float, ...]]  # (t, x, y) per sample

# ---- The oracle. A formula is a nested tuple: (">=", e, e), ("and", f, g), ("always", (a, b) or None, f),
# ("until" or "until_from", (a, b) or None, f, g). b may be None: without end. Expressions: floats, names, tuples.

OPERATIONS: dict[str, Callable[..., float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "^": lambda a, b: a**b,
    "neg": lambda a: -a,
    "abs": abs,
}
WORDS = {"always", "eventually", "until", "until_from", "historically", "once", "since"}
STEPS = {"next", "previous", "rise", "fall"}


class RefusedError(Exception):
    """The definition gives no number."""


def render(node: Any) -> str:
    if not isinstance(node, tuple):
        return str(node)
    if node[0] == "neg":
        return f"(-{render(node[1])})"
    if node[0] == "abs":
        return f"abs({render(node[1])})"
    if node[0] == "not":
        return f"(not {render(node[1])})"
    if node[0] in STEPS:
        return f"({node[0]} ({render(node[1])}))"
    if node[0] not in WORDS:
        return f"({render(node[1])} {node[0]} {render(node[2])})"
    parts = [render(part) for part in node[2:]]
    word = node[0] + render_interval(node[1])
    return f"({word} {parts[0]})" if len(parts) == 1 else f"({parts[0]} {word} {parts[1]})"


def render_interval(interval: Any) -> str:
    if interval is None:
        return ""
    a, b, *ends = interval
    opening, closing = ends[0] if ends else "[]"
    return f"{opening}{a!r},inf)" if b is None else f"{opening}{a!r}, {b!r}{closing}"


def value(node: Any, sample: tuple[float, ...]) -> float:
    if isinstance(node, str):
        return sample[NAMES.index(node)]
    if isinstance(node, float):
        return node
    parts = [value(part, sample) for part in node[1:]]
    return float(OPERATIONS[node[0]](*parts))


def slack(i: int, trace: Trace) -> float:
    """How far from stamp i a border is the same instant: a hundredth of the shorter step beside it."""
    t = [sample[0] for sample in trace]
    steps = [abs(t[i] - t[j]) for j in (i - 1, i + 1) if 0 <= j < len(t)]
    return max(0.01 * min(steps, default=0.0), t[i] * 2.0**-23)


def window(interval: Any, k: int, trace: Trace) -> list[int]:
    a, b = interval or (0.0, None)
    t = [sample[0] for sample in trace]
    end = t[-1] if b is None else t[k] + b
    chosen = [i for i in range(len(trace)) if t[k] + a - slack(i, trace) <= t[i] <= end + slack(i, trace)]
    if interval is None:  # needs no sample times
        chosen = list(range(k, len(trace)))
    if not chosen:
        raise RefusedError
    return chosen


def check_reach(node: Any, latest: float, end: float, slack: float) -> None:
    """The rule about the end of the trajectory: no operand is read beyond it."""
    if node[0] in WORDS:
        a, b = node[1] or (0.0, None)
        if latest + (a if b is None else b) > end + slack:
            raise RefusedError
        latest = end if b is None else latest + b
    for part in node[1:]:
        if isinstance(part, tuple) and part and part[0] in {*WORDS, "and", "or", "implies", "not"}:
            check_reach(part, latest, end, slack)


def brute(node: Any, k: int, trace: Trace) -> float:
    word = node[0]
    if word in {"<=", "<"}:
        return value(node[2], trace[k]) - value(node[1], trace[k])
    if word in {">=", ">"}:
        return value(node[1], trace[k]) - value(node[2], trace[k])
    if word == "not":
        return -brute(node[1], k, trace)
    if word in {"always", "eventually"}:
        there = [brute(node[2], i, trace) for i in window(node[1], k, trace)]
        return min(there) if word == "always" else max(there)
    if word in {"until", "until_from"}:
        chosen = window(node[1], k, trace)
        begin = k if word == "until" else chosen[0]
        best = -float("inf")
        for i in chosen:
            held = [brute(node[2], j, trace) for j in range(begin, i + 1)]
            best = max(best, min([brute(node[3], i, trace), *held]))
        return best
    left, right = (brute(part, k, trace) for part in node[1:])
    return {"and": min(left, right), "or": max(left, right), "implies": max(-left, right)}[word]


def oracle(formula: Any, trace: Trace) -> float:
    check_reach(formula, 0.0, trace[-1][0] - trace[0][0], slack(len(trace) - 1, trace))
    return brute(formula, 0, trace)


# ---- Random formulas and traces.

CONNECTIVES = ("and", "or", "implies", "not", "always", "eventually", "until", "until_from")


def draw_expression(rng: random.Random, depth: int) -> Any:
    if depth == 0 or rng.random() < 0.4:
        return rng.choice([*NAMES[1:], *NAMES[1:], round(rng.uniform(0, 3), 2)])
    word = rng.choice(["+", "-", "*", "^", "neg", "abs"])
    left = draw_expression(rng, depth - 1)
    if word in {"neg", "abs"}:
        return (word, left)
    return (word, left, rng.choice([0.0, 1.0, 2.0, 3.0]) if word == "^" else draw_expression(rng, depth - 1))


def draw_interval(rng: random.Random, length: float) -> Any:
    if rng.random() < 0.3:
        return None
    a, b = sorted(round(rng.choice([0, 0, 0.5, 1, 1.5, 2, rng.uniform(0, 2)]) * length / 6, 3) for _ in range(2))
    return (a, None) if rng.random() < 0.15 else (a, b)


def draw_formula(rng: random.Random, depth: int, length: float) -> Any:
    if depth == 0:
        return (rng.choice(["<=", ">=", "<", ">"]), draw_expression(rng, 2), draw_expression(rng, 1))
    word = rng.choice(CONNECTIVES)
    parts = [draw_formula(rng, rng.randrange(depth), length) for _ in range(2)]
    if word in {"not", "always", "eventually"}:
        parts = parts[:1]
    return (word, draw_interval(rng, length), *parts) if word in WORDS else (word, *parts)


def draw_trace(rng: random.Random) -> Trace:
    size, step = rng.randint(1, 10), rng.choice([0.1, 0.25, 1 / 120, 1.0])
    kind = rng.choice(["uniform", "multiples", "any"])
    steps = {
        "uniform": lambda: step,
        "multiples": lambda: step * rng.randint(1, 3),
        "any": lambda: rng.uniform(0.2, 2) * step,
    }
    times = [rng.choice([0.0, 0.0, 2.5])]
    for _ in range(size - 1):
        times.append(times[-1] + steps[kind]())
    return [(t, rng.uniform(-2, 2), rng.uniform(-2, 2)) for t in times]


@pytest.mark.rest
def test_a_thousand_formulas_equal_the_brute_force() -> None:
    rng = random.Random(20250101)
    counts: dict[str, int] = {"defined": 0, "refused": 0}
    while counts["defined"] < 1000:
        trace = draw_trace(rng)
        formula = draw_formula(rng, rng.randint(1, 4), trace[-1][0] - trace[0][0])
        tree, samples = parse_formula(render(formula), NAMES), np.array(trace)
        try:
            expected = oracle(formula, trace)
        except RefusedError:
            counts["refused"] += 1
            with pytest.raises(FormulaError, match=r"reaches to|contains no sample"):
                robustness(tree, NAMES, samples)
        else:
            counts["defined"] += 1
            assert robustness(tree, NAMES, samples) == pytest.approx(expected, rel=1e-12, abs=1e-12), render(formula)
    assert counts["refused"] > 100


@pytest.mark.parametrize("word", ["until", "until_from"])
def test_nested_until_equals_the_brute_force(word: str) -> None:
    rng = random.Random(7)
    for _ in range(60):
        t = np.cumsum([rng.uniform(0.5, 1.5) for _ in range(24)])
        trace: Trace = [(float(now), rng.uniform(-2, 2), rng.uniform(-2, 2)) for now in t]
        inner = (word, (round(rng.uniform(0, 2), 2), 5.0), (">=", "x", -1.0), ("<=", "y", 0.0))
        other = (word, (0.0, round(rng.uniform(1.5, 4), 2)), ("<", "y", 1.0), (">", "x", 1.0))
        formula = (word, (rng.uniform(0, 2), 6.5), inner, other)
        ours = robustness(parse_formula(render(formula), NAMES), NAMES, np.array(trace))
        assert ours == oracle(formula, trace)


# ---- Properties.

seeds = st.integers(0, 2**32)


def draw_case(seed: int) -> tuple[str, Trace]:
    rng = random.Random(seed)
    trace = draw_trace(rng)
    return render(draw_formula(rng, 3, trace[-1][0] - trace[0][0])), trace


@given(seeds, seeds)
@settings(deadline=None, max_examples=200)
def test_the_robustness_gap_is_never_more_than_predicate_sup(seed: int, noise: int) -> None:
    text, trace = draw_case(seed)
    tree, a = parse_formula(text), np.array(trace)
    b = a.copy()
    b[:, 1:] += np.random.default_rng(noise).normal(scale=0.5, size=a[:, 1:].shape)
    gap = predicate_sup(tree, NAMES, a, b)
    assert gap == predicate_sup(tree, NAMES, b, a)
    try:
        difference = abs(robustness(tree, NAMES, a) - robustness(tree, NAMES, b))
    except FormulaError:
        return
    assert difference <= gap


@given(seeds)
@settings(deadline=None)
def test_dualities(seed: int) -> None:
    f, trace = draw_case(seed)
    samples = np.array(trace)
    try:
        rho = robustness(parse_formula(f"always {f}"), NAMES, samples)
    except FormulaError:
        return
    assert rho == robustness(parse_formula(f"not eventually not {f}"), NAMES, samples)
    until = robustness(parse_formula(f"0 <= 1e9 until {f}"), NAMES, samples)
    assert robustness(parse_formula(f"eventually {f}"), NAMES, samples) == until


@pytest.mark.rest
def test_no_formula_leaves_its_reach() -> None:
    rng, bounded = random.Random(12), 0
    for _ in range(2000):
        trace = draw_trace(rng)
        formula = draw_formula(rng, 3, trace[-1][0] - trace[0][0])
        try:
            expected = oracle(formula, trace)
        except RefusedError:
            continue
        low, high = reach(parse_formula(render(formula), NAMES))
        assert low <= expected <= high, render(formula)
        bounded += np.isfinite(low) or np.isfinite(high)
    assert bounded > 50, "half-bounded formulas are the ones that can leave it"
