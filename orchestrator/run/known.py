"""What is known of the campaign in a run directory: the one model behind `status`, `show`, its JSON and the report."""

import time
from dataclasses import dataclass
from pathlib import Path

from ...schemas.file.parts import alpha_of
from ...schemas.result.certificate import Certificate, Predicate
from ...schemas.result.facts import Header
from ...schemas.result.known import CampaignState, CampaignVerdict, KnownAttempts, KnownCampaign, KnownProblem, SoFar
from ..certificate import files
from ..certificate.verdict import campaign_verdict
from ..certificate.words.advice import Commands
from ..certificate.words.format import replay_command
from ..fleet.children.child import in_file
from ..forecast.remaining import budget
from ..store import lock
from ..store.export_tables import robustness_unit
from ..store.progress import CampaignProgress, read_progress
from ..store.read import last_outcome, stored_header, system_reference
from ..store.robustness import read_values, read_violations
from ..store.so_far import read_so_far
from .continuation import continue_command
from .display.progress_table import proven_bound, remaining_distance


@dataclass(frozen=True, slots=True)
class Known:
    """The state of a campaign at one moment."""

    directory: Path
    progress: CampaignProgress
    certificate: Certificate | None
    so_far: SoFar | None
    """Of a campaign without certificate, as its orchestrator has last written it."""
    running: bool
    at: float
    """Unix time."""

    @property
    def state(self) -> CampaignState:
        """In one word."""
        return state_of(self.certificate, running=self.running)

    @property
    def link_down_for(self) -> float | None:
        """Seconds without a link to the router, by the last file of the session that runs; None with one."""
        if not self.running or self.so_far is None or self.so_far.link_down_since is None:
            return None
        return max(0.0, self.at - self.so_far.link_down_since) if self.so_far.at >= self.progress.began else None

    @property
    def resume(self) -> str | None:
        """The command that continues a stopped campaign."""
        return None if self.certificate is not None or self.running else continue_command(self.directory)

    def model(self) -> KnownCampaign:
        """Return it for programs.

        Raises:
            JournalError: the database of a finished campaign is damaged.

        """
        found, config = self.progress, self.progress.header.config
        finished = self.certificate
        verdict = None if finished is None else verdict_of(self.directory, found.header, finished)
        return KnownCampaign(
            campaign=config.name,
            seed=config.seed,
            run=found.header.run,
            state=self.state,
            verdict=verdict,
            so_far=self.so_far,
            problems=tuple(
                KnownProblem(
                    name=problem.name,
                    tests=each.tests,
                    most_tests=budget(config, problem, each.extended),
                    rollouts=each.rollouts,
                    bound=proven_bound(config, problem, each),
                    distance=remaining_distance(config, problem, each),
                    alpha=alpha_of(config, problem),
                    stopped_by=each.stopped_by,
                )
                for problem, each in zip(config.problems, found.problems, strict=True)
            ),
            rollouts_per_second=found.rate,
            router_link_down_for=self.link_down_for,
            attempts=KnownAttempts(
                without_result=found.failures, failed_in_system=found.system_failures, handed_back=found.handed_back
            ),
            resume=self.resume,
        )


def known(directory: Path) -> Known:
    """Read what is known of a campaign.

    Raises:
        PerfboundError: there is no campaign here, or its database cannot be read.

    """
    progress, certificate = read_progress(directory), files.read(directory)
    so_far = None if certificate is not None else so_far_of(directory, progress.header.run)
    return Known(directory, progress, certificate, so_far, lock.is_held(directory), time.time())


@dataclass(frozen=True, slots=True)
class Finished:
    """A finished campaign as a decision needs it."""

    header: Header
    predicate: Predicate
    verdict: CampaignVerdict
    age: float | None
    """Seconds since the last attempt at a rollout has ended; None where none was made."""


def finished(directory: Path, certificate: Certificate) -> Finished:
    """Read what belongs to the certificate of a finished campaign.

    Raises:
        JournalError: its database cannot be read.
        OSError: the disk is full or fails.

    """
    header, ended = stored_header(directory), last_outcome(directory)
    verdict = verdict_of(directory, header, certificate, repeatable=False)
    return Finished(header, certificate.predicate, verdict, None if ended is None else time.time() - ended)


def state_of(certificate: Certificate | None, *, running: bool) -> CampaignState:
    """Return the state of a campaign in one word; one that is extended runs again."""
    return "running" if running else "finished" if certificate is not None else "stopped"


def so_far_of(directory: Path, run: str) -> SoFar | None:
    """Return what a campaign has shown so far; None where its orchestrator has written nothing yet."""
    found = read_so_far(directory)
    return found if found is not None and found.run == run else None


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
