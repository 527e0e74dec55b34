"""Regions of a band against functions of known norm, closed forms and their own symmetries."""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.gaussian_process.kernels import Matern as ScikitMatern
from threadpoolctl import threadpool_limits

from perfbound.orchestrator.mathematics.bounds.one_law.risk import least_without_risk, linearised
from perfbound.orchestrator.mathematics.bounds.rigorous.cells import Integers
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises, mixture
from perfbound.orchestrator.mathematics.bounds.rigorous.envelope import Envelope
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.bounds.rigorous.regions import (
    MARGIN,
    SAFE,
    UNDECIDED,
    UNSAFE,
    Regions,
    covered,
    divide,
)
from perfbound.orchestrator.mathematics.gp.kernels import Floats, Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from tests.fakes.observations import an_observation

SIDE = 3.0


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


class Function:
    """A random function of norm 1 in the space of a kernel, plus a constant; evaluated by scikit-learn."""

    def __init__(self, seed: int, kernel: Matern, dimension: int, shift: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        self._kernel = ScikitMatern(kernel.length_scale, nu=kernel.nu)
        # Signs alternate, so that most of these functions have both.
        self._centres = rng.uniform(0, SIDE, (6, dimension))
        weights = np.abs(rng.normal(size=6)) * np.array([1, -1, 1, -1, 1, -1])
        self._weights = weights / math.sqrt(weights @ self._kernel(self._centres) @ weights)
        self._shift = shift

    def __call__(self, z: Floats) -> Floats:
        return np.asarray(self._kernel(z, self._centres) @ self._weights + self._shift, dtype=np.float64)


def lattice(dimension: int, resolution: int = 7) -> Lattice:
    return Lattice((0.0,) * dimension, (SIDE,) * dimension, resolution)


def method(
    box: Lattice, kernel: Matern, *, noise: float = 0.0, prior_mean: float = 0.0, **more: float
) -> RigorousMethod:
    premises = Premises(1.0, noise, more.pop("delta", 0.1), mixture(1.0, noise), **more)
    return RigorousMethod(box, kernel, premises, alpha=1e-6, prior_mean=prior_mean)


def observed(found: RigorousMethod, values: Floats, nodes: Integers) -> RigorousMethod:
    found.recall([an_observation(int(node), float(values[int(node)])) for node in nodes])
    return found


def regions(envelope: Envelope, box: Lattice, **more: float) -> Regions:
    return divide(envelope, np.array(box.low), np.array(box.high), **more)  # type: ignore[arg-type]


def wrong(found: Regions, z: Floats, j: Floats) -> int:
    """Count the points where J has another sign than their certified box."""
    status = found.at(z)
    return int(np.sum((status == SAFE) & (j >= 0)) + np.sum((status == UNSAFE) & (j <= 0)))


class TestTruth:
    @pytest.mark.rest
    @given(
        seed=st.integers(0, 10_000),
        nu=st.sampled_from([0.5, 0.8, 1.5, 2.5, 10.0]),
        dimension=st.sampled_from([1, 2, 3]),
        tests=st.integers(1, 40),
        shift=st.sampled_from([-0.3, 0.0, 0.2]),
    )
    @settings(deadline=None, max_examples=40)
    def test_every_point_of_a_certified_box_has_the_proven_sign(
        self, seed: int, nu: float, dimension: int, tests: int, shift: float
    ) -> None:
        kernel, box, rng = Matern(nu, 1.5), lattice(dimension, 5), np.random.default_rng(seed)
        j = Function(seed, kernel, dimension, shift=shift)
        nodes = rng.permutation(box.size)[:tests]
        found = observed(method(box, kernel, prior_mean=shift), j(box.nodes), nodes)
        # Few cells: the statement is as strict, and a case takes a tenth of a second.
        divided = regions(found.envelope, box, max_cells=2_000)
        z = rng.uniform(0, SIDE, (500, dimension))
        assert wrong(divided, z, j(z)) == 0
        # Corners are points of the box as well, and the first where a bound between the nodes would fail.
        for corners in (divided.low, divided.high):
            proven = divided.status != UNDECIDED
            assert (np.sign(j(corners[proven])) == np.where(divided.status[proven] == SAFE, -1, 1)).all()

    def test_most_of_the_box_is_decided_after_enough_tests(self) -> None:
        kernel, box = Matern(2.5, 1.5), lattice(2, 9)
        j = Function(3, kernel, 2)
        found = observed(method(box, kernel), j(box.nodes), np.arange(box.size))
        divided = regions(found.envelope, box)
        fine = np.random.default_rng(0).uniform(0, SIDE, (20_000, 2))
        safe = float(np.mean(j(fine) < 0))
        assert 0.1 < safe < 0.9
        assert divided.of(SAFE) == pytest.approx(safe, abs=0.03)
        assert divided.of(UNDECIDED) < 0.03

    @pytest.mark.parametrize("dimension", [1, 2, 3, 4])
    def test_the_boxes_cover_d_without_overlap(self, dimension: int) -> None:
        kernel, box = Matern(2.5, 1.5), lattice(dimension, 4)
        found = observed(method(box, kernel), Function(1, kernel, dimension)(box.nodes), np.arange(0, box.size, 2))
        divided = regions(found.envelope, box, max_cells=4_000)
        assert sum(map(divided.of, (SAFE, UNSAFE, UNDECIDED))) == 1.0
        for z in np.random.default_rng(0).uniform(0, SIDE, (200, dimension)):
            assert np.sum(np.all((divided.low < z) & (z < divided.high), axis=1)) == 1
        assert (divided.low.min(axis=0) == 0.0).all()
        assert (divided.high.max(axis=0) == SIDE).all()


class TestClosedForms:
    @pytest.mark.parametrize("sign", [-1, 1])
    def test_one_observation_without_noise(self, sign: int) -> None:
        """|f| <= 1 and f(0) = -1/2: the worst f is below 0 where k > sqrt(3)/2, so within r of 0, and no farther."""
        kernel, box = Matern(0.5, 2.0), lattice(1, 2)
        found = observed(method(box, kernel, round_off=1e-12), np.array([sign * 0.5, 0.0]), np.array([0]))
        r = -2.0 * math.log(math.sqrt(3.0) / 2.0)
        divided = regions(found.envelope, box)
        kind, other = (SAFE, UNSAFE) if sign < 0 else (UNSAFE, SAFE)
        assert r / SIDE - 3 / 1024 < divided.of(kind) <= r / SIDE
        assert divided.of(other) == 0.0

    def test_the_misspecification_moves_the_edge(self) -> None:
        """With f(0) = -1/2 +- tau and J = f +- tau, the edge is where the band of f alone ends at -tau."""
        kernel, box, tau = Matern(0.5, 2.0), lattice(1, 2), 0.05
        plain = observed(method(box, kernel), np.array([-0.5, 0.0]), np.array([0]))
        relaxed = observed(method(box, kernel, tau=tau), np.array([-0.5, 0.0]), np.array([0]))
        divided = [regions(each.envelope, box) for each in (relaxed, plain)]
        near, far = (float(each.high[each.status == SAFE].max()) for each in divided)
        assert near < far
        upper, _ = relaxed.envelope.at(np.array([[near], [near + 2 * SIDE / 1024]]))
        assert upper[0] < 0 <= upper[1] + 1e-9

    @pytest.mark.parametrize(
        ("prior_mean", "status"), [(-1.001, SAFE), (1.001, UNSAFE), (0.0, UNDECIDED), (-1.0, UNDECIDED)]
    )
    def test_without_data_the_prior_decides_all_or_nothing(self, prior_mean: float, status: int) -> None:
        box = lattice(2)
        divided = regions(method(box, Matern(2.5, 1.0), prior_mean=prior_mean).envelope, box)
        assert (divided.status.tolist(), divided.share.tolist()) == ([status], [1.0])
        assert (divided.low.tolist(), divided.high.tolist()) == ([[0.0, 0.0]], [[SIDE, SIDE]])

    def test_a_function_that_is_zero_is_undecided_everywhere(self) -> None:
        kernel, box = Matern(2.5, 1.0), lattice(2)
        found = observed(method(box, kernel), np.zeros(box.size), np.arange(box.size))
        assert regions(found.envelope, box).of(UNDECIDED) == 1.0


@pytest.fixture(scope="module")
def case() -> tuple[Envelope, Lattice]:
    kernel, box = Matern(2.5, 1.5), lattice(2)
    return observed(method(box, kernel), Function(4, kernel, 2)(box.nodes), np.arange(0, box.size, 2)).envelope, box


class TestRisk:
    @given(
        values=st.lists(st.floats(-0.5, 1.0), min_size=1, max_size=4),
        weights=st.lists(st.floats(0.01, 1.0), min_size=4, max_size=4),
        risk_weight=st.floats(0.05, 3.0),
        c=st.floats(-1.0, 1.5),
        s=st.floats(0.02, 1.0),
    )
    def test_no_law_without_negative_risk_is_below_the_threshold(
        self, values: list[float], weights: list[float], risk_weight: float, c: float, s: float
    ) -> None:
        law = np.array(weights[: len(values)]) / sum(weights[: len(values)])
        rho = np.array(values)
        mean = float(law @ rho)
        risk = mean - risk_weight * math.sqrt(float(law @ (rho - mean) ** 2))
        expectation = float(law @ [linearised(value, risk_weight, c, s) for value in values])
        assert risk < 1e-12 or expectation >= least_without_risk((-0.5, 1.0), risk_weight, c, s) - 1e-9

    def test_three_laws_attain_it(self) -> None:
        """The ends of the two branches: rho = 0, rho = M, and the law on {-m, M} whose risk is 0."""
        clip, r = (-0.5, 1.0), 0.5
        p = -clip[0] / (clip[1] - clip[0])
        for c, s in ((0.9, 0.05), (-0.9, 0.05), (0.3, 2.0), (0.1, 0.3)):
            laws = [[(0.0, 1.0)], [(1.0, 1.0)]]
            for share in np.linspace(p, 1.0, 200_001):
                mean = share * clip[1] + (1 - share) * clip[0]
                if mean >= r * math.sqrt(share * (1 - share)) * (clip[1] - clip[0]):
                    laws.append([(clip[1], float(share)), (clip[0], 1.0 - float(share))])
                    break
            attained = min(sum(w * linearised(rho, r, c, s) for rho, w in law) for law in laws)
            assert least_without_risk(clip, r, c, s) == pytest.approx(attained, abs=1e-3)
            assert least_without_risk(clip, r, c, s) <= attained


class TestThresholds:
    def test_the_bound_of_the_maximum_decides_the_whole_box(self, case: tuple[Envelope, Lattice]) -> None:
        assert regions(*case, upper=-1e-8).of(SAFE) == 1.0
        assert regions(*case, upper=-1e-10).of(SAFE) < 1.0

    def test_the_mirrored_band_exchanges_safe_and_unsafe(self, case: tuple[Envelope, Lattice]) -> None:
        envelope, box = case
        here, there = regions(envelope, box), regions(envelope.mirrored(), box)
        assert here.of(SAFE) > 0.02
        assert here.of(UNSAFE) > 0.02
        assert (here.of(SAFE), here.of(UNSAFE)) == (there.of(UNSAFE), there.of(SAFE))

    @pytest.mark.rest
    def test_a_threshold_that_no_value_passes(self, case: tuple[Envelope, Lattice]) -> None:
        assert regions(*case, unsafe_above=math.inf).of(UNSAFE) == 0.0
        assert covered(regions(*case), regions(*case, unsafe_above=math.inf), SAFE).all()
        shares = [regions(*case, unsafe_above=t).of(UNSAFE) for t in (0.0, 0.05, 0.1)]
        assert all(a > b for a, b in pairwise(shares))
        assert regions(*case, unsafe_above=1.0).of(UNSAFE) == 0.0

    def test_a_smaller_margin_covers_a_larger_one(self, case: tuple[Envelope, Lattice]) -> None:
        strict, found, lax = (regions(*case, margin=MARGIN + shift) for shift in (0.04, 0.02, 0.0))
        for status in (SAFE, UNSAFE):
            assert covered(strict, found, status).all()
            assert covered(found, lax, status).all()
            assert not covered(lax, found, status).all()
            assert strict.of(status) < found.of(status) < lax.of(status)

    def test_fewer_cells_decide_less(self, case: tuple[Envelope, Lattice]) -> None:
        few, many = (regions(*case, max_cells=cells) for cells in (300, 150_000))
        assert 0 < few.of(SAFE) < many.of(SAFE)
        assert covered(few, many, SAFE).all()
        assert len(few.low) < 300

    def test_boxes_are_halved_across_the_longest_side_in_length_scales(self) -> None:
        # In length scales the second side is a thousandth of the first: it is halved after ten halves of the other.
        box = Lattice((0.0, 0.0), (1.0, 1000.0), 5)
        values = 0.1 * np.sin(3 * box.nodes[:, 0]) - 0.05
        found = observed(method(box, Matern(2.5, (1.0, 1e6))), values, np.arange(box.size))
        divided = regions(found.envelope, box)
        sides = divided.high - divided.low
        assert (sides[sides[:, 0] > 1 / 1024, 1] == 1000.0).all()
        assert divided.of(UNDECIDED) < 0.25

    def test_halves_of_one_status_are_one_box(self, case: tuple[Envelope, Lattice]) -> None:
        found = regions(*case)
        boxes = set(zip(map(tuple, found.low.tolist()), map(tuple, found.high.tolist()), found.status, strict=True))
        assert len(boxes) == len(found.low)
        assert (np.diff(found.status) >= 0).all()
        undecided = found.status == UNDECIDED
        # Joined, most of the undecided area is in few boxes: a strip around the zero set is left in small ones.
        assert np.sort(found.share[undecided])[::-1][:50].sum() > 0.3 * found.of(UNDECIDED)


class TestNextTest:
    def campaign(self, unsafe_above: float | None, tests: int, window: int = 1) -> tuple[RigorousMethod, list[int]]:
        """Run a campaign on a function with both signs; the method afterwards, and the nodes in order."""
        kernel, box = Matern(2.5, 1.5), lattice(2, 9)
        values = Function(3, kernel, 2)(box.nodes)
        premises = Premises(1.0, 0.0, 0.1, ())
        found = RigorousMethod(box, kernel, premises, alpha=0.02, unsafe_above=unsafe_above)
        flying, nodes = [found.propose(40).node], list[int]()
        while len(nodes) < tests and found.bound().status == "open":
            while len(flying) < window:
                flying.append(found.propose(None, flying).node)
            nodes.append(flying.pop(0))
            found.observe(*an_observation(nodes[-1], float(values[nodes[-1]])))
            if window == 1 and found.bound().status == "open":
                flying.append(found.propose().node)
        return found, nodes

    def test_half_of_the_tests_go_where_the_sign_is_most_open(self) -> None:
        (plain, _), (dividing, nodes) = self.campaign(None, 14), self.campaign(0.0, 14)
        assert len(nodes) == len(set(nodes))
        box = lattice(2, 9)
        shares = [regions(each.envelope, box).of(UNDECIDED) for each in (plain, dividing)]
        assert shares[1] < 0.7 * shares[0]

    def test_the_campaign_converges_when_no_candidate_is_open_by_alpha(self) -> None:
        found, nodes = self.campaign(0.0, 81)
        assert found.bound().status == "converged"
        assert len(nodes) < 81
        upper, lower = found.envelope.at(lattice(2, 9).nodes)
        assert np.minimum(upper, -lower).max() <= 0.02 + 1e-9
        assert found.bound().upper - found.bound().lower <= 0.02

    def test_tests_in_flight_count_as_observed(self) -> None:
        (found, nodes), (_, alone) = self.campaign(0.0, 81, window=4), self.campaign(0.0, 81)
        assert found.bound().status == "converged"
        assert len(nodes) == len(set(nodes)) <= 1.5 * len(alone)

    def test_between_the_thresholds_nothing_is_open(self) -> None:
        """Without a threshold of unsafe starts only the sign of J counts, and the campaign ends all the same."""
        found, nodes = self.campaign(math.inf, 81)
        assert found.bound().status == "converged"
        assert nodes == self.campaign(0.0, 81)[1]
        found, nodes = self.campaign(0.2, 81)
        assert found.bound().status == "converged"
        upper, lower = found.envelope.at(lattice(2, 9).nodes)
        for threshold in (0.0, 0.2):
            assert np.minimum(upper - threshold, threshold - lower).max() <= 0.02 + 1e-9
