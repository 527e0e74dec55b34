"""One requirement over the versions of a system: what each finished campaign of a folder has shown of it."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ...schemas.amounts import counted
from ...schemas.errors import PerfboundError, one_line
from ...schemas.file.config import CampaignConfig
from ...schemas.file.drawn_claims import is_sampled
from ...schemas.result.certificate import CertificateClaim, Predicate
from ...schemas.result.known import VerdictWord
from ..certificate import files
from ..certificate.counter_evidence import other_side
from ..certificate.words.bound_text import claim_unit, outward
from ..certificate.words.console_lines import aligned, plain_line
from ..certificate.words.known_text import COLOURS
from ..certificate.words.text import claim_words
from ..report.listing import check_folder, last_change, run_directories
from ..run.known import finished
from ..store.export_tables import robustness_unit
from ..store.read import last_outcome, system_revision

HEAD = ("campaign", "ended (UTC)", "version", "at least", "at most", "each with probability", "verdict of all")
BOUNDS = (3, 4)
"""The columns of the bounds."""
OF_QUESTION = ("space", "where", "candidates", "beyond", "clip", "horizon")
"""The keys of a campaign file that decide what is asked, besides the specification."""


@dataclass(frozen=True, slots=True)
class Version:
    """What one campaign has shown of a requirement."""

    directory: Path
    ended: float
    """Unix time of its last rollout."""
    revision: str | None
    """The commit of its system, where git knew one."""
    question: tuple[str, ...]
    """Quantity, level, formula, starts and clip, those of all versions of a history."""
    subject: str
    """What the bounds are about, in words."""
    lower: float | None
    upper: float | None
    unit: str
    probability: float
    refuted: bool
    """Whether its claim rests on a refuted assumption."""
    verdict: VerdictWord
    """Of the whole campaign."""


@dataclass(frozen=True, slots=True)
class History:
    """The versions in a folder."""

    versions: tuple[Version, ...]
    """The oldest first; at least one."""
    others: int
    """Finished campaigns that ask another question, or belong to a comparison."""
    unreadable: tuple[str, ...]
    """Why others cannot be read, a line for each."""


def history(folder: Path, requirement: str | None) -> History:
    """Return the versions in a folder that ask the question of the newest one.

    Without a requirement it is about the whole specification.

    Raises:
        PerfboundError: no campaign in the folder has finished, or none has the requirement.

    """
    check_folder(folder)
    directories = [each for each in run_directories(folder) if (each / files.CERTIFICATE).exists()]
    found, unreadable = list[Version](), list[str]()
    for directory in directories:
        try:
            version = _version(directory, requirement)
        except PerfboundError as error:
            unreadable.append(one_line(f"{directory}: cannot be read, and is left out: {error}"))
            continue
        found += [version] if version is not None else []
    if not found:
        wanted = "" if requirement is None else f" with a claim about the requirement {requirement!r}"
        raise PerfboundError(f"{folder}: no finished campaign{wanted} is in this folder", *unreadable)
    found.sort(key=lambda each: each.ended)
    alike = tuple(each for each in found if each.question == found[-1].question)
    return History(alike, len(directories) - len(unreadable) - len(alike), tuple(unreadable))


def _version(directory: Path, requirement: str | None) -> Version | None:
    certificate = files.read(directory)
    if certificate is None:
        return None
    campaign = finished(directory, certificate)
    config, predicate = campaign.header.config, campaign.predicate
    named = _named(config, requirement)
    if config.draws is not None or (requirement is not None and named is None):
        return None  # the campaigns of a comparison are no versions
    name, formula = named or (None, config.formula)
    claim = next((each for each in predicate.claims if each.requirement == name), None)
    if claim is None:
        return None
    partner = _partner(predicate, claim)
    lower, upper = (claim.bound, partner) if claim.sense == ">=" else (partner, claim.bound)
    return Version(
        directory,
        last_outcome(directory) or last_change(directory),
        system_revision(directory),
        (claim.quantity, str(claim.level), formula or "", *(str(getattr(config, key)) for key in OF_QUESTION)),
        claim_words(claim),
        lower,
        upper,
        claim_unit(claim, robustness_unit(config, campaign.header.spec)),
        claim.probability,
        bool(claim.refuted),
        campaign.verdict.verdict,
    )


def _named(config: CampaignConfig, requirement: str | None) -> tuple[str, str] | None:
    """Return name and formula of the requirement with this id or name; None where the campaign has none such."""
    if requirement is None:
        return None
    wanted = (each for each in config.specifications if requirement in (each.name, each.id))
    return next(((each.name, each.formula) for each in wanted), None)


def _partner(predicate: Predicate, claim: CertificateClaim) -> float | None:
    """Return the bound from the other side of what the first claim is about; None of every other claim."""
    if claim != predicate.claims[0]:
        return None
    return predicate.problems[0].partner if is_sampled(claim.quantity) else other_side(predicate)


def print_history(found: History, console: Console) -> None:
    """Print a line for each version, the oldest first, and what was left out."""
    versions, newest = found.versions, found.versions[-1]
    plain_line(console, ": ".join(filter(None, (newest.subject, one_line(newest.question[2])))), "bold")
    head, *lines = aligned([HEAD, *map(_cells, versions)], right=BOUNDS)
    plain_line(console, head, "bold")
    for each, text in zip(versions, lines, strict=True):
        line = Text(text)
        line.stylize(COLOURS[each.verdict], len(line) - len(each.verdict))
        console.print(line, soft_wrap=True)
    if found.others:
        left_out = counted(found.others, "finished campaign")
        plain_line(console, f"{left_out} in this folder left out: of another question, or of a comparison")
    for reason in found.unreadable:
        plain_line(console, reason, "red")


def _cells(each: Version) -> tuple[str, ...]:
    ended = datetime.fromtimestamp(each.ended, UTC).strftime("%Y-%m-%d %H:%M")
    low, high = (
        "" if end is None else f"{outward(end, sense)} {each.unit}".rstrip()
        for end, sense in ((each.lower, ">="), (each.upper, "<="))
    )
    chance = "refuted" if each.refuted else outward(each.probability, ">=")
    found = (str(each.directory), ended, each.revision or "", low, high, chance, each.verdict)
    return tuple(map(one_line, found))
