"""The rollouts of a calibration of one problem, in the order in which each shows where the next ones go."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from ....schemas.file.config import CampaignConfig
from ....schemas.file.draft import Draft
from ....schemas.file.objectives import OBJECTIVES, rolled_out
from ....schemas.file.problem_models import KrigingProblem, Linearised, RigorousProblem
from ....schemas.system import SystemSpec
from ...campaign import plan as plans
from ...campaign.methods import bases
from ...campaign.region import Start
from ...mathematics.calibration.noise import noisiest, pooled
from ...mathematics.calibration.sampled import SampledValues
from ...mathematics.calibration.steepness import FRESH, Descent, End, SteepPlace, steepest
from ...mathematics.calibration.trust import least_predicted
from ...mathematics.gp.kernels import Floats
from ..rounded import clip_around
from .constants import (
    Constant,
    PilotPace,
    ProblemCalibration,
    ProblemEvidence,
    calibrated,
    linearised_constants,
    required_objective,
)
from .control import PilotControl, PilotRollouts
from .design import ROLLOUTS, Box, RolloutBudget
from .rollouts import RolloutBatch, StartRollout

Values = Mapping[tuple[int, int], float]
"""By (test, replicate)."""


class Simulated(Protocol):
    """The rollouts of one problem; a failed one raises PerfboundError."""

    @property
    def count(self) -> int:
        """Rollouts so far."""
        ...

    @property
    def pace(self) -> PilotPace:
        """How fast the first of them were."""
        ...

    def simulate(self, wanted: Sequence[StartRollout]) -> RolloutBatch:
        """Simulate rollouts."""
        ...

    def values(self, batch: RolloutBatch, config: CampaignConfig) -> Values:
        """Return J of each, with the clip and the constants of `config`."""
        ...

    def scores(self, wanted: Sequence[StartRollout]) -> Floats:
        """Return the scores of the disturbances of rollouts (n, w), of a system that declares some."""
        ...

    def robustness(self, batch: RolloutBatch, config: CampaignConfig) -> Values:
        """Return the robustness of each, not clipped."""
        ...


class CalibrationPilot:
    """The rollouts of one problem, in the order in which each shows where the next ones go."""

    def __init__(
        self,
        draft: Draft,
        number: int,
        spec: SystemSpec,
        simulated: Simulated,
        *,
        propose_clip: bool,
    ) -> None:
        self._draft, self._number, self._spec, self._simulated = draft, number, spec, simulated
        self._config, self._box = draft.config, Box.of(draft.config, spec)
        self._noisy = bool(set(rolled_out(self._problem.name, spec)) & set(spec.noisy))
        self._propose_clip, self._budget = propose_clip, RolloutBudget.of(ROLLOUTS, noisy=self._noisy)
        self._chosen: tuple[Constant, ...] = ()
        self._control: PilotControl | None = None
        self.clip: Constant | None = None
        """The clip that is proposed, if the draft needs one."""

    @property
    def _problem(self) -> RigorousProblem | KrigingProblem:
        problem = self._config.problems[self._number]
        assert isinstance(problem, RigorousProblem | KrigingProblem), "a draft has no other"
        return problem

    def calibrated(self, rollouts: int, seed: int) -> ProblemCalibration:
        """Simulate about so many rollouts of each variant, and return what follows; call it once.

        Raises:
            CampaignError: almost nothing of the box is in its region.
            PerfboundError: as `Simulated`.

        """
        self._budget = RolloutBudget.of(rollouts, noisy=self._noisy)
        starts = self._box.space_filling(self._budget.starts, seed)
        wanted = [StartRollout(k, start, r) for k, start in enumerate(starts) for r in range(self._budget.replicates)]
        batch = self._simulated.simulate(wanted)
        shares = self._box.shares(starts)
        clipped = self._settle(batch, shares)
        plain = self._matrix(self._simulated.values(batch, self._config))
        plan = plans.plan(self._config, self._spec, self._problem)
        values = self._less_explained(plan, wanted, shares, plain) if plan.controlled else plain
        chosen = noisiest(shares, values) if self._noisy else []
        at_noisiest = self._repeated(starts, chosen, self._budget.at_noisiest, self._budget.replicates)
        variance = pooled(values) ** 2 / values.shape[1] if self._noisy else 0.0
        data = SampledValues(shares, values.mean(axis=1), variance)
        doubted = least_predicted(data) if self._noisy and np.ptp(data.values) > 0 else []
        later = self._budget.replicates + self._budget.at_noisiest
        again = self._repeated(starts, doubted, self._budget.at_doubted, later).mean(axis=1) if doubted else []
        descents = self._descents(data, pooled(values), len(starts))
        repeated = {start: float(mean) for start, mean in zip(doubted, again, strict=True)}
        if self._noisy:
            descents = self._tested(descents, pooled(values), len(starts) * 2)
            repeated |= _at_starts(descents, shares)
        measured = ProblemEvidence(
            plan=plan,
            box=self._box,
            shares=shares,
            values=values,
            plain=plain,
            noisiest=tuple(chosen),
            at_noisiest=at_noisiest,
            again=repeated,
            descents=descents,
            clipped=clipped,
            pace=self._simulated.pace,
            rollouts=self._simulated.count,
            required=required_objective(self._config, self._problem),
        )
        return calibrated(measured, self._draft.given(self._number), self._chosen)

    def _settle(self, batch: RolloutBatch, shares: Floats) -> float | None:
        """Choose the clip and the constants of a risk that the draft leaves open; return the share that is clipped."""
        if OBJECTIVES[self._problem.name].measured == "column":
            return None
        found = self._simulated.robustness(batch, self._config)
        robustness = self._matrix(found)
        if self._propose_clip:
            reason = f"Contains all {robustness.size} values, with half of their spread below and a quarter above."
            self.clip = Constant("clip", list(clip_around(robustness)), reason)
            self._config = self._config.model_copy(update={"clip": clip_around(robustness)})
        low, high = self._config.clip or plans.UNBOUNDED
        robustness = np.clip(robustness, low, high)
        if OBJECTIVES[self._problem.name].risk and "linearised" not in self._draft.given(self._number):
            constant = linearised_constants(shares, robustness)
            self._chosen = (constant,)
            problem = self._problem.model_copy(update={"linearised": Linearised.model_validate(constant.value)})
            problems = list(self._config.problems)
            problems[self._number] = problem
            self._config = self._config.model_copy(update={"problems": tuple(problems)})
        has_clip = self.clip is not None or self._draft.clip is not None
        return float(np.mean((robustness <= low) | (robustness >= high))) if has_clip else None

    def _less_explained(
        self, plan: plans.ProblemPlan, wanted: Sequence[StartRollout], shares: Floats, plain: Floats
    ) -> Floats:
        """Fit the control on the first rollouts (n, k), and return what it leaves of them."""
        low, high = plans.value_range(plan)
        assert low is not None, "a problem with a control has a clip"
        assert high is not None
        first = PilotRollouts(shares, self._simulated.scores(wanted).reshape(*plain.shape, -1), plain)
        self._control = PilotControl.of(bases(self._spec), (low, high), first)
        return plain - self._control.of_first(first)

    def _values(self, wanted: Sequence[StartRollout]) -> Values:
        """Simulate later rollouts, and return J of each, less what the control explains."""
        found = self._simulated.values(self._simulated.simulate(wanted), self._config)
        if self._control is None:
            return found
        shares, scores = self._box.shares([each.start for each in wanted]), self._simulated.scores(wanted)
        g = self._control.of_later(shares, scores[:, None, :])[:, 0].tolist()
        places = ((each.test, each.replicate) for each in wanted)
        return {place: found[place] - each for place, each in zip(places, g, strict=True)}

    def _repeated(self, starts: Sequence[Start], tests: Sequence[int], count: int, first: int) -> Floats:
        """Return J of further rollouts at some starts, (m, count), whose replicates are numbered from `first`."""
        if not tests:
            return np.empty((0, 0))
        numbers = range(first, first + count)
        found = self._values([StartRollout(test, starts[test], r) for test in tests for r in numbers])
        return np.array([[found[test, r] for r in numbers] for test in tests])

    def _descents(self, data: SampledValues, sd: float, test: int) -> tuple[Descent, ...]:
        """Halve the steepest places as often as the budget allows; a place ends where its middle is no start."""
        paths: list[list[SteepPlace]] = [[place] for place in steepest(data)]
        count = self._budget.at_halves
        for halving in range(self._budget.halvings):
            middles = [self._box.starts(np.array([path[-1].middle]))[0] for path in paths]
            inside = self._box.admitted(middles)
            going = [k for k, kept in enumerate(inside) if kept and len(paths[k]) == halving + 1]
            if not going:
                break
            wanted = [StartRollout(test + k, middles[k], r) for k in going for r in range(count)]
            found = self._values(wanted)
            for k in going:
                mean = float(np.mean([found[test + k, r] for r in range(count)]))
                shares = tuple(self._box.shares([middles[k]])[0].tolist())
                paths[k].append(paths[k][-1].half(End(shares, mean, sd**2 / count)))
            test += len(paths)
        return tuple(Descent(tuple(path)) for path in paths)

    def _tested(self, descents: Sequence[Descent], sd: float, test: int) -> tuple[Descent, ...]:
        """Return the descents with fresh rollouts at both ends of every suspected jump; they are beyond the budget."""
        found = []
        for k, each in enumerate(descents):
            if not each.is_suspected:
                found.append(each)
                continue
            last = each.places[-1]
            ends = (self._fresh(last.a, test + 2 * k, sd), self._fresh(last.b, test + 2 * k + 1, sd))
            found.append(replace(each, fresh=SteepPlace(*ends)))
        return tuple(found)

    def _fresh(self, end: End, test: int, sd: float) -> End:
        """Return an end by fresh rollouts; `sd` is that of a rollout at most starts."""
        start = self._box.starts(np.array([end.shares]))[0]
        wanted = [StartRollout(test, start, r) for r in range(FRESH)]
        found = list(self._values(wanted).values())
        variance = max(float(np.var(found, ddof=1)), sd**2)  # the noise may differ from start to start
        return End(end.shares, float(np.mean(found)), variance / FRESH)

    def _matrix(self, found: Values) -> Floats:
        """Return the values of the space-filling starts, (n, k)."""
        return np.array(
            [[found[test, r] for r in range(self._budget.replicates)] for test in range(self._budget.starts)]
        )


def _at_starts(descents: Sequence[Descent], shares: Floats) -> dict[int, float]:
    """Return the fresh means at ends that are among the starts (n, p)."""
    numbers = {tuple(each): k for k, each in enumerate(shares.tolist())}
    ends = (end for each in descents if each.fresh for end in (each.fresh.a, each.fresh.b))
    return {numbers[end.shares]: end.value for end in ends if end.shares in numbers}
