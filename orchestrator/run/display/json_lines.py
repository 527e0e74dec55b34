"""A text stream that writes each line as one JSON object, for `--log json`."""

import io
import json
from datetime import UTC, datetime
from typing import TextIO


class JsonLines(io.TextIOBase):
    """A stream that makes one JSON object of every line: `time` (UTC), `level`, `message`, and other fields."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._rest = ""

    def write(self, text: str) -> int:
        """Take text; whole lines become objects."""
        *lines, self._rest = (self._rest + text).split("\n")
        for whole in lines:
            self.line(whole)
        return len(text)

    def line(self, message: str, *, level: str = "info", **fields: object) -> None:
        """Write one object."""
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        self._out.write(json.dumps({"time": now, "level": level, "message": message, **fields}, allow_nan=False) + "\n")
        self._out.flush()
