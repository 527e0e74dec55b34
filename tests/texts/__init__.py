"""What the product says, as text files: one for each subject, with a case under each head line.

`make texts` writes them, and a review reads the difference. The functions in `cases_*.py` make the cases from the
inputs of the unit tests, which assert facts alone.
"""

import re
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from perfbound.schemas.errors import PerfboundError
from perfbound.schemas.file.faults import faults

FOLDER = Path(__file__).parent
Cases = Iterator[tuple[str, str]]
"""Names and texts."""
Subject = Callable[[Path], Cases]
"""Makes the cases of a file; it may write to the folder that it gets, which is DIR in their texts."""
NAMELESS: dict[str, Any] = {"problems": [None] * 9, "specifications": [None] * 99}
"""A file whose problems and requirements go by their numbers."""
LONGEST = 100
"""Characters of the name of a case."""


def written(subject: Subject) -> str:
    """Return the content of a file."""
    found: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, text in subject(Path(folder)):
            head = _in_one_line(name.replace(folder, "DIR"))
            number = sum(each.partition(" #")[0] == head for each in found)
            found[f"{head} #{number + 1}" if number else head] = text.replace(folder, "DIR")
    return "\n".join(f"== {name}\n{_without_blanks_at_ends(text)}\n" for name, text in found.items())


def rows(test: Callable[..., object]) -> list[Any]:
    """Return the rows of the table of a parametrized test."""
    (found,) = (mark for mark in vars(test)["pytestmark"] if mark.name == "parametrize")
    return list(found.args[1])


def refusal(call: Callable[[], object]) -> str:
    """Return the lines with which a call is refused, or that it returns."""
    try:
        found = call()
    except ValidationError as error:
        return "\n".join(faults(error, NAMELESS, one_problem=False))
    except (PerfboundError, ValueError, TypeError, OSError) as error:
        return str(error)
    assert isinstance(found, str), "it was not refused"
    return found


def refusals(about: str, test: Callable[..., object], call: Callable[..., object]) -> Cases:
    """Yield a case for each row of a table whose last column has the facts of its refusal."""
    for row in rows(test):
        inputs = row[:-1]
        yield f"{about}: {', '.join(_name(each) for each in inputs)}", refusal(partial(call, *inputs))


def _name(value: object) -> str:
    return value if isinstance(value, str) else re.sub(r" at 0x\w+", "", repr(value))


def _in_one_line(name: str) -> str:
    line = re.sub(r"\s*\n\s*", " / ", name.strip())
    return line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."


def _without_blanks_at_ends(text: str) -> str:
    return "\n".join(line.rstrip() for line in text.rstrip("\n").split("\n"))
