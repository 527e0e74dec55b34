"""Checks of the words of a command before it loads what it needs: a typo is answered at once."""

import os
from pathlib import Path

import click


def check_directory(context: click.Context, _parameter: click.Parameter, directory: Path) -> Path:
    """Refuse a run directory without a campaign."""
    if not context.resilient_parsing and not os.path.isfile(directory / "campaign.db"):
        from ..store.rows import existing  # noqa: PLC0415

        existing(directory)
    return directory


def check_folder(context: click.Context, _parameter: click.Parameter, directory: Path) -> Path:
    """Refuse a folder that is not there."""
    if not context.resilient_parsing and not os.path.isdir(directory):
        from ...schemas.errors import PerfboundError  # noqa: PLC0415

        raise PerfboundError(f"{directory}: no such folder; name a run directory, or the folder with many of them")
    return directory


def check_campaign(context: click.Context, _parameter: click.Parameter, campaign: Path) -> Path:
    """Refuse a campaign file that is not there."""
    if not context.resilient_parsing and not os.path.isfile(campaign):
        from ...schemas.file.reader import file_and_place  # noqa: PLC0415

        file_and_place(campaign)
    return campaign


def check_reference(context: click.Context, parameter: click.Parameter, system: str | None) -> str | None:
    """Refuse FILE.py:NAME without that file, and a campaign file that cannot be read."""
    if context.resilient_parsing or system is None:
        return system
    if system.endswith(".toml"):
        from ...schemas.file.reader import load_description  # noqa: PLC0415

        load_description(Path(system))
    elif ".py:" in system and not os.path.exists(path := os.path.abspath(system.rpartition(":")[0])):
        from ...schemas.errors import DefinitionError  # noqa: PLC0415

        raise DefinitionError(f"{str(parameter.name).upper()}: {path}: there is no such Python file")
    return system
