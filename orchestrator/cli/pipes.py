"""Outputs whose reader may end first, as `head` does: what a command writes into files does not depend on them."""

import io
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, BinaryIO, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

BROKEN_PIPE = 128 + signal.SIGPIPE
"""Exit code where nobody read the whole of stdout: that of a program which the signal ends."""


class _Output(io.FileIO):
    """A descriptor that drops what nobody reads any more."""

    unread = False

    def write(self, data: "ReadableBuffer", /) -> int:
        """Write; after the reader has ended, drop the data.

        Raises:
            OSError: the disk under a file is full or fails; it names stdout, and none of the files of the command.

        """
        if not self.unread:
            try:
                return super().write(data)
            except BrokenPipeError:
                # Not SIG_DFL for SIGPIPE: it would kill a run in the middle, also where Zenoh writes to a closed link.
                self.unread = True
            except OSError as error:
                error.filename = "stdout"
                raise
        return memoryview(data).nbytes


class _News(_Output):
    """The descriptor of stderr: a line that a full disk does not take is lost, and nothing else."""

    def write(self, data: "ReadableBuffer", /) -> int:
        """Write, or drop the data."""
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


@contextmanager
def readers_may_end() -> Iterator[None]:
    """Let stdout and stderr lose their readers; a success whose stdout was not read to its end exits with 141."""
    before = sys.stdout, sys.stderr
    try:
        out, stdout = _unbroken(_Output, sys.stdout, by_line=sys.stdout.isatty())
        err, stderr = _unbroken(_News, sys.stderr, by_line=True)
    except (OSError, AttributeError):  # closed from the start
        yield
        return
    sys.stdout, sys.stderr = stdout, stderr
    try:
        yield
    except SystemExit as end:
        if end.code:
            raise
        stdout.flush()
        if out.unread:
            raise SystemExit(BROKEN_PIPE) from None
        raise
    finally:
        sys.stdout, sys.stderr = before
        for raw, text in ((out, stdout), (err, stderr)):
            try:
                text.flush()
            except OSError:  # a full disk, which has its line already
                raw.unread = True


def _unbroken(kind: type[_Output], stream: TextIO, *, by_line: bool) -> tuple[_Output, TextIO]:
    raw = kind(stream.fileno(), "w", closefd=False)
    text = io.TextIOWrapper(
        io.BufferedWriter(raw), encoding=stream.encoding, errors=stream.errors, line_buffering=by_line
    )
    return raw, text


@contextmanager
def stdout_bytes() -> Iterator[BinaryIO]:
    """Yield stdout for the rows of a table; the command ends with its reader, since the rest is work for nobody."""
    try:
        stream: BinaryIO = io.BufferedWriter(io.FileIO(sys.stdout.fileno(), "w", closefd=False))
    except io.UnsupportedOperation:  # no descriptor, in a test
        stream = sys.stdout.buffer
    try:
        yield stream
        stream.flush()
    except BrokenPipeError:
        sys.exit(BROKEN_PIPE)
