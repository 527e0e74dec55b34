"""One notion of the same instant: stamps that are not exact give what exact ones give."""

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from perfbound.orchestrator.mathematics.stl.grid import Grid, OtherReading
from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.orchestrator.mathematics.stl.predicates import Signals, check_grids
from perfbound.orchestrator.mathematics.stl.robustness import evaluated, margins_at_samples, robustness
from perfbound.orchestrator.mathematics.stl.tree import Formula
from perfbound.schemas.instants import disorder, reached, slack, stamps, uncovered

Floats = NDArray[np.float64]
GRIDS, FORMULAS = 200, 50
NAMES = ("t", "x", "y")


def as_float32(times: Floats) -> Floats:
    return times.astype(np.float32).astype(np.float64)


def random_formula(rng: np.random.Generator, step: float, steps: int) -> str:
    """Return a formula whose windows begin and end at samples, or clearly between two of them."""

    def moment(most: int) -> float:
        return round(float(step * (rng.integers(most + 1) + rng.choice([0.0, 0.0, 0.0, 0.5]))), 12)

    def predicate() -> str:
        name, sign, limit = rng.choice(["x", "y"]), rng.choice(["<=", ">="]), rng.normal()
        return f"({name} {sign} {limit:.6f})"

    def window(most: int) -> str:
        ends = sorted(moment(most - 1) for _ in range(2))
        opening, closing = rng.choice(["[", "[", "("]), rng.choice(["]", "]", ")"])
        # Long enough to hold a sample.
        return f"{opening}{ends[0]:.12g},{ends[1] + step * (1 + (opening + closing != '[]')):.12g}{closing}"

    inner, outer = max(steps // 4 - 1, 1), max(steps // 2 - 1, 1)
    kind = rng.integers(6)
    if kind == 4:
        return f"always{window(outer)} ({predicate()} or once{window(inner)} {predicate()})"
    if kind == 5:
        return f"eventually{window(outer)} ({predicate()} or ({predicate()} since{window(inner)} {predicate()}))"
    if kind == 0:
        return f"always{window(outer)} {predicate()}"
    if kind == 1:
        return f"eventually{window(outer)} {predicate()} or always{window(outer)} {predicate()}"
    if kind == 2:
        return f"always{window(outer)} eventually{window(inner)} {predicate()}"
    return f"{predicate()} until{window(outer)} {predicate()}"


def spoiled(rng: np.random.Generator, exact: Floats, step: float) -> tuple[str, Floats]:
    """Return the same stamps as a simulator may give them."""
    kind = str(rng.choice(["float32", "accumulated", "accumulated in float32", "jittered"]))
    if kind == "float32":
        return kind, as_float32(exact)
    if kind == "accumulated":
        return kind, np.concatenate(([0.0], np.cumsum(np.full(len(exact) - 1, step))))
    if kind == "accumulated in float32":
        single = np.concatenate(([0.0], np.full(len(exact) - 1, step))).astype(np.float32)
        return kind, np.cumsum(single, dtype=np.float32).astype(np.float64)
    size = 10.0 ** rng.uniform(-12, -3) * step
    jitter = rng.uniform(-size, size, len(exact))
    jitter[0] = abs(jitter[0])
    return kind, exact + jitter


def by_numbers(tree: Formula, samples: Floats) -> float:
    """Return the robustness by windows without a tolerance."""
    grid = Strict(Grid(samples[:, 0]), wide=False)
    return float(margins_at_samples(tree, Signals(NAMES, samples), grid)[0])


class Strict(OtherReading):
    """The windows by the numbers of the stamps alone, at open borders, too."""

    def _instants(self, *, opened: bool) -> tuple[Floats, Floats]:
        return self._strictly


@pytest.mark.rest
def test_200_grids_and_50_formulas_give_what_exact_stamps_give() -> None:
    rng, compared, decided, kinds = np.random.default_rng(20261125), 0, 0, dict[str, int]()
    for _ in range(GRIDS):
        step, steps = float(rng.choice([0.001, 0.01, 1 / 30, 0.1, 0.25, 1.0])), int(rng.integers(8, 60))
        exact = np.arange(steps + 1, dtype=np.float64) * step
        kind, times = spoiled(rng, exact, step)
        if np.abs(times - exact).max() > 0.005 * step:
            continue  # what is beyond the tolerance is another grid
        kinds[kind] = kinds.get(kind, 0) + 1
        values = rng.normal(size=(len(exact), 2))
        jumps = rng.random() < 0.3
        rows = np.sort(np.concatenate((np.arange(len(exact)), rng.choice(np.arange(1, steps), 2, replace=False))))
        rows = rows if jumps else np.arange(len(exact))
        values = rng.normal(size=(len(rows), 2)) if jumps else values
        for _ in range(FORMULAS):
            tree = parse_formula(random_formula(rng, step, steps), NAMES)
            one, other = (robustness(tree, NAMES, np.column_stack((each[rows], values))) for each in (exact, times))
            assert one == other, (kind, step)
            assert not evaluated(tree, NAMES, np.column_stack((exact[rows], values))).by_tolerance, step
            # Of the windows by the numbers of these stamps: what another sign would follow from is counted.
            strict = by_numbers(tree, np.column_stack((times[rows], values)))
            if np.sign(strict) != np.sign(other):
                assert evaluated(tree, NAMES, np.column_stack((times[rows], values))).by_tolerance, (kind, step)
                decided += 1
            compared += 1
    assert compared >= 0.9 * GRIDS * FORMULAS
    assert decided > FORMULAS
    assert set(kinds) == {"float32", "accumulated", "accumulated in float32", "jittered"}


@pytest.mark.parametrize("begin", [0.0, 100.0, 1000.0])
@pytest.mark.parametrize("step", [0.01, 0.1])
def test_a_border_of_decimals_takes_in_a_stamp_of_float32(begin: float, step: float) -> None:
    times = as_float32(begin + np.arange(40, dtype=np.float64) * step)
    for number in range(1, 39):
        values = np.ones(40)
        values[number] = -1.0
        samples = np.column_stack((times, values, values))
        border = f"{number * step:.9g}"
        assert robustness(parse_formula(f"always[0,{border}] x >= 0", NAMES), NAMES, samples) == -1.0
        assert robustness(parse_formula(f"always[{border},{39 * step:.9g}] x >= 0", NAMES), NAMES, samples) == -1.0
        before = f"{(number - 0.02) * step:.9g}"
        assert robustness(parse_formula(f"always[0,{before}] x >= 0", NAMES), NAMES, samples) == 1.0


def test_a_grid_finer_than_float32_keeps_its_own_step() -> None:
    times = 1.0 + np.arange(100, dtype=np.float64) * 1e-9
    assert slack(times).max() < 2e-11
    fine = np.concatenate(([0.0], times))
    assert (np.diff(reached(fine)[0]) >= 0.0).all()


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ([0.02, 1.0, 2.02], "the first row is at t = 0.02 s, and 0 s is requested: begin with the state at the start"),
        ([1.7e9, 1.7e9 + 1, 1.7e9 + 2], "subtract the time at the start"),
        ([0.0, 1000.0, 2000.0], "the last row, 2, is at t = 2000 s, and the horizon is 2 s: give seconds, not"),
        ([0.0, 1.0, 1.9], "the last row, 2, is at t = 1.9 s, and the horizon is 2 s, before which it may be by 0.04 s"),
        ([0.0, 1.0, 2.05], "the last row, 2, is at t = 2.05 s, and the horizon is 2 s: end at the horizon"),
        ([0.0], "one sample at 0 s, and the horizon is 2 s: where rollouts last, give one"),
    ],
)
def test_what_does_not_cover_the_horizon_is_named_with_row_stamp_and_remedy(times: list[float], words: str) -> None:
    found = uncovered(np.array(times), 2.0)
    assert found is not None
    assert words in found
    named = re.findall(r"t = (\S+) s.* is (\S+) s\b", found)
    assert all(one != other for one, other in named)


@pytest.mark.parametrize("last", [2.0, 2.0000002384, 1.9999998, np.cumsum(np.full(20, 0.1))[-1], 2.0009, 1.97])
def test_ends_that_are_the_same_instant_cover_it(last: float) -> None:
    assert uncovered(np.append(np.arange(20, dtype=np.float64) * 0.1, last), 2.0) is None


def test_a_step_that_is_another_one_is_named_with_the_number_of_samples() -> None:
    found = uncovered(np.arange(11, dtype=np.float64) * 0.01, 1.0)
    assert found is not None
    assert found.startswith(
        "11 samples are 1 s in steps of 0.1 s, not of 0.01 s: correct the step, or return 101 samples"
    )
    assert "after_end" not in found, "nothing ends early"
    other = uncovered(np.arange(8, dtype=np.float64) * 0.01, 1.0)
    assert other is not None
    assert "in steps of" not in other, "no step that anyone means"
    almost = uncovered(np.arange(201, dtype=np.float64) * 0.00992, 2.0)
    assert almost is not None
    assert "after_end" in almost, "a step is another one from twice its length on"


def test_numbers_that_differ_in_the_eighth_digit_are_printed_with_it() -> None:
    found = uncovered(np.append(np.arange(2000, dtype=np.float64) * 1e-7, 2.0001e-4), 2e-4)
    assert found is not None
    assert "2.0001e-04" in found or "0.00020001" in found
    assert "the horizon is 0.0002 s" in found


@pytest.mark.parametrize(
    ("times", "states", "words"),
    [
        ([0.0, 0.2, 0.1], [1, 1, 1], "t = 0.1 s in row 2 is before t = 0.2 s in row 1"),
        ([0.0, 0.1, 0.1, 0.1], [1, 2, 3, 4], "t = 0.1 s has a third state in row 3"),
        ([0.0, 0.1, 0.1, 0.1, 0.2, 0.2, 0.2], [1, 2, 3, 3, 4, 5, 4], "t = 0.2 s has a third state in row 6"),
        ([-0.1, 0.0], [1, 1], "t = -0.1 s in row 0 is before the start"),
        ([0.0, 1.00000001, 1.0], [1, 1, 1], "t = 1 s in row 2 is before t = 1.00000001 s in row 1"),
        ([0.0, 0.1, 0.1, 0.2, 0.2], [1, 1, 2, 3, 3], ""),
        ([0.0, 0.1, 0.1, 0.1, 0.2, 0.2], [1, 2, 2, 3, 4, 5], ""),
    ],
)
def test_stamps_out_of_order_are_named_and_jumps_are_not(times: list[float], states: list[float], words: str) -> None:
    found = disorder(np.column_stack((times, states)))
    assert (found is None) == (not words)
    assert words in (found or "")


def test_pairs_may_differ_by_what_is_the_same_instant() -> None:
    exact = np.arange(20, dtype=np.float64) * 0.1
    one, other = (np.column_stack((each, exact)) for each in (exact, as_float32(exact)))
    check_grids(one, other)
    other[7, 0] += 2e-3
    with pytest.raises(ValueError, match=r"differ at sample 7: t = 0\.7 and 0\.702"):
        check_grids(one, other)


def test_the_kind_of_stamps() -> None:
    for step in (0.01, 0.1, 1 / 240):
        exact = np.arange(1000, dtype=np.float64) * step
        assert stamps(exact) == "exact"
        assert stamps(as_float32(exact)) == "float32"
    assert stamps(np.cumsum(np.full(1000, 0.1)) - 0.1) == "accumulated"
    assert stamps(np.arange(1000, dtype=np.float64) * 0.25) == "exact"
    assert stamps(np.sort(np.random.default_rng(1).uniform(0, 9, 50))) == "exact", "steps of its own"


AT_A_BORDER = np.array([1.0, 1.0, 1.0, -1.0, 1.0])
"""Of x: whether the fourth sample belongs to a window decides the sign."""


@pytest.mark.parametrize(
    ("formula", "moved", "decided"),
    [
        ("always[0,0.3] x >= 0", 5e-4, True),
        ("always[0,0.3] x >= 0", 0.0, False),  # 0.1 s three times is 0.30000000000000004 s
        ("always[0,0.3] x >= 0", 2e-3, False),  # clearly behind the border
        ("always[0,0.3] x >= -2", 5e-4, False),
        ("not eventually[0,0.3] x <= 0", 5e-4, True),
        ("(eventually[0,0.3] x <= 0) implies x <= 0", 5e-4, True),
        ("always[0,0.1] eventually[0.2,0.2] x >= 0", 5e-4, False),  # no other reading: without it there is no sample
        # Two borders with opposite effects: neither windows by the numbers nor those of the tolerance show it.
        ("(always[0,0.3] x >= 0) or (eventually[0,0.3] x <= 0)", 5e-4, True),
        ("x >= -2 until[0,0.3] x <= 0", 5e-4, True),
        ("always (x >= -2)", 5e-4, False),
    ],
)
def test_a_rollout_says_where_the_tolerance_could_decide_its_sign(formula: str, moved: float, decided: bool) -> None:
    times = np.arange(5, dtype=np.float64) * 0.1
    times[3] += moved
    samples = np.column_stack((times, AT_A_BORDER, AT_A_BORDER))
    assert evaluated(parse_formula(formula, NAMES), NAMES, samples).by_tolerance is decided


def test_a_rollout_that_lasts_needs_a_horizon() -> None:
    found = uncovered(np.array([0.0, 1.0]), 0.0)
    assert found is not None
    assert "the last row, 1, is at t = 1 s, and the horizon is 0 s: give the campaign horizon = 1" in found


@pytest.mark.parametrize(("samples", "missing"), [(10, True), (9, False), (1, False)])
def test_one_sample_too_few_is_named(samples: int, missing: bool) -> None:
    found = uncovered(np.arange(samples, dtype=np.float64) * 0.1, 1.0)
    assert found is not None
    assert ("one sample more: round(horizon / step) + 1" in found) is missing
