"""The question of a campaign in one sentence: what its file requires of the first claim."""

from ...schemas.file.drawn_claims import is_sampled
from ...schemas.file.objectives import Quantity, Reading
from ...schemas.result.facts import Header
from ..campaign.clip import hiding, reach_of
from ..certificate.bound_text import clip_words
from ..store.export_tables import robustness_unit

OF_MARGIN: dict[Quantity, tuple[str, Reading]] = {
    "robustness": ("the margin of every rollout", "each"),
    "expected_robustness": ("the mean margin over the noise", "mean"),
    "rho_star": ("the mean margin less {risk:g} standard deviations", "risk"),
    "mean": ("the mean margin", "mean"),
    "risk": ("the mean margin less {risk:g} standard deviations", "risk"),
}
"""Quantities of a claim about a margin, what is bounded, and how it reads the values."""


def question_words(header: Header, quantity: Quantity | None, listed: int | None = None) -> str:
    """Return what the file requires of a quantity; empty where it requires nothing that one sentence says.

    A term of a composition has no quantity: its sum bounds the risk. `listed` is the number of listed starts.
    """
    config, quantity = header.config, quantity or "rho_star"
    unit = robustness_unit(config, header.spec)
    shown = "" if unit == "1" else f" {unit}"
    every = "From every start" if listed is None else f"From each of the {listed:,} listed starts"
    where = "At starts that are drawn as declared" if is_sampled(quantity) else every
    if quantity in OF_MARGIN and config.formula is not None:
        margin, reading = OF_MARGIN[quantity]
        within, required = reach_of(config.formula, header.spec.after_end), config.required_margin
        clip = hiding(config.clip, within, reading, ">=", risk_weight=config.risk_weight, bound=required)
        clipped = "" if clip is None else f", {clip_words(clip)},"
        least = f"{where}, {margin.format(risk=config.risk_weight)}{clipped} must be at least {required:g}{shown}"
        return f"{least}. The margin of a rollout is its robustness: 0 is just met, and below 0 it violates."
    if quantity == "failure_probability":
        limit = config.required_at_most
        at_most = "as small as possible" if limit is None else f"at most {limit:g}"
        return f"{where}, the probability that a rollout violates it must be {at_most}."
    return ""
