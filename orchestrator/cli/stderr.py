"""The stderr of a command: a console and the final error, as text or JSON lines."""

import sys
from functools import cached_property
from typing import TYPE_CHECKING

from ..run.display.json_lines import JsonLines

if TYPE_CHECKING:
    from rich.console import Console


class Stderr:
    """The stderr of a command; stdout is for data."""

    def __init__(self) -> None:
        self._json: JsonLines | None = None

    def as_json(self) -> None:
        """Write JSON lines from now on."""
        self._json = JsonLines(sys.stderr)

    @cached_property
    def console(self) -> "Console":
        """Return the console of stderr."""
        from rich.console import Console  # noqa: PLC0415  (late: it costs a quick command a fifth of its time)

        return Console(stderr=True) if self._json is None else Console(file=self._json)  # type: ignore[arg-type]

    def fail(self, message: str) -> None:
        """Write the error that ends the command."""
        if self._json is None:
            sys.stderr.write(message + "\n")
        else:
            self._json.line(message, level="error")


STDERR = Stderr()
"""Of this process."""
