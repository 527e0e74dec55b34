"""A rig or a vehicle that a campaign file describes: its rollouts are logs, and no worker makes one."""

from pathlib import Path
from typing import Any, NoReturn

from ...schemas.errors import DefinitionError, SimulationError
from ...schemas.file.config import CampaignConfig
from ...schemas.file.logs import LogMapping, driven_column
from ...schemas.file.space import SystemChoice
from ...schemas.system import Parameter, SystemSpec, timed_columns
from .described import DescribedSystem, space_parameters

MAX_HORIZON = 1e6
"""Seconds: a test of eleven days."""


def rig_spec(
    choice: SystemChoice,
    parameters: tuple[Parameter, ...],
    max_horizon: float = MAX_HORIZON,
    doc: str = "measured, not simulated",
) -> SystemSpec:
    """Return the specification of a rig; the start that was driven is a column for each parameter with a tolerance.

    Raises:
        DefinitionError: a name is none.

    """
    columns, units = choice.columns or {}, {each.name: each.unit for each in parameters}
    for each in choice.tolerance or ():
        if each not in units:
            raise DefinitionError(f"tolerance.{each}: there is no such parameter, only {', '.join(units)}")
    driven = {driven_column(each): units[each] for each in choice.tolerance or ()}
    if clash := sorted(driven.keys() & columns.keys()):
        raise DefinitionError(f"columns.{clash[0]}: tolerance adds this column; leave it out")
    own = {key: law.named(key, law.unit or columns.get(key, "")) for key, law in (choice.reported or {}).items()}
    return SystemSpec(
        name=choice.rig or "",
        doc=doc,
        parameters=parameters,
        columns=timed_columns({**columns, **driven}, choice.after_end),
        variants=("nominal",),
        noisy=() if choice.noisy is False else ("nominal",),
        reported=tuple(own.values()),
        max_horizon=max_horizon,
        repeated="nowhere",
        stamps=choice.stamps or "exact",
        after_end=choice.after_end,
    )


class DescribedRig(DescribedSystem):
    """The rig of a campaign file, and how its logs become columns."""

    def __init__(self, spec: SystemSpec, choice: SystemChoice) -> None:
        super().__init__(spec)
        self.mapping, self.step, self.tolerance = choice.logs or LogMapping(), choice.step, choice.tolerance or {}

    def rollout(self, x: Any, **arguments: Any) -> NoReturn:  # noqa: ARG002  (of every system)
        """Raise SimulationError: nothing here drives it."""
        raise SimulationError(
            f"{self.spec.name} is a rig: hand its logs in, `perfbound import LOGS --starts starts.csv --campaign FILE`"
        )


def load_rig(path: Path, config: CampaignConfig) -> DescribedRig:
    """Return the rig of the campaign file `path`.

    Raises:
        DefinitionError: the file does not describe one.

    """
    choice = config.system
    assert choice.rig is not None
    if choice.options:
        raise DefinitionError(f"{path}: system.{next(iter(choice.options))}: a rig has no options; remove this key")
    try:
        spec = rig_spec(choice, tuple(space_parameters(config, str(path))))
    except DefinitionError as error:
        raise DefinitionError(f"{path}: system: {error}") from None
    return DescribedRig(spec, choice)
