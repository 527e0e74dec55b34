"""Formulas as people write them, on random traces, against an evaluator that shares the tree alone: loops."""

import math
import random
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.stl import tree as stl
from perfbound.orchestrator.mathematics.stl.grid import Grid
from perfbound.orchestrator.mathematics.stl.horizon import horizon
from perfbound.orchestrator.mathematics.stl.over_time import robustness_signal, worst_moment
from perfbound.orchestrator.mathematics.stl.parser import FormulaError, parse_formula
from perfbound.orchestrator.mathematics.stl.predicates import Signals
from perfbound.orchestrator.mathematics.stl.reach import reach
from perfbound.orchestrator.mathematics.stl.robustness import evaluated, evaluated_each, margins_at_samples, robustness
from perfbound.orchestrator.mathematics.stl.text import text
from perfbound.schemas.values import FORMULA_WORDS, Beyond

PAGE = Path(__file__).parents[4] / "docs" / "stl.md"
TRACES = 300
Trace = list[dict[str, float]]
UNITS = {"t": "s", "x": "m", "y": "m", "gear": "discrete"}


class RefusedError(Exception):
    """The definition gives no number."""


class Naive:
    """The definition, sample by sample: a window is a list of samples, and a number is kept once it is known."""

    def __init__(self, trace: Trace, *, truncate: bool) -> None:
        self.trace, self.truncate = trace, truncate
        self.t = [sample["t"] for sample in trace]
        self.known: dict[tuple[int, int], float] = {}
        steps = [later - now for now, later in zip(self.t, self.t[1:], strict=False)]
        beside = [[*steps[max(i - 1, 0) : i], *steps[i : i + 1]] for i in range(len(trace))]
        self.slack = [max(0.01 * min(each, default=0.0), t * 2.0**-23) for each, t in zip(beside, self.t, strict=True)]

    def of(self, tree: Any, k: int) -> float:
        key = id(tree), k
        if key not in self.known:
            self.known[key] = self._of(tree, k)
        return self.known[key]

    def window(self, tree: Any, k: int) -> list[int]:
        now, past = self.t[k], isinstance(tree, stl.Behind)
        if tree.interval == stl.REST:
            return list(range(k + 1) if past else range(k, len(self.t)))
        a, b = tree.interval.low, tree.interval.high
        found = []
        for i, t in enumerate(self.t):
            apart, near = (now - t if past else t - now), self.slack[i]
            begun = apart > a + near if tree.interval.low_open else apart >= a - near
            ended = apart < b - near if tree.interval.high_open else apart <= b + near
            if begun and ended:
                found.append(i)
        if not past and not self.truncate and math.isfinite(b) and now + b > self.t[-1] + self.slack[-1] + 1e-9:
            raise RefusedError
        # Wholly before the start, or beyond the end; an open end may be at the first sample, or at the last one.
        near = -self.slack[0] if not tree.interval.low_open else self.slack[0]
        if past:
            cut = now - a < self.t[0] + near or (tree.interval.low_open and now - a <= self.t[0] + near)
        else:
            near = -self.slack[-1] if tree.interval.low_open else self.slack[-1]
            cut = self.truncate and now + a > self.t[-1] + near
        if not found and not cut:
            raise RefusedError
        return found

    def _of(self, tree: Any, k: int) -> float:
        parts = [lambda i, part=part: self.of(part, i) for part in stl.operands(tree)]
        if isinstance(tree, stl.Timed):
            return self._timed(tree, k)
        match tree:
            case stl.Comparison(sign, left, right):
                one, other = self.number(left, k), self.number(right, k)
                apart = 0.5 - abs(one - other)
                found = {"<": other - one, ">": one - other, "=": apart, "!": -apart}[sign[0]]
            case stl.Not():
                found = -parts[0](k)
            case stl.And():
                found = min(parts[0](k), parts[1](k))
            case stl.Or():
                found = max(parts[0](k), parts[1](k))
            case stl.Implies():
                found = max(-parts[0](k), parts[1](k))
            case stl.Next():
                found = self._next(parts[0], k)
            case _:
                before = {stl.Previous: 1, stl.Rise: -1, stl.Fall: 1}[type(tree)]
                now = {stl.Previous: 0, stl.Rise: 1, stl.Fall: -1}[type(tree)]
                found = before * parts[0](k - 1) if k else -math.inf
                found = min(found, now * parts[0](k)) if now else found
        return float(found)

    def _next(self, part: Callable[[int], float], k: int) -> float:
        if k + 1 < len(self.t):
            return part(k + 1)
        if not self.truncate:
            raise RefusedError
        return -math.inf

    def _timed(self, tree: Any, k: int) -> float:
        window = self.window(tree, k)
        match tree:
            case stl.Always(part) | stl.Historically(part):
                return min((self.of(part, i) for i in window), default=math.inf)
            case stl.Eventually(part) | stl.Once(part):
                return max((self.of(part, i) for i in window), default=-math.inf)
            case stl.Until(left, right, _, reading):
                begin = k if reading == "standard" else min(window, default=0)
                ends = [(i, range(begin, i + 1)) for i in window]
            case stl.Since(left, right):
                ends = [(i, range(i, k + 1)) for i in window]
        held = [min([self.of(right, i), *(self.of(left, j) for j in through)]) for i, through in ends]
        return max(held, default=-math.inf)

    def number(self, tree: Any, k: int) -> float:
        match tree:
            case stl.Number(value):
                return float(value)
            case stl.Column(name):
                return self.trace[k][name]
            case stl.Negative(part):
                return -self.number(part, k)
            case stl.Absolute(part):
                return abs(self.number(part, k))
            case stl.Function(name, parts):
                values = [self.number(part, k) for part in parts]
                return float(max(values) if name == "max" else min(values) if name == "min" else _call(name, values[0]))
            case stl.Arithmetic(sign, left, right):
                one, other = self.number(left, k), self.number(right, k)
                operations = {"+": one + other, "-": one - other, "*": one * other}
                return operations[sign] if sign in operations else one / other if sign == "/" else one**other
        raise AssertionError(tree)


def _call(name: str, value: float) -> float:
    return float(getattr(math, name)(value))


def rows(trace: Trace) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([list(sample.values()) for sample in trace])


def draw_trace(rng: random.Random, names: tuple[str, ...], duration: float, most: int = 24) -> Trace:
    """Samples from 0 to the end, in equal steps or in any; names with a unit of their own are whole numbers."""
    size = rng.randint(2, most)
    steps = [1.0] * size if rng.random() < 0.4 else [rng.uniform(0.2, 2) for _ in range(size)]
    times = [0.0]
    for step in steps:
        times.append(times[-1] + step)
    return [
        {"t": t * duration / times[-1]}
        | {name: float(rng.randint(0, 3)) if name == "gear" else rng.uniform(-2, 2) for name in names[1:]}
        for t in times
    ]


def check_reach(tree: Any, latest: float, naive: Naive) -> None:
    """The rule about the end of the trajectory, for `tree` that is read until `latest`."""
    if isinstance(tree, stl.Ahead):
        low, high = tree.interval.low, tree.interval.high
        latest += high if tree.interval.bounded else low
        if latest > naive.t[-1] + naive.slack[-1] + 1e-9:
            raise RefusedError
        latest = latest if tree.interval.bounded else naive.t[-1]
    for part in stl.operands(tree):
        ago = tree.interval.low if isinstance(tree, stl.Behind) else 0.0
        check_reach(part, latest - (0.0 if isinstance(tree, stl.Since) and part is tree.left else ago), naive)


def compare(tree: stl.Formula, trace: Trace, beyond: Beyond) -> bool:
    """Compare with the definition; return whether it gives a number."""
    names, samples = tuple(trace[0]), rows(trace)
    naive = Naive(trace, truncate=beyond == "truncate")
    try:
        if beyond == "refuse":
            check_reach(tree, 0.0, naive)
        expected = naive.of(tree, 0)
    except RefusedError:
        expected = math.inf
    if math.isinf(expected):
        with pytest.raises(FormulaError, match=r"reaches|contains no sample|last sample|of every trajectory"):
            robustness(tree, names, samples, beyond)
        return False
    found = evaluated(tree, names, samples, beyond)
    assert found.robustness == pytest.approx(expected, rel=1e-12, abs=1e-12), (text(tree), trace)
    each = evaluated_each(tree, names, samples[:, 0], samples[:, 1:, None].transpose(1, 2, 0), beyond)
    assert (each.robustness.item(), each.by_tolerance.item()) == (found.robustness, found.by_tolerance)
    low, high = reach(tree, beyond)
    assert low <= found.robustness <= high, text(tree)
    return True


# ---- Published requirements, see docs/stl.md. Their intervals are shortened where a trace would need many samples.


def published() -> Iterator[tuple[str, Beyond]]:
    """Yield (formula, `beyond`) of each row of the table in the documentation."""
    table = PAGE.read_text(encoding="utf-8").partition("## Published requirements")[2].partition("\n## ")[0]
    for row in re.findall(r"^\|[^|]+\|[^`]*`([^`]+)`([^|]*)\|$", table, re.MULTILINE):
        yield row[0], "truncate" if "truncate" in row[1] else "refuse"


UNITS_OF_PUBLISHED = dict.fromkeys(("gear", "cut_in", "alarm", "request"), "discrete")


@pytest.mark.rest
def test_published_requirements_equal_the_definition() -> None:
    cases, rng = list(published()), random.Random(20261128)
    assert len(cases) >= 12
    for formula, beyond in cases:
        known = dict.fromkeys(re.findall(r"[a-z]\w*", formula), "") | UNITS_OF_PUBLISHED
        tree = parse_formula(formula, {name: unit for name, unit in known.items() if name not in FORMULA_WORDS})
        names = ("t", *sorted(stl.columns(tree)))
        shorter = _shortened(tree)
        ends = [4.0, horizon(shorter), *(each.high for each in _intervals(shorter))]
        duration = max(end for end in ends if math.isfinite(end))
        defined, drawn = 0, 0
        while defined < TRACES:
            drawn += 1
            assert drawn < 40 * TRACES, (formula, defined)
            lasting = duration * (rng.uniform(0.7, 1.0) if beyond == "truncate" else rng.uniform(1.0, 2.5))
            trace = draw_trace(rng, names, lasting)
            for sample in trace:
                sample |= {name: float(rng.randint(0, 1)) for name in names if name in UNITS_OF_PUBLISHED}
            defined += compare(shorter, trace, beyond)


def _intervals(tree: stl.Formula) -> Iterator[stl.Interval]:
    return (node.interval for node in stl.walk(tree) if isinstance(node, stl.Timed))


def _shortened(tree: Any) -> Any:
    """Return a formula with the lengths of its intervals pulled together: 0.05 and 50 s become 2 and 9."""
    if isinstance(tree, stl.Interval):
        low, high = (0.0 if end == 0 else 1 + math.log(1 + 20 * end) for end in (tree.low, min(tree.high, 1e9)))
        return stl.Interval(low, high if tree.bounded else math.inf, tree.low_open, tree.high_open)
    if isinstance(tree, stl.Comparison) or not hasattr(tree, "__dataclass_fields__"):
        return tree
    return type(tree)(*(_shortened(getattr(tree, name)) for name in tree.__dataclass_fields__))


# ---- Random formulas with every operator.


def draw_interval(rng: random.Random, length: float) -> stl.Interval:
    if rng.random() < 0.25:
        return stl.REST
    low, high = sorted(round(rng.choice([0, 0, 0.5, 1, 1.5, 2, rng.uniform(0, 2)]) * length / 6, 3) for _ in range(2))
    if rng.random() < 0.15:
        return stl.Interval(low, low_open=rng.random() < 0.5)
    opened = (rng.random() < 0.4, rng.random() < 0.4) if low < high else (False, False)
    return stl.Interval(low, high, *opened)


PREDICATES = ["x <= 0.5", "y > x", "max(x, y, 0.3) >= 1", "sin(x) + cos(y) < exp(y)", "sqrt(abs(x)) < 1", "gear == 2"]
PREDICATES += ["gear != 1", "-1 < x <= y", "log(abs(x) + 1) <= tan(0.5)", "min(x, -y) < 0"]


def draw_formula(rng: random.Random, depth: int, length: float) -> stl.Formula:
    if depth == 0:
        return parse_formula(rng.choice(PREDICATES), UNITS)
    left, right = (draw_formula(rng, rng.randrange(depth), length) for _ in range(2))
    interval = draw_interval(rng, length)
    options: list[stl.Formula] = [stl.And(left, right), stl.Or(left, right), stl.Implies(left, right), stl.Not(left)]
    options += [stl.Next(left), stl.Previous(left), stl.Rise(left), stl.Fall(left)]
    options += [kind(left, interval) for kind in (stl.Always, stl.Eventually, stl.Historically, stl.Once)]
    options += [stl.Until(left, right, interval), stl.Since(left, right, interval)] * 2
    options += [stl.Until(left, right, interval, "paper")]
    return rng.choice(options)


@pytest.mark.rest
@pytest.mark.parametrize("beyond", ["refuse", "truncate"])
def test_random_formulas_equal_the_definition(beyond: Beyond) -> None:
    rng, defined, refused = random.Random(7), 0, 0
    while defined < 1500:
        length = rng.choice([1.0, 10.0, 0.3])
        trace = draw_trace(rng, tuple(UNITS), length, 10)
        tree = draw_formula(rng, rng.randint(1, 4), length)
        assert parse_formula(text(tree), UNITS) == tree
        found = compare(tree, trace, beyond)
        defined, refused = defined + found, refused + (not found)
    assert refused > 100


seeds = st.integers(0, 2**32)


def case(seed: int) -> tuple[random.Random, stl.Formula, Trace]:
    rng = random.Random(seed)
    length = rng.choice([1.0, 10.0])
    return rng, draw_formula(rng, 2, length), draw_trace(rng, tuple(UNITS), length, 10)


def at_samples(tree: stl.Formula, samples: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    found = margins_at_samples(tree, Signals(tuple(UNITS), samples), Grid(samples[:, 0], "truncate"))
    return [float(each) for each in found]


MIRRORED: dict[type, type] = {stl.Always: stl.Historically, stl.Eventually: stl.Once, stl.Until: stl.Since}
MIRRORED |= {stl.Next: stl.Previous} | {past: ahead for ahead, past in MIRRORED.items()} | {stl.Previous: stl.Next}


def changed(tree: stl.Edge) -> stl.And:
    """What `rise` and `fall` mean, in other operators."""
    before, now = tree.operand, stl.Not(tree.operand)
    return stl.And(stl.Previous(now), before) if isinstance(tree, stl.Rise) else stl.And(stl.Previous(before), now)


def mirrored(tree: Any) -> Any:
    """Return a formula with every operator over time turned around."""
    if isinstance(tree, stl.Edge):
        tree = changed(tree)
    if isinstance(tree, stl.Comparison) or not hasattr(tree, "__dataclass_fields__") or isinstance(tree, stl.Interval):
        return tree
    fields = {name: mirrored(getattr(tree, name)) for name in tree.__dataclass_fields__ if name != "reading"}
    return MIRRORED.get(type(tree), type(tree))(**fields)


@given(seeds)
def test_the_past_is_the_future_backwards_in_time(seed: int) -> None:
    _, tree, trace = case(seed)
    tree = mirrored(mirrored(tree))  # without the reading of [ARA], which has no mirror
    samples = rows(trace)
    backwards = samples[::-1].copy()
    backwards[:, 0] = samples[-1, 0] - backwards[:, 0]
    assert at_samples(tree, samples) == at_samples(mirrored(tree), backwards)[::-1]


@given(seeds)
def test_dualities(seed: int) -> None:
    rng, f, trace = case(seed)
    samples, interval = rows(trace), draw_interval(rng, trace[-1]["t"])

    def of(tree: stl.Formula) -> list[float]:
        return at_samples(tree, samples)

    since = of(stl.Since(parse_formula("0 <= 1e9"), f, interval))
    assert of(stl.Historically(f, interval)) == of(stl.Not(stl.Once(stl.Not(f), interval)))
    assert of(stl.Always(f, interval)) == of(stl.Not(stl.Eventually(stl.Not(f), interval)))
    assert np.clip(of(stl.Once(f, interval)), -1e9, 1e9).tolist() == np.clip(since, -1e9, 1e9).tolist()
    assert of(stl.Fall(f)) == of(stl.Rise(stl.Not(f))) == of(changed(stl.Fall(f)))
    assert of(stl.Rise(f))[0] == of(stl.Fall(f))[0] == -math.inf


@given(seeds, st.sampled_from(["refuse", "truncate"]))
def test_the_signal_and_the_moment_fit_the_robustness(seed: int, beyond: Beyond) -> None:
    _, tree, trace = case(seed)
    samples = rows(trace)
    try:
        expected = robustness(tree, tuple(UNITS), samples, beyond)
    except FormulaError:
        return
    found = robustness_signal(tree, tuple(UNITS), samples, beyond)
    values = found.values[~np.isnan(found.values)]
    assert np.isfinite(values).all()
    assert expected == {"least": values.min(), "greatest": values.max(), "first": found.values[0]}[found.attained]
    moment = worst_moment(tree, tuple(UNITS), samples, beyond)
    if moment is None:
        return
    # Some predicate has this number there, or its negative.
    signals = Signals(tuple(UNITS), samples)
    margins = [signals.margins(each)[moment.first : moment.last + 1] for each in stl.predicates(tree)]
    assert np.isin(np.abs(np.concatenate(margins)), abs(expected)).any()


# ---- Numbers that a person can check.


def of(formula: str, *x: float, beyond: Beyond = "refuse", gear: tuple[float, ...] = ()) -> float:
    samples = np.array([[float(k), v, 0.0, (gear or (0.0,) * len(x))[k]] for k, v in enumerate(x)])
    return robustness(parse_formula(formula, UNITS), tuple(UNITS), samples, beyond)


class TestIntervals:
    def test_an_open_end_leaves_its_sample_out(self) -> None:
        x = (0, 1, 2, 3, 4)
        assert of("always[1,3] x >= 0", *x) == of("always[1,3) x >= 0", *x) == 1
        assert of("always(1,3] x >= 0", *x) == of("always(1,3) x >= 0", *x) == 2
        assert of("eventually[1,3) x >= 0", *x) == of("eventually(1,3) x >= 0", *x) == 2
        assert of("always(2,inf) x >= 0", *x) == 3
        assert of("x >= 0 until(0,2) x >= 1", *x) == 0

    def test_round_off_leaves_it_out_as_well(self) -> None:
        t = np.cumsum(np.full(1801, 1 / 120)) - 1 / 120
        samples = np.column_stack([t, np.arange(1801.0)])
        assert robustness(parse_formula("eventually[0,15) x >= 0"), ("t", "x"), samples) == 1799
        assert robustness(parse_formula("always(0.3,0.4) x >= 0"), ("t", "x"), samples) == 37

    def test_an_open_end_that_a_stamp_of_float32_decides_is_reported(self) -> None:
        t = np.array([0.0, 0.1, 0.2, 0.3], dtype=np.float32).astype(np.float64)  # the last one is 0.30000001
        samples = np.column_stack([t, [1.0, 1.0, 1.0, -1.0]])
        for formula, value in (("always[0,0.3) x >= 0", 1.0), ("always[0,0.3] x >= 0", -1.0)):
            found = evaluated(parse_formula(formula), ("t", "x"), samples)
            exact = evaluated(parse_formula(formula), ("t", "x"), np.column_stack([np.arange(4) * 0.1, samples[:, 1]]))
            assert found.robustness == exact.robustness == value
            # By its number 0.30000001 is beyond both ends: of the closed one alone the sign follows from the tolerance.
            assert found.by_tolerance == (formula[10] == "]" or formula[12] == "]")
            assert not exact.by_tolerance
        early = samples - [[0, 0], [0, 0], [0, 0], [2e-8, 0]]  # 0.29999999 is before the open end
        assert evaluated(parse_formula("always[0,0.3) x >= 0"), ("t", "x"), early) == (1.0, True)

    def test_an_open_interval_between_two_samples_is_refused(self) -> None:
        with pytest.raises(FormulaError, match="contains no sample at t = 0 s"):
            of("always(0,1) x >= 0", 0, 1, 2)


class TestPast:
    def test_the_past_ends_at_the_start(self) -> None:
        assert of("always[2,2] once[0,2] x >= 0", 3, 2, 1, 0) == 3
        assert of("always[2,2] historically[1,5] x >= 0", 3, 2, 1, 0) == 2
        assert of("always (x >= 1 implies once[1,2] x >= 2)", 0, 3, 1, 1) == -2
        assert of("always[3,3] (x >= 0 since x >= 5)", 6, -1, 9, 2) == 2
        assert of("always[3,3] (x >= 0 since[2,3] x >= 5)", 6, -1, 9, 2) == -1

    @pytest.mark.parametrize("formula", ["once[1,2] x >= 0", "previous x >= 0", "rise(x >= 1)", "always fall(x >= 1)"])
    def test_what_only_the_start_decides_is_refused(self, formula: str) -> None:
        with pytest.raises(FormulaError, match="is false of every trajectory"):
            of(formula, 0, 1, 2)
        with pytest.raises(FormulaError, match="is true of every trajectory"):
            of(f"not {formula}", 0, 1, 2)

    def test_a_window_of_the_past_between_two_samples_is_refused(self) -> None:
        with pytest.raises(FormulaError, match="contains no sample at t = 1 s"):
            of("always (x >= 0 or once[0.2,0.8] x >= 1)", 0, 1, 2)


class TestSteps:
    def test_next_and_previous_are_the_samples_beside(self) -> None:
        assert of("next x >= 0", 0, 1, 5) == of("next previous next x >= 0", 0, 1, 5) == 1
        assert of("always[0,1] next x >= 0", 0, 7, 5) == 5

    def test_next_is_refused_at_the_last_sample(self) -> None:
        with pytest.raises(FormulaError, match="is read at the last sample, at t = 2 s"):
            of("always next x >= 0", 0, 1, 2)
        with pytest.raises(FormulaError, match="reaches beyond the trajectory, which ends at 2 s"):
            of("always[0,1] next always[0,1] x >= 0", 0, 1, 2)
        assert of("always[0,1] next always[0,0] x >= 0", 0, 1, 2) == 1

    def test_a_change_needs_two_samples(self) -> None:
        assert of("eventually rise(x >= 1)", 3, 0, 2, 2) == 1
        assert of("eventually fall(x >= 1)", 0, 3, 0, 2) == 1
        assert of("always (rise(x >= 1) implies x >= 2)", 3, 0, 1.5, 5) == -0.5

    @pytest.mark.parametrize("x", [(0.0,) * 20, (1.0, -1.0) * 10, tuple(np.random.default_rng(0).normal(size=20))])
    def test_changes_of_changes_are_followed(self, x: tuple[float, ...]) -> None:
        tree = parse_formula("eventually " + "rise(" * 19 + "x > 0" + ")" * 19)
        samples = np.column_stack([np.arange(20.0), x])
        # 19 levels: what doubled with each would not end.
        assert evaluated(tree, ("t", "x"), samples).robustness >= 0
        assert reach(tree) == (-math.inf, math.inf)
        worst_moment(tree, ("t", "x"), samples)


class TestDiscrete:
    def test_equality_is_positive_where_equal(self) -> None:
        x = (0.0,) * 3
        assert of("always gear == 1", *x, gear=(1, 1, 1)) == 0.5
        assert of("always gear == 1", *x, gear=(1, 3, 1)) == -1.5
        assert of("eventually gear != 1", *x, gear=(1, 1, 3)) == 1.5
        assert of("always (not gear == 1)", *x, gear=(2, 2, 2)) == of("always gear != 1", *x, gear=(2, 2, 2)) == 0.5

    def test_a_number_that_is_not_whole_is_refused(self) -> None:
        with pytest.raises(ValueError, match="`gear == 1` compares numbers at sample 1 that are not whole"):
            of("always gear == 1", 0, 0, gear=(1, 1.5))


class TestTruncate:
    def test_windows_end_with_the_trajectory(self) -> None:
        assert of("always eventually[0,5] x >= 0", 0, 3, 2, beyond="truncate") == 2
        assert of("always[0,9] x >= 0", 1, 3, 2, beyond="truncate") == 1
        assert of("always[0,9] (x <= 2 or next x >= 1)", 1, 3, 2, beyond="truncate") == 0

    def test_over_no_sample_always_is_true_and_eventually_false(self) -> None:
        assert of("always (x >= 2 implies always[2,4] x >= 9)", 0, 3, 2.5, beyond="truncate") == 2
        with pytest.raises(FormulaError, match="is true of every trajectory"):
            of("always[5,9] x >= 0", 0, 1, beyond="truncate")
        with pytest.raises(FormulaError, match="is false of every trajectory"):
            of("eventually[5,9] x >= 0", 0, 1, beyond="truncate")
        with pytest.raises(FormulaError, match="is false of every trajectory"):
            of("always eventually[1,2] x >= 0", 0, 1, beyond="truncate")
