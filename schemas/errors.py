"""The known errors: one family with one base, each one line of text with the place, the fault and the remedy."""

from collections.abc import Callable, Iterable


class PerfboundError(Exception):
    """perfbound cannot continue."""

    def __init__(self, text: str | None = None, *further: str) -> None:
        # The docstring of the class is the default text, so that no error is ever empty.
        self.lines = (text or str(type(self).__doc__).partition("\n")[0].removesuffix("."), *further)
        """One for each fault; most errors have one."""
        super().__init__("\n".join(self.lines))


class CampaignError(PerfboundError):
    """The campaign file cannot be run."""


def check_all(*checks: Callable[[], None]) -> None:
    """Call every check, also those after one that fails.

    Raises:
        CampaignError: with the lines of all that fail.

    """
    lines: list[str] = []
    for check in checks:
        try:
            check()
        except CampaignError as error:
            lines += error.lines
    if lines:
        raise CampaignError(*lines)


class LinkError(PerfboundError):
    """The endpoint cannot be used as asked."""


class SecretError(LinkError):
    """The secret of this user cannot be used."""


class AuthorityError(PerfboundError):
    """The certificate authority cannot be used as asked."""


class MessageError(PerfboundError):
    """The message is not acceptable."""


class SealError(MessageError):
    """The message does not show that its sender knows the secret."""


class TrajectoryError(PerfboundError):
    """The bytes are not one whole trajectory file."""


class EvidenceError(PerfboundError):
    """A trajectory file is missing, or is not the one that was recorded."""


class UnusableTrajectoryError(TrajectoryError, EvidenceError):
    """The file is intact, but its trajectory is not finite, not ordered or not whole, or has other columns."""


class RequestError(EvidenceError):
    """The trajectory was simulated for another request."""


class JournalError(PerfboundError):
    """The campaign database cannot be used as it is."""


class OtherVersionError(JournalError):
    """Another perfbound wrote the campaign database."""


class SignatureError(PerfboundError):
    """The key or the signature is not acceptable."""


class SimulationError(PerfboundError):
    """The rollout has no usable trajectory: a start outside the specification, or a state that is not finite."""


class ReplacedError(SimulationError):
    """A file of the system is another one than when the worker loaded the system."""


class UnknownSystemError(PerfboundError):
    """The system is not installed here."""


class DefinitionError(PerfboundError):
    """The system under test is not defined as it must be."""


class RefusedError(PerfboundError):
    """The orchestrator has refused this worker."""


class IllegalEvent(ValueError):  # noqa: N818  (the convention of h11: the event, not the failure)
    """An event that the present state of a machine does not allow; the state is unchanged.

    A fault of perfbound itself, so not in the family above: it ends with a traceback.
    """


class Stopped(BaseException):
    """A signal has stopped the orchestrator; everything that was recorded is durable.

    Not an Exception: like KeyboardInterrupt, no `except Exception` may catch it.
    """

    def __init__(self, signal: int, state: str = "nothing was changed") -> None:
        super().__init__(f"stopped by signal {signal}")
        self.signal = signal
        self.state = state
        """What has happened until then, in words."""


def one_line(message: str) -> str:
    """Return `message` as one line without control characters, since parts of it may be untrusted.

    >>> one_line("a\\nb\\x1b[2J")
    'a\\\\nb\\\\x1b[2J'
    """
    if message.isprintable():
        return message
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in message)


LONGEST_EXCERPT = 300
"""Characters that are kept of a text from outside."""
_GAP = " ... "


def shortened(text: str, longest: int = LONGEST_EXCERPT) -> str:
    """Return a text from outside as one line of at most `longest` characters, without its middle if it is longer.

    >>> shortened("a\\nb"), shortened("x" * 400 + " (cars.py, line 17)")[-25:]
    ('a\\\\nb', 'xxxxxx (cars.py, line 17)')
    """
    # Cut before it is escaped as well: it may have megabytes.
    return _cut(one_line(_cut(text, longest)), longest)


def _cut(text: str, longest: int) -> str:
    if len(text) <= longest:
        return text
    end = longest // 3  # where the place of a fault is named
    return text[: longest - end - len(_GAP)] + _GAP + text[-end:]


def nearest_name(given: str, allowed: Iterable[str]) -> str:
    """Return the one of the `allowed` names that is nearest to a misspelt one; empty if none is near.

    >>> nearest_name("Horizont", ["horizon", "seed"]), nearest_name("wind", ["gains"])
    ('horizon', '')
    """
    import difflib  # noqa: PLC0415  (late: only a mistake needs it)

    small = {each.lower(): each for each in allowed}
    near = difflib.get_close_matches(given.lower(), small, 1)
    return small[near[0]] if near else ""


def meant(given: str, allowed: Iterable[str]) -> str:
    """Return the question that a message has before the allowed names: `did you mean 'NAME'? `, or nothing."""
    near = nearest_name(given, allowed)
    return f"did you mean {near!r}? " if near else ""
