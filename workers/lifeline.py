"""The end of a process with its parent."""

import ctypes
import signal

PR_SET_PDEATHSIG = 1
"""Of Linux: the signal that a process gets when its parent dies."""
PR_SET_CHILD_SUBREAPER = 36
"""Of Linux: a process becomes the parent of those below it whose own parent ends."""


def die_with_parent() -> None:
    """Have the kernel kill this process with its parent: no thread runs while a rollout has the lock of Python."""
    signal_with_parent(signal.SIGKILL)


def signal_with_parent(number: signal.Signals) -> None:
    """Have the kernel send this process a signal when its parent dies."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)


def adopt_orphans() -> None:
    """Keep all that this process has started below it, also what outlives a child of it."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
