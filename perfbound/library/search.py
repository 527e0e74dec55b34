"""A search for a failing start by ask and tell: without system, workers, files and claim."""

import threading
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..orchestrator.campaign.checks import check_scale
from ..orchestrator.campaign.observation import LIMITS, Observer, for_search, goal_of_search
from ..orchestrator.campaign.region import Start, condition
from ..orchestrator.campaign.starts import Ranges, check_where
from ..orchestrator.mathematics.search import Falsifier
from ..orchestrator.mathematics.stl.parser import columns, parse_formula
from ..schemas.amounts import counted
from ..schemas.errors import CampaignError, PerfboundError, RequestError, meant, shortened
from ..schemas.file.against_system import as_in_campaign
from ..schemas.file.config import CampaignConfig
from ..schemas.file.defaults import OVER_TIME
from ..schemas.file.parameters import knots_alike, parameter_ranges
from ..schemas.file.reader import parse_campaign
from ..schemas.real_numbers import real_number
from ..schemas.system import SystemSpec
from ..schemas.trajectory.input_signal import start_values, with_signals
from ..schemas.trajectory.trajectory import Trajectory
from ..schemas.values import DISCRETE, Beyond
from ..workers.systems.described import space_parameters
from ..workers.systems.rig import rig_spec
from .campaign import toml
from .handed_in import of_columns
from .process import reproducible

MARGIN = "margin"
"""The only column where no specification is given: the number that the caller gives."""
NO_BOX = "Search: space: a search is over ranges; give that of each parameter, {'gap': (20, 50)}"
BLOCK, BLOCKS = 1024, 1000
"""Random starts that are drawn together, and how often, until one is in the region."""


class Worst(NamedTuple):
    """A start with the least margin so far."""

    start: dict[str, Any]
    margin: float


class Search:
    """A search for a start with a margin below 0, of a system that the caller runs; it makes no claim, whatever it has
    found or not found.

    `space` has the ranges of `pb.Campaign`: (low, high), steps, choices, `where`, and inputs over time, which need the
    `horizon` in s and are `InputSignal` in a start. With `specification` an outcome is a trajectory in place of a
    margin, and each part of the formula has a model of its own; `discrete` and `beyond` are those of `pb.robustness`.
    `scale` has the usual range of each column, as in `falsify`: it compares predicates inside one part.

    The same seed, and the same calls in the same order, give the same starts on one machine. Several starts may be
    asked for before the first outcome, also by several threads. Inside, BLAS uses one thread.

    Raises:
        PerfboundError: one line with the key and the allowed values, as for a campaign.

    >>> search = Search({"gap": (20, 50), "speed": (10, 30)}, seed=1)
    >>> for test in range(100):
    ...     start = search.ask()
    ...     if search.tell(start, start["gap"] - start["speed"] ** 2 / 30) < 0:
    ...         break
    >>> search.worst.start == start, search.worst.margin < 0
    (True, True)

    """

    def __init__(
        self,
        space: Mapping[str, Any],
        *,
        seed: int = 1,
        specification: str | None = None,
        horizon: float = 0.0,
        discrete: Collection[str] = (),
        beyond: Beyond = "refuse",
        scale: Mapping[str, float] | None = None,
    ) -> None:
        falsify = {} if scale is None else {"scale": scale}
        keys = {"space": space, "seed": seed, "horizon": horizon, "beyond": beyond, "falsify": falsify}
        config = _config(keys, specification, discrete)
        assert isinstance(config.space, dict)
        self._spec = _spec(config)
        self._horizon, self._has_formula = config.horizon, specification is not None
        self._names = tuple(each.name for each in self._spec.parameters)
        ranges = parameter_ranges(config.space)
        self._allowed = Ranges([ranges[name] for name in self._names])
        if config.where is not None:
            check_where(config.space, config.where, "Search")
        self._region, self._seed = condition(config.where, self._names), config.seed
        if specification is not None:
            _check_formula(config, self._spec, specification)
        self._observer, self._has_scale = Observer(config, self._spec), scale is not None
        self._goal = goal_of_search(config, self._spec)[0]
        self._falsifier = Falsifier(
            *(ends.tolist() for ends in self._allowed.box),
            seed=config.seed,
            admitted=self._region,
            signals=knots_alike(config.space, self._names),
            goal=self._goal,
        )
        self._open: list[tuple[dict[str, Any], Start]] = []
        self._worst: tuple[Start, float] | None = None
        self._lock = threading.Lock()

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters; those of an input over time are its knots or numbers."""
        return self._names

    @property
    def worst(self) -> Worst | None:
        """The start with the least margin so far, and this margin; None before the first outcome."""
        return None if self._worst is None else Worst(self._values(self._worst[0]), self._worst[1])

    def ask(self) -> dict[str, Any]:
        """Return the next start by parameter; starts that wait for an outcome are not returned again."""
        with self._lock, reproducible():
            x = self._next([each for _, each in self._open])
            start = self._values(x)
            self._open.append((start, x))
            return dict(start)

    def tell(self, start: Mapping[str, Any], outcome: Any) -> float:
        """Take the outcome of a start that `ask` has returned, and return its margin: below 0 the system fails.

        The outcome is the margin, or with a specification a `Trajectory` or a dict of its columns.

        Raises:
            PerfboundError: the start was not asked for, or was told before; or the outcome is no finite number, or no
                trajectory on which the specification can be evaluated. Nothing has changed then.

        """
        with self._lock, reproducible():
            place = next((k for k, (each, _) in enumerate(self._open) if _same(each, start)), None)
            if place is None:
                raise RequestError(
                    f"tell: {shortened(repr(start), 120)} is no start that waits for its outcome; give one that `ask` "
                    "has returned, once, or hand in what is known beforehand by `add`"
                )
            margin = self._observed(self._open[place][1], outcome)
            del self._open[place]
            return margin

    def add(self, start: Mapping[str, float], outcome: Any) -> float:
        """Take the outcome of a start that was run before, and return its margin.

        The start has a number for each of `parameters`.

        Raises:
            PerfboundError: the start has other parameters or is outside their ranges, or as `tell`.

        """
        with self._lock, reproducible():
            return self._observed(self._known(start), outcome)

    def _known(self, start: object) -> Start:
        """Return the numbers (p,) of a start from outside."""
        if not isinstance(start, Mapping):
            raise PerfboundError(f"add: {shortened(repr(start), 60)} is no start; give a number by parameter")
        if unknown := next((str(name) for name in start if name not in self._names), ""):
            known = f"{meant(unknown, self._names)}known are {', '.join(self._names)}"
            raise PerfboundError(f"add: {unknown}: there is no such parameter; {known}")
        x = []
        for name, low, high in zip(self._names, *self._allowed.box, strict=True):
            if name not in start:
                raise PerfboundError(f"add: {name}: this parameter is missing; give a number from {low:g} to {high:g}")
            value = _number(start[name], f"add: {name}")
            if not low <= value <= high:
                raise PerfboundError(f"add: {name}: {value:g} is not allowed: allowed is {low:g} to {high:g}")
            x.append(value)
        return tuple(x)

    def _next(self, pending: Sequence[Start]) -> Start:
        proposed = np.array(self._falsifier.propose(pending))
        _, x = self._allowed.nearest(proposed, ())
        if self._region is None or self._region([x])[0]:
            return x
        # A start that no model chose: of the whole box.
        low, high = self._allowed.box
        rng = np.random.default_rng([self._seed, self._falsifier.observations, len(pending)])
        for _ in range(BLOCKS):
            drawn = rng.uniform(low, high, (BLOCK, len(low)))
            for each in drawn[self._region(drawn)]:
                if self._region([near := self._allowed.nearest(each, ())[1]])[0]:
                    return near
        raise CampaignError(
            f"Search: space.where: none of {BLOCK * BLOCKS:,} random starts is in it; fix the condition"
        )

    def _observed(self, x: Start, outcome: object) -> float:
        """Give an outcome to the search, and return its margin."""
        if self._has_formula:
            try:
                score = self._observer.score(self._trajectory(x, outcome))
            except ValueError as error:
                raise PerfboundError(f"the trajectory: {error}") from None
            assert score.robustness is not None, "there is a specification"
            margin, parts = score.robustness, score.parts
        else:
            if isinstance(outcome, Trajectory | Mapping):
                raise PerfboundError(
                    "a trajectory needs a formula: give `specification` to pb.Search, or tell a margin"
                )
            margin, parts = _number(outcome, "the margin"), ()
        self._falsifier.observe(x, *for_search(self._goal, margin, parts, has_scale=self._has_scale))
        if self._worst is None or margin < self._worst[1]:
            self._worst = x, margin
        return margin

    def _trajectory(self, x: Start, outcome: object) -> Trajectory:
        if not isinstance(outcome, Trajectory | Mapping):
            what = shortened(repr(outcome), 60)
            raise PerfboundError(
                f"{what} is no trajectory of the specification; give a pb.Trajectory, or a dict of its columns"
            )
        found = of_columns(outcome)
        missing = set(self._spec.recorded) - set(found.columns)
        return with_signals(found, self._spec, self._values(x)) if missing else found

    def _values(self, x: Start) -> dict[str, Any]:
        return start_values(self._spec, x, self._horizon)

    def __repr__(self) -> str:
        """Return how many starts were told and asked for, and the least margin."""
        found = "" if self._worst is None else f", least margin {self._worst[1]:g}"
        told = counted(self._falsifier.observations, "start")
        return f"<Search over {', '.join(self._names)}: {told} told, {len(self._open)} open{found}>"


def _config(keys: Mapping[str, Any], specification: str | None, discrete: Collection[str]) -> CampaignConfig:
    """Return the campaign with this search: of a rig that has the columns of the specification."""
    if specification is None and keys["falsify"]:
        raise CampaignError("Search: scale: is about the predicates of a specification; give one, or leave it out")
    if not isinstance(keys["space"], Mapping) or "scenarios" in keys["space"]:
        raise CampaignError(NO_BOX)
    names = {MARGIN} if specification is None else _columns(specification)
    inputs = {name for name, each in keys["space"].items() if isinstance(each, Mapping) and each.keys() & OVER_TIME}
    # Of a formula about inputs alone any column: a rig has one.
    named = sorted(names - inputs - {"t"}) or [MARGIN]
    table = {
        "name": "search",
        "specification": f"{MARGIN} >= 0" if specification is None else specification,
        "method": "sample",
        "clip": LIMITS,
        "system": {"rig": "search", "columns": {name: DISCRETE if name in discrete else "" for name in named}},
    }
    config = parse_campaign(toml({**table, **keys}, "Search").encode(), "Search")
    if not isinstance(config.space, dict):
        raise CampaignError(NO_BOX)
    return config


def _columns(specification: str) -> frozenset[str]:
    try:
        return columns(parse_formula(specification))
    except ValueError as error:
        raise CampaignError(f"Search: specification: {error}") from None


def _check_formula(config: CampaignConfig, spec: SystemSpec, specification: str) -> None:
    """Refuse a formula that compares whole numbers of no discrete column, and a scale that does not fit it."""
    try:
        tree = parse_formula(specification, spec.units)
    except ValueError as error:
        raise CampaignError(f"Search: specification: {error}") from None
    if config.falsify is not None and config.falsify.scale is not None:
        check_scale(config.falsify.scale, tree, "Search")


def _spec(config: CampaignConfig) -> SystemSpec:
    """Return the rig of a search, with its inputs over time as parameters."""
    return as_in_campaign(rig_spec(config.system, tuple(space_parameters(config, "Search"))), config)


def _same(one: Mapping[str, Any], other: object) -> bool:
    return isinstance(other, Mapping) and dict(one) == dict(other)


def _number(value: object, name: str) -> float:
    try:
        return real_number(value)
    except ValueError as error:
        raise PerfboundError(f"{name} {error}") from None
