"""The rules of a campaign: how seeds, digests and decisions follow from its file and its facts.

A campaign keeps the rules that it was started with: `resume`, `verify` and `replay` follow the number in its header.
A change that gives another seed, digest or decision is a new number here, and a branch at the place that it changes.

    1   the rules of perfbound 0.1, and of every campaign whose header names none
    2   digests over the keys that differ from their defaults and decide a number; seeds follow from seed and digest, so
        that no two campaigns share rollouts; a certificate has the sensitivity of its claims, and a claim is never
        weaker than what the clip alone proves
    3   a certificate lists that crashes have nothing to do with outcomes
    4   the pairs of the spot check test that a gap dominates, and its values count where they are clipped; of most
        starts nothing is claimed that the clip alone proves; equal rollouts refute independence where they are
        more alike within tests than between them, and no longer wherever they are alike; the spot check bets with a
        noise scale that the claim rests on beside the range as well
    5   claims and bounds name a clip that may hide what they say; the bound of most starts takes the threshold that is
        expected best
"""

from .errors import JournalError

RULES = 5
"""The rules of a new campaign."""
KNOWN = frozenset({1, 2, 3, 4, 5})


def check_rules(rules: int, place: str) -> int:
    """Return `rules` if this perfbound can follow them.

    Raises:
        JournalError: they are those of a later perfbound; the message names `place`.

    """
    if rules not in KNOWN:
        followed = ", ".join(map(str, sorted(KNOWN)))
        raise JournalError(f"{place}: the campaign follows rules {rules}, this perfbound {followed}; use a newer one")
    return rules
