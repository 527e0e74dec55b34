"""The mathematics of a running campaign: z of the next test, the bound after an observation."""

from collections.abc import Sequence

from orchestrator.bounds.paper import Proposal
from orchestrator.methods import Paper, Rigorous, Scenario, method
from orchestrator.observation import Observation
from orchestrator.seeds import first_node
from orchestrator.store.journal import BoundFact, ProposalFact
from schemas.campaign import CampaignConfig
from schemas.system import SystemSpec


class Proposer:
    """One method per problem; what it has observed is all its state, so a replay of observations rebuilds it."""

    def __init__(self, config: CampaignConfig, spec: SystemSpec) -> None:
        self._config = config
        self.methods: dict[str, Paper | Rigorous | Scenario] = {
            problem.name: method(config, spec, problem) for problem in config.problems
        }

    def propose(self, problem: str, test: int, pending: Sequence[int]) -> ProposalFact:
        """Choose z of this test from the observations so far; the first one is drawn from the campaign's seed.

        Raises:
            ValueError: the method cannot go on (singular kernel matrix, every candidate known).

        """
        return _fact(problem, test, self.methods[problem].propose(self._first(problem) if test == 0 else None, pending))

    def instead(self, problem: str, test: int, pending: Sequence[int], x: Sequence[float]) -> ProposalFact | None:
        """Return the proposal of `x` (p,) if another CPU, which rounds otherwise, could have chosen it."""
        rival = None if test == 0 else self.methods[problem].rival(x, pending)
        return None if rival is None else _fact(problem, test, rival)

    def observe(self, fact: ProposalFact, observation: Observation, *, last: bool) -> BoundFact:
        """Add an observation and return the bound that follows; `last` says that the budget ends here.

        Raises:
            ValueError: the method cannot go on.

        """
        found = self.methods[fact.problem].observe(_chosen(fact), observation)
        stopped_by = found.verdict or ("budget" if last else None)
        return BoundFact(fact.problem, fact.test, found.upper, found.lower, stopped_by)

    def recall(self, problem: str, seen: Sequence[tuple[ProposalFact, Observation]]) -> None:
        """Add observations whose bounds are known, for a picture of what the method knows; see `Method.recall`.

        Raises:
            ValueError: the method cannot go on.

        """
        self.methods[problem].recall([(_chosen(fact), observation) for fact, observation in seen])

    def _first(self, problem: str) -> int:
        return first_node(self._config, problem, self.methods[problem].size)


def _fact(problem: str, test: int, chosen: Proposal) -> ProposalFact:
    return ProposalFact(problem, test, chosen.index, chosen.x, chosen.mu, chosen.sigma, chosen.beta, chosen.F)


def _chosen(fact: ProposalFact) -> Proposal:
    return Proposal(fact.node, fact.x, fact.mu or 0.0, fact.sigma or 0.0, fact.beta, fact.F)
