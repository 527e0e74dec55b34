"""The host as a process finds it: its name, and what it does not allow."""

import os

_NO_THREAD = "can't start new thread"
_NO_ROOM = ("failed to map segment", "cannot allocate memory", "Cannot allocate memory")
"""Of libraries that the dynamic linker cannot load."""


def host_name() -> str:
    """Return the name of this host; bytes that are no UTF-8 are replaced, as messages and the database need text."""
    return os.fsencode(os.uname().nodename).decode("utf-8", "replace")


def host_fault(error: BaseException) -> str | None:
    """Return what the host does not allow, and the remedy, if that is what an error says; None otherwise.

    >>> host_fault(RuntimeError("can't start new thread"))
    'no thread or memory is left: raise the limit of this shell or container (`ulimit -v`, `ulimit -u`)'
    >>> host_fault(UnicodeEncodeError("utf-8", "/tmp/\\udcff", 5, 6, "surrogates not allowed"))
    "'/tmp/\\\\udcff': this name is no UTF-8 text, which messages and the database need; rename it"
    >>> host_fault(ValueError("of something else"))
    """
    if isinstance(error, UnicodeEncodeError) and error.reason == "surrogates not allowed":
        return f"{error.object!a}: this name is no UTF-8 text, which messages and the database need; rename it"
    loading = isinstance(error, ImportError | OSError) and any(each in str(error) for each in _NO_ROOM)
    thread = isinstance(error, RuntimeError) and _NO_THREAD in str(error)
    if isinstance(error, MemoryError) or loading or thread:
        return "no thread or memory is left: raise the limit of this shell or container (`ulimit -v`, `ulimit -u`)"
    return None
