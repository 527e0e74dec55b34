"""Become a program under limits: `launch.py BYTES PARENT PROGRAM [ARGUMENT ...]`.

A process of its own, because limits that are set after the start come too late, and code between fork and exec is not
safe in a process with threads. It runs as a file, without perfbound.
"""

import ctypes
import os
import resource
import signal
import sys

PR_SET_PDEATHSIG = 1
NOT_STARTED = 127
"""Exit code, as in a shell."""


def main() -> None:
    """Set the limits of this process, and replace it by the program."""
    memory, parent, *command = sys.argv[1:]
    # A program that hangs must not outlive a worker that is killed.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != int(parent):
        sys.exit(NOT_STARTED)
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for number in (signal.SIGPIPE, signal.SIGXFSZ):  # which Python ignores, and a program would inherit
        signal.signal(number, signal.SIG_DFL)
    try:
        os.execvp(command[0], command)  # noqa: S606  (the program of the campaign file)
    except OSError as error:
        sys.stderr.write(f"{command[0]}: {error.strerror}\n")
        sys.exit(NOT_STARTED)


if __name__ == "__main__":
    main()
