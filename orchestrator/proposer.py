"""The mathematics of a running campaign: z of the next test, the bound after an observation."""

import math
from collections.abc import Mapping

from orchestrator.bounds.paper import PaperMethod, Proposal
from orchestrator.gp.kernels import Matern
from orchestrator.gp.lattice import Lattice
from orchestrator.seeds import first_node
from orchestrator.store.journal import BoundFact, ProposalFact
from schemas.campaign import CampaignConfig, Problem
from schemas.certificate import StoppedBy
from schemas.system import SystemSpec


class Proposer:
    """One method per problem; what it has observed is all its state, so a replay of observations rebuilds it."""

    def __init__(self, config: CampaignConfig, spec: SystemSpec) -> None:
        self._config = config
        self._lattices: dict[str, Lattice] = {
            problem.name: lattice(config, spec, problem) for problem in config.problems
        }
        self._methods: Mapping[str, PaperMethod] = {
            problem.name: paper_method(config, problem, self._lattices[problem.name]) for problem in config.problems
        }

    def propose(self, problem: str, test: int) -> ProposalFact:
        """Choose z of this test from the observations so far; the first one is drawn from the campaign's seed."""
        first = first_node(self._config, problem, self._lattices[problem].size) if test == 0 else None
        chosen = self._methods[problem].propose(first)
        return ProposalFact(problem, test, chosen.index, chosen.x, chosen.mu, chosen.sigma, chosen.beta, chosen.F)

    def observe(self, fact: ProposalFact, y: float, *, last: bool) -> BoundFact:
        """Add an observation of J and return the bound that follows; `last` says that the budget ends here."""
        method = self._methods[fact.problem]
        method.observe(fact.node, y)
        if fact.F is None:
            return BoundFact(fact.problem, fact.test, None, None)
        chosen = Proposal(fact.node, fact.x, fact.mu, fact.sigma, fact.beta, fact.F)
        stopped_by: StoppedBy | None = "converged" if method.stops(chosen) else "budget" if last else None
        return BoundFact(fact.problem, fact.test, method.epsilon(chosen, y), stopped_by)


def lattice(config: CampaignConfig, spec: SystemSpec, problem: Problem) -> Lattice:
    """Return the candidates of a problem; parameters in the order of the system."""
    boxes = [config.space[parameter.name] for parameter in spec.parameters]
    low, high = tuple(box.low for box in boxes), tuple(box.high for box in boxes)
    return Lattice(low, high, config.resolution_of(problem))


def noise_per_test(config: CampaignConfig, problem: Problem) -> float:
    """Return R of one observation: that of a mean over the replicates.

    The observation of `true_risk` is not a mean, so R of the file stands for the observation itself.
    """
    if problem.name == "true_risk":
        return problem.noise_scale
    return problem.noise_scale / math.sqrt(config.replicates_of(problem))


def paper_method(config: CampaignConfig, problem: Problem, candidates: Lattice) -> PaperMethod:
    """Return Algorithm 1 for one problem."""
    return PaperMethod(
        candidates,
        Matern(problem.kernel.nu, problem.kernel.length_scale),
        rkhs_norm=problem.rkhs_norm,
        noise_scale=noise_per_test(config, problem),
        delta=problem.delta,
        alpha=problem.alpha,
        c=problem.c,
        prior_mean=problem.prior_mean,
        regulariser=problem.regulariser,
        sigma=problem.sigma,
        tail=problem.tail,
    )
