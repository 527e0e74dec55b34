"""The end of a process with its parent."""

import ctypes
import signal

PR_SET_PDEATHSIG = 1
"""Of Linux: the signal that a process gets when its parent dies."""


def die_with_parent() -> None:
    """Have the kernel kill this process with its parent: no thread runs while a rollout has the lock of Python."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
