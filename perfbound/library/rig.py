"""A system that no simulator repeats: a rig, a vehicle, or another program's loop."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from ..schemas.errors import DefinitionError
from ..schemas.file.disturbance import Disturbance
from ..schemas.file.space import SystemChoice
from ..schemas.system import AfterEnd, Parameter, SystemSpec
from ..schemas.values import Stamps
from ..workers.systems.rig import rig_spec


@dataclass(frozen=True)
class Rig:
    """A system whose trajectories are handed in, by `Campaign.ask_tell`.

    `parameters` has the range and the unit of each parameter of the starting condition, `columns` the unit of each
    column of a trajectory, beside the time `t` in s; with `step`, in seconds, the time of a sample follows from its
    number. `noisy`: two trials from one start may differ. `tolerance` is how far, by parameter, the start that was
    driven may be from the one that was asked for. `reported`, `stamps` and `after_end` are as those of
    `@perfbound.system`.

    Raises:
        DefinitionError: a name is not one of a-z, 0-9 and _, or a range is none.

    >>> rig = Rig("brake-rig", parameters={"speed": Parameter(5, 30, unit="m/s")}, columns={"distance": "m"})
    >>> rig.spec.columns[0].name, rig.spec.repeated
    ('t', 'nowhere')

    """

    name: str
    parameters: Mapping[str, Parameter]
    columns: Mapping[str, str]
    noisy: bool = True
    step: float | None = None
    max_horizon: float = 3600.0
    doc: str = "measured, not simulated"
    tolerance: Mapping[str, float] | None = None
    reported: Mapping[str, Disturbance] | None = None
    stamps: Stamps = "exact"
    after_end: AfterEnd | None = None

    @property
    def choice(self) -> dict[str, Any]:
        """Its keys of `[system]` in a campaign file."""
        keys: dict[str, Any] = {"rig": self.name, "columns": dict(self.columns), "noisy": self.noisy}
        keys |= {"step": self.step, "after_end": self.after_end, "tolerance": self.tolerance}
        laws = {key: law.model_dump(mode="json", exclude_defaults=True) for key, law in (self.reported or {}).items()}
        keys |= {"stamps": None if self.stamps == "exact" else self.stamps, "reported": laws or None}
        return {key: value for key, value in keys.items() if value is not None}

    def __post_init__(self) -> None:
        """Refuse a description that is none."""
        _ = self.spec

    @property
    def spec(self) -> SystemSpec:
        """The specification of the rig."""
        try:
            parameters = (each.model_copy(update={"name": key}) for key, each in self.parameters.items())
            return rig_spec(SystemChoice(**self.choice), tuple(parameters), self.max_horizon, self.doc)
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
            place = ".".join(map(str, fault["loc"]))
            raise DefinitionError(f"rig {self.name!r}: {place}: {fault['msg']}") from None
        except DefinitionError as error:
            raise DefinitionError(f"rig {self.name!r}: {error}") from None
