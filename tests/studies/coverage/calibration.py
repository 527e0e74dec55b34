"""Campaigns with constants from a calibration alone, on the functions of `spot_checks`: how many claims are false.

Every function is calibrated as the product does it, from a draft with system, space and specification (with noise also
the clip), by rollouts in this process. The campaign file that follows is run by its own method, on its own candidates.

    .venv/bin/python -m tests.studies.coverage.calibration --functions 500 --observed exact
"""

import argparse
import math
import sys
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from perfbound.schemas.platforms import one_blas_thread

one_blas_thread()

import numpy as np  # noqa: E402

from perfbound.orchestrator.campaign import plan as plans  # noqa: E402
from perfbound.orchestrator.campaign.methods import kernel_method  # noqa: E402
from perfbound.orchestrator.mathematics.bounds.rigorous.method import ExhaustedError, RigorousMethod  # noqa: E402
from perfbound.orchestrator.mathematics.calibration.norm_growth import needed_norm  # noqa: E402
from perfbound.orchestrator.mathematics.calibration.sampled import SampledValues  # noqa: E402
from perfbound.orchestrator.prepare.calibrate.calibrate import Calibration, CalibrationWish, with_file  # noqa: E402
from perfbound.orchestrator.prepare.calibrate.constants import PilotPace, ProblemCalibration  # noqa: E402
from perfbound.orchestrator.prepare.calibrate.pilot import CalibrationPilot  # noqa: E402
from perfbound.orchestrator.prepare.calibrate.rollouts import RolloutBatch, StartRollout  # noqa: E402
from perfbound.schemas.file.config import CampaignConfig  # noqa: E402
from perfbound.schemas.file.draft import Draft, load_draft  # noqa: E402
from perfbound.schemas.file.problem_models import RigorousProblem  # noqa: E402
from perfbound.schemas.file.reader import parse_campaign  # noqa: E402
from perfbound.schemas.system import Column, Parameter, SystemSpec  # noqa: E402
from tests.fakes.observations import an_observation  # noqa: E402
from tests.studies.coverage import spot_checks  # noqa: E402
from tests.studies.coverage.functions import SIDE, Floats, Function  # noqa: E402
from tests.studies.coverage.spot_checks import CLIP, FAMILIES, LEVEL, LINES, OBSERVED, Observed, grid  # noqa: E402

ROLLOUTS = 400
MOST_TESTS, EVERY = 151, 5
"""Tests of a campaign, whatever its budget: its bound is valid whenever it ends; and one of how many has a bound."""
NORM_LINES = 25
"""Points per axis of the grid on which the norm of a function is computed, a lower bound of the true one."""
SEED = 20261122


def spec(*, noisy: bool) -> SystemSpec:
    """Return the system of the functions."""
    return SystemSpec(
        name="any-function",
        doc="a random function",
        parameters=tuple(Parameter(name=name, unit="m", low=0.0, high=SIDE) for name in ("z1", "z2")),
        columns=(Column(name="t", unit="s"), Column(name="value", unit="m")),
        variants=("nominal",),
        noisy=("nominal",) if noisy else (),
        max_horizon=1.0,
    )


def draft(folder: Path, *, noisy: bool) -> Draft:
    """Write and read the draft of a campaign."""
    path = folder / "any-function.toml"
    clip = f"clip = {list(CLIP)}\n" if noisy else ""
    path.write_text(
        f'specification = "value >= 0"\n{clip}system.name = "any-function"\n'
        f"space.z1 = [0.0, {SIDE}]\nspace.z2 = [0.0, {SIDE}]\n"
    )
    return load_draft(path)


class FunctionRollouts:
    """Rollouts of one function in this process; their noise follows from a generator."""

    def __init__(self, rng: np.random.Generator, function: Function, observed: Observed) -> None:
        self._rng, self._function, self._observed = rng, function, observed
        self._batches: list[dict[tuple[int, int], float]] = []
        self.count, self.pace = 0, PilotPace(1000, 1.0, 1)

    def simulate(self, wanted: Sequence[StartRollout]) -> RolloutBatch:
        """Draw the robustness of every rollout."""
        values = self._function(np.array([each.start for each in wanted]))
        if self._observed.noisy:
            values = values + self._rng.choice(spot_checks.NOISE, len(values))
        numbers = [(each.test, each.replicate) for each in wanted]
        self._batches.append(dict(zip(numbers, values.tolist(), strict=True)))
        self.count += len(wanted)
        return RolloutBatch(len(self._batches))

    def values(self, batch: RolloutBatch, config: CampaignConfig) -> dict[tuple[int, int], float]:
        """Return minus the clipped robustness."""
        low, high = config.clip or plans.UNBOUNDED
        return {key: -min(max(each, low), high) for key, each in self._batches[batch.number - 1].items()}

    def robustness(self, batch: RolloutBatch, config: CampaignConfig) -> dict[tuple[int, int], float]:
        """Return the robustness."""
        return self._batches[batch.number - 1]

    def scores(self, wanted: Sequence[StartRollout]) -> Floats:
        """Return nothing for each: no disturbance is declared."""
        return np.empty((len(wanted), 0))


@dataclass(frozen=True, slots=True)
class Outcome:
    """One function: what the calibration proposed, and what came of it."""

    family: str
    doubts: tuple[str, ...]
    """Names of what speaks against every kernel; empty where there is a campaign."""
    nu: float = 0.0
    ratio: float = math.inf
    """B over the norm of the function, as far as its grid shows it."""
    tests: int = 0
    status: str = ""
    any_share: float = 0.0
    """Share of the box where the claim is false."""
    share: float = 0.0
    """The same; with noise, where it is false by at least one standard deviation of a rollout."""
    deficit: float = 0.0
    contradicted: bool = False
    """Whether the spot check refutes a claim that is false somewhere."""

    @property
    def silent(self) -> bool:
        """Whether the claim is false somewhere and the method does not refute it."""
        return self.any_share > 0 and self.status != "refuted"


def outcome(number: int, observed: Observed, folder: Path, *, seed: int = SEED) -> Outcome:
    """Calibrate one function and run its campaign."""
    family = list(FAMILIES)[number % len(FAMILIES)]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    draw = FAMILIES[family](rng)

    def function(z: Floats) -> Floats:
        return LEVEL + draw(z)

    system, found = spec(noisy=observed.noisy), draft(folder, noisy=observed.noisy)
    simulated = FunctionRollouts(rng, function, observed)
    proposal = CalibrationPilot(found, 0, system, simulated, propose_clip=False).calibrated(ROLLOUTS, number)
    if proposal.choice.chosen is None:
        return Outcome(family, proposal.choice.faults)
    wish = CalibrationWish(folder / "any-function.toml", ROLLOUTS, number, 1, folder / "any-function-calibrated.toml")
    text = with_file(Calibration(wish, found, system, None, (proposal,), (), None)).text
    assert text is not None
    config = parse_campaign(text.encode(), "any-function-calibrated.toml")
    ended = _campaign(rng, config, system, function, observed)
    return replace(ended, family=family, ratio=_ratio(proposal, config, function, observed))


def _ratio(proposal: ProblemCalibration, config: CampaignConfig, function: Function, observed: Observed) -> float:
    problem, chosen, points = config.problems[0], proposal.choice.chosen, grid(NORM_LINES)
    assert isinstance(problem, RigorousProblem)
    assert chosen is not None
    values = -observed.expectation(function(points))
    exact = replace(chosen.fit, ratio=1e-8)
    norm = needed_norm(exact, SampledValues(points / SIDE, values, 0.0), problem.prior_mean)
    return problem.rkhs_norm / max(norm, 1e-9)


def _campaign(
    rng: np.random.Generator, config: CampaignConfig, system: SystemSpec, function: Function, observed: Observed
) -> Outcome:
    plan = plans.plan(config, system, config.problems[0])
    method = kernel_method(plan)
    assert isinstance(method, RigorousMethod)
    first: int | None = int(rng.integers(method.size))
    nodes, tests = plan.chosen_from.nodes, 0
    while method.bound().status == "open" and tests < min(plan.budget, MOST_TESTS):
        try:
            node, first = method.propose(first).node, None
        except ExhaustedError:
            break
        seen = observed.rollouts(rng, float(function(nodes[node : node + 1])[0]), plan.replicates)
        # To certify a bound takes most of the time, and any subset of the tests may have one.
        (method.recall if tests % EVERY else method.bound_after)([an_observation(node, (-seen).tolist())])
        tests += 1
    bound, truth = method.bound(), function(grid(LINES))
    excess, sd = -observed.expectation(truth) - bound.upper, observed.spread(truth)
    wrong = excess > 1e-9
    problem = config.problems[0]
    assert isinstance(problem, RigorousProblem)
    return Outcome(
        "",
        (),
        nu=problem.kernel.nu,
        tests=tests,
        status=bound.status,
        any_share=float(wrong.mean()),
        share=float((wrong & (excess >= sd)).mean()),
        deficit=float(excess.max()),
        contradicted=bool(wrong.any()) and spot_checks.spot_checked(rng, function, observed, bound.upper),
    )


def main() -> None:
    """Print the counts of each family."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--functions", type=int, default=500)
    parser.add_argument("--observed", choices=["exact", "mean"], default="exact")
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=SEED)
    asked = parser.parse_args()
    observed = next(each for each in OBSERVED if each.name == asked.observed)
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    ratios: list[float] = []
    for number in range(asked.functions):
        found = outcome(number, observed, asked.folder, seed=asked.seed)
        counts[found.family].update(names(found))
        if found.family == "GP draws" and not found.doubts:
            ratios.append(found.ratio)
        if found.any_share > 0:
            sys.stdout.write(f"{number} {found}\n")
            sys.stdout.flush()
    for family, each in counts.items():
        sys.stdout.write(f"{family} {dict(sorted(each.items()))}\n")
    small = sum(ratio < 1 for ratio in ratios)
    sys.stdout.write(f"B over the norm of GP draws: {np.quantile(ratios, [0, 0.05, 0.5, 1])}, {small} too small\n")


def names(found: Outcome) -> list[str]:
    """Return what a function counts as."""
    if found.doubts:
        return ["functions", "no kernel", f"no kernel: {found.doubts[0]}"]
    counted = ["functions", f"nu {found.nu:g}", found.status]
    if found.any_share > 0:
        area = "2 % and more" if found.share >= 0.02 else "1 to 2 %" if found.share >= 0.01 else "below 1 %"
        if found.share == 0:
            area = "less than one sd"
        counted += [f"false: {area}"] + [f"silent: {area}"] * found.silent
        counted += [f"silent with spot check: {area}"] * (found.silent and not found.contradicted)
    return counted


if __name__ == "__main__":
    main()
