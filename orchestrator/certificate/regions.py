"""Regions of a finished campaign: their boxes as CSV, and their part of the certificate.

Safe is a start with a positive objective: the robustness, its expectation, or the risk. Of the risk method `rigorous`
bounds E[X], which is never above it (eq. (linearised)), so E[X] > 0 proves a start safe and E[X] < 0 proves nothing;
below the least E[X] of any law without a negative risk (eq. (no risk)) a start is unsafe.
"""

import csv
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...schemas.result import certificate as document
from ..campaign.ledger import Ledger
from ..campaign.plan import ProblemPlan, unsafe_below
from ..mathematics.bounds.rigorous.method import RigorousMethod
from ..mathematics.bounds.rigorous.regions import MARGIN, SAFE, STATUSES, UNDECIDED, Regions, divide
from ..mathematics.gp.lattice import Lattice
from .problem_results import confidence


@dataclass(frozen=True, slots=True)
class CampaignRegions:
    """The regions of one campaign, and the text of `regions.csv`."""

    boxes: Regions
    csv: str
    document: document.CertifiedRegions


def campaign_regions(ledger: Ledger) -> CampaignRegions | None:
    """Return the regions of a campaign whose problem has stopped; None if its file does not ask for them.

    Refuted assumptions give none either: an empty confidence set proves every sign, and so no sign.
    """
    boxes = divided(ledger)
    if boxes is None:
        return None
    (account,) = ledger.accounts.values()
    text = table(account.plan, [each.unit for each in ledger.header.spec.parameters], boxes)
    chances = 1.0 if account.plan.exact else confidence(account.plan.problem.delta)
    certified = _fresh_signs(ledger, boxes)
    found = document.CertifiedRegions(
        **{name: boxes.of(status) for status, name in enumerate(STATUSES)},
        probability=chances,
        unsafe_below=unsafe_below(account.plan),
        checked=None if certified is None else len(certified),
        contradicted=None if certified is None else len(certified) - sum(certified),
        boxes=len(boxes.low),
        sha256=hashlib.sha256(text.encode()).hexdigest(),
    )
    return CampaignRegions(boxes, text, found)


def _fresh_signs(ledger: Ledger, boxes: Regions) -> list[bool] | None:
    """Return, for each fresh start in a certified box, whether its value has the proven sign; None without values."""
    check = ledger.closing.spot_check
    series = None if check is None else ledger.series.get(check.name)
    (account,) = ledger.accounts.values()
    # One rollout of a noisy system shows no sign of its expectation.
    if check is None or series is None or check.hypotheses[account.plan.name].noisy:
        return None
    limit = unsafe_below(account.plan)
    # Test j is at start j, and its observation is J of the one problem; values without noise have no follow-ups.
    return [
        j < MARGIN if status == SAFE else limit is not None and j > -limit - MARGIN
        for status, j in zip(boxes.at(np.array(check.starts)), series.observations, strict=True)
        if status != UNDECIDED
    ]


def divided(ledger: Ledger, margin: float = MARGIN) -> Regions | None:
    """Return the boxes of `campaign_regions`, proven with this margin."""
    if not ledger.config.regions:
        return None
    ((name, account),) = ledger.accounts.items()
    method, last, box = ledger.methods[name], account.last_bound, account.plan.candidates
    assert isinstance(method, RigorousMethod)
    assert isinstance(box, Lattice)
    if last is None or last.bound.upper is None or last.bound.verdict == "refuted":
        return None
    limit = unsafe_below(account.plan)
    return divide(
        method.envelope,
        np.array(box.low),
        np.array(box.high),
        upper=last.bound.upper,
        unsafe_above=np.inf if limit is None else -limit,
        margin=margin,
    )


def table(plan: ProblemPlan, units: Sequence[str], boxes: Regions) -> str:
    """Return `regions.csv`: RFC 4180, a row a box, floats that read back exactly."""
    file = io.StringIO(newline="")
    writer = csv.writer(file)
    named = [
        (name, "" if unit in {"", "1"} else f" ({unit})") for name, unit in zip(plan.parameters, units, strict=True)
    ]
    writer.writerow([*(f"{name} {end}{unit}" for name, unit in named for end in ("low", "high")), "status"])
    for low, high, status in zip(boxes.low.tolist(), boxes.high.tolist(), boxes.status.tolist(), strict=True):
        corners = zip(low, high, strict=True)
        writer.writerow([*(end for pair in corners for end in pair), STATUSES[status]])
    return file.getvalue()


def boxes_of(text: str, box: Lattice) -> Regions:
    """Return the boxes of a `regions.csv` over a box.

    Raises:
        ValueError: it is no such table.

    """
    lines = list(csv.reader(io.StringIO(text, newline="")))[1:]
    ends = np.array([[float(value) for value in line[:-1]] for line in lines])
    low, high = np.moveaxis(ends.reshape(len(lines), box.dimension, 2), 2, 0)
    status = np.array([STATUSES.index(line[-1]) for line in lines], dtype=np.intp)
    share = np.prod((high - low) / (np.array(box.high) - np.array(box.low)), axis=1)
    if not ((low < high).all() and np.isfinite(ends).all()):
        raise ValueError("a box has no volume")
    return Regions(low, high, status, share)


def safe_share(found: document.CertifiedRegions, of: document.CertificateClaim) -> document.CertificateClaim:
    """Return the claim about the share of safe starts; it rests on the assumptions of the claim `of` the problem."""
    # Before the first rollout the band is flat: it proves every sign, or none.
    alone = None if of.without_data is None else float(of.without_data > 0)
    return of.model_copy(
        update={
            "quantity": "safe_share",
            "sense": ">=",
            "bound": found.safe,
            "by_clip": None,
            "without_data": alone,
            "vacuous": found.safe == 0.0,
        }
    )
