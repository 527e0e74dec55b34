"""The issue of the certificate of a finished campaign; nothing in it depends on time, host or number of workers."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

from ...schemas.base import digest
from ...schemas.file.bases import bases
from ...schemas.ids import FileId
from ...schemas.result import certificate as document
from ...schemas.result.facts import DiscardFact, Header
from ..campaign.bounded_parts import bounded_accounts
from ..campaign.ledger import Ledger, failed_attempts, observed_rollouts
from ..store.files import FOLDER
from .assumptions.audit import ClosingResults, assumptions
from .assumptions.opinions import workers_honest
from .bounded import bounded_disturbances
from .claims import claims, of_listed_starts
from .closing_checks import recheck, spot_check
from .problem_results import Results, result, with_controls
from .regions import CampaignRegions, campaign_regions, safe_share
from .search_results import counterexample_of, failures_of, search_of
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
        counterexample=counterexample_of(ledger),
        failures=failures_of(ledger),
        search=search_of(ledger),
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
