"""The questions that `perfbound init` writes a campaign file for: one row each.

The help of the command, the error for another question and the table of the docs are made from the rows. The module
loads neither pydantic nor numpy, because the command line reads it for every command.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ....schemas.errors import meant
from ....schemas.file.toml_text import toml_comment, toml_value
from ..size import EXACT, NOISY, FirstSize

if TYPE_CHECKING:
    from ....schemas.file.objectives import ProblemName
    from ....schemas.file.space import SystemChoice
    from ....schemas.system import SystemSpec
    from .values import FirstValues

Lines = Callable[["FirstCampaign"], Iterator[str]]


def _none(_: "FirstCampaign") -> Iterator[str]:
    return iter(())


@dataclass(frozen=True, slots=True)
class Question:
    """One question, and the part of a campaign file that asks it."""

    words: str
    """The question."""
    claim: str
    """What answers it, in one line."""
    key: str
    """The key of the file that asks it."""
    keys: Lines
    """Returns the lines of its keys, before system and space."""
    ending: Lines = _none
    """Returns its lines after them: tables, and claims."""
    problems: tuple["ProblemName", ...] = ("robustness",)
    drawn: bool = False
    """Whether its starts are drawn: it needs no constants, and asks for a number of samples."""
    clip: bool = True
    """Whether a clip is written where rollouts are noisy; the bound of a frequency or of an order needs none."""
    always_clip: bool = False
    """Whether it is also written where nothing is random."""
    of_box: bool = False
    """Whether it is about a whole box, and so for few parameters alone."""

    @property
    def values(self) -> str:
        """What a pilot proposes for it, in words with their verb."""
        if not self.drawn:
            return "the constants are"
        return "the clip and the number of samples are" if self.clip else "the number of samples is"


@dataclass(frozen=True, slots=True)
class FirstCampaign:
    """The content of a first campaign file."""

    spec: "SystemSpec"
    system: "SystemChoice"
    command: str
    """`perfbound init` with the system and the question."""
    question: Question
    basis: "FirstValues"
    lengths: dict[str, float]
    """Length scale of each parameter."""
    candidates: int | None
    """Fixed starts, where no lattice covers the box."""
    size: FirstSize
    noisy: "frozenset[ProblemName]"
    """Problems whose rollouts depend on the seed."""
    cost: float | None = None
    """Seconds of a rollout, if known."""
    batch: int = 1
    """Rollouts of a batch, where the samples do not depend on each other."""

    @property
    def full_size(self) -> FirstSize:
        """The size where rollouts cost little."""
        return NOISY if self.noisy else EXACT


def _clip_lines(campaign: "FirstCampaign") -> Iterator[str]:
    basis = campaign.basis
    if basis.clip is not None:
        yield from toml_comment(
            "Range to which the robustness, the margin to a violation, is clipped; the claim is about the clipped "
            f"one. Choose it so that it contains nearly all values.{basis.guess}"
        )
        yield f"clip = {toml_value(list(basis.clip))}"


def _worst(campaign: "FirstCampaign") -> Iterator[str]:
    yield from _clip_lines(campaign)
    yield from _sizes(campaign, "Tests at most")
    yield from _constants(campaign, "robustness")


def _fails(campaign: "FirstCampaign") -> Iterator[str]:
    yield from toml_comment(
        "Search for a start that fails: the first test that violates the specification ends the campaign, and is its "
        "answer. Every fourth test is drawn at random; if none fails, these say how often it fails at most."
    )
    if scale := campaign.basis.scale:
        yield from toml_comment(
            "The search compares predicates by the ranges of their columns in the pilot; verdict and claim do not."
        )
        yield f"falsify = {toml_value({'scale': dict(scale)})}"
    else:
        yield "falsify = {}"
    yield from _acceptable()
    yield "# Tests at most."
    yield f"max_tests = {min(campaign.size.max_tests, MOST_SEARCHED)}"


def _safe(campaign: "FirstCampaign") -> Iterator[str]:
    yield "# Divide the box: the starts that are certified safe, those that are certified unsafe, and the others."
    yield "regions = true"
    yield from _worst(campaign)


def _samples(campaign: "FirstCampaign") -> Iterator[str]:
    yield from _clip_lines(campaign)
    samples = campaign.size.max_tests
    slow = "" if campaign.cost is None or samples > FEW else f" A rollout takes about {campaign.cost:.2g} s."
    yield from toml_comment(
        f"Number of samples, fixed beforehand. More of them give a sharper claim: without a violation, {samples:,} "
        f"show at 95 % that at most {100 * (1 - 0.05 ** (1 / samples)):.2g} % fail.{slow}"
    )
    yield f"max_tests = {samples}"
    if campaign.batch > 1:
        yield "# Rollouts that a worker simulates at once: quick ones cost more to hand out than to simulate."
        yield f"batch = {campaign.batch}"


MOST_SEARCHED = 299
"""Tests of a first search."""
FEW = 298
"""Samples that show less than 1 %."""


def _rare(campaign: "FirstCampaign") -> float:
    """Return the level of the worst cases that the number of samples can show."""
    return 0.01 if campaign.size.max_tests > FEW else 0.05


def _acceptable() -> Iterator[str]:
    yield "# The largest probability of a failure that you accept; without this key nothing is SHOWN:"
    yield "# required_at_most = 0.01"


def _counted(campaign: "FirstCampaign") -> Iterator[str]:
    yield from _samples(campaign)
    yield from _acceptable()


def _how_often(_: "FirstCampaign") -> Iterator[str]:
    yield ""
    yield "[[claims]]"
    yield 'quantity = "failure_probability"'


def _next_claim(_: "FirstCampaign") -> Iterator[str]:
    yield ""
    yield "[[claims]]"
    yield 'quantity = "next_rollout"'
    yield "# Probability with which the next rollout may be below the bound."
    yield "level = 0.05"


def _worst_cases(campaign: "FirstCampaign") -> Iterator[str]:
    level = _rare(campaign)
    yield ""
    yield from toml_comment(
        f"The robustness that all rollouts but {100 * level:g} % reach; the mean of the worst {100 * level:g} %; and "
        "what all starts but a tenth reach, of noisy rollouts as a mean."
    )
    yield "claims = ["
    for quantity, share in (("quantile", level), ("cvar", level), ("share_of_starts", 0.1)):
        yield f"    {toml_value({'quantity': quantity, 'level': share})},"
    yield "]"


def _transfer(campaign: "FirstCampaign") -> Iterator[str]:
    yield from _clip_lines(campaign)
    yield "# How the rollouts of the two variants are compared, and the two bounds become one claim."
    yield 'gap = { kind = "robustness" }'
    yield 'composition = "pointwise"'
    yield from _sizes(campaign, "Tests of a problem at most")


_ABOUT: Mapping["ProblemName", str] = {
    "nominal_robustness": "Lower bound of the worst mean robustness of the variant nominal.",
    "sim_gap": "Upper bound of how much less robust the variant true is than nominal, as a mean.",
}


def _both_problems(campaign: "FirstCampaign") -> Iterator[str]:
    for name, about in _ABOUT.items():
        yield ""
        yield from toml_comment(about)
        yield "[[problems]]"
        yield f'name = "{name}"'
        yield from _constants(campaign, name)


def _sizes(campaign: "FirstCampaign", tests: str) -> Iterator[str]:
    """Yield the number of tests, and the sizes of the closing checks where the defaults would take long."""
    size, full = campaign.size, campaign.full_size
    yield from toml_comment(f"{tests}; the bound is valid whenever they end.{_fewer_rollouts(campaign)}")
    yield f"max_tests = {size.max_tests}"
    if size.spot_check == full.spot_check:
        return
    default = f"without these two keys {full.spot_check} each" if campaign.noisy else f"without it {full.spot_check}"
    yield from toml_comment(
        f"Tests of the check at the end, fewer since a rollout takes about {campaign.cost or 0.0:.2g} s: {default}."
    )
    yield f"spot_check = {size.spot_check}"
    if campaign.noisy:
        yield f"spot_check_followups = {size.spot_check}"


def _fewer_rollouts(campaign: "FirstCampaign") -> str:
    """Return how the tests of slow rollouts differ from those of quick ones; empty if they do not."""
    size, full, problems = campaign.size, campaign.full_size, campaign.question.problems
    slow = f" A rollout takes about {campaign.cost or 0.0:.2g} s, so this first campaign is small"
    quick = f"where rollouts are quick, `perfbound init` writes max_tests = {full.max_tests}"
    if size.replicates < full.replicates:
        each = f"that is {full.max_tests:,} tests of {full.replicates:,} rollouts each"
        if len(problems) > 1:  # those without noise have one rollout in each test, whatever it takes
            where = f" for {' and '.join(name for name in problems if name in campaign.noisy)}, {each}"
        else:
            where = f", {each}: {full.max_tests * full.replicates:,} rollouts in place of {size.max_tests:,}"
        return (
            f"{slow}: one rollout a test. More rollouts prove more: {quick} and replicates = {full.replicates}{where}."
        )
    return f"{slow}. More tests prove more: {quick}." if size.max_tests < full.max_tests else ""


def _constants(campaign: "FirstCampaign", name: "ProblemName") -> Iterator[str]:
    """Yield the constants of a problem, each with its meaning and its reason; none while they are not known yet."""
    found = {each.key: each for each in campaign.basis.constants.get(name, ())}
    objective = "the difference" if name == "sim_gap" else "-robustness"
    for key, meaning in _MEANINGS.items():
        if key in found:
            yield from toml_comment(f"{meaning.format(objective)} {found[key].why}".strip())
            yield f"{key} = {toml_value(found[key].value)}"
        elif key == "kernel" and found:
            yield from toml_comment(
                f"{meaning.format(objective)} Without this key: half of each range, of more than three parameters the "
                "whole range."
            )
            yield f"# kernel = {toml_value({'length_scale': campaign.lengths})}"
    if name in campaign.noisy and campaign.size.replicates > 1:
        yield "# Rollouts of a test, with different seeds."
        yield f"replicates = {campaign.size.replicates}"


_MEANINGS: Mapping[str, str] = {
    "alpha": "The problem stops when its bounds are so near, or after max_tests: both give valid bounds.",
    "prior_mean": "About the mean of {} over all starts.",
    "rkhs_norm": "B, the norm of {} minus prior_mean for the kernel: the main assumption. A larger one is safer and "
    "proves less.",
    "noise_scale": 'R, the noise of one rollout. "derived" follows from the clip, assumes nothing and proves less.',
    "kernel": "Smoothness nu, and distances in each parameter over which {} changes its course: assumptions.",
}
"""Of the constants of a problem, in the order of the file; the braces are the objective."""

QUESTIONS: Mapping[str, Question] = {
    "worst": Question(
        "How bad is the worst start?",
        "the worst robustness over all starts, of noisy rollouts the worst mean, is at least this",
        "rkhs_norm = ...",
        _worst,
    ),
    "fails": Question(
        "Is there a start from which it fails?",
        "a start that fails; or, where none is found, at most this share of all rollouts violates the specification",
        "falsify = {}",
        _fails,
        drawn=True,
        clip=False,
    ),
    "safe": Question(
        "Where is it safe?",
        "shares of the box that are certified safe, certified unsafe or undecided, as map and list",
        "regions = true",
        _safe,
        of_box=True,
    ),
    "how-often": Question(
        "How often does it fail?",
        "at most this share of all rollouts violates the specification",
        'quantity = "failure_probability"',
        _counted,
        _how_often,
        drawn=True,
        clip=False,
    ),
    "worst-cases": Question(
        "How bad are the worst cases?",
        "a quantile, the mean of the worst share, and what nearly all starts reach, are at least these",
        'claims = [{ quantity = "quantile", level = 0.01 }, ...]',
        _samples,
        _worst_cases,
        drawn=True,
        always_clip=True,
    ),
    "next": Question(
        "How bad may the next rollout be?",
        "one more rollout has at least this robustness, with this probability",
        'quantity = "next_rollout"',
        _samples,
        _next_claim,
        drawn=True,
        clip=False,
    ),
    "transfer": Question(
        "Does the claim carry over to the true system?",
        "the risk of the variant true is at least this, from nominal rollouts and the gap to the true ones",
        'composition = "pointwise"',
        _transfer,
        _both_problems,
        problems=("nominal_robustness", "sim_gap"),
    ),
}
"""By the value of `--question`; the first one is the default."""
DEFAULT, IN_MANY = next(iter(QUESTIONS)), "how-often"
"""The question for a system that is asked none, and for one of more than three parameters: it holds in any number."""


def question_help() -> str:
    """Return the help of `--question`."""
    return " ".join(f"{name}: {each.words}" for name, each in QUESTIONS.items())


def unknown_question(name: str) -> str:
    """Return the error for a question that has no row."""
    known = "; ".join(f"{each} ({row.words})" for each, row in QUESTIONS.items())
    return f"--question {name}: there is no such question; {meant(name, QUESTIONS)}choose one of {known}"


def docs_table() -> str:
    """Return the rows as a table in Markdown."""
    rows = (f"| `{name}` | {each.words} | {each.claim} |" for name, each in QUESTIONS.items())
    return "\n".join(["| `--question` | question | claim |", "|---|---|---|", *rows])
