"""The check of a campaign file that asks for regions: where method `rigorous` proves the sign of the robustness."""

from typing import TYPE_CHECKING

from .problems import OF_ROBUSTNESS, any_of
from .space import space_kind

if TYPE_CHECKING:
    from .campaign import CampaignConfig


def check_regions(config: "CampaignConfig") -> None:
    """Refuse a campaign whose box cannot be divided into regions.

    Raises:
        ValueError: one line with the key and the remedy.

    """
    first, clip = config.problems[0], config.clip
    if len(config.problems) > 1 or first.name not in OF_ROBUSTNESS:
        raise ValueError(
            f"regions: only for one problem, {any_of(OF_ROBUSTNESS)}; remove this key, or the other problems"
        )
    # Only this method has one band that is true at all starts at once, and between the nodes.
    if first.method != "rigorous":
        raise ValueError(
            f"regions: method {first.method!r} has no band that holds at all starts of a box at once; choose 'rigorous'"
        )
    if space_kind(config.space) != "box":
        raise ValueError("regions: a list of starts has no regions; give low and high per parameter under [space]")
    if config.where is not None or config.starts_of(first) is not None:
        raise ValueError(
            "regions: only a whole box with a lattice is divided; remove `where` and `candidates`, and with more than "
            "three parameters give `resolution`"
        )
    if clip is not None and not clip[0] < 0 < clip[1]:
        raise ValueError(f"clip: {list(clip)} must contain 0 inside with regions, or it decides the sign everywhere")
