"""Method `sample`: each claim is the bound of its quantity, and the port of a method is kept."""

import math
from collections.abc import Iterable
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.method import Integers
from perfbound.orchestrator.mathematics.bounds.one_law.failures import beta_mixture_upper
from perfbound.orchestrator.mathematics.bounds.one_law.predictable import CvarSequence, RiskSequence
from perfbound.orchestrator.mathematics.bounds.one_law.share import (
    clopper_pearson_lower,
    clopper_pearson_upper,
    quantile_rank,
)
from perfbound.orchestrator.mathematics.bounds.sample import ESTIMATES, SampleMethod, Terms
from perfbound.orchestrator.mathematics.gp.kernels import Floats
from perfbound.schemas.file.drawn_claims import SAMPLED
from perfbound.schemas.values import Bound, Observation, SampledQuantity
from tests.fakes.states import blocks, sizes, state_of

CLIP = (-1.0, 1.0)
EVERY = [
    Terms("failure_probability", 0.05, clip=CLIP),
    Terms("quantile", 0.05, level=0.1, clip=CLIP),
    Terms("cvar", 0.05, level=0.1, clip=CLIP),
    Terms("mean", 0.05, clip=CLIP),
    Terms("risk", 0.05, clip=CLIP, risk_weight=0.2),
    Terms("share_of_starts", 0.05, level=0.1, clip=CLIP),
    Terms("next_rollout", 0.05, level=0.05, clip=CLIP),
]
VALUES = st.lists(st.floats(*CLIP), min_size=1, max_size=60)


def start(number: int) -> tuple[float, ...]:
    return (float(number), 0.5)


def fed(terms: list[Terms], values: list[float], *, fixed: int | None = None) -> SampleMethod:
    method = SampleMethod(terms, start, fixed=fixed, largest=terms[0].quantity == "failure_probability")
    for value in values:
        method.observe(method.propose(), Observation(-value, (value,)))
    return method


def drawn(count: int, seed: int = 1) -> list[float]:
    return [float(each) for each in np.random.default_rng(seed).uniform(-0.1, 1.0, count)]


def test_every_quantity_of_the_file_has_an_estimate() -> None:
    assert set(SAMPLED) == set(ESTIMATES) == set(get_args(SampledQuantity))


def test_samples_without_a_failure_prove_one_per_cent() -> None:
    method = fed(EVERY[:1], [0.5] * 299, fixed=299)
    assert method.found(0) == clopper_pearson_upper(0, 299, 0.05) < 0.01


@pytest.mark.parametrize("failures", [0, 1, 7])
def test_a_number_that_was_fixed_beforehand_has_the_exact_bound_and_every_other_one_the_betting_bound(
    failures: int,
) -> None:
    values = [-0.5] * failures + [0.5] * (300 - failures)
    exact, anytime = fed(EVERY[:1], values, fixed=300), fed(EVERY[:1], values)
    assert exact.found(0) == clopper_pearson_upper(failures, 300, 0.05)
    assert anytime.found(0) == min(beta_mixture_upper(min(failures, n), n, 0.05) for n in range(1, 301))
    assert fed(EVERY[:1], values, fixed=301).found(0) == anytime.found(0)
    assert (exact.is_exact, anytime.is_exact) == (True, False)


def test_the_exact_quantile_is_a_value_and_the_bound_before_it_is_of_the_grid() -> None:
    values = drawn(200)
    rank = quantile_rank(200, 0.1, 0.05)
    assert rank is not None
    exact = fed(EVERY[1:2], values, fixed=200).found(0)
    assert exact == pytest.approx(sorted(values)[rank - 1], abs=2e-9)
    before = fed(EVERY[1:2], values).found(0)
    assert before is not None
    assert exact is not None
    assert before < exact


def test_without_a_clip_a_quantile_has_no_bound_before_its_number() -> None:
    terms = [Terms("quantile", 0.05, level=0.1)]
    method = fed(terms, [1e6, -1e9] * 49, fixed=100)
    assert method.found(0) is None
    assert method.observe(method.propose(), Observation(0.0, (3.0,))) == Bound(None, None, None)
    assert method.observe(method.propose(), Observation(0.0, (3.0,))).upper == 1e9


def test_means_are_the_sequences_by_betting() -> None:
    values = drawn(300)
    cvar, risk = CvarSequence(0.1, CLIP, delta=0.05), RiskSequence(0.2, CLIP, delta=0.05)
    for value in values:
        cvar.add(value)
        risk.add(value)
    method = fed(EVERY, values, fixed=300)
    assert (method.found(2), method.found(4)) == (cvar.lower(), risk.lower())
    assert method.found(5) == cvar.lower()  # one rollout a start


def test_replicates_of_a_start_count_once_where_one_rollout_counts() -> None:
    method = SampleMethod([EVERY[0], EVERY[3]], start, fixed=50, largest=True)
    for _ in range(50):
        bound = method.observe(method.propose(), Observation(0.0, (0.5, -0.5, -0.5)))
    assert bound.upper == clopper_pearson_upper(0, 50, 0.05)
    mean = method.found(1)
    assert mean is not None
    assert mean < -1 / 6  # of all three


def test_a_factor_divides_the_level() -> None:
    values = drawn(400)
    terms = [
        Terms("failure_probability", 0.05, ratio=3.0),
        Terms("quantile", 0.05, level=0.3, ratio=3.0),
        Terms("mean", 0.05, ratio=4.0, clip=CLIP),
        Terms("cvar", 0.05, level=0.5, ratio=2.0, clip=CLIP),
    ]
    plain = [Terms("quantile", 0.05, level=0.1), Terms("cvar", 0.05, level=0.25, clip=CLIP)]
    method, other = fed(terms, values, fixed=400), fed(plain, values, fixed=400)
    failures = sum(value < 0 for value in values)
    assert method.found(0) == pytest.approx(3 * clopper_pearson_upper(failures, 400, 0.05), abs=2e-9)
    assert method.found(1) == other.found(0)
    assert method.found(2) == method.found(3) == other.found(1)


def test_the_first_claim_is_the_bound_of_j() -> None:
    values = drawn(100)
    upper = fed(EVERY, values, fixed=100).observe(fed(EVERY, values).propose(), Observation(0.0, (0.5,)))
    assert upper.upper is not None
    assert upper.lower is not None
    assert 0 <= upper.lower <= upper.upper <= 1
    fixed = SampleMethod(EVERY[:1], start, fixed=2, largest=True)
    for value in (-0.5, 0.5):
        bound = fixed.observe(fixed.propose(), Observation(0.0, (value,)))
    assert bound == Bound(clopper_pearson_upper(1, 2, 0.05), clopper_pearson_lower(1, 2, 0.05), None)
    lower = SampleMethod(EVERY[3:4], start, fixed=100, largest=False)
    for value in values:
        bound = lower.observe(lower.propose(), Observation(-value, (value,)))
    mean = lower.found(0)
    assert mean is not None
    assert bound.upper == -mean


@given(VALUES)
@settings(max_examples=40, deadline=None)
def test_observations_that_are_recalled_give_the_same_bounds(values: list[float]) -> None:
    one, other = fed(EVERY, values, fixed=len(values)), SampleMethod(EVERY, start, fixed=len(values), largest=True)
    other.recall([(other.propose(), Observation(-value, (value,))) for value in values])
    assert [one.found(k) for k in range(len(EVERY))] == [other.found(k) for k in range(len(EVERY))]


@given(VALUES)
@settings(max_examples=40, deadline=None)
def test_a_claim_does_not_depend_on_the_others(values: list[float]) -> None:
    together = fed(EVERY, values, fixed=len(values))
    for place, terms in enumerate(EVERY):
        assert fed([terms], values, fixed=len(values)).found(0) == together.found(place)


def test_starts_depend_on_their_number_alone() -> None:
    method = fed(EVERY[:1], [0.5, 0.5])
    assert method.propose().x == start(2)
    assert method.propose(0, (2, 3)).x == start(4)
    near = (4.0 * (1 + 1e-10), 0.5)
    rival = method.rival(near, (2, 3))
    assert rival is not None
    assert rival.x == near
    assert method.rival((4.1, 0.5), (2, 3)) is None


def test_a_value_beyond_the_clip_changes_nothing() -> None:
    method = fed(EVERY, drawn(20))
    before = [method.found(k) for k in range(len(EVERY))]
    for each in ((2.0,), (), (float("nan"),)):
        with pytest.raises(ValueError, match="within the clip"):
            method.observe(method.propose(), Observation(0.0, each))
    assert [method.found(k) for k in range(len(EVERY))] == before
    with pytest.raises(ValueError, match="clip: required"):
        SampleMethod([Terms("mean", 0.05)], start, fixed=1, largest=False)


def test_a_value_of_exactly_0_may_be_a_violation() -> None:
    # Neither is shown: it counts for the bound from above, and not for the one from below.
    method = SampleMethod(EVERY[:1], start, fixed=100, largest=True)
    for _ in range(100):
        bound = method.observe(method.propose(), Observation(1.0, (0.0,)))
    assert (bound.upper, bound.lower) == (1.0, 0.0)


def named(quantity: SampledQuantity, **changed: Any) -> Terms:
    levels = {"quantile": 0.1, "cvar": 0.1, "share_of_starts": 0.1, "next_rollout": 0.05}
    given: dict[str, Any] = {"level": levels.get(quantity, 1.0), "clip": CLIP, "risk_weight": 0.2}
    return Terms(quantity, 0.05, **{**given, **changed})


SHIFTED: tuple[SampledQuantity, ...] = (
    "failure_probability",
    "quantile",
    "cvar",
    "mean",
    "share_of_starts",
    "next_rollout",
)
CLAIMS: dict[str, list[Terms]] = {
    **{quantity: [named(quantity)] for quantity in get_args(SampledQuantity)},
    **{
        f"shifted {quantity}": [named(quantity, ratio=3.0)]
        for quantity in get_args(SampledQuantity)
        if quantity in SHIFTED
    },
    "without a clip": [named(each, clip=None) for each in ("failure_probability", "quantile", "next_rollout")],
    "of a deterministic system": [named("share_of_starts", deterministic=True)],
    "of requirements": [named(each, place=place) for place in (0, 1, 2) for each in ("quantile", "mean", "risk")],
    "of the second requirement alone": [named("failure_probability", place=2)],
}
"""Claims of one method, by name."""


def arrays(each: Floats) -> tuple[Integers, Floats, Floats]:
    return np.arange(len(each)), -each[:, 0], each


def method_of(name: str, *, fixed: int | None = None) -> SampleMethod:
    largest = CLAIMS[name][0].quantity == "failure_probability"
    return SampleMethod(CLAIMS[name], start, fixed=fixed, largest=largest)


def facts(method: SampleMethod) -> object:
    # The bounds first, for those that are kept.
    return method.bound(), [method.found(claim) for claim in range(len(method._claims))], state_of(method)


class TestManyAtOnce:
    """Everything is to the bit as after one test after the other."""

    @staticmethod
    def check(name: str, each: Floats, cuts: Iterable[int], fixed: int | None) -> None:
        one, many, recalled, listed = (method_of(name, fixed=fixed) for _ in range(4))
        for part in blocks(len(each), cuts):
            for row in each[part].tolist():
                bound = one.observe(one.propose(), Observation(-row[0], tuple(row)))
            assert many.observe_each(*arrays(each[part])) == bound
            recalled.recall_each(*arrays(each[part]))
            listed.recall([(listed.propose(), Observation(-row[0], tuple(row))) for row in each[part].tolist()])
            assert facts(one) == facts(many) == facts(recalled) == facts(listed)

    @pytest.mark.parametrize("name", CLAIMS)
    @given(st.data())
    @settings(max_examples=12, deadline=None)
    def test_any_values_in_any_blocks(self, name: str, data: st.DataObject) -> None:
        parts, width = 1 + max(terms.place for terms in CLAIMS[name]), data.draw(st.integers(1, 2))
        values = st.one_of(st.floats(*CLIP), st.sampled_from([0.0, -0.0, *CLIP]))
        row = st.lists(values, min_size=parts * width, max_size=parts * width)
        each = np.array(data.draw(st.lists(row, min_size=1, max_size=40)))
        cuts = data.draw(st.lists(st.integers(1, 20), max_size=5))
        self.check(name, each, cuts, data.draw(st.sampled_from([None, len(each)])))

    @pytest.mark.parametrize("name", CLAIMS)
    def test_a_thousand_tests(self, name: str) -> None:
        rng, parts = np.random.default_rng(8), 1 + max(terms.place for terms in CLAIMS[name])
        each = np.clip(rng.normal(0.3, 0.3, (1_000, 2 * parts)), *CLIP)
        self.check(name, each, sizes(len(each), 8), len(each))

    @pytest.mark.parametrize("bad", [1.5, -1.5, math.nan, math.inf])
    @pytest.mark.parametrize("name", [name for name in CLAIMS if name != "without a clip"])
    def test_an_error_changes_nothing(self, name: str, bad: float) -> None:
        method, parts = method_of(name), 1 + max(terms.place for terms in CLAIMS[name])
        each = np.full((5, parts), 0.25)
        method.observe_each(*arrays(each))
        before = facts(method)
        each[3, -1] = bad
        for call in (method.observe_each, method.recall_each):
            with pytest.raises(ValueError, match=r"within the clip \[-1.0, 1.0\], not \["):
                call(*arrays(each))
        with pytest.raises(ValueError, match="within the clip"):
            method.recall_each(np.arange(2), np.zeros(2), np.empty((2, 0)))
        assert facts(method) == before

    def test_without_a_clip_only_numbers_enter(self) -> None:
        method = method_of("without a clip")
        with pytest.raises(ValueError, match="within the clip"):
            method.observe_each(*arrays(np.array([[1e9], [math.nan]])))
        assert facts(method) == facts(method_of("without a clip"))

    def test_no_tests_change_nothing(self) -> None:
        for name in CLAIMS:
            method = method_of(name)
            assert method.observe_each(*arrays(np.empty((0, 3)))) == method.bound()
            assert facts(method) == facts(method_of(name))

    def test_tests_of_several_widths_are_recalled(self) -> None:
        one, other = method_of("mean"), method_of("mean")
        rows = [(0.1,), (0.2,), (0.3, 0.4), (0.5,), (0.6, 0.7), (0.8, 0.9)]
        for row in rows:
            one.observe(one.propose(), Observation(0.0, row))
        other.recall([(other.propose(), Observation(0.0, row)) for row in rows])
        assert facts(one) == facts(other)

    def test_whole_numbers_are_numbers(self) -> None:
        for name in ("quantile", "mean", "next_rollout"):
            one, other = method_of(name, fixed=3), method_of(name, fixed=3)
            one.recall([(one.propose(), Observation(0.0, (1,))) for _ in range(3)])
            other.recall([(one.propose(), Observation(0.0, (1.0,))) for _ in range(3)])
            assert facts(one) == facts(other)
