"""The discarded rollouts of a certificate: each one is listed, kept, and allows no observation of its test."""

from collections.abc import Sequence

from ....schemas.batch import alone
from ....schemas.errors import EvidenceError
from ....schemas.ids import RolloutId
from ....schemas.result.certificate import Certificate
from ....schemas.result.facts import DiscardFact
from ...campaign.admission import admit, objective_fault
from ...campaign.ledger import Ledger
from ...campaign.observation import Others
from ..assumptions.audit import DISCARDED
from .checks import CheckFailed
from .manifest import Entry


def discarded(certificate: Certificate, kept: Sequence[tuple[RolloutId, Entry]]) -> tuple[DiscardFact, ...]:
    """Return the discards that a certificate names; the seeds are those of the campaign, and not known here.

    Raises:
        CheckFailed: they are not those of the manifest.

    """
    named = [each.values for each in certificate.predicate.assumptions if each.id.startswith(DISCARDED)]
    listed = [(str(rollout), entry.sha256) for rollout, entry in kept]
    if [(each.get("rollout"), each.get("sha256")) for each in named] != listed:
        raise CheckFailed("manifest", "its discarded rollouts are not those that the certificate names")
    return tuple(
        DiscardFact(rollout, 0, entry.sha256, 0, entry.path, str(values.get("reason")))
        for values, (rollout, entry) in zip(named, kept, strict=True)
    )


def check_discard(
    ledger: Ledger, fact: DiscardFact, columns: tuple[str, ...], payload: bytes, others: Others
) -> DiscardFact:
    """Return a discard with its seed, if the objective of its open test cannot be computed from its rollout.

    Raises:
        CheckFailed: it can, or the file is that of another rollout.

    """
    rollout = fact.rollout
    request = alone(ledger.request(rollout))
    try:
        trajectory = admit(request, columns, payload, fact.sha256)
    except EvidenceError as fault:
        raise CheckFailed("trajectories", f"{fact.path}: {fault}") from None
    # Else a rollout with an unwelcome outcome could be discarded.
    if objective_fault(ledger, rollout, trajectory, others) is None:
        raise CheckFailed("observations", f"{fact.path}: was discarded, although the objective can be computed from it")
    return DiscardFact(rollout, request.seed, fact.sha256, len(payload), fact.path, fact.reason)
