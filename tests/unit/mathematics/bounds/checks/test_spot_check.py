"""Spot check: order and choice of starts, both kinds of test, the exact mean wealth, bad input."""

import itertools
import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perfbound.orchestrator.mathematics.bounds.checks.spot_check import VIOLATION, Hypothesis, SpotTests, failure_share
from perfbound.orchestrator.mathematics.bounds.one_law.share import clopper_pearson_upper

NOISY = Hypothesis("risk", 0.0, -0.4, 1.0, noisy=True)
EXACT = Hypothesis("nominal", 0.5, None, None, noisy=False)
UNBOUNDED = Hypothesis("gap", 0.5, None, None, noisy=True)


def check_of(*hypotheses: Hypothesis, size: int = 4, followups: int = 10, delta: float = 0.05) -> SpotTests:
    return SpotTests(tuple((float(j), 0.5) for j in range(size)), hypotheses, followups=followups, delta=delta)


def campaign(check: SpotTests, simulate: Callable[[int], list[float]], window: int) -> list[int]:
    """Run a check with `window` tests in flight, and return the starts in the order of their tests."""
    flight: list[int] = []
    order: list[int] = []
    while True:
        while len(flight) < window and (proposal := check.propose(flight)) is not None:
            flight.append(proposal.node)
            order.append(proposal.node)
        if not flight:
            return order
        check.observe(flight[0], simulate(flight.pop(0)))


def a_law(means: list[float], seed: int, hypothesis: Hypothesis = NOISY) -> Callable[[int], list[float]]:
    rng = np.random.default_rng(seed)
    low, high = hypothesis.low, hypothesis.high
    assert low is not None
    assert high is not None
    return lambda node: [float(np.clip(means[node] + 0.1 * rng.standard_normal(), low, high))]


class TestOrder:
    @given(st.integers(1, 30), st.integers(1, 12))
    @settings(max_examples=25, deadline=None)
    def test_every_start_is_tested_once_first_in_order(self, size: int, window: int) -> None:
        order = campaign(check_of(NOISY, EXACT, size=size, followups=7), lambda _: [0.05, 0.0], window)
        assert order[:size] == list(range(size))
        assert len(order) <= size + 7

    def test_a_proposal_has_its_start_and_changes_nothing(self) -> None:
        check = check_of(NOISY)
        first = check.propose()
        assert first is not None
        assert (first.node, first.x, first.mu, first.sigma, first.beta, first.F) == (0, (0.0, 0.5), *[None] * 4)
        assert check.propose() == first
        assert check.propose([0, 1]) == check.propose([1, 0])

    def test_without_noise_there_is_no_followup(self) -> None:
        check = check_of(EXACT, UNBOUNDED)
        assert campaign(check, lambda _: [1.0, 1.0], 3) == [0, 1, 2, 3]
        assert check.propose() is None

    def test_a_followup_goes_where_the_value_is_highest_and_says_so(self) -> None:
        check = check_of(NOISY)
        for node, value in enumerate((-0.1, 0.2, 0.1, -0.2)):
            check.observe(node, [value])
        proposal = check.propose()
        assert proposal is not None
        assert proposal.node == 1
        assert proposal.mu == pytest.approx(0.2)
        assert proposal.sigma is not None
        assert proposal.sigma > 0

    def test_tests_in_flight_spread_over_the_suspicious_starts(self) -> None:
        check = check_of(NOISY, size=10, followups=100)
        for node in range(10):
            check.observe(node, [0.1 if node < 5 else -0.4])
        flight: list[int] = []
        for _ in range(20):
            proposal = check.propose(flight)
            assert proposal is not None
            flight.append(proposal.node)
        assert sorted(flight[:5]) == [0, 1, 2, 3, 4]
        assert set(flight) == {0, 1, 2, 3, 4}

    def test_values_far_below_the_limit_end_the_check_without_followups(self) -> None:
        hypothesis = Hypothesis("risk", 0.0, -2.0, 1.0, noisy=True)
        check = check_of(hypothesis, size=30, followups=1000)
        assert len(campaign(check, a_law([-1.5] * 30, 1, hypothesis), 8)) < 60
        assert check.finding(0).undecided == 0

    def test_a_claim_that_no_value_can_break_has_no_followups(self) -> None:
        check = check_of(Hypothesis("risk", 1.0, -0.4, 1.0, noisy=True))
        assert len(campaign(check, lambda _: [1.0], 2)) == 4
        assert check.finding(0).status == "not refuted"

    def test_the_budget_ends_the_check_and_the_rest_is_counted(self) -> None:
        check = check_of(NOISY, size=20, followups=30)
        order = campaign(check, a_law([-0.01] * 20, 2), 6)
        assert len(order) == 50
        finding = check.finding(0)
        assert finding.rollouts == 50
        assert finding.undecided is not None
        assert finding.undecided > 10


class TestFinding:
    def test_a_deterministic_violation_names_the_worst_start(self) -> None:
        check = check_of(EXACT)
        for node, value in enumerate((0.5 + VIOLATION / 2, 0.6, 0.7, 0.1)):
            check.observe(node, [value])
        finding = check.finding(0)
        assert (finding.status, finding.violations, finding.start, finding.starts) == ("refuted", 2, 2, 4)
        assert finding.share == clopper_pearson_upper(2, 4, 0.05)
        assert (finding.wealth, finding.undecided) == (None, None)

    def test_missing_starts_count_as_violations(self) -> None:
        check = check_of(EXACT, size=10)
        assert check.finding(0).share == 1.0
        check.observe(0, [0.0])
        finding = check.finding(0)
        assert (finding.status, finding.violations, finding.start) == ("not refuted", 0, None)
        assert finding.share == clopper_pearson_upper(9, 10, 0.05)

    def test_none_of_299_is_at_most_one_percent(self) -> None:
        check = check_of(EXACT, size=299)
        campaign(check, lambda _: [0.5], 20)
        assert check.finding(0).share == pytest.approx(1 - 0.05 ** (1 / 299), abs=2e-9)

    def test_an_unbounded_noisy_objective_is_not_testable(self) -> None:
        check = check_of(UNBOUNDED)
        check.observe(0, [9.0])
        finding = check.finding(0)
        assert (finding.status, finding.start, finding.wealth, finding.share) == ("not testable", None, None, None)

    @pytest.mark.parametrize(("deficit", "followups"), [(0.05, 900), (0.1, 600), (0.3, 200)])
    def test_a_bad_start_is_refuted_and_named(self, deficit: float, followups: int) -> None:
        check = check_of(NOISY, size=100, followups=followups)
        means = [-0.1 - 0.002 * j for j in range(100)]
        means[70] = deficit
        campaign(check, a_law(means, 3), 10)
        finding = check.finding(0)
        assert (finding.status, finding.start) == ("refuted", 70)
        assert finding.wealth is not None
        assert finding.wealth >= 20

    def test_many_starts_that_are_little_too_bad_are_refuted_together(self) -> None:
        """A tenth of the starts is .12 beyond the limit, the range is 25 sd wide: no single start can be named."""
        hypothesis = Hypothesis("risk", 0.0, -1.0, 1.5, noisy=True)
        refuted = named = 0
        for seed in range(10):
            check = check_of(hypothesis, size=299, followups=150)
            campaign(check, a_law([0.12 if j % 10 == 0 else -0.3 for j in range(299)], seed, hypothesis), 10)
            refuted += check.finding(0).status == "refuted"
            named += check.finding(0).start is not None
        assert (refuted, named) == (10, 0)

    def test_one_rollout_serves_all_hypotheses(self) -> None:
        """A follow-up that one hypothesis asks for is a rollout of the other, too."""
        other = Hypothesis("other", 0.9, -1.0, 1.0, noisy=True)
        check = check_of(NOISY, other, EXACT, size=20, followups=100)
        rng = np.random.default_rng(5)
        campaign(check, lambda node: [0.3 if node == 7 else -0.3, float(rng.uniform(-1, 0)), 0.0], 5)
        findings = [check.finding(k) for k in range(3)]
        assert [each.status for each in findings] == ["refuted", "not refuted", "not refuted"]
        assert findings[0].rollouts == findings[1].rollouts > 20
        assert findings[2].rollouts == 20, "without noise a follow-up adds nothing"
        assert findings[0].start == 7

    def test_a_limit_below_the_range_is_refuted(self) -> None:
        check = check_of(Hypothesis("risk", -1.0, -0.4, 1.0, noisy=True), followups=20)
        campaign(check, lambda _: [-0.4], 1)
        assert check.finding(0).status == "refuted"

    def test_first_values_are_those_of_the_first_rollouts(self) -> None:
        check = check_of(NOISY)
        for node, value in ((0, 0.1), (2, -0.1), (0, 0.9)):
            check.observe(node, [value])
        assert check.first_values(0) == (0.1, None, -0.1, None)


class TestWealth:
    @pytest.mark.parametrize("p", [Fraction(1, 4), Fraction(1, 2)])
    def test_the_mean_over_all_paths_is_one_at_the_limit(self, p: Fraction) -> None:
        """Every path of 8 two-point rollouts whose mean is the limit, follow-ups chosen by the check itself."""
        high, low = float(1 - p), float(-p)
        total = 0.0
        for path in itertools.product((0, 1), repeat=8):
            check = check_of(Hypothesis("risk", 0.0, low, high, noisy=True), size=3, followups=5, delta=1e-6)
            for one in path:
                if (proposal := check.propose()) is None:  # no start is suspicious on this path
                    break
                check.observe(proposal.node, [high if one else low])
            weight = p ** sum(path) * (1 - p) ** (8 - sum(path))
            record = check._records[0]
            ((_, wealth),) = record._kinds
            total += float(weight) * wealth.whole
        assert total == pytest.approx(1, abs=1e-12)

    @given(st.lists(st.tuples(st.integers(0, 3), st.floats(-0.4, 1.0)), max_size=60))
    @settings(max_examples=50, deadline=None)
    def test_wealth_is_positive_and_findings_never_go_back(self, rollouts: list[tuple[int, float]]) -> None:
        check, last = check_of(NOISY), 1.0
        for node, value in rollouts:
            check.observe(node, [value])
            assert all(wealth.own(start) > 0 for _, wealth in check._records[0]._kinds for start in range(check.size))
            wealth = check.finding(0).wealth
            assert wealth is not None
            assert wealth >= last
            last = wealth

    def test_a_named_start_implies_a_refuted_claim(self) -> None:
        check = check_of(NOISY, size=3, followups=50)
        named_at = None
        for n in range(60):
            check.observe(1, [0.2])
            finding = check.finding(0)
            if finding.start is not None:
                assert finding.status == "refuted"
                named_at = named_at or n
        assert named_at is not None


class TestFailureShare:
    @given(st.integers(0, 50), st.floats(0.01, 1.0))
    def test_it_is_the_share_divided_by_theta(self, failures: int, theta: float) -> None:
        found = failure_share(failures, 50, theta, 0.05)
        assert found == pytest.approx(min(1.0, clopper_pearson_upper(failures, 50, 0.05) / theta), abs=1.1e-9)
        assert found * theta >= min(theta, clopper_pearson_upper(failures, 50, 0.05)) * (1 - 1e-12)

    def test_bad_theta(self) -> None:
        with pytest.raises(ValueError, match="theta"):
            failure_share(0, 10, 0.0, 0.05)


@pytest.mark.parametrize(
    "call",
    [
        lambda: Hypothesis("a", math.nan, None, None, noisy=True),
        lambda: Hypothesis("a", 0.0, 0.0, None, noisy=True),
        lambda: Hypothesis("a", 0.0, 1.0, 1.0, noisy=True),
        check_of,
        lambda: check_of(NOISY, size=0),
        lambda: check_of(NOISY, NOISY),
        lambda: check_of(NOISY, followups=-1),
        lambda: check_of(NOISY, delta=0.0),
        lambda: SpotTests(((0.0,), (0.0, 1.0)), (NOISY,), followups=1),
        lambda: SpotTests(((math.inf,),), (NOISY,), followups=1),
        lambda: check_of(NOISY).observe(0, []),
        lambda: check_of(NOISY).observe(0, [1.1]),
        lambda: check_of(EXACT).observe(0, [math.nan]),
        lambda: check_of(NOISY).observe(4, [0.0]),
        lambda: check_of(NOISY).propose([-1]),
        lambda: check_of(NOISY).finding(1),
    ],
)
def test_bad_input_is_refused(call: Callable[[], object]) -> None:
    with pytest.raises((ValueError, IndexError)):
        call()


def test_a_refused_rollout_changes_nothing() -> None:
    check = check_of(NOISY, EXACT)
    with pytest.raises(ValueError, match="nominal"):
        check.observe(0, [0.5, math.inf])
    assert check.rollouts == 0
    assert check.finding(0).wealth == 1.0


def test_unbounded_noise_of_a_known_scale_is_tested() -> None:
    rng = np.random.default_rng(5)
    for excess, expected in ((-0.5, "not refuted"), (0.5, "refuted")):
        check = SpotTests(
            [(float(j),) for j in range(30)], [Hypothesis("y", 1.0, None, None, noisy=True, scale=0.5)], followups=200
        )
        while (proposal := check.propose()) is not None:
            check.observe(proposal.node, [1.0 + (excess if proposal.node == 7 else -2.0) + 0.5 * rng.standard_normal()])
        assert check.finding(0).status == expected


@pytest.mark.parametrize(("scale", "expected"), [(None, "not refuted"), (0.02, "refuted")])
def test_a_wide_range_needs_the_scale_of_the_noise(scale: float | None, expected: str) -> None:
    """An excess of .4 at three of 30 starts with noise of .02: next to nothing of a range of 200."""
    rng = np.random.default_rng(5)
    hypothesis = Hypothesis("y", 0.0, -100.0, 100.0, noisy=True, scale=scale)
    check = SpotTests([(float(j),) for j in range(30)], [hypothesis], followups=60)
    while (proposal := check.propose()) is not None:
        check.observe(proposal.node, [(0.4 if proposal.node < 3 else -0.1) + 0.02 * rng.standard_normal()])
    assert check.finding(0).status == expected


@pytest.mark.rest
@pytest.mark.parametrize("noise", ["gaussian", "two points"])
def test_range_and_scale_together_keep_the_level(noise: str) -> None:
    """Every start at the limit itself."""
    rng, refuted = np.random.default_rng(7), 0
    for _ in range(400):
        hypothesis = Hypothesis("y", 0.0, -8.0, 8.0, noisy=True, scale=1.0)
        check = SpotTests([(float(j),) for j in range(20)], [hypothesis], followups=40)
        while (proposal := check.propose()) is not None:
            value = rng.standard_normal() if noise == "gaussian" else rng.choice((-1.0, 1.0))
            check.observe(proposal.node, [float(np.clip(value, -8.0, 8.0))])
        refuted += check.finding(0).status == "refuted"
    assert refuted <= 31  # binom.ppf(.99, 400, .05)


def test_noise_without_range_or_scale_is_not_tested() -> None:
    check = SpotTests([(0.0,)], [Hypothesis("y", 1.0, None, None, noisy=True)], followups=200)
    check.observe(0, [99.0])
    assert check.finding(0).status == "not testable"


@pytest.mark.rest
def test_the_wealth_of_sub_gaussian_noise_is_a_supermartingale() -> None:
    # E[exp(lambda e - lambda^2 R^2/2)] = 1 for Gaussian noise of mean 0: over many starts at the limit itself.
    rng, refuted = np.random.default_rng(6), 0
    for _ in range(400):
        check = SpotTests(
            [(float(j),) for j in range(20)], [Hypothesis("y", 0.0, None, None, noisy=True, scale=1.0)], followups=40
        )
        while (proposal := check.propose()) is not None:
            check.observe(proposal.node, [rng.standard_normal()])
        refuted += check.finding(0).status == "refuted"
    assert refuted <= 30  # 20 expected at most at level .05; binom.ppf(.99, 400, .05) = 31
