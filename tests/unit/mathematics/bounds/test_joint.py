"""Several methods on one sequence of tests: whose turn it is, and what is bounded of the largest objective."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from perfbound.orchestrator.mathematics.bounds.joint import JointMethod, joined
from perfbound.orchestrator.mathematics.bounds.kriging.bound import KrigingPremises
from perfbound.orchestrator.mathematics.bounds.kriging.method import KrigingBudget, KrigingMethod
from perfbound.orchestrator.mathematics.bounds.method import Integers
from perfbound.orchestrator.mathematics.bounds.rigorous.confidence import Premises
from perfbound.orchestrator.mathematics.bounds.rigorous.method import RigorousMethod
from perfbound.orchestrator.mathematics.bounds.scenario import ScenarioMethod
from perfbound.orchestrator.mathematics.gp.kernels import Floats, Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.orchestrator.mathematics.gp.points import Points
from perfbound.schemas.values import Bound, Observation, Proposal
from tests.fakes.states import blocks, state_of

ALPHA = 0.05
NODES = Lattice((0.0,), (1.0,), 41).nodes


def split(observation: Observation) -> list[Observation]:
    return [Observation(value, (value,)) for value in observation.each]


def premises(rkhs_norm: float) -> Premises:
    return Premises(rkhs_norm=rkhs_norm, noise_scale=0.0, delta=0.05, regularisers=(), tau=0.0, round_off=1e-9)


def part(rkhs_norm: float = 2.0) -> RigorousMethod:
    return RigorousMethod(Lattice((0.0,), (1.0,), 41), Matern(2.5, 0.5), premises(rkhs_norm), alpha=ALPHA)


def objectives(x: float) -> tuple[float, ...]:
    """Return two values of J, whose maxima are .9 at 0 and .5 at 1."""
    return 0.9 - x**2, 0.5 * x


def run(method: JointMethod[RigorousMethod], *, most: int = 60) -> tuple[list[Bound], list[float]]:
    bounds: list[Bound] = []
    starts: list[float] = []
    while len(bounds) < most and (not bounds or bounds[-1].verdict is None):
        proposal = method.propose(None if bounds else 20)
        values = objectives(proposal.x[0])
        starts.append(proposal.x[0])
        bounds.append(method.observe(proposal, Observation(max(values), values)))
    return bounds, starts


def test_it_ends_when_every_method_has_converged_and_the_bound_is_that_of_the_largest() -> None:
    method = JointMethod([part(), part()], [ALPHA, ALPHA], split, NODES)
    bounds, _ = run(method)
    assert bounds[-1].verdict == "converged"
    assert [each.verdict for each in method.bounds] == ["converged", "converged"]
    first, second = method.bounds
    assert first.upper is not None
    assert second.upper is not None
    assert 0.9 <= first.upper <= 0.95 + 1e-9
    assert 0.5 <= second.upper <= 0.55 + 1e-9
    assert bounds[-1].upper == first.upper
    assert all(later.upper <= earlier.upper for earlier, later in pairwise(bounds) if later.upper and earlier.upper)


def test_each_method_proves_what_it_proves_alone_from_the_same_tests() -> None:
    method = JointMethod([part(), part()], [ALPHA, ALPHA], split, NODES)
    alone = [part(), part()]
    for k in range(12):
        proposal = method.propose(None if k else 20)
        values = objectives(proposal.x[0])
        method.observe(proposal, Observation(max(values), values))
        found = [
            each.observe(proposal, Observation(value, (value,))) for each, value in zip(alone, values, strict=True)
        ]
        assert method.bounds == tuple(found)


def test_the_method_furthest_from_its_tolerance_leads() -> None:
    method = JointMethod([part(), part()], [ALPHA, 100 * ALPHA], split, NODES)
    method.observe(method.propose(20), Observation(0.5, (0.4, 0.3)))
    lead, other = (each.acquisition(()) for each in method.parts)
    loss = lead.max() - lead[method.propose().node]
    assert loss <= 0.01 * (other.max() - other.min()), "what the other one can gain"
    eager = JointMethod([part(), part()], [100 * ALPHA, ALPHA], split, NODES)
    eager.observe(eager.propose(20), Observation(0.5, (0.4, 0.3)))
    assert eager.propose().mu != method.propose().mu, "its numbers are those of the other method"
    assert eager.propose(pending=(3,)).node != 3
    assert eager.rival((2.0,)) is None
    assert eager.rival(eager.propose().x) == eager.propose()


def test_of_equal_starts_the_one_that_serves_the_others_is_tested() -> None:
    class Fixed(RigorousMethod):
        values: Sequence[float] = ()

        def acquisition(self, pending: Sequence[int]) -> Floats:
            return np.array([*self.values, *[-1.0] * (self.size - len(self.values))])

    methods = [Fixed(Lattice((0.0,), (1.0,), 41), Matern(2.5, 0.5), premises(2.0), alpha=ALPHA) for _ in range(2)]
    method = JointMethod(methods, [ALPHA, 20 * ALPHA], split, NODES)
    method.bounds = (Bound(0.5, 0.0, None), Bound(9.0, 0.0, None))
    methods[0].values, methods[1].values = (0.5, 0.49), (0.0, 0.1)
    assert method.propose().node == 0, "a twentieth of .1 is not worth .01"
    methods[0].values, methods[1].values = (0.5, 0.49, 0.2), (0.0, 0.1, 9.0)
    assert method.propose().node == 2, "a twentieth of 9 is worth .3"


def test_a_refuted_method_leads_no_more() -> None:
    method = JointMethod([part(), part()], [ALPHA, ALPHA], split, NODES)
    method.observe(method.propose(20), Observation(0.5, (0.4, 0.3)))
    method.bounds = (Bound(9.0, 0.0, "refuted"), Bound(0.5, 0.0, None))
    assert method.propose() == method.parts[1].propose() != method.parts[0].propose()


def test_a_refuted_method_ends_only_when_the_others_do_and_marks_the_whole() -> None:
    method = JointMethod([part(), part(rkhs_norm=0.05)], [ALPHA, ALPHA], split, NODES)
    bounds, _ = run(method)
    verdicts = [each.verdict for each in method.bounds]
    assert verdicts == ["converged", "refuted"]
    assert bounds[-1].verdict == "refuted"
    assert all(each.verdict is None for each in bounds[:-1])


def test_recall_gives_the_same_state_as_observing() -> None:
    method, again = (JointMethod([part(), part()], [ALPHA, ALPHA], split, NODES) for _ in range(2))
    tests = []
    for k in range(6):
        proposal = method.propose(None if k else 20)
        values = objectives(proposal.x[0])
        observation = Observation(max(values), values)
        bound = method.observe(proposal, observation)
        tests.append((proposal, observation))
    again.recall(tests)
    band = method.band(bound)
    assert again.band(bound) == band
    x = np.array([node[0] for node in method.parts[0].candidates.nodes])
    largest = np.maximum(0.9 - x**2, 0.5 * x)
    assert (np.array(band.lower) - 1e-9 <= largest).all()
    assert (largest <= np.array(band.upper) + 1e-9).all()
    assert band.possible[0]


@pytest.mark.parametrize(
    ("bounds", "wanted"),
    [
        ([Bound(0.5, 0.4, "converged"), Bound(0.7, 0.6, "converged")], Bound(0.7, 0.6, "converged")),
        ([Bound(0.5, None, None), Bound(None, None, None)], Bound(None, None, None)),
        ([Bound(0.5, 0.4, "refuted"), Bound(0.7, 0.6, None)], Bound(0.7, 0.6, None)),
        ([Bound(math.inf, 0.4, "refuted"), Bound(0.7, 0.6, "converged")], Bound(math.inf, 0.6, "refuted")),
    ],
)
def test_the_bound_of_the_largest(bounds: Sequence[Bound], wanted: Bound) -> None:
    assert joined(bounds) == wanted


def test_lists_of_starts_are_shared_too() -> None:
    points = Points(((0.0,), (1.0,)))

    def one(centre: float) -> ScenarioMethod:
        return ScenarioMethod(points, clip=(-1.0, 1.0), risk_weight=0.2, delta=0.05, alpha=0.2, constants=(centre, 0.2))

    method = JointMethod(
        [one(0.5), one(0.2)],
        [0.2, 0.2],
        lambda found: [Observation(-value, (value,)) for value in found.each],
        points.nodes,
    )
    rng, bound = np.random.default_rng(1), Bound(None, None, None)
    for k in range(3000):
        proposal = method.propose(None if k else 0)
        values = (0.5 + 0.1 * rng.choice([-1, 1]), 0.2 + 0.3 * proposal.x[0] + 0.1 * rng.choice([-1, 1]))
        bound = method.observe(proposal, Observation(-min(values), values))
        if bound.verdict is not None:
            break
    assert bound.verdict == "converged"
    assert bound.upper is not None
    assert -bound.upper <= 0.18 <= -bound.upper + 0.2, "E - r sd of the second at the first start"


def test_a_tolerance_for_each_method() -> None:
    with pytest.raises(ValueError, match="one tolerance for each"):
        JointMethod([part(), part()], [ALPHA], split, NODES)


class TestManyAtOnce:
    """Every method has, to the bit, what it has after one test after the other."""

    @staticmethod
    def check(make: Callable[[], JointMethod[Any]], nodes: Integers, each: Floats) -> None:
        one, many, recalled = make(), make(), make()
        for part in blocks(len(nodes), [1, 5, 2, 40]):
            given = nodes[part], each[part].max(axis=1), each[part]
            for node, y, row in zip(*(array.tolist() for array in given), strict=True):
                bound = one.observe(Proposal(node, (), None, None, None, None), Observation(y, tuple(row)))
            assert many.observe_each(*given) == bound
            assert many.bounds == one.bounds
            recalled.recall_each(*given)
            # Method `rigorous` keeps room for more rows, which has any content, and recalls no certified bound.
            for other in (many, recalled):
                assert state_of(one.band(bound)) == state_of(other.band(bound))
                if not isinstance(one.parts[0], RigorousMethod):
                    assert state_of(one.parts) == state_of(other.parts)

    def test_of_scenarios(self, monkeypatch: pytest.MonkeyPatch) -> None:
        points = Points(((0.0,), (1.0,), (2.0,)))

        def make() -> JointMethod[ScenarioMethod]:
            parts = [
                ScenarioMethod(points, clip=(-1.0, 1.0), risk_weight=0.2, delta=0.05, alpha=0.2, risk=risk)
                for risk in ("bhatia-davis", "mean")
            ]
            return JointMethod(parts, [0.2, 0.2], halves, points.nodes)

        rng = np.random.default_rng(1)
        nodes, each = rng.integers(0, 3, 60), np.clip(rng.normal(0.5, 0.2, (60, 4)), -1, 1)
        self.check(make, nodes, each)
        monkeypatch.setattr("perfbound.orchestrator.mathematics.bounds.joint.PIECE", 4)
        self.check(make, nodes, each)

    def test_of_kriging(self) -> None:
        lattice, premises = Lattice((0.0,), (1.0,), 9), KrigingPremises(0.3, -0.6, (-1.0, 0.0), 0.05)

        def make() -> JointMethod[KrigingMethod]:
            parts = [
                KrigingMethod(lattice, Matern(2.5, 1.0), premises, spread=0.1, budget=KrigingBudget(60, 2, 3))
                for _ in range(2)
            ]
            return JointMethod(parts, [math.inf, math.inf], halves, lattice.nodes)

        design = make().parts[0].design
        nodes = np.array([design.nodes[point] for point in design.order])
        self.check(make, nodes, np.random.default_rng(2).uniform(-0.8, -0.5, (60, 4)))

    def test_of_methods_that_choose_their_tests(self) -> None:
        nodes = np.random.default_rng(3).permutation(41)[:12]
        x = NODES[nodes, 0]
        self.check(
            lambda: JointMethod([part(), part()], [ALPHA, ALPHA], split, NODES),
            nodes,
            np.column_stack([0.9 - x**2, 0.5 * x]),
        )


def halves(observation: Observation) -> list[Observation]:
    """Return the observations of two requirements with two replicates each."""
    both = observation.each[:2], observation.each[2:]
    return [Observation(sum(each) / 2, each) for each in both]
