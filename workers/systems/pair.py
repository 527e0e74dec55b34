"""Two simulators as one system: one simulates the variant `nominal`, the other one the variant `true`.

A worker that has one of them alone simulates that variant. Both record the columns that the campaign file names.
"""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from ...schemas.errors import DefinitionError, SimulationError, UnknownSystemError
from ...schemas.file.space import SystemChoice
from ...schemas.system import Parameter, SystemSpec, Variant, timed_columns
from ...schemas.system_check import Acts
from ...schemas.trajectory.trajectory import Trajectory, Visual
from .base import Floats, SystemUnderTest, Vectorised, acts_of
from .described import DescribedSystem, fixed_option


class Half(DescribedSystem):
    """One of the simulators: its columns are those of the pair, its options those of the file; it has one variant."""

    def __init__(
        self, system: SystemUnderTest, variant: Variant, choice: SystemChoice, columns: Mapping[str, str], pair: str
    ) -> None:
        self._system, own = system, system.spec
        self._simulated: Variant = variant if variant in own.variants else own.variants[0]
        self._options = {each.name: each.default for each in own.options} | choice.options
        self._places = [0, *(_place(own, name, unit, variant) for name, unit in columns.items())]
        if unknown := choice.options.keys() - {each.name for each in own.options}:
            raise DefinitionError(f"{variant}.{min(unknown)}: {own.name} has no such option")
        random = self._simulated in own.noisy
        spec = own.model_copy(
            update={
                "name": pair,
                "columns": timed_columns(columns, own.after_end),
                "options": tuple(fixed_option(name, value) for name, value in sorted(self._options.items())),
                "variants": (variant,),
                "noisy": (variant,) if random else (),
                "residual": own.residual if random else True,
                "reported": tuple(each for each in own.reported if random and each.name in columns),
            }
        )
        super().__init__(spec)
        self._own = own.own_columns

    def rollout(self, x: Sequence[Any], **arguments: Any) -> Trajectory:
        """Simulate with the simulator; raises as that."""
        found = self._system.rollout(x, **self._translated(arguments))
        if found.columns != self._own:
            raise SimulationError(f"{self._system.spec.name} returned the columns {found.columns}, not its own")
        return Trajectory(self._spec.own_columns, np.ascontiguousarray(found.samples[:, self._places]))

    def rollouts(self, starts: Floats, **arguments: Any) -> object:
        """Simulate many with a vectorised simulator; raises as that."""
        found = np.asarray(cast(Vectorised, self._system).rollouts(starts, **self._translated(arguments)))
        return found[:, :, self._places]

    def acted(self) -> Acts | None:
        """Return what a policy did in the last rollout of the simulator."""
        return acts_of(self._system)

    def _translated(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        # What the other one alone takes.
        kept = {key: each for key, each in arguments.items() if key != "disturbances" or self._spec.disturbances}
        return {**kept, "variant": self._simulated, "options": self._options}


class TwoSimulators(SystemUnderTest):
    """The system that consists of both."""

    def __init__(self, name: str, halves: Mapping[Variant, Half | str]) -> None:
        self.name = name
        self._halves = halves
        """Of each variant the simulator, or the reason why it is not here."""
        self._spec: SystemSpec | None = None

    @property
    def spec(self) -> SystemSpec:
        """The specification of both together.

        Raises:
            UnknownSystemError: one is not here.
            DefinitionError: they do not fit together.

        """
        if self._spec is None:
            self._spec = _joined(self.name, self.half("nominal").spec, self.half("true").spec)
        return self._spec

    @property
    def present(self) -> dict[Variant, SystemSpec]:
        """The simulators that are here, by their variants."""
        return {variant: each.spec for variant, each in self._halves.items() if isinstance(each, Half)}

    def half(self, variant: Variant) -> Half:
        """Return the simulator of a variant; raises UnknownSystemError if it is not here."""
        found = self._halves[variant]
        if isinstance(found, str):
            raise UnknownSystemError(f"{variant}: {found}")
        return found

    def rollout(self, x: Sequence[Any], *, variant: Variant, **arguments: Any) -> Trajectory:
        """Simulate with the simulator of the variant; raises as that."""
        return self.half(variant).rollout(x, variant=variant, **arguments)

    def rollouts(self, starts: Floats, *, variant: Variant, **arguments: Any) -> object:
        """Simulate many with vectorised simulators; raises as they."""
        return self.half(variant).rollouts(starts, variant=variant, **arguments)

    def visual(self, trajectory: Trajectory) -> Visual:  # noqa: ARG002  (the same for all)
        """Return a plot of every column."""
        return Visual(plots=True)


def _place(spec: SystemSpec, name: str, unit: str, variant: Variant) -> int:
    """Return the place of a column among those of a simulator, which has to have its unit."""
    known = {each.name: each.unit for each in spec.columns if each.name in spec.own_columns}
    if name not in known:
        raise DefinitionError(f"columns: {name!r} is no column of {variant}: {', '.join(known)}")
    if unit != known[name]:
        raise DefinitionError(f"columns: {name} is in {known[name] or 'no unit'!r} in {variant}, and not in {unit!r}")
    return spec.own_columns.index(name)


def _joined(name: str, nominal: SystemSpec, true: SystemSpec) -> SystemSpec:
    """Return the specification of two simulators as one system."""
    both = (nominal, true)
    if nominal.after_end != true.after_end:
        raise DefinitionError(
            f"after_end: is {nominal.after_end} in nominal, and {true.after_end} in true; make it equal"
        )
    declaring = [each for each in both if each.disturbances]
    if len(declaring) == 2 and nominal.disturbances != true.disturbances:
        raise DefinitionError("disturbances: those of nominal and true differ; declare the same in both, or in one")
    horizons = [each.default_horizon for each in both if each.default_horizon is not None]
    return SystemSpec(
        name=name,
        doc=f"nominal: {nominal.doc}; true: {true.doc}",
        parameters=tuple(_shared(nominal, true)),
        columns=nominal.columns,
        variants=("nominal", "true"),
        noisy=(*nominal.noisy, *true.noisy),
        max_horizon=min(each.max_horizon for each in both),
        default_horizon=min(horizons, default=None),
        timed=any(each.timed for each in both),
        versions=_united(nominal.versions, true.versions),
        code=_united(nominal.code, true.code),
        seed_bits=min(each.seed_bits for each in both),
        stamps=next((each for each in ("accumulated", "float32") if each in (nominal.stamps, true.stamps)), "exact"),
        after_end=nominal.after_end,
        vectorised=all(each.vectorised for each in both),
        batch_is_the_unit=all(each.vectorised for each in both) and any(each.batch_is_the_unit for each in both),
        disturbances=declaring[0].disturbances if declaring else (),
        undisturbed=tuple(each.variants[0] for each in both if declaring and not each.disturbances),
        # Whether anything is random besides.
        residual=any(each.residual and each.noisy for each in both) or not declaring,
        simulators={each.variants[0]: each.digest for each in both},
    )


def _shared(nominal: SystemSpec, true: SystemSpec) -> list[Parameter]:
    """Return the parameters that both take, with the ranges that both allow."""
    names = [[(each.name, each.unit, each.signal) for each in spec.parameters] for spec in (nominal, true)]
    if names[0] != names[1]:
        listed = [", ".join(f"{name} ({unit})" if unit else name for name, unit, _ in each) for each in names]
        raise DefinitionError(
            f"the parameters of nominal are {listed[0]}, those of true {listed[1]}; give both the same ones, in the "
            "same order"
        )
    found = list[Parameter]()
    for one, other in zip(nominal.parameters, true.parameters, strict=True):
        low, high = max(one.low, other.low), min(one.high, other.high)
        if low > high:
            raise DefinitionError(f"{one.name}: the ranges of nominal and true have no value in common")
        found.append(one.model_copy(update={"low": low, "high": high}))
    return found


def _united(nominal: Mapping[str, str], true: Mapping[str, str]) -> dict[str, str]:
    """Return the files or packages of both; one of which each has another under the same name stands twice."""
    differing = {name for name in nominal.keys() & true.keys() if nominal[name] != true[name]}
    return {
        (f"{variant}: {name}" if name in differing else name): value
        for variant, found in (("nominal", nominal), ("true", true))
        for name, value in found.items()
    }
