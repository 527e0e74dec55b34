"""All checks of a campaign against its system: `schemas.file.against_system`, and those of the parsed formula."""

from collections.abc import Callable, Sequence
from functools import partial

from ...schemas.errors import CampaignError, check_all
from ...schemas.file.against_system import check_against
from ...schemas.file.config import CampaignConfig
from ...schemas.file.space import space_kind
from ...schemas.system import SystemSpec
from ..mathematics.stl.horizon import check_horizon
from ..mathematics.stl.parser import FormulaError, columns, parse_formula
from .objectives import LARGEST
from .starts import check_distributions, check_where


def check(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    """Refuse a campaign, read from `source`, that its system cannot run or whose claim would not follow.

    Raises:
        CampaignError: a line for each fault, with the source, the key and the remedy.

    """
    if config.system.name not in ("", spec.name):
        raise CampaignError(f"{source}: system.name: is {config.system.name!r}, the system here is {spec.name!r}")
    checks: list[Callable[[], None]] = [
        partial(check_against, config, spec, source),
        partial(_check_specification, config, spec, source),
    ]
    if isinstance(config.space, dict) and space_kind(config.space) == "distributions":
        checks.append(partial(check_distributions, config.space, source))
    if isinstance(config.space, dict) and config.where is not None:
        checks.append(partial(check_where, config.space, config.where, source))
    check_all(*checks)


def check_new(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    """Refuse what `check` refuses, and a clip that hides violations; campaigns that have begun may have one.

    Raises:
        CampaignError: a line for each fault, with the source, the key and the remedy.

    """
    check_all(partial(check, config, spec, source), partial(_check_new_clip, config, source))


def _check_new_clip(config: CampaignConfig, source: str) -> None:
    """Refuse a clip beyond what a campaign records, or one that hides violations."""
    if config.clip is not None and max(map(abs, config.clip)) > LARGEST:
        raise CampaignError(
            f"{source}: clip: {list(config.clip)} is beyond {LARGEST:g}; give a range of the robustness"
        )
    # Robustness is recorded clipped, and a violation is one below 0.
    if config.formula is not None and config.clip is not None and config.clip[0] >= 0:
        raise CampaignError(
            f"{source}: clip: its lower end {config.clip[0]:g} hides violations, which have a robustness below 0; "
            "choose one below 0"
        )


def _check_specification(config: CampaignConfig, spec: SystemSpec, source: str) -> None:
    known = [column.name for column in spec.columns]
    # A horizon that is missing has a line already.
    horizon = spec.max_horizon if config.horizon == 0 and spec.timed else config.horizon
    # One by one first, so that an error names the requirement.
    faults = []
    for each in config.specifications:
        try:
            check_horizon(parse_formula(each.formula, known), horizon)
        except FormulaError as error:
            faults.append(f"{source}: specifications.{each.name}: {error}")
    if faults:
        raise CampaignError(*faults)
    if config.formula is None:
        return
    try:
        formula = parse_formula(config.formula, known)
        check_horizon(formula, horizon)
        _check_gap(config, known, columns(formula), source)
    except FormulaError as error:
        raise CampaignError(f"{source}: specification: {error}") from None


def _check_gap(config: CampaignConfig, known: Sequence[str], read: frozenset[str], source: str) -> None:
    """Refuse a gap in one column where the robustness depends on others."""
    for problem in config.problems:
        gap = config.gap_of(problem)
        # The composition needs |rho(s) - rho(z)| <= L * gap: a gap in one column bounds nothing that others change.
        # An unknown column has a line already.
        if gap is not None and gap.kind == "signal_sup" and gap.column in known and read != {gap.column}:
            raise CampaignError(
                f"{source}: gap.column: {gap.column!r} does not bound the robustness: the specification reads "
                f'{", ".join(sorted(read)) or "no column"}; use kind = "predicate_sup", which fits every specification'
            )
