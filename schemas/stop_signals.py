"""The signals that ask a process of perfbound to end."""

import signal

END_FAMILY = signal.SIGUSR1
"""Has the guardian of a worker end it at once, with everything below it."""


def stop_signals() -> tuple[signal.Signals, ...]:
    """Return the signals of Ctrl-C, of a service manager, and of a terminal or connection that closes.

    A process that began under `nohup` ignores the last one, and continues.
    """
    both = signal.SIGINT, signal.SIGTERM
    return both if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN else (*both, signal.SIGHUP)
