"""Rollouts of the true Segway at the design points of method `kriging`, recorded once; an interrupted record continues.

A rollout's seed follows from its node and its number alone, so that no interruption changes a record.
"""

import csv
import hashlib
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perfbound.orchestrator.campaign.methods import kernel
from perfbound.orchestrator.campaign.observation import Observer
from perfbound.orchestrator.campaign.plan import ProblemPlan, plans
from perfbound.orchestrator.mathematics.bounds.kriging.design import plan_design
from perfbound.orchestrator.mathematics.gp.kernels import Floats
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from perfbound.schemas.draws.laws import Laws
from perfbound.schemas.file.config import CampaignConfig
from perfbound.schemas.file.problem_models import KrigingProblem
from perfbound.schemas.file.reader import load_campaign
from perfbound.schemas.system import OptionValue
from perfbound.workers.systems import load_system
from perfbound.workers.systems.base import SystemUnderTest, disturbances_of

ROOT = Path(__file__).parents[3]
CAMPAIGN = ROOT / "deploy" / "campaigns" / "segway.toml"
DIRECTORY = Path("build/tightness")
PER_PARAMETER = (5, 3)
"""Points per parameter, about, of large budgets and of small ones."""
SEED = 20261123
Place = tuple[int, int]
"""The node of a rollout, and its number there."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """The clipped robustness of the rollouts at each node of the design, and the scores of their disturbances."""

    robustness: dict[int, Floats]
    scores: dict[int, Floats]

    @property
    def total(self) -> int:
        """Number of rollouts."""
        return sum(map(len, self.robustness.values()))


@dataclass(frozen=True)
class Subject:
    """The system of the campaign, and how a rollout of it is scored."""

    config: CampaignConfig
    system: SystemUnderTest

    @property
    def plan(self) -> ProblemPlan:
        """The plan of the risk of the true system."""
        return plans(self.config, self.system.spec)["true_risk"]

    @property
    def lattice(self) -> Lattice:
        """The nodes that the box is covered with."""
        lattice = self.plan.candidates
        assert isinstance(lattice, Lattice), "the campaign is about a box"
        return lattice

    @property
    def identity(self) -> str:
        """What every recorded number depends on, as 16 hexadecimal digits."""
        config, spec = self.config, self.system.spec
        keys = (spec.digest, self._options, config.formula, config.clip, config.horizon, self.lattice.resolution)
        text = json.dumps([*keys, self.lattice.low, self.lattice.high, SEED], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def _options(self) -> dict[str, OptionValue]:
        defaults = {option.name: option.default for option in self.system.spec.options}
        return defaults | dict(self.config.system.options)

    def simulated(self, places: Sequence[Place]) -> Iterator[tuple[Place, float]]:
        """Yield the clipped robustness of one true rollout after the other."""
        spec, nodes, options = self.system.spec, self.lattice.nodes, self._options
        observer, laws = Observer(self.config, spec), Laws(spec.disturbances)
        for place in places:
            seed = seed_of(place)
            trajectory = self.system.rollout(
                nodes[place[0]].tolist(),
                variant="true",
                seed=seed,
                horizon=self.config.horizon,
                options=options,
                progress=lambda _: None,
                **disturbances_of(spec, laws.values([seed])[0].tolist()),
            )
            value = observer.robustness(trajectory)
            assert value is not None, "the campaign has a specification"
            yield place, value

    def counts(self, total: int) -> dict[int, int]:
        """Return how many rollouts each node has: `total` in the shares of the large design, and as many on average
        at those that only the small one has.
        """
        assert isinstance(self.plan.problem, KrigingProblem)
        lengths = np.broadcast_to(kernel(self.plan, self.plan.problem).length_scale, self.lattice.dimension).tolist()
        large, small = (plan_design(self.lattice, total, points, lengths) for points in PER_PARAMETER)
        return dict.fromkeys(small.nodes, total // large.size) | dict(zip(large.nodes, large.counts, strict=True))

    def scores(self, node: int, count: int) -> Floats:
        """Return the scores of the disturbances of the first rollouts of a node (n, k): they follow from the seeds."""
        return Laws(self.system.spec.disturbances).scores([seed_of((node, number)) for number in range(count)])


def seed_of(place: Place) -> int:
    """Return the seed of a rollout."""
    return int(np.random.SeedSequence(SEED, spawn_key=place).generate_state(1, np.uint64)[0] >> np.uint64(11))


def subject() -> Subject:
    """Return the Segway of the campaign file."""
    config = load_campaign(CAMPAIGN)
    return Subject(config, load_system(config.system.name))


def record(subject: Subject, total: int, directory: Path = DIRECTORY) -> Recorded:
    """Return the rollouts of `Subject.counts`; simulate those that no earlier call has recorded."""
    wanted = subject.counts(total)
    path = directory / f"rollouts-{subject.identity}.csv"
    found = _read(path)
    missing = [(node, number) for node, count in wanted.items() for number in range(count)]
    missing = [place for place in missing if place not in found]
    if missing:
        found |= _appended(path, subject, missing)
    return Recorded(
        {node: np.array([found[node, n] for n in range(count)]) for node, count in wanted.items()},
        {node: subject.scores(node, count) for node, count in wanted.items()},
    )


def _whole(path: Path) -> str:
    """Return the finished lines of a file: one that a kill cut short has no end."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return text[: text.rfind("\n") + 1]


def _read(path: Path) -> dict[Place, float]:
    lines = csv.reader(_whole(path).splitlines())
    return {(int(node), int(number)): float(value) for node, number, value in lines}


def _appended(path: Path, subject: Subject, missing: Sequence[Place]) -> dict[Place, float]:
    path.parent.mkdir(parents=True, exist_ok=True)
    finished, found = len(_whole(path)), dict[Place, float]()
    with path.open("a", encoding="ascii", newline="") as file:
        file.truncate(finished)
        writer = csv.writer(file, lineterminator="\n")
        for done, (place, value) in enumerate(subject.simulated(missing), start=1):
            found[place] = value
            writer.writerow((*place, repr(value)))
            if done % 100 == 0:
                file.flush()
                sys.stderr.write(f"rollout {done} of {len(missing)}\n")
    return found
