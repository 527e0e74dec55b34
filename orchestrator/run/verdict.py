"""The verdict on the campaign in a run directory, and its lines on a terminal."""

from collections.abc import Iterator
from pathlib import Path

from ...schemas.result.certificate import Certificate
from ...schemas.result.facts import Header
from ...schemas.result.verdict import CampaignVerdict, VerdictWord, Violations
from ..certificate.verdict import campaign_verdict
from ..certificate.words.advice import Commands
from ..certificate.words.refutation_text import margin_words
from ..fleet.children.child import in_file
from ..store.export_tables import robustness_unit
from ..store.progress import read_progress
from ..store.read import system_reference
from ..store.robustness import read_values, read_violations
from .continuation import continue_command
from .format import replay_command

COLOURS: dict[VerdictWord, str] = {"SHOWN": "green", "VIOLATED": "red", "NOT SHOWN": "yellow"}


def system_file(directory: Path) -> str | None:
    """Return the reference of a system that is not installed; None for one that is."""
    reference = system_reference(directory)
    return reference if in_file(reference) else None


def verdict_of(
    directory: Path, header: Header, certificate: Certificate, *, repeatable: bool = True
) -> CampaignVerdict:
    """Return the verdict on a finished campaign.

    With `repeatable` it has the command that repeats the worst rollout as well, and a forecast where one would help.

    Raises:
        JournalError: its database is damaged.
        OSError: the disk is full or fails.

    """
    variant, problems = header.claimed_variant, [problem.name for problem in header.config.problems]
    violations, repeat = read_violations(directory, variant), ""
    if repeatable and violations.violations:
        repeat = replay_command(directory, header, violations.rollout or "", system_file(directory))
    return campaign_verdict(
        header,
        certificate.predicate,
        violations,
        lambda: read_values(directory, variant, problems),
        unit=robustness_unit(header.config, header.spec),
        commands=Commands(continue_command(directory), repeat),
        progress=(lambda: read_progress(directory).problems) if repeatable else tuple,
    )


def verdict_lines(found: CampaignVerdict) -> Iterator[str]:
    """Yield the verdict, its reasons, what would help, and how many rollouts violate the specification."""
    yield f"VERDICT  {found.verdict}"
    # The number of a claim that does not answer the question comes after the answer.
    yield from (f"{found.claim}.", *found.reasons) if found.verdict == "SHOWN" else (*found.reasons, f"{found.claim}.")
    for sentence in found.advice:
        yield f"What would help: {sentence[0].lower()}{sentence[1:]}"
    if count := violation_words(found):
        yield count


def violations_in_words(seen: Violations) -> str:
    """Return how many rollouts violate the specification.

    >>> violations_in_words(Violations(rollouts=320, violations=1, starts=9, violating_starts=1, least=-1, rollout="a"))
    '1 of 320 rollouts violates the specification'
    """
    verb = "violates" if seen.violations == 1 else "violate"
    return f"{seen.violations:,} of {seen.rollouts:,} rollouts {verb} the specification"


def violation_words(found: CampaignVerdict) -> str:
    """Return how many rollouts violate the specification; empty where none has a robustness."""
    seen = found.violations
    if not seen.rollouts or seen.least is None:
        return ""
    margin = margin_words(seen.least, found.unit)
    worst = f"the worst {margin}, or lower: the clip" if found.clipped else f"the worst {margin}"
    count = violations_in_words(seen)
    if not seen.violations:
        return f"{count}; {worst}."
    return f"{count}, at {seen.violating_starts:,} of {seen.starts:,} starts, {worst}."
