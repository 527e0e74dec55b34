"""The issue of the certificate of a finished campaign; nothing in it depends on time, host or number of workers."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

from ...schemas.base import digest
from ...schemas.file.bases import bases
from ...schemas.ids import FileId, RolloutId
from ...schemas.result import certificate as document
from ...schemas.result.facts import DiscardFact, Header, RolloutFact
from ..campaign.bounded_parts import bounded_accounts
from ..campaign.closing.likeliest import LikeliestFailure
from ..campaign.closing.shrink import Shrink
from ..campaign.closing.spot_check import LEVEL
from ..campaign.counterexample import counterexample
from ..campaign.ledger import Ledger, failed_attempts, observed_rollouts
from ..campaign.observation import goal_of_search
from ..mathematics.bounds.one_law.weighted import DEFENSIVE
from ..mathematics.search.clusters import Cluster
from ..mathematics.stl.text import text
from ..store.files import FOLDER
from .assumptions.audit import ClosingResults, assumptions
from .assumptions.opinions import workers_honest
from .bounded import bounded_disturbances
from .claims import claims, of_listed_starts
from .closing_checks import recheck, spot_check
from .problem_results import Results, result, with_controls
from .regions import CampaignRegions, campaign_regions, safe_share
from .sensitivity import sensitivity, with_clip, without_rollouts


@dataclass(frozen=True, slots=True)
class Manifest:
    """The list of the trajectory files behind the observations, as `sha256sum` reads it."""

    text: str


def manifest(entries: Iterable[tuple[str, str]], discards: Iterable[DiscardFact] = ()) -> Manifest:
    """Return the manifest of (sha256, path) pairs, then of discarded rollouts, in the format of sha256sum."""
    lines = [f"{sha256}  {path}\n" for sha256, path in entries]
    kept = [f"{fact.sha256}  {fact.path}\n" for fact in discards]
    return Manifest("".join([*lines, *kept]))


def issue(
    ledger: Ledger,
    evidence: Manifest,
    *,
    irreproducible: int = 0,
    contradicted: Sequence[str] = (),
    regions: CampaignRegions | None = None,
) -> document.Certificate:
    """Return the certificate of a campaign whose problems have all stopped.

    `irreproducible` is the number of rollouts and batches that were recorded after the system had failed in an attempt.
    `contradicted` are rollouts of outvoted workers that had another result when they were simulated again. `regions`
    are those of `campaign_regions`, which takes seconds; if they are missing, they are computed here.
    """
    regions = regions or campaign_regions(ledger)
    header, config = ledger.header, ledger.config
    accounts = bounded_accounts(ledger.accounts, ledger.methods)
    plans = {name: account.plan for name, account in accounts.items()}
    results: Results = {name: result(account) for name, account in accounts.items()}
    checked, repeated = spot_check(ledger), recheck(ledger)
    honest = workers_honest(header, _listed(evidence), contradicted)
    found = assumptions(
        ledger,
        accounts,
        ClosingResults(checked, repeated, None if regions is None else regions.document),
        failed=irreproducible + failed_attempts(ledger),
        honest=honest,
    )
    claimed = claims(config, plans, results, ledger.methods, found)
    results = with_clip(results, config)
    found_claims = without_rollouts(claimed.claims, config, plans, results)
    claimed = replace(claimed, claims=of_listed_starts(found_claims, bases(config), plans))
    results = with_controls(results, ledger.methods, header)
    varied = sensitivity(claimed.claims, header, accounts, results)
    if regions is not None:
        first, *others = claimed.claims
        claimed = replace(claimed, claims=(first, safe_share(regions.document, first), *others))
    manifest_sha256 = hashlib.sha256(evidence.text.encode()).hexdigest()
    predicate = document.Predicate(
        question=question(header),
        campaign=document.CampaignId(
            name=config.name,
            seed=config.seed,
            config_sha256=header.config_sha256,
            system_sha256=header.system_sha256,
        ),
        claims=claimed.claims,
        problems=tuple(results.values()),
        composition=claimed.composition,
        assumptions=tuple(found),
        counterexample=_counterexample(ledger),
        failures=_failures(ledger),
        bounded=bounded_disturbances(header, claimed.claims[0]),
        regions=None if regions is None else regions.document,
        spot_check=checked,
        recheck=repeated,
        evidence=document.Evidence(
            manifest_sha256=manifest_sha256,
            # One chain per problem and check, because observations of two series have no order; the head covers all.
            chain_head=digest([series.link for series in ledger.series.values()]),
            rollouts=observed_rollouts(ledger),
        ),
        software=header.software,
        rules=header.rules,
        sensitivity=varied,
    )
    return document.Certificate(subject=(subject(manifest_sha256),), predicate=predicate)


def _counterexample(ledger: Ledger) -> document.Counterexample | None:
    for account in ledger.accounts.values():
        if (found := counterexample(account)) is not None:
            rollout = found.rollout
            return document.Counterexample(
                rollout=str(rollout.rollout),
                test=rollout.rollout.test,
                # A search has single tests, and another campaign ends with the last ones.
                rollouts=len(account.last_rollouts if account.clusters is None else account.plan.rollouts),
                start=dict(zip(account.plan.parameters, found.start, strict=True)),
                seed=rollout.seed,
                disturbances=_values(ledger.header, rollout.rollout, found.start, rollout.seed),
                robustness=rollout.robustness or 0.0,
                shrunk=_shrunk(ledger, account.plan.parameters),
                likeliest=_likeliest(ledger, account.plan.parameters, rollout.seed),
                simplest=None if account.clusters else _simplest(ledger, rollout),
            )
    return None


def _failures(ledger: Ledger) -> document.Failures | None:
    """Return the clusters of failing starts; None of a campaign that ends with the first one, or has none."""
    for account in ledger.accounts.values():
        if account.clusters is not None and account.clusters.found:
            parts = [text(each) for each in goal_of_search(ledger.config, ledger.header.spec)[1]]
            names = account.plan.parameters
            clusters = tuple(_cluster(ledger, each, names, parts) for each in account.clusters.found)
            return document.Failures(clusters=clusters, undecided=account.clusters.undecided)
    return None


def _cluster(
    ledger: Ledger, cluster: Cluster[RolloutFact], parameters: Sequence[str], parts: Sequence[str]
) -> document.FailureCluster:
    worst = cluster.worst
    return document.FailureCluster(
        violated=tuple(parts[number] for number in cluster.violated),
        tests=len(cluster.failures),
        starts=dict(zip(parameters, zip(*cluster.box, strict=True), strict=True)),
        start=dict(zip(parameters, worst.start, strict=True)),
        robustness=worst.margin,
        rollout=str(worst.test.rollout),
        seed=worst.test.seed,
        simplest=_simplest(ledger, worst.test),
    )


def _simplest(ledger: Ledger, failure: RolloutFact) -> document.Simplest | None:
    """Return the simplest failure that follows from one; None where none was sought."""
    sought = ledger.closing.simplest
    found = None if sought is None else sought.of(failure.rollout)
    if sought is None or found is None:
        return None
    names = [parameter.name for parameter in ledger.header.spec.parameters]
    start, robustness, rollout = found.best
    return document.Simplest(
        nominal=dict(zip(names, sought.nominal, strict=True)),
        start=dict(zip(names, start, strict=True)),
        away=tuple(names[number] for number in found.away),
        robustness=robustness,
        rollout=str(rollout),
        rollouts=found.tests,
    )


def _shrunk(ledger: Ledger, parameters: Sequence[str]) -> document.Shrunk | None:
    shrink = ledger.closing.shrink
    if not isinstance(shrink, Shrink):
        return None
    start, robustness, rollout = shrink.best
    return document.Shrunk(
        nominal=dict(zip(parameters, shrink.nominal, strict=True)),
        start=dict(zip(parameters, start, strict=True)),
        robustness=robustness,
        rollout=str(rollout),
        rollouts=len(ledger.series[shrink.name].observations),
    )


def _likeliest(ledger: Ledger, parameters: Sequence[str], seed: int) -> document.LikeliestFailure | None:
    sought = ledger.closing.shrink
    if not isinstance(sought, LikeliestFailure):
        return None
    start, robustness, rollout = sought.best
    return document.LikeliestFailure(
        start=dict(zip(parameters, start, strict=True)),
        disturbances=_values(ledger.header, rollout, start, seed),
        distance=sought.distance,
        robustness=robustness,
        rollout=str(rollout),
        rollouts=len(ledger.series[sought.name].observations),
        at_start=_at_start(ledger),
    )


def _at_start(ledger: Ledger) -> document.FailureAtStart | None:
    sampled = ledger.closing.importance
    if sampled is None:
        return None
    count = len(ledger.series[sampled.name].observations)
    return document.FailureAtStart(
        bound=sampled.lower(count),
        probability=1 - LEVEL,
        rollouts=count,
        failures=len(sampled.weights),
        share=DEFENSIVE,
    )


def _values(header: Header, rollout: RolloutId, start: Sequence[float], seed: int) -> dict[str, document.DrawnValue]:
    """Return the values of the disturbances of a rollout by their names."""
    drawn = header.template.disturbances(rollout.variant, [start], [seed])
    each = zip(header.spec.disturbances, drawn[0] if drawn else (), strict=bool(drawn))
    return {law.name: document.DrawnValue(value=value, unit=law.unit) for law, value in each}


def _listed(evidence: Manifest) -> list[FileId]:
    paths = [PurePosixPath(line.split()[1]) for line in evidence.text.splitlines()]
    # A discarded one is in another folder.
    return [FileId.parse(path.stem) for path in paths if path.parts[0] == FOLDER and path.stem.count(".") > 2]


def subject(manifest_sha256: str) -> document.Subject:
    """Return the subject of a certificate: its manifest."""
    return document.Subject(name="manifest.sha256", digest={"sha256": manifest_sha256})


def question(header: Header) -> dict[str, object]:
    """Return the keys of the campaign file that the claims are about, so that a reader needs no other file."""
    keys = {"system", "space", "specification", "clip", "risk_weight", "horizon", "gap", "composition"}
    # Left out while it is not set: few campaigns set one.
    optional = ("until_counterexample", "falsify", "specifications", "regions", "where")
    sought = {key for key in optional if getattr(header.config, key)}
    if header.config.on_refuted != "continue":
        sought.add("on_refuted")
    if header.config.beyond != "refuse":
        sought.add("beyond")
    return header.config.model_dump(mode="json", exclude_none=True, include=keys | sought)
