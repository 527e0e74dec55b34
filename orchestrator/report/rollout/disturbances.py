"""The disturbances of recorded rollouts, with how far out each value is under its law."""

from collections.abc import Sequence

from ....schemas.result.facts import Header
from ..data.rollouts import DrawnValue

MOST = 4
"""Disturbances of a rollout that are shown, those furthest out."""


def drawn_values(header: Header, variant: str, seeds: Sequence[int], most: int = MOST) -> list[tuple[DrawnValue, ...]]:
    """Return the drawn disturbances of rollouts with these seeds, the furthest out first.

    None of a variant without noise.
    """
    laws = header.template.laws
    if laws is None or variant not in header.spec.noisy or not seeds:
        return [()] * len(seeds)
    rows = zip(laws.values(seeds).tolist(), laws.scores(seeds).tolist(), strict=True)
    return [tuple(_furthest(header, *row)[:most]) for row in rows]


def words(header: Header, variant: str, seed: int) -> str:
    """Return the disturbances of one rollout in words; empty where there are none."""
    found = each_in_words(header, variant, seed)
    more = len(header.spec.drawn) - len(found)
    return ", ".join(found) + (f", and {more:,} more" if found and more else "")


def each_in_words(header: Header, variant: str, seed: int, most: int = MOST) -> list[str]:
    """Return the disturbances of one rollout, the furthest out first, such as "gust = 5.8 m/s (2.9 sd)"."""
    texts = []
    for each in drawn_values(header, variant, [seed], most)[0]:
        law = header.spec.disturbances[each.place]
        value = f"{law.name} = {each.value:.3g} {law.unit}".removesuffix(" 1").rstrip()
        texts.append(f"{value} ({_far(each)})")
    return texts


def _far(drawn: DrawnValue) -> str:
    return f"probability {drawn.chance:.3g}" if drawn.sd is None else f"{drawn.sd:.1f} sd"


def _furthest(header: Header, values: Sequence[float], scores: Sequence[float]) -> list[DrawnValue]:
    from scipy.special import ndtri  # noqa: PLC0415  (a tenth of a second that few commands need)

    found = []
    for place in header.spec.drawn_places:
        law, value, score = header.spec.disturbances[place], values[place], scores[place]
        if law.choices is None:
            found.append((-abs(score), DrawnValue(place, value, score, None)))
        else:
            chance = law.shares[int(score)]
            # As rare as this on both sides of a normal law.
            found.append((float(ndtri(chance / 2.0)), DrawnValue(place, value, None, chance)))
    return [each for _, each in sorted(found, key=lambda pair: pair[0])]
