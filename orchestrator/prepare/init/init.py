"""`perfbound init`: a pilot of a few rollouts in one child process, and a campaign file with what follows from it."""

import os
import shlex
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ....schemas import atomic
from ....schemas.errors import PerfboundError, Stopped, one_line
from ....schemas.file.against_system import as_in_campaign
from ....schemas.file.draft import parse_draft
from ....schemas.file.method_spaces import FIXED_STARTS, LATTICE_PARAMETERS
from ....schemas.file.objectives import OBJECTIVES, ProblemName, rolled_out
from ....schemas.file.reader import parse_campaign
from ....schemas.file.space import SystemChoice
from ....schemas.system import SystemSpec, Variant
from ....schemas.trajectory.trajectory import Floats
from ...campaign import plan
from ...campaign.checks import check_new
from ...campaign.consistency import scope
from ...certificate.words.format import duration
from ...fleet.children.child import in_file, named_campaign, resolved
from ...fleet.children.rollouts import ChildRolloutError, ChildSystem, simulated_spec
from ...fleet.children.simulate import chosen_horizon
from ...forecast.remaining import least_distance
from ..calibrate.calibrate import Effort, proposals
from ..calibrate.constants import Constant
from ..check_system.files import to_declare
from ..rounded import clip_around, covering, rounded_up
from ..size import LEAST_COST, WORKERS, first_samples, first_size, proposed_batch
from . import values
from .file import campaign_text
from .pilot import SECONDS, Pilot, PilotError, PilotPlan, SlowPilotError, run_pilot
from .questions import DEFAULT, IN_MANY, QUESTIONS, FirstCampaign, unknown_question
from .values import FirstValues, Score

REACH = 2.0
"""`alpha` is at least so many times what the tests could reach if all were at one start."""
FEWEST_ROLLOUTS, MOST_ROLLOUTS = 150, 200
"""Of a problem and a variant, for constants; fewer show no kernel, and more are the business of `calibrate`."""
WORTH = 5.0
"""Seconds of rollouts for which a second process is worth its start."""
LONGEST = 3.0
"""Pilots that the rollouts for the constants may take."""
A_GUESS = "A guess: `perfbound calibrate` proposes a better one."
CALIBRATED = ("worst",)
"""Questions about the worst start of a box, whose file is a draft for `perfbound calibrate` as well."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What a first campaign is about, as the command line names it."""

    reference: str
    """The system, a name, FILE.py:NAME or a campaign file."""
    question: str
    """A key of `QUESTIONS`; empty for the usual one of the system."""
    specification: str | None
    """None for a harmless formula."""
    horizon: float | None
    """In s; None for the one that the system assumes."""
    out: Path | None


def write_first_campaign(wish: Wish) -> Iterator[str]:
    """Write a campaign file for a system, and yield lines of progress.

    Where a pilot takes too long, the constants are guesses, and the file says so.

    Raises:
        CampaignError: the system is not installed, or cannot be loaded.
        PilotError: a rollout of the pilot failed.
        PerfboundError: the question does not fit the system, the specification is none of its columns, or the file
            exists or cannot be written.

    """
    if wish.question and wish.question not in QUESTIONS:
        raise PerfboundError(unknown_question(wish.question))
    if wish.out is not None:  # first: to load a system may take seconds
        _check_unwritten(wish.out)
    known = named_campaign(wish.reference)
    if known is not None and wish.specification is not None:
        known = known.model_copy(update={"specification": wish.specification})
    spec = as_in_campaign(simulated_spec(wish.reference, "SYSTEM"), known).as_simulated
    wish = replace(wish, question=wish.question or (DEFAULT if len(spec.parameters) <= LATTICE_PARAMETERS else IN_MANY))
    question = QUESTIONS[wish.question]
    if question.of_box and len(spec.parameters) > LATTICE_PARAMETERS:
        raise PerfboundError(
            f"--question {wish.question}: {spec.name} has {len(spec.parameters)} parameters, and a map of safe "
            f"starts is for at most {LATTICE_PARAMETERS}; ask --question {IN_MANY}"
        )
    if wish.specification is None and known is not None and known.specification:
        wish = replace(wish, specification=known.specification)
    folder = Path(wish.reference).parent if known else Path()
    out = wish.out or _check_unwritten(folder / f"{spec.name}.toml")
    variants, choice = _variants(spec, wish.question), _system_choice(wish.reference, out)
    horizon = chosen_horizon(spec, wish.horizon)
    score = values.score(wish.specification, spec)
    yield f"{spec.name}: {_about(wish.question, spec)}"
    yield f"{spec.name}: a pilot of a few rollouts, for about {SECONDS:g} s at most"
    limit = SECONDS if known is None else min(SECONDS, known.deadline)
    plan_of_pilot = PilotPlan(wish.reference, spec, choice.options, variants, horizon, limit)
    choice, basis, found, news = _piloted(wish, choice, plan_of_pilot, score)
    if basis.horizon == 0 and wish.horizon:
        raise PerfboundError(
            f"--horizon {wish.horizon:g}: rollouts of {spec.name} are one sample, which has none; remove this option"
        )
    if basis.horizon == 0 and not all(OBJECTIVES[problem].static for problem in question.problems):
        raise PerfboundError(
            f"--question {wish.question}: rollouts of {spec.name} are one sample, and this question needs longer ones; "
            "choose --question worst"
        )
    campaign = _first_campaign(wish, spec, choice, basis, found)
    if found is not None and not question.drawn:
        system = ChildSystem(wish.reference, spec, limit, LONGEST * SECONDS)
        constants = yield from _calibrated(campaign, system, found, out)
        campaign, news = replace(campaign, basis=constants.of(campaign.basis)), f"the constants are {constants.news}"
    campaign = _reachable(campaign)
    text = campaign_text(campaign)
    written = parse_campaign(text.encode(), str(out))
    check_new(written, spec, str(out))
    try:
        atomic.write_new({out.absolute(): (text.encode(), 0o666)})
    except FileExistsError:
        raise _exists(out) from None
    yield f"{out}: {news}"
    yield from scope(plan.plans(written, spec), listed_alone=True)
    yield from _next_steps(wish, campaign, out, slow=found is None)


def _piloted(
    wish: Wish, choice: SystemChoice, pilot: PilotPlan, score: Score
) -> tuple[SystemChoice, FirstValues, Pilot | None, str]:
    """Return the system with the files that it reads, the numbers, the pilot if it has enough rollouts, and the news.

    Raises:
        PilotError: a rollout failed.

    """
    question = QUESTIONS[wish.question]
    try:
        found = run_pilot(pilot, score)
        basis, kept = _proposal(wish, pilot.spec, found)
        return _with_files(choice, found.undeclared), basis, kept, f"{question.values} proposed from {found.size}"
    except SlowPilotError as error:
        fault = f"because the pilot took too long: {error}"
        return choice, _guess(wish, pilot.spec, pilot.horizon, fault), None, f"{question.values} guessed, {fault}"
    except PilotError as error:
        command = f"perfbound check-system {shlex.quote(wish.reference)}"
        raise PilotError(f"the pilot failed, and nothing is written: {error}; for all faults: {command}") from None


def _next_steps(wish: Wish, campaign: FirstCampaign, out: Path, *, slow: bool) -> Iterator[str]:
    """Yield what to do with the file."""
    drawn, file = campaign.question.drawn, shlex.quote(str(out))
    if slow:
        yield (
            f"Shorten the horizon or the rollouts, and write the file anew; or replace the guesses. For all faults: "
            f"perfbound check-system {file}"
        )
        return
    if campaign.noisy and wish.question in CALIBRATED and len(campaign.spec.parameters) <= LATTICE_PARAMETERS:
        yield (
            f"Rollouts are noisy. perfbound calibrate {file} proposes constants from more of them, and says whether "
            "method kriging may be expected to prove more."
        )
    if not wish.specification and not drawn:
        # B and its companions fit the formula that they were proposed for, and no other.
        again = f'{one_line(campaign.command)} --specification "..." --out FILE'
        yield f"The formula is a stand-in, and the constants fit it alone. For yours: {again}"
    edit = "Edit its specification. " if not wish.specification and drawn else ""
    yield f"{edit}Check the system: perfbound check-system {file}. Then: perfbound run {file}"


def _about(question: str, spec: SystemSpec) -> str:
    """Return what will be claimed, and about which starts."""
    row, count = QUESTIONS[question], len(spec.parameters)
    if row.drawn:
        starts = "starts that are drawn from the ranges"
    elif count > LATTICE_PARAMETERS:
        number = FIXED_STARTS["rigorous"].proposed
        starts = f"the worst of {number:,} listed starts alone; `--question how-often` is about the whole ranges"
    else:
        starts = "all starts of the ranges"
    return f"{count} parameter{'s' * (count > 1)}, question `{question}`: {row.words} The claim is about {starts}"


def _check_unwritten(out: Path) -> Path:
    if out.exists():
        raise _exists(out)
    if not out.absolute().parent.is_dir():
        raise PerfboundError(f"{out}: there is no such folder; make it, or choose another --out")
    return out


def _exists(out: Path) -> PerfboundError:
    return PerfboundError(f"{out}: exists already and stays as it is; choose another --out")


def _variants(spec: SystemSpec, question: str) -> tuple[Variant, ...]:
    """Return the variants that a question simulates, each once."""
    found = dict.fromkeys(variant for problem in QUESTIONS[question].problems for variant in rolled_out(problem, spec))
    if missing := set(found) - set(spec.variants):
        raise PerfboundError(
            f"--question {question}: {spec.name} has no variant {', '.join(sorted(missing))}; give it two variants, "
            "nominal and true, or choose --question worst"
        )
    for each in spec.parameters:
        if not each.low < each.high:
            raise PerfboundError(f"{spec.name}: the range of {each.name} is empty; give it a low below its high")
    return tuple(found)


def _proposal(wish: Wish, spec: SystemSpec, found: Pilot) -> tuple[FirstValues, Pilot]:
    """Return what follows from a pilot, and the pilot with the robustness for scores, also by a formula of its own."""
    specification, about = wish.specification, ""
    question = QUESTIONS[wish.question]
    if specification is None:
        column, every = spec.columns[1].name, _all(found.scores)
        limit, _ = covering(every, 0.1, 0.0)
        specification = _above(column, limit, found.horizon)
        found = replace(found, scores={variant: each - limit for variant, each in found.scores.items()})
        least = f"where {column} was at least {every.min():g}"
        about = f"This formula holds in the whole pilot, {least}; it is a stand-in for yours."
    elif not question.drawn:
        about = "The constants below fit this formula."
    source = "" if not question.drawn else f"{question.values.capitalize()} proposed from {found.size}."
    clip, scale = clip_around(_all(found.scores)), values.search_scale(specification, spec, found.spans)
    return FirstValues(source, found.horizon, specification, about, clip, {}, scale=scale), found


@dataclass(frozen=True, slots=True)
class FirstConstants:
    """The constants of every problem, and where they come from."""

    found: dict[ProblemName, tuple[Constant, ...]]
    whence: str
    """The rollouts that they follow from, or why they are guesses."""
    are_guesses: bool = False

    @property
    def news(self) -> str:
        """What they are, in words."""
        return f"{'guessed, because' if self.are_guesses else 'proposed from'} {self.whence}"

    def of(self, basis: FirstValues) -> FirstValues:
        """Return the first values with them."""
        # In capitals in the file, which is read without the lines of this command.
        head = f"The constants are {self.news.replace('guessed', 'GUESSED', 1).removesuffix('.')}."
        return replace(basis, source=head, constants=self.found)


def _calibrated(
    campaign: FirstCampaign, system: ChildSystem, pilot: Pilot, out: Path
) -> Generator[str, None, FirstConstants]:
    """Return the constants that `perfbound calibrate` would propose from few rollouts; else guesses, with the reason.

    Yields lines of progress.
    """
    names = campaign.question.problems
    draft = parse_draft(campaign_text(campaign).encode(), str(out))
    cost = max(campaign.cost or 0.0, LEAST_COST)
    each = sum(len(rolled_out(name, campaign.spec)) for name in names) * cost / WORKERS
    rollouts = min(MOST_ROLLOUTS, int(SECONDS / each))
    if rollouts < FEWEST_ROLLOUTS:
        return _guesses(campaign, pilot, f"{FEWEST_ROLLOUTS} rollouts would take {duration(FEWEST_ROLLOUTS * each)}")
    yield f"{campaign.spec.name}: {rollouts:,} rollouts for its constants, about {duration(rollouts * each)}"
    try:
        workers = WORKERS if rollouts * each > WORTH else 1
        found = proposals(draft, system, Effort(rollouts, 1, workers), lambda *_: None, str(out))
    except ChildRolloutError as error:
        return _guesses(campaign, pilot, f"a rollout failed: {error}")
    except Stopped as stop:
        raise Stopped(stop.signal, "the pilot was ended, nothing was written") from None
    yield from found.violations
    if doubts := [doubt for problem in found.problems for doubt in problem.doubts]:
        ask = "Method `sample` needs no kernel: `--question how-often`."
        return _guesses(campaign, pilot, f"no kernel is trustworthy here. {' '.join(doubts)} {ask}")
    spent = sum(problem.measured.rollouts for problem in found.problems)
    constants = {name: problem.constants for name, problem in zip(names, found.problems, strict=True)}
    return FirstConstants(constants, f"{spent} rollouts")


def _guesses(campaign: FirstCampaign, pilot: Pilot, why: str) -> FirstConstants:
    spec = campaign.spec
    return FirstConstants(
        {
            name: values.guessed(_objective(name, spec, pilot.scores), noisy=_noisy(name, spec), why=A_GUESS)
            for name in campaign.question.problems
        },
        why,
        are_guesses=True,
    )


def _above(column: str, limit: float, horizon: float) -> str:
    """Return a formula that suits rollouts of one sample, where the horizon is 0, and longer ones."""
    return f"always ({column} >= {limit!r})" if horizon else f"{column} >= {limit!r}"


def _all(scores: dict[Variant, Floats]) -> Floats:
    return np.concatenate([each.ravel() for each in scores.values()])


def _objective(name: ProblemName, spec: SystemSpec, scores: dict[Variant, Floats]) -> Floats:
    """Return the maximised objective of a problem, shape (n, k)."""
    if name != "sim_gap":
        return -scores[rolled_out(name, spec)[0]]
    nominal, true = scores["nominal"], scores["true"]
    count = max(nominal.shape[1], true.shape[1])
    return np.stack([nominal[:, k % nominal.shape[1]] - true[:, k % true.shape[1]] for k in range(count)], axis=1)


def _noisy(name: ProblemName, spec: SystemSpec) -> bool:
    return bool(set(rolled_out(name, spec)) & set(spec.noisy))


def _guess(wish: Wish, spec: SystemSpec, horizon: float, fault: str) -> FirstValues:
    """Return numbers to replace, where no pilot shows better ones."""
    question = QUESTIONS[wish.question]
    unfit = (
        ""
        if question.drawn
        else "The constants below do not follow from this formula, because the pilot took too long."
    )
    return FirstValues(
        source=f"{question.values.capitalize()} GUESSED, {fault}",
        horizon=horizon,
        specification=wish.specification or _above(spec.columns[1].name, 0.0, horizon),
        about=unfit if wish.specification else "Put your formula here.",
        clip=(-10.0, 10.0),
        constants={
            name: values.guessed(None, noisy=_noisy(name, spec), why=A_GUESS)
            for name in ([] if question.drawn else question.problems)
        },
        guess=f" {A_GUESS}",
    )


def _reachable(campaign: FirstCampaign) -> FirstCampaign:
    """Return the campaign with an `alpha` for each problem that its tests can reach."""
    if campaign.question.drawn:
        return campaign
    plans = plan.plans(parse_campaign(campaign_text(campaign).encode(), "campaign.toml"), campaign.spec)
    constants = {
        name: tuple(_reaching(each, REACH * least_distance(plans[name])) for each in found)
        for name, found in campaign.basis.constants.items()
    }
    return replace(campaign, basis=replace(campaign.basis, constants=constants))


def _reaching(constant: Constant, least: float) -> Constant:
    """Return an `alpha` that is not below what the tests can reach; another constant as it is."""
    if constant.key != "alpha" or not isinstance(constant.value, float) or constant.value >= rounded_up(least):
        return constant
    return Constant("alpha", rounded_up(least), "Twice what the tests could reach if all were at one start.")


def _first_campaign(
    wish: Wish, spec: SystemSpec, choice: SystemChoice, basis: FirstValues, pilot: Pilot | None
) -> FirstCampaign:
    question, cost = QUESTIONS[wish.question], pilot.cost if pilot else None
    size = first_samples(cost) if question.drawn else None
    in_batch = pilot.in_batch if pilot else None
    names = question.problems
    noisy = frozenset(name for name in names if _noisy(name, spec))
    needs_clip = question.always_clip or (
        question.clip and any(_noisy(name, spec) or not OBJECTIVES[name].static for name in names)
    )
    variants = sum(len(rolled_out(name, spec)) for name in noisy or names)
    many = len(spec.parameters) > LATTICE_PARAMETERS
    return FirstCampaign(
        spec=spec,
        system=choice,
        command=f"perfbound init {shlex.quote(wish.reference)} --question {wish.question}",
        question=question,
        basis=basis if needs_clip else replace(basis, clip=None),
        lengths=values.length_scales(spec.parameters),
        candidates=FIXED_STARTS["rigorous"].proposed if not question.drawn and many else None,
        size=size or first_size(cost, noisy=bool(noisy), variants=variants),
        noisy=noisy,
        cost=cost,
        batch=proposed_batch(*in_batch, rollouts=size.max_tests) if in_batch and size else 1,
    )


def _with_files(choice: SystemChoice, undeclared: Sequence[str]) -> SystemChoice:
    """Return `[system]` with the files that rollouts have read, which are named from the folder of the system."""
    if not undeclared:
        return choice
    folder = os.path.dirname(choice.python or "")
    names = (name if os.path.isabs(name) else os.path.normpath(os.path.join(folder, name)) for name in undeclared)
    return choice.model_copy(update={"files": (*(choice.files or ()), *to_declare(names))})


def _system_choice(reference: str, out: Path) -> SystemChoice:
    """Return `[system]` of a campaign file `out`; the path of a system in a file is relative to it.

    Raises:
        PerfboundError: it cannot be named from there.

    """
    file = Path(reference)
    campaign, found = named_campaign(reference), resolved(reference)
    if campaign is not None and campaign.system.is_described:
        if out.absolute().parent != file.absolute().parent:
            raise PerfboundError(
                f"{out}: its system belongs to the folder of the file that describes it; choose --out beside {file}"
            )
        return campaign.system
    if campaign is not None:
        raise PerfboundError(
            f"{file}: this is a campaign file already; give its system: {campaign.system.python or found}"
        )
    if not in_file(found):
        return SystemChoice.model_validate({"name": found})
    path, _, name = found.rpartition(":")
    relative = os.path.relpath(Path(path).absolute(), out.absolute().parent)
    if ":" in relative:
        raise PerfboundError(f"{relative}: a campaign file takes no ':' in the path of a system; rename the folder")
    return SystemChoice.model_validate({"python": f"{relative}:{name}"})
