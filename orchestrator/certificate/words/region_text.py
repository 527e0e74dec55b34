"""Sentences about the regions of a certificate."""

import math
from collections.abc import Mapping

from ....schemas.file.objectives import Quantity
from ....schemas.result.certificate import CertifiedRegions, Predicate
from .bound_text import clip_words, outward

SUBJECTS: Mapping[Quantity, str] = {
    "robustness": "robustness",
    "expected_robustness": "expected robustness",
    "rho_star": "robustness risk",
}
"""The objective whose sign is proven, by the quantity of the first claim."""

NONE = "No regions: the data refute the assumptions, and an empty confidence set proves nothing."


def shares(found: CertifiedRegions) -> str:
    """Return the three shares in words; the certified ones are rounded down, and the sum is 100 %.

    >>> shares(CertifiedRegions(safe=0.62109375, unsafe=0.11, undecided=0.26890625, probability=0.95,
    ...                         unsafe_below=0.0, boxes=12, sha256="", checked=None,
    ...                         contradicted=None))
    'certified safe: at least 62.1 % of the starts; certified unsafe 11.0 %; undecided 26.9 %'
    """
    safe, unsafe = (math.floor(1000 * share + 1e-9) for share in (found.safe, found.unsafe))
    return (
        f"certified safe: at least {safe / 10:.1f} % of the starts; certified unsafe {unsafe / 10:.1f} %; undecided "
        f"{(1000 - safe - unsafe) / 10:.1f} %"
    )


def region_sentences(predicate: Predicate) -> tuple[str, ...]:
    """Return what the regions of a certificate show; nothing for a campaign that was not asked for them."""
    found = predicate.regions
    if found is None:
        # Only a refuted campaign has none, although its file asks for them.
        return (NONE,) if predicate.question.get("regions") else ()
    subject, words = _subject(predicate), shares(found)
    refuted = predicate.claims[0].refuted
    return (
        f"{words[0].upper()}{words[1:]}.",
        *(("They rest on a REFUTED assumption: do not rely on them.",) if refuted else ()),
        f"Safe: the {subject} is above 0 at every start of a box.",
        unsafe_words(subject, found),
        f"All boxes are right at once, and the first claim with them, {_chance(found.probability)}.",
        *_fresh_starts(found),
    )


def _subject(predicate: Predicate) -> str:
    """Return the objective in words; one of clipped values names the clip where that may change its sign."""
    quantity, clip = predicate.claims[0].quantity, predicate.question.get("clip")
    if quantity == "robustness" or not isinstance(clip, (list, tuple)):
        return SUBJECTS[quantity]
    return f"{SUBJECTS[quantity]}, {clip_words(clip)},"


def _chance(probability: float) -> str:
    if probability == 1.0:
        return "with certainty, given the assumptions"
    return f"with probability at least {outward(probability, '>=')}"


def _fresh_starts(found: CertifiedRegions) -> tuple[str, ...]:
    if found.checked is None:
        return ()
    verdict = "REFUTED: " if found.contradicted else ""
    verb = "has" if found.contradicted == 1 else "have"
    return (
        f"{verdict}{found.contradicted:,} of {found.checked:,} fresh starts in certified boxes {verb} another sign.",
    )


def unsafe_words(subject: str, found: CertifiedRegions) -> str:
    """Return what unsafe means, or that nothing can be certified unsafe."""
    if found.unsafe_below is None:
        return "No start can be certified unsafe: the expectation that bounds the risk never proves it negative."
    if found.unsafe_below == 0.0:
        return f"Unsafe: the {subject} is below 0 at every start of a box."
    limit = outward(found.unsafe_below, ">=")
    return (
        f"Unsafe: the expectation that bounds the risk is below {limit}, and so the risk below 0, at every start "
        "of a box."
    )
