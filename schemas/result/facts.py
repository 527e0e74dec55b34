"""The facts of a campaign, and the hash chain over them.

Facts are drawn in one order and never changed; everything else about a campaign follows from them.
"""

import hashlib
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .. import __version__
from ..base import canonical_json, digest
from ..errors import OtherVersionError, shortened
from ..file.against_system import as_in_campaign
from ..file.config import CampaignConfig
from ..file.objectives import rolled_out
from ..ids import RolloutId
from ..requests import RequestTemplate
from ..system import SystemSpec
from ..values import Bound, Observation, Proposal, StoppedBy

RULES = 1
"""How seeds, digests and decisions follow from the file and the facts of a new campaign, which keeps this number in its
header. A change that gives another seed, digest or decision is a new number, and a branch where it changes."""
RECORDED, RESTORED, HANDED_BACK = NO_FAILURE = "recorded", "restored", "handed back"
"""Outcomes of attempts; every other text is the reason of a failure."""
"""Outcomes of attempts that brought a result: a new one, or the file of a recorded one once more."""


def check_rules(rules: int, software: Mapping[str, object], place: str) -> int:
    """Return `rules` if this perfbound follows them.

    Raises:
        OtherVersionError: it does not; the message names `place`, and the perfbound of `software` that does.

    """
    if rules != RULES:
        wrote = shortened(str(software.get("perfbound")), 40)
        raise OtherVersionError(
            f"{place}: the campaign follows rules {rules!r}, this perfbound {__version__} rules {RULES}; use the "
            f"perfbound that began it ({wrote})"
        )
    return rules


@dataclass(frozen=True, slots=True)
class Header:
    """The first fact: the campaign, its system and its software.

    The digests are those of the parsed values, not of the texts.
    """

    run: str
    config: CampaignConfig
    spec: SystemSpec
    software: dict[str, str]
    config_sha256: str
    system_sha256: str
    rules: int = RULES

    @classmethod
    def new(
        cls, config: CampaignConfig, spec: SystemSpec, software: dict[str, str], *, run: str | None = None
    ) -> "Header":
        """Return the header of a new campaign, with a random run id if none is given.

        The knots of its input signals are parameters of its system, which has the laws of its disturbances.
        """
        return cls(
            run or secrets.token_hex(8), config, as_in_campaign(spec, config), software, config.digest, spec.digest
        )

    def __repr__(self) -> str:
        """Return campaign, system and seed."""
        return f"<Header of {self.config.name}: system {self.spec.name}, seed {self.config.seed}, run {self.run}>"

    @property
    def claimed_variant(self) -> str:
        """The variant whose robustness the claims are about: the true system where it is simulated."""
        return max(variant for problem in self.config.problems for variant in rolled_out(problem.name, self.spec))

    @property
    def template(self) -> RequestTemplate:
        """The common part of the requests of all rollouts."""
        config = self.config
        return RequestTemplate.of(
            self.spec,
            config.system.options,
            spec_sha256=self.system_sha256,
            horizon=config.horizon,
            visual=config.visual == "all",
            campaign=config.name,
            config_sha256=self.config_sha256,
        )


@dataclass(frozen=True, slots=True)
class ProposalFact:
    """z of a test, and the numbers that chose it."""

    problem: str
    test: int
    proposal: Proposal

    def __len__(self) -> int:
        """Return 1, the number of tests: a fact of a block has more."""
        return 1


@dataclass(frozen=True, slots=True)
class RolloutFact:
    """A trajectory that is durable."""

    rollout: RolloutId
    seed: int
    sha256: str
    size: int
    path: str
    robustness: float | None
    by_tolerance: bool = False
    """Whether the tolerance around its time stamps could decide a sign, that of a requirement included."""
    ended: float | None = None
    """s at which it ended before the horizon, of a system with `after_end`."""
    batch: str = ""
    """Of a rollout of a batch: the sha256 of the file that it shares with the others; `sha256` is then its own."""
    kept: bool = True
    """Whether its samples are in the file, see the key `keep`."""
    parts: tuple[float, ...] = ()
    """The robustness of each part of the specification that a search has a model of; empty if it has one of all.

    With a scale of the search, that of each predicate is divided by it."""

    @property
    def violates(self) -> bool:
        """Whether it violates the specification."""
        return self.robustness is not None and self.robustness < 0


@dataclass(frozen=True, slots=True)
class DiscardFact:
    """A recorded rollout that allows no observation of its test, and is to be simulated again; its file is kept."""

    rollout: RolloutId
    seed: int
    sha256: str
    size: int
    path: str
    """Of the kept file."""
    reason: str


@dataclass(frozen=True, slots=True)
class ObservationFact:
    """The observation of a test; `chain` is the head of the problem's hash chain after it."""

    problem: str
    test: int
    observation: Observation
    chain: str

    def __len__(self) -> int:
        """Return 1, the number of tests: a fact of a block has more."""
        return 1


@dataclass(frozen=True, slots=True)
class BoundFact:
    """The bound after a test; with `budget` the budget, and not the method, ends the problem here.

    Of a block `test` is the last one, and `tests` the number of them.
    """

    problem: str
    test: int
    bound: Bound
    budget: bool = False
    tests: int = 1

    @property
    def stopped_by(self) -> StoppedBy | None:
        """The reason why the problem ends here, if it does."""
        return self.bound.verdict or ("budget" if self.budget else None)


@dataclass(frozen=True, slots=True)
class ExtensionFact:
    """A larger budget for problems that had spent theirs, after every series had stopped; the first one has number 1.

    Whoever gave it could know every rollout before it.
    """

    number: int
    budgets: tuple[tuple[str, int], ...]
    """(problem, tests at most from now on), in the order of the campaign file; the others stay as they ended."""


Fact = ProposalFact | RolloutFact | DiscardFact | ObservationFact | BoundFact | ExtensionFact


def first_link(header: Header, problem: str) -> str:
    """Return the start of a problem's hash chain."""
    return digest({"config": header.config_sha256, "system": header.system_sha256, "problem": problem})


def extended_link(link: str, fact: ExtensionFact) -> str:
    """Return the head of a problem's hash chain after an extension, which is in the chain of every problem."""
    value = {"extension": fact.number, "budgets": [list(each) for each in fact.budgets]}
    return hashlib.sha256((link + canonical_json(value)).encode()).hexdigest()


def next_link(
    link: str,
    fact: ProposalFact,
    rollouts: Sequence[RolloutFact],
    observation: Observation,
    discards: Sequence[DiscardFact] = (),
) -> str:
    """Return the head of a problem's hash chain after one more observed test."""
    chosen = fact.proposal
    value: dict[str, object] = {
        "test": [fact.test, chosen.node, chosen.x, chosen.mu, chosen.sigma, chosen.beta, chosen.F],
        # By id: the order of arrival depends on the speed of the workers, and the chain must not.
        "rollouts": sorted([str(each.rollout), each.seed, each.sha256] for each in rollouts),
        "y": observation.y,
        "each": list(observation.each),
    }
    if discards:  # no key without them, so that the chains of older campaigns stay as they are
        value["discards"] = sorted([str(each.rollout), each.seed, each.sha256, each.reason] for each in discards)
    return hashlib.sha256((link + canonical_json(value)).encode()).hexdigest()
