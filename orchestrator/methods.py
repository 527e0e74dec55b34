"""One port for the three methods: which test is next, and what the observations so far prove about max J."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.bounds.composition import derived_noise_scale
from orchestrator.bounds.confidence import mixture
from orchestrator.bounds.paper import PaperMethod, Proposal
from orchestrator.bounds.rigorous import RigorousMethod
from orchestrator.bounds.risk import linearised_range
from orchestrator.bounds.scenario import ScenarioMethod
from orchestrator.gp.kernels import Floats, Matern
from orchestrator.gp.lattice import Lattice
from orchestrator.gp.points import Points
from orchestrator.observation import Observation
from schemas.campaign import CampaignConfig, PaperProblem, Problem, RigorousProblem, ScenarioProblem, Scenarios
from schemas.system import SystemSpec

Verdict = Literal["converged", "refuted"]


@dataclass(frozen=True, slots=True)
class Bound:
    """lower <= max J <= upper; None where the method says nothing (yet)."""

    upper: float | None
    lower: float | None
    verdict: Verdict | None


@dataclass(frozen=True, slots=True)
class Band:
    """What a method says of J at each of its m candidates, unit J; NaN where it says nothing. All have shape (m,)."""

    mean: Floats
    lower: Floats
    upper: Floats
    possible: NDArray[np.bool_]
    """Whether the maximum may still be there."""


class Method(Protocol):
    """What the campaign needs of a method; all in terms of the maximised objective J."""

    size: int
    """Number of candidates."""

    def propose(self, first: int | None, pending: Sequence[int]) -> Proposal:
        """Choose the next test, given the tests in flight; it changes nothing. `first` is the node of test 0."""
        ...

    def rival(self, x: Sequence[float], pending: Sequence[int]) -> Proposal | None:
        """Return the proposal of `x` if another CPU, which rounds otherwise, could have chosen it."""
        ...

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """Add an observation and return what follows from all of them."""
        ...

    def recall(self, seen: Sequence[tuple[Proposal, Observation]]) -> None:
        """Add observations of a campaign whose bounds are known; only `band` may be asked for afterwards."""
        ...

    def band(self, bound: Bound) -> Band:
        """Return what is known of J over D, after at least one observation; `bound` is what followed from the last."""
        ...


class Paper(Method):
    """Algorithm 1 as printed."""

    def __init__(self, config: CampaignConfig, spec: SystemSpec, problem: PaperProblem) -> None:
        lattice = candidates(config, spec, problem)
        assert isinstance(lattice, Lattice), "the campaign file was checked"
        self.size = lattice.size
        self.method = PaperMethod(
            lattice,
            kernel(problem),
            rkhs_norm=problem.rkhs_norm,
            noise_scale=noise_per_test(config, spec, problem),
            delta=problem.delta,
            alpha=problem.alpha,
            c=problem.c,
            prior_mean=problem.prior_mean,
            regulariser=problem.regulariser,
            sigma=problem.sigma,
            tail=problem.tail,
            refine=problem.refine,
        )

    def propose(self, first: int | None, pending: Sequence[int]) -> Proposal:
        """As `Method`."""
        assert not pending, "Algorithm 1 is sequential"
        return self.method.propose(first)

    def rival(self, x: Sequence[float], pending: Sequence[int]) -> Proposal | None:  # noqa: ARG002
        """As `Method`."""
        return self.method.rival(x)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """As `Method`."""
        self.method.observe(proposal.index, observation.y, proposal.x)
        if proposal.F is None:
            return Bound(None, None, None)
        stops = self.method.stops(proposal)
        return Bound(self.method.epsilon(proposal, observation.y), None, "converged" if stops else None)

    def recall(self, seen: Sequence[tuple[Proposal, Observation]]) -> None:
        """As `Method`."""
        for proposal, observation in seen:
            self.method.observe(proposal.index, observation.y, proposal.x)

    def band(self, bound: Bound) -> Band:  # noqa: ARG002  (each moment's band stands alone)
        """As `Method`; on the nodes alone."""
        centre, half = self.method.band()
        upper, lower = centre + half, centre - half
        return Band(centre, lower, upper, upper >= lower.max())


class Rigorous(Method):
    """Bounds that hold at every moment, from one confidence set."""

    def __init__(self, config: CampaignConfig, spec: SystemSpec, problem: RigorousProblem) -> None:
        self.candidates = candidates(config, spec, problem)
        self.size = self.candidates.size
        noise = noise_per_test(config, spec, problem)
        self.method = RigorousMethod(
            self.candidates,
            kernel(problem),
            rkhs_norm=problem.rkhs_norm,
            noise_scale=noise,
            delta=problem.delta,
            alpha=problem.alpha,
            regularisers=_mixture(problem, noise),
            prior_mean=problem.prior_mean,
            tau_misspecification=problem.misspecification,
            round_off=problem.round_off,
            slack=problem.slack,
        )

    def propose(self, first: int | None, pending: Sequence[int]) -> Proposal:
        """As `Method`."""
        return self.method.propose(first, pending)

    def rival(self, x: Sequence[float], pending: Sequence[int]) -> Proposal | None:
        """As `Method`."""
        return self.method.rival(x, pending)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """As `Method`."""
        self.method.observe(proposal.index, observation.y)
        found = self.method.bound()
        return Bound(found.upper, found.lower, None if found.status == "open" else found.status)

    def recall(self, seen: Sequence[tuple[Proposal, Observation]]) -> None:
        """As `Method`; a certified bound for each would take longer than the campaign did."""
        self.method.recall([proposal.index for proposal, _ in seen], [observation.y for _, observation in seen])

    def band(self, bound: Bound) -> Band:
        """As `Method`; refuted premises have no band."""
        mean, lower, upper = self.method.band()
        if bound.verdict == "refuted" or bound.lower is None:
            nothing = np.full_like(mean, np.nan)
            return Band(mean, nothing, nothing, np.ones_like(mean, dtype=np.bool_))
        return Band(mean, lower, upper, upper >= max(float(lower.max()), bound.lower))


class Scenario(Method):
    """Betting bounds on finitely many starts; J is minus the risk."""

    def __init__(self, config: CampaignConfig, spec: SystemSpec, problem: ScenarioProblem) -> None:
        points = candidates(config, spec, problem)
        assert config.clip is not None, "the campaign file was checked"
        self.size = points.size
        constants = problem.linearised
        self.method = ScenarioMethod(
            points.nodes,
            clip=config.clip,
            risk_weight=config.risk_weight,
            delta=problem.delta,
            alpha=problem.alpha,
            risk="bhatia-davis" if constants is None else "linearised",
            constants=None if constants is None else (constants.centre, constants.spread),
        )

    def propose(self, first: int | None, pending: Sequence[int]) -> Proposal:  # noqa: ARG002  (starts in their order)
        """As `Method`; every start once, then the one with the lowest bound."""
        return self._at(self.method.propose(pending=pending))

    def rival(self, x: Sequence[float], pending: Sequence[int]) -> Proposal | None:
        """As `Method`."""
        index = self.method.rival(x, pending)
        return None if index is None else self._at(index)

    def _at(self, index: int) -> Proposal:
        x = tuple(float(value) for value in np.asarray(self.method.scenarios[index]))
        return Proposal(index, x, -self.method.bound().scenarios[index].lower, 0.0, None, None)

    def observe(self, proposal: Proposal, observation: Observation) -> Bound:
        """As `Method`."""
        self.method.observe(proposal.index, observation.each)
        found = self.method.bound()
        verdict: Verdict | None = "refuted" if self.method.refuted else "converged" if self.method.stops() else None
        return Bound(-found.ell, -found.upper, verdict)

    def recall(self, seen: Sequence[tuple[Proposal, Observation]]) -> None:
        """As `Method`."""
        for proposal, observation in seen:
            self.method.observe(proposal.index, observation.each)

    def band(self, bound: Bound) -> Band:  # noqa: ARG002  (the method has them at hand)
        """As `Method`; no start has a lower bound of its own, and the upper ones hold one by one."""
        found = self.method.bound()
        mean = [np.nan if each.mean is None else -each.mean for each in found.scenarios]
        upper = np.array([-each.lower for each in found.scenarios])
        possible = np.array([self.method.refuted or each.each <= found.upper for each in found.scenarios])
        return Band(np.array(mean), np.full_like(upper, np.nan), upper, possible)


def method(config: CampaignConfig, spec: SystemSpec, problem: Problem) -> Paper | Rigorous | Scenario:
    """Return the method of one problem, before its first observation.

    Raises:
        ValueError: a parameter is outside the range of the method.

    """
    match problem:
        case PaperProblem():
            return Paper(config, spec, problem)
        case RigorousProblem():
            return Rigorous(config, spec, problem)
        case ScenarioProblem():
            return Scenario(config, spec, problem)


def candidates(config: CampaignConfig, spec: SystemSpec, problem: Problem) -> Lattice | Points:
    """Return the starting conditions that a problem chooses from; parameters in the order of the system."""
    if isinstance(config.space, Scenarios):
        return Points(config.space.scenarios)
    boxes = [config.space[parameter.name] for parameter in spec.parameters]
    low, high = tuple(box.low for box in boxes), tuple(box.high for box in boxes)
    return Lattice(low, high, config.resolution_of(problem))


def kernel(problem: PaperProblem | RigorousProblem) -> Matern:
    """Return the kernel of a problem."""
    return Matern(problem.kernel.nu, problem.kernel.length_scale)


def noise_per_test(config: CampaignConfig, spec: SystemSpec, problem: PaperProblem | RigorousProblem) -> float:
    """Return R of one observation, in the unit of the objective: that of a mean over the replicates.

    The observation of `true_risk` in method `paper` is not a mean, so R of the file stands for the observation itself.
    """
    if problem.method == "paper" and problem.name == "true_risk":
        return problem.noise_scale
    per_rollout = problem.noise_scale
    if per_rollout == "derived":
        per_rollout = derived_noise(config, spec, problem)
    return per_rollout / math.sqrt(config.replicates_of(problem))


def budget(config: CampaignConfig, spec: SystemSpec, problem: Problem) -> int:
    """Return the most tests of a problem: without noise, no more than there are candidates to learn from."""
    tests = config.max_tests_of(problem)
    if isinstance(problem, RigorousProblem) and noise_per_test(config, spec, problem) == 0:
        return min(tests, config.candidates_of(problem))
    return tests


def derived_noise(config: CampaignConfig, spec: SystemSpec, problem: Problem) -> float:
    """Return R of one rollout by Hoeffding's lemma: half the range of a bounded objective."""
    clip = config.clip
    assert clip is not None, "the campaign file was checked"
    if isinstance(problem, RigorousProblem) and problem.linearised is not None:
        low, high = linearised_range(clip, config.risk_weight, problem.linearised.centre, problem.linearised.spread)
        return (high - low) / 2
    gap = config.gap_of(problem) if problem.name == "sim_gap" else None
    deterministic = "nominal" not in spec.noisy
    return derived_noise_scale(
        gap.kind if gap else "nominal_robustness",
        clip,
        deterministic_nominal=deterministic,
        common_seeds=False,
        lipschitz=gap.lipschitz if gap else 1.0,
    )


def _mixture(problem: RigorousProblem, noise: float) -> tuple[tuple[float, float], ...]:
    if noise == 0:
        return ()
    if problem.regulariser is None:
        return mixture(problem.rkhs_norm, noise)
    if isinstance(problem.regulariser, tuple):
        return tuple((each.value, each.weight) for each in problem.regulariser)
    return ((problem.regulariser, 1.0),)
