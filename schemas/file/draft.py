"""The draft of a campaign file: system, space and specification, and no constants of a kernel yet."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import CampaignError
from .config import CampaignConfig
from .defaults import completed, leaves_out_problems
from .objectives import OBJECTIVES, any_of
from .reader import Beside, campaign_table, file_and_place, validated

CLIP = (-1e100, 1e100)
"""Stands in for a clip that the draft leaves open: no value is beyond it."""
STAND_INS: Mapping[str, Mapping[str, Any]] = {
    "rigorous": {"alpha": 1.0, "rkhs_norm": 1.0, "noise_scale": "derived", "kernel": {"length_scale": 1.0}},
    "kriging": {"rkhs_norm": 1.0, "kernel": {"length_scale": 1.0}},
}
"""The constants that a draft may leave open: a row for each method that is calibrated."""
NOT_CALIBRATED: Mapping[str, str] = {
    "claims": "decides what is claimed, not the constants; calibrate a copy of the file without it",
    "falsify": "a search needs no constants of a kernel; run the file as it is, or remove falsify",
    "specifications": "each requirement has constants of its own; calibrate one of them at a time as `specification`",
}
"""Keys that a draft has not, and why."""
_LINEARISED = {"centre": 0.0, "spread": 1.0}
DRAFT_METHOD = "rigorous"
"""Of a problem that names none."""


@dataclass(frozen=True, slots=True)
class Draft:
    """A draft that was read."""

    config: CampaignConfig
    """With stand-ins for the constants that the file leaves open."""
    table: Mapping[str, Any]
    """The file as it is written."""

    @property
    def clip(self) -> tuple[float, float] | None:
        """The clip of the file."""
        return self.config.clip if "clip" in self.table else None

    def given(self, number: int) -> Mapping[str, Any]:
        """Return the keys of a problem as the file gives them, over those of the campaign."""
        return self.table if leaves_out_problems(self.table) else {**self.table, **self.table["problems"][number]}

    def names_method(self, number: int) -> bool:
        """Whether the file says which method a problem has."""
        return "method" in self.given(number)


def load_draft(path: Path) -> Draft:
    """Read a campaign file whose constants of a kernel, and whose clip, may be missing.

    Raises:
        CampaignError: it cannot be read, or is no campaign for methods with a kernel; one line with the remedy.

    """
    return parse_draft(*file_and_place(path))


def parse_draft(data: bytes, source: str, beside: Beside | None = None) -> Draft:
    """Read the bytes of a draft; raises as `load_draft`."""
    table = campaign_table(data, source, beside)
    for key, reason in NOT_CALIBRATED.items():
        if key in table:
            raise CampaignError(f"{source}: {key}: {reason}")
    if leaves_out_problems(table):
        found = _completed_problem(table)
    elif isinstance(table["problems"], list):
        found = {**table, "problems": [_completed_problem(each) for each in table["problems"]]}
    else:
        found = table  # at fault, which is reported below
    config = validated(completed({"clip": list(CLIP), **found}, Path(source).stem), table, source)
    for problem in config.problems:
        if problem.method not in STAND_INS:
            raise CampaignError(
                f"{source}: problems.{problem.name}.method: {problem.method!r} has no constants that can be "
                f"calibrated; choose {any_of(tuple(STAND_INS))}, or run the file as it is"
            )
    if not isinstance(config.space, dict):
        raise CampaignError(
            f"{source}: space: a kernel on a list of starts cannot be calibrated; give a range per parameter, or "
            "choose method 'scenario', which needs no kernel"
        )
    return Draft(config, table)


def _completed_problem(problem: Any) -> Any:
    """Return the table of a problem with stand-ins for its constants."""
    method = str(problem.get("method", DRAFT_METHOD)) if isinstance(problem, Mapping) else ""
    if method not in STAND_INS:
        return problem
    found = {"method": method, **STAND_INS[method], **problem}
    objective = OBJECTIVES.get(problem.get("name", "robustness"))
    if objective is not None and objective.measured == "column" and "noise_scale" not in problem:
        found["noise_scale"] = 1.0  # no clip bounds the noise of a column
    if objective is not None and objective.risk:
        found = {"linearised": _LINEARISED, **found}
    if "slack" in found and "alpha" not in problem:
        del found["slack"]  # a share of the tolerance that is still open
    return found
