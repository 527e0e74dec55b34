"""`perfbound calibrate`: rollouts of its own at the draft's starts, the constants that follow, and a campaign file."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ....schemas.amounts import amount
from ....schemas.errors import PerfboundError, Stopped
from ....schemas.file.against_system import as_in_campaign
from ....schemas.file.config import CampaignConfig
from ....schemas.file.draft import Draft, load_draft
from ....schemas.file.objectives import OBJECTIVES, rolled_out
from ....schemas.file.problem_models import KrigingProblem
from ....schemas.file.reader import parse_campaign
from ....schemas.system import SystemSpec
from ...campaign import plan as plans
from ...campaign.checks import check, check_new, check_sizes
from ...fleet.children.rollouts import ChildRolloutError, ChildSystem, simulated_spec
from ...mathematics.bounds.cost import LARGEST_MEMORY, calibration_memory, most
from ..rounded import clip_around
from .constants import Constant, ProblemCalibration
from .design import RolloutBudget
from .file import kernel_file, sample_file, without_keys
from .forecast import FORECASTS, Forecast, Instead, kriging_instead
from .pilot import CalibrationPilot
from .rollouts import rollouts
from .tolerance import ToleranceForecast

SECONDS = 1e6
"""A calibration has a number of rollouts, and no duration."""
Report = Callable[[str, int, int], None]
"""Progress callback: problem, rollouts so far, rollouts in all."""


@dataclass(frozen=True, slots=True)
class CalibrationWish:
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

    wish: CalibrationWish
    draft: Draft
    spec: SystemSpec
    clip: Constant | None
    """Proposed where the draft has none and needs one."""
    problems: tuple[ProblemCalibration, ...]
    forecasts: tuple[Forecast, ...]
    """Of each problem; empty where a kernel is not trustworthy."""
    text: str | None
    """The campaign file; None where no method fits."""
    instead: tuple[Instead, ...] = ()
    """Comparisons with method `kriging`, of problems that name no method."""
    violations: tuple[str, ...] = ()
    """How many rollouts of each problem violate the specification, and the worst one, in a sentence each."""

    @property
    def trusted(self) -> bool:
        """Whether every problem has a kernel."""
        return bool(self.forecasts)


def calibrate_draft(wish: CalibrationWish, report: Report) -> Calibration:
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
    spec = as_in_campaign(simulated_spec(reference, f"{source}: system.name", config.horizon), config)
    (check if draft.clip is None else check_new)(config, spec, source)
    check_sizes(config, source)
    check_effort(wish.rollouts, spec)
    system = ChildSystem(reference, spec, config.deadline, SECONDS)
    effort = Effort(wish.rollouts, wish.seed, wish.workers)
    try:
        found = proposals(draft, system, effort, report, source)
    except ChildRolloutError as error:
        raise PerfboundError(f"{source}: {error}") from None
    except Stopped as stop:
        raise Stopped(stop.signal, "the calibration was ended, nothing was written") from None
    return with_file(Calibration(wish, draft, spec, found.clip, found.problems, (), None, violations=found.violations))


def check_effort(rollouts: int, spec: SystemSpec) -> None:
    """Refuse more starts than kernel matrices have room for, before any of them is simulated.

    Raises:
        PerfboundError: there are.

    """

    def memory(number: int) -> float:
        return calibration_memory(RolloutBudget.of(number, noisy=bool(spec.noisy)).starts)

    if memory(rollouts) > LARGEST_MEMORY:
        fewer = most(rollouts, lambda number: memory(number) <= LARGEST_MEMORY) // 1000 * 1000
        raise PerfboundError(
            f"--rollouts {rollouts}: the kernel matrices of their starts take {amount(memory(rollouts))}, and "
            f"{amount(LARGEST_MEMORY)} are allowed; choose at most --rollouts {fewer}"
        )


@dataclass(frozen=True, slots=True)
class Effort:
    """The rollouts that constants are proposed from."""

    rollouts: int
    """Of each problem and variant."""
    seed: int
    workers: int


@dataclass(frozen=True, slots=True)
class Proposals:
    """What the rollouts of a draft show."""

    problems: tuple[ProblemCalibration, ...]
    clip: Constant | None
    """Proposed where the draft has none and needs one."""
    violations: tuple[str, ...]
    """How many rollouts of each problem violate the specification, and the worst one, in a sentence each."""


def proposals(draft: Draft, system: ChildSystem, effort: Effort, report: Report, source: str) -> Proposals:
    """Return the constants that follow from rollouts of the draft at `source`: the one way from rollouts to constants.

    Raises:
        ChildRolloutError: a rollout fails, or would be refused by a campaign.
        PerfboundError: the problems share a clip that the draft leaves open.

    """
    config, spec = draft.config, system.spec
    needs_clip = draft.clip is None and _needs_clip(config, spec)
    if needs_clip and len(config.problems) > 1:
        raise PerfboundError(f"{source}: clip: the problems share it; give [low, high], a range of the robustness")
    clip, found, seen = None, list[ProblemCalibration](), list[str]()
    for number, problem in enumerate(config.problems):
        with rollouts(system, config, number, seed=effort.seed, workers=effort.workers) as simulated:
            total = effort.rollouts * len(rolled_out(problem.name, spec))
            simulated.report = lambda done, name=problem.name, total=total: report(name, done, total)  # type: ignore[misc]
            pilot = CalibrationPilot(draft, number, spec, simulated, propose_clip=needs_clip)
            found.append(pilot.calibrated(effort.rollouts, effort.seed))
            clip = clip or pilot.clip
            seen.append(f"{problem.name}: {words}" if (words := simulated.margins.words) else "")
    return Proposals(tuple(found), clip, tuple(filter(None, seen)))


def _needs_clip(config: CampaignConfig, spec: SystemSpec) -> bool:
    return any(
        OBJECTIVES[each.name].measured != "column"
        and (
            isinstance(each, KrigingProblem)
            or bool(set(rolled_out(each.name, spec)) & set(spec.noisy))
            or not OBJECTIVES[each.name].static
        )
        for each in config.problems
    )


def with_file(found: Calibration) -> Calibration:
    """Return the calibration with its forecasts and its campaign file, as text.

    Raises:
        CampaignError: the draft has a key that does not go with the constants, or with method `sample`.

    """
    source, table = str(found.wish.out), without_keys(found.draft.table, "max_tests", "replicates")
    if any(each.choice.chosen is None for each in found.problems):
        text = _sample_text(found)
        if text is not None:
            check_new(parse_campaign(text.encode(), source), found.spec, source)
        return replace(found, text=text)
    constants = [each.constants for each in found.problems]
    config = parse_campaign(kernel_file(table, constants, found.clip, "").encode(), source)
    forecasts = tuple(
        _forecast(config, found.spec, each, found.draft.given(number)) for number, each in enumerate(found.problems)
    )
    found = replace(
        found,
        problems=tuple(
            replace(each, constants=guess.settled(each.constants))
            for each, guess in zip(found.problems, forecasts, strict=True)
        ),
        forecasts=forecasts,
    )
    found = replace(found, instead=tuple(_comparisons(found, config)))
    spent = sum(each.measured.rollouts for each in found.problems)
    head = (
        f"Constants from `perfbound calibrate`: {spent} rollouts of its own, --seed {found.wish.seed}. They are "
        "assumptions of the certificate."
    )
    text = kernel_file(table, [each.constants for each in found.problems], found.clip, head)
    check_new(parse_campaign(text.encode(), source), found.spec, source)
    return replace(found, text=text)


def _forecast(
    config: CampaignConfig, spec: SystemSpec, found: ProblemCalibration, given: Mapping[str, Any]
) -> Forecast:
    problem = next(each for each in config.problems if each.name == found.name)
    assert found.choice.chosen is not None, "the caller has checked it"
    plan = plans.plan(config, spec, problem)
    return FORECASTS[problem.method](config, plan, found.choice.chosen.fit, found.measured, given)


def _comparisons(found: Calibration, config: CampaignConfig) -> Iterator[Instead]:
    for number, (problem, guess) in enumerate(zip(found.problems, found.forecasts, strict=True)):
        if isinstance(guess, ToleranceForecast) and not found.draft.names_method(number):
            compared = kriging_instead(config, found.spec, problem, guess, found.draft.given(number))
            if compared is not None:
                yield compared


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
    return sample_file(found.draft.table, list(clip), found.problems[0].measured.pace.cost, doubts)
