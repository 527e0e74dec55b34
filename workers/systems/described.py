"""The parts of a specification that every system takes from its campaign file."""

import re
from collections.abc import Iterator
from pathlib import Path

from ...schemas.file.config import CampaignConfig
from ...schemas.system import Option, OptionValue, Parameter


def space_parameters(config: CampaignConfig) -> Iterator[Parameter]:
    """Yield the parameters of `[space]`; those of a list of starts are x1, x2, ..., each with its range."""
    if not isinstance(config.space, dict):
        for k, values in enumerate(zip(*config.space.rows, strict=True)):
            yield Parameter(name=f"x{k + 1}", low=min(values), high=max(values))
        return
    for name, box in config.space.items():
        yield Parameter(name=name, unit=box.unit, low=box.low, high=box.high, signal=box.signal is not None)


def option_of(name: str, value: OptionValue) -> Option:
    """Return the option of a system for one that the file sets; a word has no other value."""
    return Option(name=name, default=value, choices=(value,) if isinstance(value, str) else ())


def name_of(path: str, otherwise: str) -> str:
    """Return the name of a system from that of its file; one without a letter in front begins with another word.

    >>> name_of("./Pendulum_2.sh", "program"), name_of("7.sh", "program")
    ('pendulum-2', 'program-7')
    """
    found = re.sub("[^a-z0-9]+", "-", Path(path).stem.lower()).strip("-")
    return found if re.match("[a-z]", found) else f"{otherwise}-{found}".strip("-")
