"""What is said on stderr while a command works, for people or, on request, for programs."""

import io
import json
import sys
from datetime import UTC, datetime
from functools import cached_property
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import Console


class JsonLines(io.TextIOBase):
    """A stream that makes one JSON object of every line: `time` (UTC), `level`, `message`, and what else is known."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._rest = ""

    def write(self, text: str) -> int:
        """Take text; whole lines are told."""
        *lines, self._rest = (self._rest + text).split("\n")
        for whole in lines:
            self.line(whole)
        return len(text)

    def line(self, message: str, *, level: str = "info", **fields: object) -> None:
        """Write one object."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._out.write(json.dumps({"time": now, "level": level, "message": message, **fields}, allow_nan=False) + "\n")
        self._out.flush()


class Talk:
    """Where a command says what happens; stdout is for data."""

    def __init__(self) -> None:
        self._json: JsonLines | None = None

    def as_json(self) -> None:
        """From now on say everything as JSON lines."""
        self._json = JsonLines(sys.stderr)

    @cached_property
    def console(self) -> "Console":
        """Return what prints to stderr."""
        from rich.console import Console  # noqa: PLC0415  (late: it costs a quick command a fifth of its time)

        return Console(stderr=True) if self._json is None else Console(file=self._json)  # type: ignore[arg-type]

    def fail(self, message: str) -> None:
        """Say why the command ends."""
        if self._json is None:
            sys.stderr.write(message + "\n")
        else:
            self._json.line(message, level="error")


TALK = Talk()
"""Of this process."""
