"""The spaces that each method takes: one row for each name.

A method that draws its starts takes distributions and a table; every check of this follows from its row.
"""

from bisect import bisect_right
from collections.abc import Mapping
from typing import NamedTuple

from ..amounts import amount
from .objectives import OBJECTIVES, MethodName, ProblemName, any_of
from .parameters import Box, parameter_ranges
from .space import MAX_SCENARIOS, Space, SpaceKind, space_kind

SPACES: Mapping[MethodName, tuple[SpaceKind, ...]] = {
    "paper": ("box",),
    "rigorous": ("box", "scenarios"),
    "kriging": ("box",),
    "scenario": ("scenarios", "box"),
    # One kind for distributions, steps and choices: a method that takes one of them takes all.
    "sample": ("box", "distributions", "table"),
}
"""The kinds of `[space]`; the first one is what an error asks for."""
MAX_CANDIDATES = 100_000
"""Nodes of the largest lattice: every test at another one keeps a number for each node, 0.8 MB."""
MOST_PRINTED = 10**12
"""From so many nodes on messages have their number as a power."""
RESOLUTION = 21
"""Lattice nodes per parameter, by default."""
NODES: Mapping[MethodName, int] = {"kriging": 10_000}
"""Nodes of the largest lattice of methods with another limit: kernel values in every cell are kept, 5 kB each."""
LATTICE_PARAMETERS = 3
"""A lattice of the default resolution covers a box of at most so many parameters."""
CELLS_OF_MORE: Mapping[int, int] = {4: 6, 5: 5, 6: 3}
"""Nodes per parameter of method `kriging` by default, by the number of parameters: its starts are scattered there."""
MOST_STARTS = 5000
"""Of the Sobol sequence; kernel rows over them are kept, 40 kB each."""


class FixedStarts(NamedTuple):
    """How many starts of a box a method chooses from, where the file lists them by `candidates`."""

    proposed: int
    most: int


FIXED_STARTS: Mapping[MethodName, FixedStarts] = {
    "rigorous": FixedStarts(4096, MOST_STARTS),
    # Without a kernel each start needs some tens of rollouts: the default of 2,000 tests has 31 for each of 64.
    "scenario": FixedStarts(64, MAX_SCENARIOS),
}
"""The methods whose claim can be about listed starts of a box; `scenario` has no other one, `rigorous` a lattice."""
NEEDED: Mapping[SpaceKind, str] = {
    "box": "a box under [space]: low and high per parameter",
    "distributions": "ranges with distributions under [space]",
    "scenarios": "a list of scenarios under [space]",
    "table": "a table of starts under [space]",
}


def draws_starts(method: MethodName) -> bool:
    """Whether the starts of a method are drawn from the distribution that `[space]` declares."""
    return "distributions" in SPACES[method]


def fixed_starts(method: MethodName, space: Space, chosen: int | None) -> int | None:
    """Return how many listed starts of a box a method chooses from; None for a lattice, a list and draws.

    `chosen` is the key `candidates` of the file: nothing else makes a claim one about listed starts.

    >>> from perfbound.schemas.file.parameters import Range
    >>> box = {name: Range(low=0.0, high=1.0) for name in "abcd"}
    >>> [fixed_starts("rigorous", box, each) for each in (None, 500)]
    [None, 500]
    """
    return chosen if method in FIXED_STARTS and isinstance(space, dict) else None


def candidates(space: Space, resolution: int, starts: int | None) -> int:
    """Return how many starts a method that draws none chooses from: `starts`, those of a list, or lattice nodes."""
    if starts is not None:
        return starts
    return int(resolution ** len(parameter_ranges(space))) if isinstance(space, dict) else len(space.rows)


def check_starts(method: MethodName, space: Space, chosen: int) -> None:
    """Refuse the key `candidates` where it has no effect, or is too large.

    Raises:
        ValueError: one line with the key and the remedy.

    """
    known = FIXED_STARTS.get(method)
    if known is None or not isinstance(space, dict):
        raise ValueError(f"candidates: only for ranges, with method {any_of(tuple(FIXED_STARTS))}; remove this key")
    if chosen > known.most:
        raise ValueError(f"candidates: {chosen} is not allowed: method {method!r} takes at most {known.most}")


def check_unlisted(problem: ProblemName, method: MethodName, where: str, *, region: bool) -> None:
    """Refuse ranges whose starts nobody listed, with a method that has to choose from a list.

    A claim about listed starts says nothing of those between them, so it is made only where the file asks for it.

    Raises:
        ValueError: one line with the key `candidates` and the methods that claim something about the whole ranges.

    """
    if method == "scenario":
        fault = f"{where}.method: 'scenario' chooses from listed starts, and [space] has ranges"
    elif method in FIXED_STARTS and region:
        fault = f"space.where: method {method!r} covers a whole box or chooses from listed starts"
    else:
        return
    others = [repr(name) for name in OBJECTIVES[problem].methods if draws_starts(name)]
    whole = f", or choose method {' or '.join(others)}, whose claim is about all of them" if others else ""
    number = FIXED_STARTS[method].proposed
    raise ValueError(f"{fault}; give candidates = {number} for a claim about so many starts of them alone{whole}")


def largest_resolution(method: MethodName, parameters: int) -> int:
    """Return the most nodes per parameter of a lattice of a method; 1 where no lattice is small enough.

    >>> [largest_resolution("paper", parameters) for parameters in (1, 4, 5, 6, 16, 17)]
    [100000, 17, 10, 6, 2, 1]
    """
    most = NODES.get(method, MAX_CANDIDATES)
    return bisect_right(range(1, most + 1), most, key=lambda resolution: resolution**parameters)


def nodes_per_parameter(method: MethodName, space: Space, given: int) -> int:
    """Return the nodes per parameter of the lattice of a method; `given` is the key `resolution` of the file.

    >>> from perfbound.schemas.file.parameters import Range
    >>> boxes = [{name: Range(low=0.0, high=1.0) for name in names} for names in ("abc", "abcd")]
    >>> [nodes_per_parameter("kriging", box, RESOLUTION) for box in boxes], nodes_per_parameter("kriging", boxes[1], 8)
    ([21, 6], 8)
    """
    if method != "kriging" or given != RESOLUTION or not isinstance(space, dict):
        return given
    return CELLS_OF_MORE.get(len(parameter_ranges(space)), given)


def check_lattice(
    problem: ProblemName, method: MethodName, box: Box, resolution: int, where: str, *, regions: bool
) -> None:
    """Refuse a lattice that is too large for the method of the problem at `where`, before anything of it is made.

    Raises:
        ValueError: one line with the key, the size, and every remedy that this campaign allows.

    """
    parameters, most = len(parameter_ranges(box)), NODES.get(method, MAX_CANDIDATES)
    # First: a smaller lattice would be refused for this reason.
    if method == "kriging" and parameters > max(CELLS_OF_MORE):
        raise ValueError(
            f"{where}.method: 'kriging' is for at most {max(CELLS_OF_MORE)} parameters, not {parameters}; choose "
            f"{without_lattice(problem)}"
        )
    fitting = largest_resolution(method, parameters)
    if resolution <= fitting:
        return
    nodes = resolution**parameters
    number, memory = f"{resolution}^{parameters}", "more memory than there is"
    if nodes < MOST_PRINTED:
        number, memory = f"{nodes:,}", f"{amount(8 * nodes)} for each start that is tested"
    ways = [f"give resolution = {fitting}"] if fitting > 1 else []
    if parameters > LATTICE_PARAMETERS and not regions:
        other = method != "kriging" and parameters in CELLS_OF_MORE and "kriging" in OBJECTIVES[problem].methods
        fits = nodes_per_parameter("kriging", box, resolution) <= largest_resolution("kriging", parameters)
        whole = "'kriging', or " if other and fits else ""
        ways.append(f"choose another method: {whole}{without_lattice(problem)}")
    elif method in FIXED_STARTS and not (regions and ways):
        first = "remove regions and " if regions else ""
        ways.append(f"{first}give candidates = {FIXED_STARTS[method].proposed} for a claim about so many starts alone")
    raise ValueError(
        f"{where}.resolution: {resolution} for each of {parameters} parameters are {number} lattice nodes, more than "
        f"the {most:,} allowed, and take {memory}; {', or '.join(ways)}"
    )


def without_lattice(problem: ProblemName) -> str:
    """Return the methods of a problem that take ranges without a lattice, as a choice: first those about all of them.

    >>> without_lattice("robustness")
    "'sample', or for listed starts alone 'rigorous' with candidates = 4096 or 'scenario' with candidates = 64"
    """
    methods = OBJECTIVES[problem].methods
    whole = [repr(name) for name in SPACES if draws_starts(name) and name in methods]
    listed = [f"{name!r} with candidates = {each.proposed}" for name, each in FIXED_STARTS.items() if name in methods]
    return ", or ".join(filter(None, (" or ".join(whole), f"for listed starts alone {' or '.join(listed)}")))


def check_space(method: MethodName, space: Space, where: str) -> None:
    """Refuse a space that the method of the problem at `where` does not take.

    Raises:
        ValueError: it does not; one line with the key and the remedy.

    """
    kind = space_kind(space)
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
    raise ValueError(f"{where}.{space_needed(method, kind)}")


def space_needed(method: MethodName, kind: SpaceKind) -> str:
    """Return the fault of a method that does not take a space of this kind, and the methods that do.

    >>> space_needed("kriging", "scenarios").partition("; ")[2]
    "for a list of scenarios under [space] choose 'rigorous' or 'scenario'"
    """
    others = any_of(tuple(name for name, kinds in SPACES.items() if kind in kinds))
    return f"method: {method!r} needs {NEEDED[SPACES[method][0]]}; for {NEEDED[kind]} choose {others}"


def check_region(method: MethodName, space: Space) -> None:
    """Refuse `where` with a method that does not take it, or with a list.

    Raises:
        ValueError: one line with the remedy.

    """
    if not isinstance(space, dict):
        raise ValueError("space.where: only for ranges; remove the starts from the list that it should leave out")
    if not draws_starts(method) and method not in FIXED_STARTS:
        others = tuple(name for name in SPACES if draws_starts(name) or name in FIXED_STARTS)
        raise ValueError(
            f"space.where: method {method!r} bounds the worst start of a whole box; remove where, or choose method "
            f"{any_of(others)}"
        )
