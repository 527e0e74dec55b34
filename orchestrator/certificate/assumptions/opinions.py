"""The assumption that workers are honest, where rollouts got a second opinion."""

import math
from collections.abc import Iterable, Sequence

from ....schemas.ids import FileId
from ....schemas.result.certificate import Assumption, Predicate
from ....schemas.result.facts import Header
from ...campaign.seeds import is_chosen
from ...mathematics.bounds.one_law.share import unseen_share
from .sentences import assumption

UNSEEN = 0.05
"""Probability that the comparisons miss the share of false rollouts which the certificate names."""
NAME = "workers_honest"
MOST_NAMED = 20
"""Rollouts in the sentence."""


def workers_honest(header: Header, evidence: Iterable[FileId], contradicted: Sequence[str]) -> Assumption | None:
    """Return the assumption for the files behind a certificate; None for a campaign without second opinions.

    A chosen rollout or batch is recorded only once two results agree, so all of those in the evidence were compared and
    agree.
    """
    if not header.config.second_opinion:
        return None
    files = list(evidence)
    in_batches = "_in_batches" if any(file.places for file in files) else ""
    if contradicted:
        named = ", ".join(contradicted[:MOST_NAMED])
        more = f", and {len(contradicted) - MOST_NAMED} more" if len(contradicted) > MOST_NAMED else ""
        form, count = f"outvoted{in_batches}", len(contradicted)
        return assumption(NAME, "refuted", {"count": count, "rollouts": named + more}, form=form)
    compared = sum(is_chosen(header, file.rollout) for file in files)
    share = unseen_share(compared, UNSEEN) if compared else 1.0
    if in_batches:
        share = _share_of_rollouts(share, [max(file.places, 1) for file in files])
    values = {
        "chosen": 100 * header.config.second_opinion,
        "compared": compared,
        "agreed": compared,
        "percent": math.ceil(1000 * share) / 10,
    }
    form = f"second_opinion{in_batches}"
    return assumption(NAME, "not refuted" if compared else "assumed", values, form=form)


def _share_of_rollouts(share: float, sizes: Sequence[int]) -> float:
    """Return the share of rollouts in so large a share of files at most: drawn are files, and the largest may be false.

    >>> _share_of_rollouts(0.5, [8, 8, 1, 1]), _share_of_rollouts(0.25, [1, 1])
    (0.8888888888888888, 0.25)
    """
    whole, part = divmod(share * len(sizes), 1.0)
    ordered = [*sorted(sizes, reverse=True), 0]
    return (sum(ordered[: int(whole)]) + part * ordered[int(whole)]) / sum(sizes)


def admitted_rollouts(found: Predicate) -> list[str]:
    """Return the contradicted rollouts that a certificate admits; without a name where its sentence only counts."""
    admitted = [each for each in found.assumptions if each.id == NAME and each.status == "refuted"]
    names = [name for each in admitted for name in str(each.values.get("rollouts", "")).split(", ")]
    count = next((each.values.get("count") for each in admitted), None)
    # The file is anyone's: no more are made than the evidence can have.
    if len(names) <= MOST_NAMED or not isinstance(count, int) or not MOST_NAMED < count <= found.evidence.rollouts:
        return names
    return names[:MOST_NAMED] + [""] * (count - MOST_NAMED)
