"""The result of a finished campaign on a terminal: the end of a run on one screen, and everything on request."""

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from ...schemas.ids import RolloutId
from ...schemas.places import short_path
from ...schemas.result.certificate import Certificate
from ...schemas.result.facts import Header
from ...schemas.result.known import CampaignVerdict
from ..certificate.words import text
from ..certificate.words.bound_text import parameter_units
from ..certificate.words.console_lines import hanging, heading, plain_line
from ..certificate.words.format import replay_command
from ..certificate.words.known_text import COLOURS, verdict_lines
from ..certificate.words.region_text import region_sentences
from ..certificate.words.search_text import MOST_CLUSTERS
from ..run.known import system_file, verdict_of
from ..store.export_tables import robustness_unit

OUTPUT = {
    "certificate.json": "certificate",
    "certificate.dsse.json": "signed",
    "regions.csv": "regions",
    "manifest.sha256": "manifest",
    "attempts.json": "attempts",
    "trajectories": "evidence",
    "campaign.db": "database",
    "report.html": "report",
    "counterexamples.csv": "violations",
}
"""The files of a run directory, and what they are, in the order of the output."""
MOST_CLAIMS = 3
"""Claims after the first that the end of a run shows."""
MOST_SENTENCES = 4
"""Sentences on regions and closing checks that it shows."""

MOST_DISTURBANCES = 2
"""Disturbances of the worst rollout that it shows, which is one line."""


def print_end(directory: Path, header: Header, certificate: Certificate, console: Console) -> CampaignVerdict:
    """Print the verdict, the first claim and what comes next, on one screen of 30 lines; return the verdict."""
    unit, predicate = robustness_unit(header.config, header.spec), certificate.predicate
    units = parameter_units(header.spec)
    shown = shlex.quote(str(directory))
    verdict = print_verdict(directory, header, certificate, console)
    text.print_counterexample(predicate, console, unit, units, most=MOST_CLUSTERS)
    # A bound that shows nothing only hides what a violation shows.
    if not (verdict.verdict == "VIOLATED" and predicate.counterexample and predicate.claims[0].vacuous):
        text.first_claim(certificate, console, unit)
    if others := text.other_claims(predicate, unit, MOST_CLAIMS):
        console.print()
        for each in others:
            hanging(console, Text("also   "), each)
    if sentences := (*region_sentences(predicate), *text.check_sentences(predicate, units)):
        console.print()
        for sentence in first_sentences(sentences, shown):
            plain_line(console, sentence, "bold red" if "REFUTED" in sentence else "")
    console.print()
    if again := _repeat_command(directory, header, certificate):
        plain_line(console, f"draw it       {again}")
    if (violations := directory / "counterexamples.csv").exists() and predicate.counterexample:
        plain_line(console, f"every number  {violations}")
    plain_line(console, f"report        {directory / 'report.html'}")
    plain_line(console, f"certificate   {directory / 'certificate.json'}")
    plain_line(console, f"everything    perfbound show {shown}")
    plain_line(console, f"check it      {_verify_command(directory, header)}")
    return verdict


def first_sentences(sentences: Sequence[str], shown: str) -> Iterator[str]:
    """Yield the sentences that fit, refuted ones first, and a line that counts the others; `shown` is the directory."""
    further = len(sentences) - MOST_SENTENCES
    # A line that counts one sentence is as long as this sentence.
    if further <= 1:
        yield from sentences
        return
    yield from sorted(sentences, key=lambda each: "REFUTED" not in each)[:MOST_SENTENCES]
    yield f"{further} further lines: perfbound show {shown}"


def print_everything(
    directory: Path, header: Header, certificate: Certificate, console: Console, *, assumptions: bool
) -> None:
    """Print the verdict, every claim, problem and file, and with `assumptions` each of them with its sentence."""
    print_verdict(directory, header, certificate, console)
    unit, units = robustness_unit(header.config, header.spec), parameter_units(header.spec)
    text.print_certificate(certificate, console, unit, assumptions=assumptions, units=units)
    if not assumptions:
        heading(console, f"Assumptions: perfbound show {shlex.quote(str(directory))} --assumptions", "bold")
    print_files(directory, console)
    heading(console, f"To check it against the evidence: {_verify_command(directory, header)}", "bold")


def print_files(directory: Path, console: Console) -> None:
    """Print the output files of a run."""
    heading(console, "Output files", "bold")
    for name, content in OUTPUT.items():
        if (directory / name).exists():
            plain_line(console, f"  {content:<12} {directory / name}")


def print_verdict(directory: Path, header: Header, certificate: Certificate, console: Console) -> CampaignVerdict:
    """Print and return the verdict on a finished campaign: its reasons, and how many rollouts violate the formula."""
    found = verdict_of(directory, header, certificate)
    first, *others = verdict_lines(found, vacuous=bool(certificate.predicate.claims[0].vacuous))
    plain_line(console, first, f"bold {'yellow' if found.rests_on else COLOURS[found.verdict]}")
    indent = " " * 9
    for each in others:
        hanging(console, Text(indent), each)
    if drawn := _worst_disturbances(header, found.violations.rollout):
        hanging(console, Text(indent), f"In the worst, {', '.join(drawn)}.")
    if found.repeat:
        plain_line(console, f"{indent}Repeat the worst: {found.repeat}")  # in one line, to be copied
    return found


def _worst_disturbances(header: Header, rollout: str | None) -> list[str]:
    """Return the disturbances of a rollout that are furthest out."""
    if rollout is None or not header.spec.disturbances:
        return []
    # Late: `status` needs no numerical library.
    from ..campaign.seeds import rollout_seed  # noqa: PLC0415
    from ..report.rollout.disturbances import each_in_words  # noqa: PLC0415

    worst = RolloutId.parse(rollout)
    return each_in_words(header, worst.variant, rollout_seed(header, worst), MOST_DISTURBANCES)


def _repeat_command(directory: Path, header: Header, certificate: Certificate) -> str:
    """Return the command that draws the counterexample that ended a campaign; empty where there is none."""
    found = certificate.predicate.counterexample
    again = found and replay_command(directory, header, found.rollout, system_file(directory))
    return f"{again} --out counterexample.png" if again else ""


def _verify_command(directory: Path, header: Header) -> str:
    command = f"perfbound verify {shlex.quote(str(directory))}"
    if header.spec.repeated != "anywhere":
        return command
    system = system_file(directory)
    return f"{command} --resimulate 5" + (f" --system {shlex.quote(short_path(system))}" if system else "")
