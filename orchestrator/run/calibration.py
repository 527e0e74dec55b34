"""`perfbound calibrate`: rollouts of its own at the draft's starts, the constants that follow, and a campaign file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...schemas.campaign import CampaignConfig
from ...schemas.campaign_draft import Draft, load_draft
from ...schemas.campaign_file import parse_campaign
from ...schemas.errors import PerfboundError, Stopped
from ...schemas.parameters import signal_shapes
from ...schemas.problem_models import Linearised, RigorousProblem
from ...schemas.problems import OBJECTIVES, rolled_out
from ...schemas.system import SystemSpec
from ..campaign import plan as plans
from ..campaign.calibrated_file import kernel_file, sample_file, without
from ..campaign.calibration import Constant, Measured, ProblemCalibration, calibrated, linearised_constants
from ..campaign.calibration_design import Box, Budget
from ..campaign.calibration_forecast import Forecast, budget_constant, forecast
from ..campaign.checks import check, check_new
from ..campaign.pilot import clip_around
from ..fleet.child import system_spec
from ..mathematics.calibration.noise import noisiest, pooled
from ..mathematics.calibration.sampled import Sampled
from ..mathematics.calibration.steepness import Descent, End, Place, steepest
from ..mathematics.gp.kernels import Floats
from .calibration_rollouts import Batch, Rollouts, Wanted, rollouts
from .child_rollouts import ChildRolloutError, ChildSystem

SECONDS = 1e6
"""A calibration has a number of rollouts, and no duration."""
Report = Callable[[str, int, int], None]
"""Progress callback: problem, rollouts so far, rollouts in all."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What is calibrated, as the command line names it."""

    campaign: Path
    rollouts: int
    """Of each problem and variant."""
    seed: int
    workers: int
    out: Path
    """The campaign file to write."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The result for one draft."""

    wish: Wish
    draft: Draft
    spec: SystemSpec
    clip: Constant | None
    """Proposed where the draft has none and needs one."""
    problems: tuple[ProblemCalibration, ...]
    forecasts: tuple[Forecast, ...]
    """Of each problem; empty where a kernel is not trustworthy."""
    text: str | None
    """The campaign file; None where no method fits."""

    @property
    def trusted(self) -> bool:
        """Whether every problem has a kernel."""
        return bool(self.forecasts)


def calibrate(wish: Wish, report: Report) -> Calibration:
    """Return the calibration of a draft; nothing is written.

    Raises:
        CampaignError: the file is no draft, or its system cannot run it.
        PerfboundError: a rollout fails, or would be refused by a campaign.
        Stopped: with what was ended.

    """
    source = str(wish.campaign)
    draft = load_draft(wish.campaign)
    config = draft.config
    reference = config.system.reference(wish.campaign)
    spec = system_spec(reference, f"{source}: system.name").spread(signal_shapes(config.space))
    (check if draft.clip is None else check_new)(config, spec, source)
    needs_clip = draft.clip is None and _needs_clip(config, spec)
    if needs_clip and len(config.problems) > 1:
        raise PerfboundError(f"{source}: clip: the problems share it; give [low, high], a range of the robustness")
    system, clip, found = ChildSystem(reference, spec, config.deadline, SECONDS), None, []
    try:
        for number, problem in enumerate(config.problems):
            with rollouts(system, config, number, seed=wish.seed, workers=wish.workers) as simulated:
                total = wish.rollouts * len(rolled_out(problem.name, spec))
                simulated.report = lambda done, name=problem.name, total=total: report(name, done, total)  # type: ignore[misc]
                pilot = _Pilot(draft, number, spec, wish, simulated, propose_clip=needs_clip)
                found.append(pilot.calibrated())
                clip = clip or pilot.clip
    except ChildRolloutError as error:
        raise PerfboundError(f"{source}: {error}") from None
    except Stopped as stop:
        raise Stopped(stop.signal, "the calibration was ended, nothing was written") from None
    return _with_file(Calibration(wish, draft, spec, clip, tuple(found), (), None))


def _needs_clip(config: CampaignConfig, spec: SystemSpec) -> bool:
    return any(
        OBJECTIVES[each.name].measured != "column"
        and (bool(set(rolled_out(each.name, spec)) & set(spec.noisy)) or not OBJECTIVES[each.name].static)
        for each in config.problems
    )


class _Pilot:
    """The rollouts of one problem, in the order in which each shows where the next ones go."""

    def __init__(
        self,
        draft: Draft,
        number: int,
        spec: SystemSpec,
        wish: Wish,
        simulated: Rollouts,
        *,
        propose_clip: bool,
    ) -> None:
        self._draft, self._number, self._spec, self._simulated = draft, number, spec, simulated
        self._config, self._box, self._seed = draft.config, Box.of(draft.config, spec), wish.seed
        self._noisy = bool(set(rolled_out(self._problem.name, spec)) & set(spec.noisy))
        self._budget = Budget.of(wish.rollouts, noisy=self._noisy)
        self._propose_clip = propose_clip
        self._chosen: tuple[Constant, ...] = ()
        self.clip: Constant | None = None
        """The clip that is proposed, if the draft needs one."""

    @property
    def _problem(self) -> RigorousProblem:
        problem = self._config.problems[self._number]
        assert isinstance(problem, RigorousProblem), "a draft has no other"
        return problem

    def calibrated(self) -> ProblemCalibration:
        """Simulate, and return what follows."""
        starts = self._box.space_filling(self._budget.starts, self._seed)
        wanted = [Wanted(k, start, r) for k, start in enumerate(starts) for r in range(self._budget.replicates)]
        batch = self._simulated.simulate(wanted)
        clipped = self._settle(batch)
        values = self._matrix(self._simulated.values(batch, self._config))
        shares = self._box.shares(starts)
        chosen = noisiest(shares, values) if self._noisy else []
        at_noisiest = self._repeated([(k, starts[k]) for k in chosen])
        variance = pooled(values) ** 2 / values.shape[1] if self._noisy else 0.0
        descents = self._descents(Sampled(shares, values.mean(axis=1), variance), pooled(values), len(starts))
        measured = Measured(
            plan=plans.plan(self._config, self._spec, self._problem),
            box=self._box,
            shares=shares,
            values=values,
            noisiest=tuple(chosen),
            at_noisiest=at_noisiest,
            descents=descents,
            clipped=clipped,
            cost=self._simulated.cost,
            rollouts=self._simulated.count,
        )
        return calibrated(measured, self._draft.given(self._number), self._chosen)

    def _settle(self, batch: Batch) -> float | None:
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
            constant = linearised_constants(robustness)
            self._chosen = (constant,)
            problem = self._problem.model_copy(update={"linearised": Linearised.model_validate(constant.value)})
            problems = list(self._config.problems)
            problems[self._number] = problem
            self._config = self._config.model_copy(update={"problems": tuple(problems)})
        has_clip = self.clip is not None or self._draft.clip is not None
        return float(np.mean((robustness <= low) | (robustness >= high))) if has_clip else None

    def _repeated(self, starts: Sequence[tuple[int, tuple[float, ...]]]) -> Floats:
        """Return J of further rollouts at some starts, (m, l)."""
        if not starts:
            return np.empty((0, 0))
        first = self._budget.replicates
        numbers = range(first, first + self._budget.at_noisiest)
        batch = self._simulated.simulate([Wanted(test, start, r) for test, start in starts for r in numbers])
        found = self._simulated.values(batch, self._config)
        return np.array([[found[test, r] for r in numbers] for test, _ in starts])

    def _descents(self, data: Sampled, sd: float, test: int) -> tuple[Descent, ...]:
        """Halve the steepest places as often as the budget allows; a place ends where its middle is no start."""
        paths: list[list[Place]] = [[place] for place in steepest(data)]
        count = self._budget.at_halves
        for halving in range(self._budget.halvings):
            middles = [self._box.starts(np.array([path[-1].middle]))[0] for path in paths]
            inside = self._box.admitted(middles)
            going = [k for k, kept in enumerate(inside) if kept and len(paths[k]) == halving + 1]
            if not going:
                break
            wanted = [Wanted(test + k, middles[k], r) for k in going for r in range(count)]
            found = self._simulated.values(self._simulated.simulate(wanted), self._config)
            for k in going:
                mean = float(np.mean([found[test + k, r] for r in range(count)]))
                shares = tuple(self._box.shares([middles[k]])[0].tolist())
                paths[k].append(paths[k][-1].half(End(shares, mean, sd**2 / count)))
            test += len(paths)
        return tuple(Descent(tuple(path)) for path in paths)

    def _matrix(self, found: Mapping[tuple[int, int], float]) -> Floats:
        """Return the values of the space-filling starts, (n, k)."""
        return np.array(
            [[found[test, r] for r in range(self._budget.replicates)] for test in range(self._budget.starts)]
        )


def _with_file(found: Calibration) -> Calibration:
    """Return the calibration with its forecasts and its campaign file."""
    source, table = str(found.wish.out), without(found.draft.table, "max_tests", "replicates")
    if any(each.choice.chosen is None for each in found.problems):
        text = _sample_text(found)
        if text is not None:
            check_new(parse_campaign(text.encode(), source), found.spec, source)
        return replace(found, text=text)
    constants = [each.constants for each in found.problems]
    config = parse_campaign(kernel_file(table, constants, found.clip, "").encode(), source)
    forecasts = tuple(_forecast(config, found.spec, each) for each in found.problems)
    found = replace(
        found,
        problems=tuple(
            replace(each, constants=(*each.constants, budget_constant(guess)))
            for each, guess in zip(found.problems, forecasts, strict=True)
        ),
        forecasts=forecasts,
    )
    spent = sum(each.measured.rollouts for each in found.problems)
    head = (
        f"Constants from `perfbound calibrate`: {spent} rollouts of its own, --seed {found.wish.seed}. They are "
        "assumptions of the certificate."
    )
    text = kernel_file(table, [each.constants for each in found.problems], found.clip, head)
    check_new(parse_campaign(text.encode(), source), found.spec, source)
    return replace(found, text=text)


def _forecast(config: CampaignConfig, spec: SystemSpec, found: ProblemCalibration) -> Forecast:
    problem = next(each for each in config.problems if each.name == found.name)
    assert found.choice.chosen is not None, "the caller has checked it"
    return forecast(config, plans.plan(config, spec, problem), found.choice.chosen.fit, found.measured)


def _sample_text(found: Calibration) -> str | None:
    """Return a campaign of drawn starts; None for a draft without a specification."""
    config = found.draft.config
    if config.formula is None:
        return None
    doubts: list[str] = [doubt for each in found.problems for doubt in each.doubts]
    clip: Any = config.clip if found.draft.clip is not None else None
    if clip is None and found.clip is not None:
        clip = found.clip.value
    if clip is None:  # rollouts that do not depend on the seed: J is minus the robustness itself
        clip = clip_around(-found.problems[0].measured.values)
    return sample_file(found.draft.table, list(clip), found.problems[0].measured.cost, doubts)
