"""The Gaussian process on a lattice against dense linear algebra, scikit-learn and its own replay."""

import math
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern as ScikitMatern
from threadpoolctl import threadpool_limits

from perfbound.orchestrator.mathematics.gp.acquisition import climb, maximiser
from perfbound.orchestrator.mathematics.gp.distinct import DistinctPoints, OffNodeKernel
from perfbound.orchestrator.mathematics.gp.kernels import Floats, Matern, scaled
from perfbound.orchestrator.mathematics.gp.lattice import PARTS, Lattice
from perfbound.orchestrator.mathematics.gp.posterior import Posterior, SingularKernelError
from perfbound.orchestrator.mathematics.gp.radial import Radial

LATTICE = Lattice((0.0, -1.0), (5.0, 1.0), 7)
KERNEL = Matern(nu=2.5, length_scale=1.5)
ROWS = LATTICE.kernel_rows(KERNEL)
DENSE = ScikitMatern(length_scale=1.5, nu=2.5)(LATTICE.nodes)  # (m, m)

observations = st.lists(
    st.tuples(st.integers(0, LATTICE.size - 1), st.floats(-2, 2, allow_nan=False)), min_size=1, max_size=40
)
regularisers = st.sampled_from([0.01, 0.3, 1.0, 2.5])


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    with threadpool_limits(1):
        yield


def fitted(data: list[tuple[int, float]], regulariser: float) -> Posterior:
    posterior = Posterior(ROWS, regulariser)
    for index, y in data:
        posterior.append(index, y)
    return posterior


def dense_moments(data: list[tuple[int, float]], regulariser: float) -> tuple[Floats, Floats]:
    indices, y = [i for i, _ in data], np.array([v for _, v in data])
    gain = np.linalg.solve(DENSE[np.ix_(indices, indices)] + regulariser * np.eye(len(y)), DENSE[indices]).T
    return gain @ y, 1.0 - np.einsum("ij,ji->i", gain, DENSE[indices])


class TestKernel:
    r = np.array([0.0, 1e-6, 0.3, 2.0, 7.0])

    def test_closed_forms(self) -> None:
        s = math.sqrt(5) * self.r / 1.5
        np.testing.assert_allclose(Matern(0.5, 1.5)(self.r), np.exp(-self.r / 1.5), atol=1e-14)
        np.testing.assert_allclose(Matern(2.5, 1.5)(self.r), (1 + s + s * s / 3) * np.exp(-s), atol=1e-14)

    @pytest.mark.parametrize("nu", [0.5, 2.5, 10.0, 30.0])
    def test_unit_amplitude_exactly(self, nu: float) -> None:
        assert Matern(nu, 1.0)(np.zeros(1))[0] == 1.0

    @pytest.mark.parametrize("length_scale", [0.3, 1.5, 20.0, (0.5, 2.0)])
    @pytest.mark.parametrize("nu", [0.1, 0.5, 1.0, 1.5, 2.0, 2.5, 3.3, 10.0])
    def test_equals_scikit_learn_bitwise(self, nu: float, length_scale: float | tuple[float, float]) -> None:
        dimension = 2 if isinstance(length_scale, tuple) else 1
        points = np.random.default_rng(1).uniform(0.01, 60, (5000, dimension))
        points[:300] /= 100
        origin = np.zeros((1, dimension))
        # The distances of `Matern` are scaled where there is a length per axis.
        distances = cdist(origin, scaled(points, np.array(length_scale)) if dimension == 2 else points)
        expected = ScikitMatern(length_scale, nu=nu)(origin, points)
        assert Matern(nu, length_scale)(distances).tobytes() == expected.tobytes()

    @pytest.mark.integration
    def test_loads_no_scikit_learn(self) -> None:
        program = "import perfbound.orchestrator.run.session, perfbound.orchestrator.mathematics.gp.kernels as kernels"
        program += "; kernels.Matern(3.3, 1.0)(kernels.np.ones(2)); import sys; print('sklearn' in sys.modules)"
        ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        assert ended.stdout.strip() == "False", "it takes over a second of CPU to import"

    @pytest.mark.parametrize(("nu", "length_scale"), [(0, 1), (-1, 1), (math.inf, 1), (1, 0), (1, math.nan)])
    def test_refuses_parameters(self, nu: float, length_scale: float) -> None:
        with pytest.raises(ValueError, match="positive finite"):
            Matern(nu, length_scale)

    def test_refuses_distances(self) -> None:
        with pytest.raises(ValueError, match="not negative"):
            Matern(1, 1)(np.array([-1.0]))

    def test_overflow_says_what_to_change(self) -> None:
        with pytest.raises(ValueError, match="smaller nu"):
            Matern(60, 1)(np.array([1e-7]))


class TestLattice:
    def test_includes_the_edges_and_runs_the_last_axis_fastest(self) -> None:
        lattice = Lattice((0, 10), (1, 30), 3)
        assert lattice.nodes[[0, 1, 8]].tolist() == [[0, 10], [0, 20], [1, 30]]
        assert lattice.spacing == (0.5, 10.0)
        assert lattice.half_diagonal() == pytest.approx(math.hypot(0.5, 10) / 2)

    @pytest.mark.parametrize("dimension", [1, 2, 3])
    def test_rows_are_the_kernel_at_the_distances(self, dimension: int) -> None:
        lattice = Lattice((0.0,) * dimension, tuple(1.0 + a for a in range(dimension)), 5)
        rows = lattice.kernel_rows(KERNEL)
        full = np.array([rows.row(i) for i in range(lattice.size)])
        np.testing.assert_allclose(full, ScikitMatern(length_scale=1.5, nu=2.5)(lattice.nodes), atol=1e-14)
        np.testing.assert_array_equal(full, full.T)
        np.testing.assert_array_equal(np.diag(full), 1.0)

    def test_evaluates_the_kernel_once_per_offset(self) -> None:
        sizes = []

        def counting(distances: Floats) -> Floats:
            sizes.append(distances.size)
            return KERNEL(distances)

        rows = LATTICE.kernel_rows(counting)
        for index in range(LATTICE.size):
            rows.row(index)
        assert sizes == [LATTICE.size]

    def test_the_kernel_of_a_point_that_was_observed_is_not_computed_again(self) -> None:
        made: list[int] = []

        class Rows:
            size = LATTICE.size

            def row(self, index: int) -> Floats:
                made.append(index)
                return ROWS.row(index)

        points = DistinctPoints(Rows())
        for index in (4, 9):
            points.position(index)
        row, among = points.row(4)
        np.testing.assert_array_equal(row, ROWS.row(4))
        np.testing.assert_array_equal(among, ROWS.row(4)[[4, 9]])
        assert made == [4, 9]

    @pytest.mark.parametrize(
        ("low", "high", "resolution", "message"),
        [
            ((), (), 3, "one pair per axis"),
            ((0,), (1, 2), 3, "one pair per axis"),
            ((1,), (1,), 3, "below high"),
            ((0,), (math.inf,), 3, "below high"),
            ((0,), (1,), 1, "at least 2"),
            ((0,) * 4, (1,) * 4, 51, "lower the resolution"),
        ],
    )
    def test_refuses(self, low: tuple[float, ...], high: tuple[float, ...], resolution: int, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            Lattice(low, high, resolution)

    def test_refuses_a_node_outside(self) -> None:
        with pytest.raises(IndexError):
            ROWS.row(-1)


class TestPosterior:
    def test_prior(self) -> None:
        prior = Posterior(ROWS, 0.0)
        assert (prior.n, prior.information(1.0)) == (0, 0.0)
        assert not prior.mean.any()
        assert (prior.variance == 1.0).all()

    @pytest.mark.rest
    @given(observations, regularisers)
    @settings(deadline=None)
    def test_equals_a_dense_solve(self, data: list[tuple[int, float]], regulariser: float) -> None:
        posterior = fitted(data, regulariser)
        mean, variance = dense_moments(data, regulariser)
        np.testing.assert_allclose(posterior.mean, mean, atol=1e-9)
        np.testing.assert_allclose(posterior.variance, variance, atol=1e-10)

    @pytest.mark.rest
    @given(observations, regularisers, regularisers)
    @settings(deadline=None)
    def test_a_changed_regulariser_equals_a_dense_solve(
        self, data: list[tuple[int, float]], before: float, after: float
    ) -> None:
        posterior = fitted(data[:-1], before)
        posterior.regularise(after)
        posterior.append(*data[-1])
        mean, variance = dense_moments(data, after)
        np.testing.assert_allclose(posterior.mean, mean, atol=1e-9)
        np.testing.assert_allclose(posterior.variance, variance, atol=1e-10)

    @given(observations, regularisers)
    @settings(deadline=None, max_examples=20)
    def test_equals_scikit_learn(self, data: list[tuple[int, float]], regulariser: float) -> None:
        kernel = ScikitMatern(length_scale=1.5, nu=2.5)
        oracle = GaussianProcessRegressor(kernel, alpha=regulariser, optimizer=None)
        oracle.fit(LATTICE.nodes[[i for i, _ in data]], [y for _, y in data])
        mean, sd = oracle.predict(LATTICE.nodes, return_std=True)
        posterior = fitted(data, regulariser)
        np.testing.assert_allclose(posterior.mean, mean, atol=1e-9)
        np.testing.assert_allclose(posterior.variance, sd**2, atol=1e-10)

    @given(observations, regularisers)
    @settings(deadline=None)
    def test_variance_is_never_negative_and_never_grows(
        self, data: list[tuple[int, float]], regulariser: float
    ) -> None:
        posterior = Posterior(ROWS, regulariser)
        before = posterior.variance
        for index, y in data:
            posterior.append(index, y)
            assert (posterior.variance >= 0.0).all()
            assert (posterior.variance <= before).all()
            before = posterior.variance

    @given(observations)
    @settings(deadline=None)
    def test_variance_never_grows_with_a_falling_regulariser(self, data: list[tuple[int, float]]) -> None:
        posterior = Posterior(ROWS, 3.0)
        before = posterior.variance
        for n, (index, y) in enumerate(data, start=1):
            posterior.regularise(1 + 2 / n)
            posterior.append(index, y)
            assert (posterior.variance >= 0.0).all()
            assert (posterior.variance <= before + 1e-13).all()
            before = posterior.variance

    @given(observations, st.floats(0.001, 3))
    @settings(deadline=None)
    def test_information_is_the_log_determinant(self, data: list[tuple[int, float]], eta: float) -> None:
        indices = [i for i, _ in data]
        _, expected = np.linalg.slogdet((1 + eta) * np.eye(len(data)) + DENSE[np.ix_(indices, indices)])
        for regulariser in (0.5, 1 + eta):  # by a factor of its own, and from the posterior's
            assert fitted(data, regulariser).information(eta) == pytest.approx(expected, abs=1e-9)

    @given(observations, st.sampled_from([None, 0.3]))
    @settings(deadline=None)
    def test_a_replay_has_the_same_bits(self, data: list[tuple[int, float]], fixed: float | None) -> None:
        calm, replayed = Posterior(ROWS, fixed or 3.0), Posterior(ROWS, fixed or 3.0)
        for n, (index, y) in enumerate(data, start=1):
            for posterior in (calm, replayed):
                posterior.regularise(fixed or 1 + 2 / n)
                posterior.append(index, y)
            _ = (calm.mean, calm.variance, calm.information(0.1))  # asked at every step, as a live campaign does
        np.testing.assert_array_equal(calm.mean, replayed.mean)
        np.testing.assert_array_equal(calm.variance, replayed.variance)
        assert calm.information(0.1) == replayed.information(0.1)

    @pytest.mark.rest
    @given(st.lists(st.tuples(st.integers(0, 3), st.floats(-2, 2)), min_size=40, max_size=150), regularisers)
    @settings(deadline=None, max_examples=30)
    def test_merging_repeats_is_exact(self, data: list[tuple[int, float]], regulariser: float) -> None:
        """Four nodes, observed often enough for the rows of the factor to be merged on the way."""
        posterior = fitted(data, regulariser)
        mean, variance = dense_moments(data, regulariser)
        np.testing.assert_allclose(posterior.mean, mean, atol=1e-9)
        np.testing.assert_allclose(posterior.variance, variance, atol=1e-10)
        indices = [i for i, _ in data]
        _, expected = np.linalg.slogdet(regulariser * np.eye(len(data)) + DENSE[np.ix_(indices, indices)])
        assert posterior.information(regulariser - 1) == pytest.approx(expected, abs=1e-8)

    def test_the_factor_stays_as_small_as_the_points(self) -> None:
        posterior = fitted([(n % 20, 0.1) for n in range(1000)], 0.5)
        assert posterior.rows <= 40

    def test_repeated_points_shrink_towards_their_mean(self) -> None:
        posterior = fitted([(3, 1.0), (3, 2.0)] * 200, 1.0)
        assert posterior.mean[3] == pytest.approx(1.5 * 400 / 401)
        assert posterior.variance[3] == pytest.approx(1 / 401)

    def test_interpolates_without_noise(self) -> None:
        posterior = fitted([(3, 1.0), (40, -1.0)], 0.0)
        assert posterior.mean[[3, 40]] == pytest.approx([1.0, -1.0])

    def test_a_singular_matrix_is_an_error_that_changes_nothing(self) -> None:
        posterior = fitted([(3, 1.0)], 0.0)
        with pytest.raises(SingularKernelError, match=r"observation 1 .* Raise the regulariser"):
            posterior.append(3, 1.0)
        assert posterior.n == 1
        posterior.append(4, 1.0)
        assert posterior.n == 2

    def test_a_singular_refactoring_names_the_observation(self) -> None:
        posterior = fitted([(3, 1.0), (8, 0.0), (3, 1.0)], 1.0)
        posterior.regularise(0.0)
        with pytest.raises(SingularKernelError, match="observation 2 "):
            _ = posterior.mean
        posterior.regularise(1.0)
        assert posterior.mean == pytest.approx(fitted([(3, 1.0), (8, 0.0), (3, 1.0)], 1.0).mean)

    @pytest.mark.parametrize("y", [math.nan, math.inf])
    def test_refuses_observations(self, y: float) -> None:
        posterior = Posterior(ROWS, 1.0)
        with pytest.raises(ValueError, match="not a finite number"):
            posterior.append(0, y)
        assert posterior.n == 0

    def test_refuses_a_node_outside(self) -> None:
        posterior = Posterior(ROWS, 1.0)
        with pytest.raises(IndexError):
            posterior.append(LATTICE.size, 0.0)
        assert posterior.n == 0

    def test_refuses_regularisers(self) -> None:
        with pytest.raises(ValueError, match="regulariser"):
            Posterior(ROWS, -1.0)
        with pytest.raises(ValueError, match="regulariser"):
            Posterior(ROWS, 1.0).regularise(math.nan)

    def test_moments_are_read_only(self) -> None:
        with pytest.raises(ValueError, match="read-only"):
            fitted([(0, 1.0)], 1.0).mean[0] = 2.0


places = st.tuples(st.floats(0, 5), st.floats(-1, 1))


class TestOffNodes:
    """Points that need not be nodes."""

    @given(st.lists(st.tuples(places, st.floats(-2, 2)), min_size=1, max_size=20), places, st.sampled_from([None, 0.3]))
    @settings(deadline=None, max_examples=40)
    def test_equals_a_dense_solve(
        self, data: list[tuple[tuple[float, float], float]], z: tuple[float, float], fixed: float | None
    ) -> None:
        posterior = Posterior(ROWS, fixed or 3.0, OffNodeKernel(LATTICE.nodes, Radial(KERNEL)))
        for n, (x, value) in enumerate(data, start=1):
            posterior.regularise(fixed or 1 + 2 / n)
            posterior.append(x, value)
        kernel, points, y = ScikitMatern(1.5, nu=2.5), np.array([x for x, _ in data]), np.array([v for _, v in data])
        inverse = np.linalg.inv(kernel(points) + posterior.regulariser * np.eye(len(y)))

        def dense(where: Floats) -> tuple[Floats, Floats]:
            k = kernel(where, points)
            return k @ inverse @ y, 1 - np.einsum("ij,jk,ik->i", k, inverse, k)

        np.testing.assert_allclose((posterior.mean, posterior.variance), dense(LATTICE.nodes), atol=1e-9)
        mean, variance, mean_slope, variance_slope = posterior.at(z)
        step = 1e-5 * np.concatenate([np.eye(2), -np.eye(2)])
        np.testing.assert_allclose((mean, variance), np.ravel(dense(np.array([z]))), atol=1e-9)
        up_mean, up_variance = dense(z + step)
        np.testing.assert_allclose(mean_slope, (up_mean[:2] - up_mean[2:]) / 2e-5, atol=1e-5)
        np.testing.assert_allclose(variance_slope, (up_variance[:2] - up_variance[2:]) / 2e-5, atol=1e-5)

    def test_a_kink_has_no_gradient_at_its_point(self) -> None:
        posterior = Posterior(
            LATTICE.kernel_rows(Matern(0.5, 1.0)), 0.1, OffNodeKernel(LATTICE.nodes, Radial(Matern(0.5, 1.0)))
        )
        posterior.append((1.0, 0.0), 1.0)
        assert all(np.isfinite(slope).all() for slope in posterior.at((1.0, 0.0))[2:])


class TestClimb:
    def test_ends_at_a_maximum_of_the_box(self) -> None:
        def hill(z: Floats) -> tuple[float, Floats]:
            return -float((z - 2) @ (z - 2)), -2.0 * (z - 2)

        inside = climb(hill, np.array([1.5, 2.5]), np.array([1.0, 1.0]), np.array([3.0, 3.0]))
        np.testing.assert_allclose(inside, [2.0, 2.0], atol=1e-6)
        edge = climb(hill, np.array([0.5, 1.5]), np.array([0.0, 1.0]), np.array([1.0, 3.0]))
        np.testing.assert_allclose(edge, [1.0, 2.0], atol=1e-6)

    def test_subnodes_stay_in_the_box(self) -> None:
        """Here low + 96 steps rounds to more than the upper edge."""
        assert Lattice((0.7,), (2.9,), 7).subnode(np.array([2.9])) == (2.9,)

    @given(places)
    def test_subnodes_are_near_and_come_again(self, z: tuple[float, float]) -> None:
        point = LATTICE.subnode(np.array(z))
        assert (np.abs(np.subtract(point, z)) <= np.array(LATTICE.spacing) / (2 * PARTS) + 1e-12).all()
        assert LATTICE.subnode(np.array(point)) == point
        assert all(low <= v <= high for low, v, high in zip(LATTICE.low, point, LATTICE.high, strict=True))


class TestMaximiser:
    def test_ties_go_to_the_lowest_index(self) -> None:
        assert maximiser(np.array([0.0, 1.0 - 5e-13, 1.0, 1.0])) == 1
        assert maximiser(np.array([0.0, 1.0 - 5e-12, 1.0, 1.0])) == 2

    def test_refuses_nan_and_nothing(self) -> None:
        with pytest.raises(ValueError, match="NaN"):
            maximiser(np.array([0.0, np.nan]))
        with pytest.raises(ValueError, match="no values"):
            maximiser(np.array([]))
