"""Errors that a person can act on: one line that says what, where and the remedy."""


class PerfboundError(Exception):
    """A known error; its text is what the user sees, and the command exits with 1."""


class EvidenceError(PerfboundError):
    """A trajectory file is missing, or is not the one that was recorded."""


class RequestError(EvidenceError):
    """A trajectory was simulated for another request than the one that it answers."""


class JournalError(PerfboundError):
    """The campaign database cannot be used as it is."""


class IllegalEvent(ValueError):  # noqa: N818  (h11's convention: what happened, not what failed)
    """An event that the present state of a core does not allow; the state is unchanged."""


class Stopped(BaseException):
    """A signal asks the orchestrator to stop; everything that was recorded is durable.

    Not an Exception: like KeyboardInterrupt, nothing may swallow it.
    """

    def __init__(self, signal: int) -> None:
        super().__init__(f"stopped by signal {signal}")
        self.signal = signal
