"""The spaces that each method takes: one row for each name.

A method that draws its starts takes distributions and a table; every check of this follows from its row.
"""

from collections.abc import Mapping

from .parameters import parameter_ranges
from .problems import MethodName, any_of
from .space import Space, SpaceKind, space_kind

SPACES: Mapping[MethodName, tuple[SpaceKind, ...]] = {
    "paper": ("box",),
    "rigorous": ("box", "scenarios"),
    "scenario": ("scenarios",),
    "sample": ("box", "distributions", "table"),
}
"""The kinds of `[space]`; the first one is what an error asks for."""
MAX_CANDIDATES = 100_000
"""Nodes of the largest lattice; memory is O(tests x nodes)."""
NEEDED: Mapping[SpaceKind, str] = {
    "box": "a box under [space]: low and high per parameter",
    "distributions": "ranges with distributions under [space]",
    "scenarios": "a list of scenarios under [space]",
    "table": "a table of starts under [space]",
}


def draws_starts(method: MethodName) -> bool:
    """Whether the starts of a method are drawn from the distribution that `[space]` declares."""
    return "distributions" in SPACES[method]


def candidates(space: Space, resolution: int) -> int:
    """Return how many starts a method that draws none chooses from, with so many lattice nodes per parameter."""
    return int(resolution ** len(parameter_ranges(space))) if isinstance(space, dict) else len(space.rows)


def check_space(method: MethodName, space: Space, resolution: int, where: str) -> None:
    """Refuse a space that the method of the problem at `where` does not take, or a lattice that is too large.

    Raises:
        ValueError: it does not; one line with the key and the remedy.

    """
    kind = space_kind(space)
    nodes = 0 if draws_starts(method) else candidates(space, resolution)
    if kind in SPACES[method] and nodes > MAX_CANDIDATES:
        raise ValueError(f"{where}.resolution: {nodes} lattice nodes are more than the {MAX_CANDIDATES} allowed")
    if kind in SPACES[method]:
        return
    drawing = tuple(name for name in SPACES if draws_starts(name))
    otherwise = f", or choose method {any_of(drawing)}" if drawing else ""
    if kind == "table":
        raise ValueError(
            f"space.table: not allowed with method {method!r}, which draws no starts; give a range per parameter or "
            f"scenarios instead{otherwise}"
        )
    if kind == "distributions" and isinstance(space, dict):
        name, given = next((name, each) for name, each in space.items() if each.for_draws)
        raise ValueError(
            f"space.{name}.{given.for_draws[0]}: not allowed with method {method!r}, which draws no starts; give low "
            f"and high alone{otherwise}"
        )
    raise ValueError(f"{where}.method: {method!r} needs {NEEDED[SPACES[method][0]]}")


def check_region(method: MethodName, space: Space) -> None:
    """Refuse `where` with a method that does not take it, or with a list.

    Raises:
        ValueError: one line with the remedy.

    """
    if not isinstance(space, dict):
        raise ValueError("space.where: only for ranges; remove the starts from the list that it should leave out")
    if not draws_starts(method):
        raise ValueError(
            f"space.where: method {method!r} bounds the worst start of a whole box; remove where, or choose method "
            f"{any_of(tuple(name for name in SPACES if draws_starts(name)))}"
        )
